"""The contents of files: rows, columns with units and spans, streams with their clocks; and what columns may mean.

Column names are guessed by what laboratories call things, in English and German; nothing else is assumed.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from calib.campaign.columns import recognise, spelled
from calib.campaign.counters import detect_wrap_bits
from calib.campaign.ingest.mapping import TABLE_COLUMNS
from calib.campaign.model import LOG_COLUMNS
from calib.campaign.readers import RawTable, holds_recording, read_recording, read_table
from calib.campaign.readers.recording import Stream, check_not_empty
from calib.campaign.readers.table import TIME_FORMATS, comma_evidence, filled_cells, numbers, time_format
from calib.errors import BadFileError
from calib.types import IntArray
from calib.units import SUFFIXES, split_suffix

#: different texts of a column that are listed
_LISTED_TEXTS: Final = 6
#: rows up to which a column of whole numbers is no counter that overflows
_FEW_ROWS: Final = 40
#: properties of a recording that are listed
_LISTED_PROPERTIES: Final = 12
#: characters of a remark's line
_WIDTH: Final = 78

_COUNTS: Final = r"(impuls|count|enc|tick|inkrement|increment|zaehl|pulse|wheel|rad_|joint|drehgeber)"

#: column of the run table -> what its name may look like, letters lower and umlauts spelt out
_TABLE: Final[Sequence[tuple[str, str]]] = (
    ("run_id", r"(run|lauf|fahrt|messung|versuch|trial|test)(_?(id|no|nr|nummer|number|name))?\.?|nr\.?|id"),
    ("session", r"(sitzung|session|schicht|serie|messtag|tag|day)(_?(id|nr|no))?"),
    ("direction", r".*(richtung|direction|heading_of_run)"),
    ("kind", r"(art|route|kurs|course|kind|type|typ|streckenart|manoever|path)"),
    ("load_left_N", r"(rad)?last_?(li|links|left|l)|(wheel_)?load_(left|l)|f_?(left|l)"),
    ("load_right_N", r"(rad)?last_?(re|rechts|right|r)|(wheel_)?load_(right|r)|f_?(right|r)"),
    ("payload_x_m", r"(payload|last|zuladung|ladung|nutzlast)_?(x|vorn.*|laengs)|(abstand|lage)_?(vorn.*|x|laengs)"),
    ("payload_y_m", r"(payload|last|zuladung|ladung|nutzlast)_?(y|quer)|(versatz|quer|lage_?y).*"),
    ("payload_kg", r"(zuladung|nutzlast|beladung|ladung|payload|masse|mass|gewicht|load|last)"),
    ("speed_mps", r"(geschw.*|speed.*|velocity|tempo|v_?soll|v)"),
    ("temperature_C", r"temp.*"),
    ("minutes_under_load", r"(standzeit|minutes?_under_load|dwell.*)"),
    ("distance_m", r"(strecke|distanz|distance|weg|laenge|length|s_?o)(_.*)?"),
    ("counts_left", _COUNTS + r".*_?(l|li|links|left)"),
    ("counts_right", _COUNTS + r".*_?(r|re|rechts|right)"),
    ("ref_x_m", r"(ref|mocap|tracker|end)_?x"),
    ("ref_y_m", r"(ref|mocap|tracker|end)_?y"),
    ("ref_theta_rad", r"(ref|mocap|tracker|end)_?(theta|yaw|heading|winkel)"),
    ("excluded", r"(excluded|ungueltig|ausschluss|ausgeschlossen)"),
)
_LOG: Final[Sequence[tuple[str, str]]] = (
    ("t_s", r"(t|time|zeit|timestamp|zeitstempel|stamp|uhrzeit|datum_?zeit)(_.*)?"),
    ("counts_front_left", r".*(front_?(l|left)|v_?l|vorn.*links)"),
    ("counts_front_right", r".*(front_?(r|right)|v_?r|vorn.*rechts)"),
    ("counts_rear_left", r".*((rear|back)_?(l|left)|h_?l|hinten.*links)"),
    ("counts_rear_right", r".*((rear|back)_?(r|right)|h_?r|hinten.*rechts)"),
    ("counts_front", _COUNTS + r".*_?(front|vorn|vorne|v)"),
    ("counts_left", r"(" + _COUNTS + r".*_?)?(l|li|links|left)"),
    ("counts_right", r"(" + _COUNTS + r".*_?)?(r|re|rechts|right)"),
    ("steer_rad", r".*(steer|lenk).*"),
    ("range_m", r".*(laser|range|abstand|entfernung|distan[cz]|weg|strecke).*"),
    ("ref_x_m", r"((ref|mocap|pose|pos|tracker)_?)?x(_?true)?"),
    ("ref_y_m", r"((ref|mocap|pose|pos|tracker)_?)?y"),
    ("ref_theta_rad", r"((ref|mocap|pose|pos|tracker)_?)?(theta|yaw|heading|gier.*)"),
)

#: names of directions along a corridor -> out or back
DIRECTION_WORDS: Final = {
    **dict.fromkeys(("out", "hin", "vor", "vorwaerts", "hinfahrt", "hinweg", "forward", "there", "a", "ab"), "out"),
    **dict.fromkeys(("back", "zurueck", "rueck", "rueckwaerts", "rueckfahrt", "rueckweg", "return", "b", "ba"), "back"),
}


_UMLAUTS: Final = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss"})


def plain_text(text: str) -> str:
    """Return a text in lower case with umlauts spelt out."""
    return text.strip().lower().translate(_UMLAUTS)


def stem_and_unit(name: str) -> tuple[str, str | None]:
    """Return a column's name without its unit, plain, and the unit where it names one that calib knows.

    `name`: as found, for example ``Strecke [mm]`` or ``Weg in mm``.
    """
    in_words = re.sub(r"\s+in\s+(\S+)\s*$", r" [\1]", name.strip())
    stem, unit = split_suffix(spelled(in_words))
    return plain_text(re.sub(r"[.\s]+", "_", stem)).strip("_"), unit


def _guessed(name: str, words: Sequence[tuple[str, str]], known: Sequence[str]) -> tuple[str, str | None] | None:
    exact = recognise(name, known).name
    if exact in known:
        return exact, None
    stem, unit = stem_and_unit(name)
    for target, pattern in words:
        if re.fullmatch(pattern, stem):
            suffix = split_suffix(target)[1]
            if unit is None or target.startswith("counts_"):
                return target, None
            if suffix is not None and SUFFIXES[unit][0] == suffix:
                return target, unit
    return None


def guessed_table_column(name: str) -> tuple[str, str | None] | None:
    """Return the column of the run table that a name may mean, and its unit, or None."""
    return _guessed(name, _TABLE, TABLE_COLUMNS)


def guessed_log_column(name: str) -> tuple[str, str | None] | None:
    """Return the column of a log that a name may mean, and its unit, or None.

    `name`: as found; of a recording's ``stream:column`` or ``group/channel`` the last part counts first.
    """
    last = re.split(r"[:/]", name)[-1]
    last = re.sub(r"^(position|velocity|effort)\.", "", last)
    return _guessed(last, _LOG, LOG_COLUMNS) or _guessed(re.sub(r"[:/.]+", "_", name).strip("_"), _LOG, LOG_COLUMNS)


@dataclass(frozen=True, slots=True)
class ColumnContents:
    """A column."""

    name: str
    #: its cells: ``number``, ``text``, ``time`` or ``empty``
    kind: str
    #: the unit that its name or the file gives; empty where none is given
    unit: str = ""
    #: span of its numbers
    low: float | None = None
    high: float | None = None
    #: its different texts, where they are few
    texts: tuple[str, ...] = ()
    #: cells without a value
    n_empty: int = 0
    #: width of the counter that it looks like
    wrap_bits: int | None = None
    #: whether all its numbers are integers
    whole: bool = False
    #: what its times look like
    form: str = ""

    def words(self, alike: Sequence[ColumnContents]) -> str:
        """Return the column in words; `alike`: the same column of all files of its kind."""
        text = f"{self.name}: "
        if self.kind == "number":
            low, high = min(c.low for c in alike if c.low is not None), max(c.high for c in alike if c.high is not None)
            ends = dict.fromkeys((f"{low:.6g}", f"{high:.6g}"))
            text += " to ".join(ends) + (f" {self.unit}" if self.unit else "")
        elif self.kind == "time":
            spans = [c.high for c in alike if c.high]
            span = f", {min(spans):.4g} to {max(spans):.4g} s long" if spans else ""
            text += (self.form if self.texts else "times of the clock") + span
        else:
            text += ", ".join(self.texts) if self.kind == "text" else "empty"
        bits = next((c.wrap_bits for c in alike if c.wrap_bits), None)
        if bits:
            text += f"; a counter that overflows at {bits} bits"
        return text + (f"; {self.n_empty} empty" if self.n_empty and self.kind != "empty" else "")


@dataclass(frozen=True, slots=True)
class StreamContents:
    """A stream of a recording, with what its clock shows; zeros where it has none."""

    name: str
    kind: str
    n_samples: int
    clock: str
    columns: tuple[str, ...]
    span_s: float = 0.0
    rate_Hz: float = 0.0
    n_gaps: int = 0
    longest_gap_s: float = 0.0
    start_ns: int | None = None
    behind_arrival_s: float | None = None

    @staticmethod
    def of(stream: Stream) -> StreamContents:
        """Return the contents of a stream as read."""
        contents = StreamContents(stream.name, stream.kind, len(stream), stream.clock, tuple(stream.columns))
        report = stream.report()
        if report is not None:
            names = ("span_s", "rate_Hz", "n_gaps", "longest_gap_s", "start_ns")
            contents = replace(contents, **{name: getattr(report, name) for name in names})
        return replace(contents, behind_arrival_s=stream.behind_arrival_s)

    def words(self) -> str:
        """Return the stream in words."""
        text = f"{self.name} ({self.kind}): {self.n_samples} samples"
        if self.start_ns is None:
            return text + ", without a clock"
        text += f" over {self.span_s:.5g} s at {self.rate_Hz:.4g} Hz, clock: {self.clock}"
        return text + (f", {self.n_gaps} gap(s) up to {self.longest_gap_s:.3g} s" if self.n_gaps else "")


@dataclass(frozen=True, slots=True)
class FileContents:
    """A file."""

    #: as given
    name: str
    #: whether it holds streams rather than one table
    recording: bool
    #: rows, or samples of the longest stream
    n_rows: int
    columns: tuple[ColumnContents, ...]
    #: what was recognised: separator, header row, sheet, encoding, decimal commas, times
    remarks: tuple[str, ...]
    #: of a recording
    streams: tuple[StreamContents, ...] = ()
    #: properties that a recording names
    properties: Mapping[str, str] = field(default_factory=dict)

    def alike(self, other: FileContents) -> bool:
        """Return whether another file has the same columns."""
        return [column.name for column in self.columns] == [column.name for column in other.columns]


def file_contents(path: Path) -> FileContents:
    """Return what a file holds.

    Raises BadFileError where it cannot be read.
    """
    shown = str(path)
    if holds_recording(path):
        return _recording_contents(path, shown)
    try:
        raw = read_table(path, shown, lambda _: True)
    except BadFileError:
        # texts among the columns: as read, and each column looked at by itself
        raw = read_table(path, shown)
    evidence = comma_evidence(list(raw.columns.values()))
    columns = tuple(_column_contents(name, raw, shown, evidence) for name in raw.columns)
    remarks = [
        note.text if note.where == shown else f"{note.where.partition(', ')[2]}: {note.text}" for note in raw.notes
    ]
    return FileContents(shown, False, len(raw.line), columns, tuple(remarks))


def _column_contents(name: str, raw: RawTable, shown: str, evidence: bool | None) -> ColumnContents:
    cells: npt.NDArray[np.generic] = raw.columns[name]
    if name in raw.epochs:
        high = float(np.nanmax(cells)) if len(cells) else 0.0
        return ColumnContents(name, "time", low=0.0, high=high, form="times of the clock")
    if cells.dtype == object:
        filled = filled_cells(cells.tolist())
        n_empty = len(cells) - len(filled)
        if not filled:
            return ColumnContents(name, "empty", n_empty=n_empty)
        first = str(filled[0])
        if form := time_format(first):
            return ColumnContents(name, "time", n_empty=n_empty, form=TIME_FORMATS[form], texts=(first,))
    try:
        values, _ = numbers(cells, shown=shown, column=name, line=raw.line, decimal_comma=evidence)
    except BadFileError:
        if cells.dtype != object:
            return ColumnContents(name, "text", n_empty=len(cells))
        different = list(dict.fromkeys(str(cell).strip() for cell in filled))
        return ColumnContents(name, "text", texts=tuple(different[:_LISTED_TEXTS]), n_empty=n_empty)
    known = values[np.isfinite(values)]
    if not len(known):
        return ColumnContents(name, "empty", n_empty=len(cells))
    whole = bool((known == np.rint(known)).all())
    bits = detect_wrap_bits(values, np.asarray([0, len(values)])) if whole and len(values) > _FEW_ROWS else None
    return ColumnContents(
        name,
        "number",
        unit=stem_and_unit(name)[1] or "",
        low=float(known.min()),
        high=float(known.max()),
        n_empty=len(values) - len(known),
        wrap_bits=bits,
        whole=whole,
    )


def _recording_contents(path: Path, shown: str) -> FileContents:
    recording = read_recording(path, shown)
    check_not_empty(recording, shown)
    columns: list[ColumnContents] = []
    for stream in recording.streams:
        line: IntArray = np.arange(1, len(stream) + 1, dtype=np.int64)
        for name in stream.columns:
            contents = _column_contents(name, RawTable(stream.columns, line), shown, None)
            columns.append(replace(contents, unit=stream.units.get(name, contents.unit)))
    longest = max((len(stream) for stream in recording.streams), default=0)
    remarks = tuple(note.text for note in recording.notes)
    streams = tuple(map(StreamContents.of, recording.streams))
    return FileContents(shown, True, longest, tuple(columns), remarks, streams, recording.properties)


def described(group: Sequence[FileContents], *, is_run_table: bool) -> list[str]:
    """Return remarks that say what files with the same columns hold, the first of them in particular."""
    file = group[0]
    title = file.name if len(group) == 1 else f"{file.name} .. {Path(group[-1].name).name}, {len(group)} files alike"
    what = "the run table" if is_run_table else "a recording" if file.recording else "a log"
    rows = [member.n_rows for member in group]
    count = f"{min(rows)}" if min(rows) == max(rows) else f"{min(rows)} to {max(rows)}"
    lines = wrapped(f"{title}: {what}, {count} {'samples' if file.recording else 'rows'}", "# ")
    properties = [f"{key} = {value}" for key, value in list(file.properties.items())[:_LISTED_PROPERTIES]]
    for text in (*dict.fromkeys(file.remarks), *properties, *(stream.words() for stream in file.streams)):
        lines += wrapped(text, "#   ")
    for number, column in enumerate(file.columns):
        lines += wrapped(column.words([member.columns[number] for member in group]), "#     ")
    return [*lines, "#"]


def wrapped(text: str, lead: str, hanging: str = "  ") -> list[str]:
    """Return a text as remarks, each line after the first indented further."""
    further = lead + hanging
    return textwrap.wrap(
        text, _WIDTH, initial_indent=lead, subsequent_indent=further, break_long_words=False, break_on_hyphens=False
    )
