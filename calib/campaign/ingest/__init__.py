"""Laboratory files and recordings become a campaign: described, mapped, cut into runs."""

import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from calib.campaign import readers
from calib.campaign.ingest import guesses
from calib.campaign.ingest.guesses import count_unit, guessed_table_column, rises_evenly, stem_and_unit, usual_step
from calib.campaign.ingest.mapping import LogSection
from calib.campaign.logs import detect_wrap_bits
from calib.campaign.model import Note
from calib.campaign.readers import Layout, RawTable, read_recording, read_table, table
from calib.campaign.readers.recording import StreamContents, check_not_empty
from calib.campaign.settings import bracketed
from calib.errors import BadFileError, BadInputError
from calib.types import IntArray

WORKBOOK: Final = ".xlsx"
_LISTED_TEXTS: Final = 6
_FEW_ROWS: Final = 40
_MOSTLY_NUMBERS: Final = 0.8
_LEAST_NAMES: Final = 2
#: a table turned has a row a quantity
_MOST_QUANTITIES: Final = 200


OF_FOLDERS: Final = "their runs become one campaign; several vehicles: ingest one by one, then 'calib fleet'"


def folders_of(files: Iterable[Path]) -> str:
    """Return the names of files' folders; empty where it is one."""
    folders = sorted({str(file.parent) for file in files})
    return f"{len(folders)} folders, {folders[0]} .. {folders[-1]}" if len(folders) > 1 else ""


def listed_files(sources: Sequence[Path]) -> list[Path]:
    """Return the files of sources: files, rosbag2 folders, and other folders' files.

    Raises BadInputError where a source is missing, or none holds a file to read.
    """
    files: list[Path] = []
    for source in sources:
        if readers.is_bag_folder(source) or source.is_file():
            files.append(source)
        elif source.is_dir():
            files += _files_inside(source)
        else:
            raise BadInputError(f"{source}: found no such file; expected a log or a folder of logs; correct the path")
    if sources and not files:
        expected = f"tables, logs or recordings ({', '.join(readers.READERS)})"
        remedy = "name them, or the folder that holds them itself"
        raise BadInputError(f"sources: found no file to read{_inside(sources)}; expected {expected}; {remedy}")
    return files


def _inside(sources: Sequence[Path]) -> str:
    inside = [path for source in sources if source.is_dir() for path in sorted(source.iterdir())]
    names = list(dict.fromkeys(f"{path.name}/" if path.is_dir() else f"*{path.suffix}" for path in inside))
    return f" in {sources[0]}, which holds {', '.join(names[:3] + ['...'] * (len(names) > 3))}" if names else ""


def _files_inside(folder: Path) -> list[Path]:
    inside = [path for path in sorted(folder.iterdir()) if not path.name.startswith(".")]
    known, is_bag = readers.READERS, readers.is_bag_folder
    files = [path for path in inside if is_bag(path) or (path.is_file() and path.suffix.lower() in known)]
    if len(files) < 2:
        for path in inside:
            is_logs = path.is_dir() and not path.is_symlink() and path not in files
            files += _files_inside(path) if is_logs and not (path / "campaign.toml").is_file() else []
    return files


@dataclass(frozen=True, slots=True)
class ColumnContents:
    """A column."""

    name: str
    #: ``number``, ``text``, ``time`` or ``empty``
    kind: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    texts: tuple[str, ...] = ()
    n_empty: int = 0
    wrap_bits: int | None = None
    whole: bool = False
    form: str = ""
    does: str = ""
    #: median step other than 0; of times in s
    step: float = 0.0
    even: bool = False

    @property
    def span(self) -> float:
        """Largest less smallest number."""
        return (self.high or 0.0) - (self.low or 0.0)

    def words(self, alike: "Sequence[ColumnContents]") -> str:
        """Return the column in words; `alike`: of all files of its kind."""
        text = f"{self.name}: "
        if self.kind == "number":
            known = [end for c in alike for end in (c.low, c.high) if end is not None]
            ends = dict.fromkeys(f"{end(known):.6g}" for end in (min, max) if known)
            text += " to ".join(ends) + (f" {self.unit}" if self.unit and bracketed(self.name)[1] is None else "")
        elif self.kind == "time":
            spans = [c.high for c in alike if c.high]
            span = f", {min(spans):.4g} to {max(spans):.4g} s long" if spans else ""
            text += f"{self.texts[0]} and later, {self.form}" + span
        else:
            text += ", ".join(self.texts) if self.kind == "text" else "empty"
        if bits := next((c.wrap_bits for c in alike if c.wrap_bits), None):
            text += f"; a counter that overflows at {bits} bits"
        return text + (f"; {self.n_empty} empty" if self.n_empty and self.kind != "empty" else "")


@dataclass(frozen=True, slots=True)
class FileContents:
    """A file."""

    name: str
    recording: bool
    n_rows: int
    columns: tuple[ColumnContents, ...]
    remarks: tuple[str, ...]
    streams: tuple[StreamContents, ...] = ()
    properties: Mapping[str, str] = field(default_factory=dict)
    #: of a workbook; empty: the first with a table
    sheet: str = ""
    others: Mapping[str, tuple[ColumnContents, ...]] = field(default_factory=dict)
    #: of the same columns, this one among them; empty where alone
    alike_sheets: tuple[str, ...] = field(default=(), metadata={"json": False})
    runs_in_columns: bool = field(default=False, metadata={"json": False})
    #: files of like names that were not read
    unread: int = field(default=0, metadata={"json": False})

    def alike(self, other: "FileContents") -> bool:
        """Return whether both have the same columns."""
        return [column.name for column in self.columns] == [column.name for column in other.columns]


def file_contents(path: Path) -> FileContents:
    """Return what a file holds; of a workbook, its first table of runs.

    Raises BadFileError where it cannot be read.
    """
    shown = str(path)
    if readers.holds_recording(path):
        return _recording_contents(path, shown)
    names: list[str] = []
    if path.suffix.lower() == ".xlsx":
        from calib.campaign.readers.workbook import sheet_names

        names = sheet_names(path, shown)
    contents = _table_contents(path, shown, "")
    sheets: dict[str, FileContents] = {}
    for name in names if len(names) > 1 else ():
        with suppress(BadFileError):
            sheets[name] = _table_contents(path, shown, name)
    usual = [name for name, sheet in sheets.items() if len(sheet.columns) > 1 and sheet.n_rows]
    runs = [name for name in usual if any(guessed_table_column(one.name) == "run_id" for one in sheets[name].columns)]
    if (chosen := next(iter(runs or usual), None)) is None:
        return contents
    alike = tuple(name for name in usual if sheets[name].alike(sheets[chosen]))
    columns = together([sheets[name] for name in (chosen, *alike)])
    others = {name: sheets[name].columns for name in usual if name != chosen}
    first = contents.alike(sheets[chosen])
    contents = replace(contents, columns=columns) if first else replace(sheets[chosen], columns=columns, sheet=chosen)
    return replace(contents, others=others, alike_sheets=alike if len(alike) > 1 else ())


def together(files: Sequence[FileContents]) -> tuple[ColumnContents, ...]:
    """Return the columns of alike files or sheets, with the texts of all."""
    columns: tuple[ColumnContents, ...] = ()
    for same in zip(*(file.columns for file in files), strict=True):
        texts = dict.fromkeys(text for column in same for text in column.texts)
        columns += (replace(same[0], texts=tuple(texts)[:_LISTED_TEXTS]),)
    return columns


def _table_contents(path: Path, shown: str, sheet: str) -> FileContents:
    layout = Layout(sheet=sheet or None, lab=True)
    try:
        raw = read_table(path, shown, lambda _: True, layout)
    except BadFileError:
        layout, raw = _as_read(path, shown, layout)
    evidence = table.comma_evidence(list(raw.columns.values()))
    notes = list(raw.notes)
    columns = tuple(_column_contents(name, raw, shown, evidence, notes) for name in raw.columns)
    remarks = [one.text if one.where == shown else f"{one.where.partition(', ')[2]}: {one.text}" for one in notes]
    if layout.runs_in_columns:
        remarks.append("each run stands in a column; what follows is the table turned")
    return FileContents(shown, False, len(raw.line), columns, tuple(remarks), runs_in_columns=layout.runs_in_columns)


def _as_read(path: Path, shown: str, layout: Layout) -> tuple[Layout, RawTable]:
    turned, known, raw = replace(layout, runs_in_columns=True), _LEAST_NAMES, None
    with suppress(BadFileError):
        raw = read_table(path, shown, None, layout)
        known = max(known, _n_known(raw.columns))
    if raw is None or len(raw.line) <= _MOST_QUANTITIES:
        with suppress(BadFileError):
            other = read_table(path, shown, None, turned)
            if _n_known(other.columns) > known:
                return turned, other
    return layout, raw if raw is not None else read_table(path, shown, None, layout)


def _n_known(names: Iterable[str]) -> int:
    return len({target for name in names if (target := guessed_table_column(name))})


def _column_contents(name: str, raw: RawTable, shown: str, evidence: bool | None, notes: list[Note]) -> ColumnContents:
    cells: npt.NDArray[np.generic] = raw.columns[name]
    if name in raw.epochs:
        first, words = raw.written.get(name, (str(cells[0]), table.TIME_FORMATS["iso8601"][1]))
        high, step = float(np.nanmax(cells)), usual_step(cells.astype(np.float64))
        return ColumnContents(name, "time", low=0.0, high=high, form=words, texts=(first,), step=step)
    if cells.dtype == object:
        filled = table.filled_cells(cells.tolist())
        n_empty = len(cells) - len(filled)
        if filled and (form := table.format_words(filled)):
            step = usual_step(table.moments_ns(filled)[0] / table.NS_PER_S)
            return ColumnContents(name, "time", n_empty=n_empty, form=form, texts=(str(filled[0]),), step=step)
    try:
        values, _ = table.numbers(cells, shown, name, raw.line, evidence, notes)
    except BadFileError as error:
        if cells.dtype != object:
            return ColumnContents(name, "text", n_empty=len(cells))
        if sum(map(table.is_number, filled)) > _MOSTLY_NUMBERS * len(filled):
            text = f"found {error.found}; expected {error.expected}; {error.remedy}"
            notes.append(Note("suspicious", f"{shown}, row {error.row}, column {name}", text, "text_column"))
            return ColumnContents(name, "number", n_empty=n_empty)
        different = list(dict.fromkeys(str(cell).strip() for cell in filled))
        return ColumnContents(name, "text", texts=tuple(different[:_LISTED_TEXTS]), n_empty=n_empty)
    if not len(known := values[np.isfinite(values)]):
        return ColumnContents(name, "empty", n_empty=len(cells))
    whole = bool((known == np.rint(known)).all())
    bits = detect_wrap_bits(values, np.asarray([0, len(values)])) if whole and len(values) > _FEW_ROWS else None
    return ColumnContents(
        name,
        "number",
        unit=stem_and_unit(name)[1] or count_unit(name) or "",
        low=float(known.min()),
        high=float(known.max()),
        n_empty=len(values) - len(known),
        wrap_bits=bits,
        whole=whole,
        does="" if bits or len(known) <= _FEW_ROWS else guesses.behaviour(known, whole=whole),
        step=usual_step(known),
        even=rises_evenly(known),
    )


def _recording_contents(path: Path, shown: str) -> FileContents:
    recording = read_recording(path, shown)
    check_not_empty(recording, shown)
    columns: list[ColumnContents] = []
    for stream in recording.streams:
        line: IntArray = np.arange(1, len(stream) + 1, dtype=np.int64)
        for name in stream.columns:
            contents = _column_contents(name, RawTable(stream.columns, line), shown, None, [])
            columns.append(replace(contents, unit=stream.units.get(name, contents.unit)))
    longest = max((len(stream) for stream in recording.streams), default=0)
    remarks = tuple(note.text for note in recording.notes)
    streams = tuple(stream.contents() for stream in recording.streams)
    return FileContents(shown, True, longest, tuple(columns), remarks, streams, recording.properties)


def described(group: Sequence[FileContents], *, is_run_table: bool) -> list[str]:
    """Return remarks on files with the same columns."""
    file = group[0]
    n_files = len(group) + sum(member.unread for member in group)
    alike = f"{n_files} files" + (f", {len(group)} of them read," if n_files > len(group) else "") + " alike"
    title = file.name if n_files == 1 else f"{file.name} .. {Path(group[-1].name).name}, {alike}"
    what = "the run table" if is_run_table else "a recording" if file.recording else "a log"
    rows = [member.n_rows for member in group]
    count = f"{min(rows)}" if min(rows) == max(rows) else f"{min(rows)} to {max(rows)}"
    count += " samples" if file.recording else " rows" if min(rows) else " rows: a header alone, export it again"
    lines = wrapped(f"{title}: {what}, {count}", "# ")
    properties = [f"{key} = {value}" for key, value in list(file.properties.items())[:12]]
    streams = [f"{stream.name} ({stream.kind}): {stream.words()}" for stream in file.streams]
    for text in (*dict.fromkeys(file.remarks), *properties, *streams):
        lines += wrapped(text, "#   ")
    for sheet, columns in file.others.items():
        lines += wrapped(f"sheet {sheet!r}: {', '.join(column.name for column in columns)[:200]}", "#   ")
    for number, column in enumerate(file.columns):
        lines += wrapped(column.words([member.columns[number] for member in group]), "#     ")
    return [*lines, "#"]


def wrapped(text: str, lead: str, hanging: str = "  ") -> list[str]:
    """Return a text as remarks, further lines indented."""
    return textwrap.TextWrapper(78, lead, lead + hanging, break_long_words=False, break_on_hyphens=False).wrap(text)


def run_number(run_id: str, pattern: str | None) -> int | None:
    """Return the number in a run's name by a pattern (``Run {n}``), or the last one."""
    if pattern is None:
        numbers = re.findall(r"\d+", run_id)
        return int(numbers[-1]) if numbers else None
    before, _, after = pattern.partition("{n}")
    match = re.fullmatch(re.escape(before) + r"\s*0*(\d+)\s*" + re.escape(after), run_id.strip(), re.IGNORECASE)
    return int(match[1]) if match else None


_PARTS: Final = {
    "{date}": r"\d{2,4}[-_.]?\d{2}[-_.]?\d{2,4}",
    "{time}": r"\d{2}[-_.:h]?\d{2}([-_.:m]?\d{2})?s?([.,_]\d+)?",
    "*": r".*",
    "{run_id}": r"(?P<run>.+)",
    "{n": r"0*(?P<run>\d+)",
}


def expected_name(log: LogSection, run_id: str, pattern: str | None = None) -> str | None:
    """Return the name of a run's log; None without a pattern, or a number in the run's name.

    `pattern`: of ``log.files``; else ``log.file``.
    """
    pattern = pattern or log.file
    name = None if pattern is None else pattern.replace("{run_id}", run_id)
    if name is None or "{n" not in name:
        return name
    number = run_number(run_id, log.run)
    return None if number is None else with_number(name, number)


def with_number(pattern: str, number: int) -> str:
    """Return a pattern with a number for its ``{n}``, ``{n:03}`` or ``{n-1}``."""
    form = r"\{n(-1)?(?::0?(\d+))?\}"
    return re.sub(form, lambda match: str(number + int(match[1] or 0)).zfill(int(match[2] or 0)), pattern)


def fits_name(name: str, wanted: str) -> bool:
    """Return whether a file's name is the wanted one, in any letter case."""
    return _match(name, wanted.replace("\\", "/").rpartition("/")[2]) is not None


def with_folder(path: Path, pattern: str) -> str:
    """Return a file's name with as many folders before it as a pattern has."""
    return "/".join(path.parts[-1 - pattern.count("/") :])


def in_its_folder(path: Path, wanted: str) -> bool:
    """Return whether name and folders of a file are the wanted ones, in any letter case."""
    return _match(with_folder(path, wanted), wanted) is not None


def run_in(name: str, pattern: str) -> str | None:
    """Return what a file's name has for ``{n}`` or ``{run_id}``; None where it does not fit."""
    match = _match(name, pattern)
    return match.groupdict().get("run") if match else None


def _match(name: str, pattern: str) -> re.Match[str] | None:
    parts = re.split(r"(\{[a-z][^}]*\}|\*)", pattern)
    form = "".join(_PARTS.get(part[:2] if part[:2] == "{n" else part, re.escape(part)) for part in parts)
    return re.fullmatch(form, name, re.IGNORECASE)


def moment_of(cells: Iterable[Any]) -> tuple[str, ...]:
    """Return the first date and time in cells as digits, year or day first; else nothing."""
    days, second = 0, 0
    for cell in map(str, table.filled_cells(list(cells))):
        for text in (cell, f"{cell} 00:00"):
            with suppress(ValueError):
                day_and_time = divmod(table.moment_ns(text) // table.NS_PER_S, 86_400)
                days, second = days or day_and_time[0], second or day_and_time[1]
                break
    moment = datetime.fromtimestamp(86_400 * days + second, UTC)
    return (f"{moment:%Y%m%d%H%M}", f"{moment:%d%m%Y%H%M}") if days and second else ()


def names_moment(name: str, moment: Iterable[str]) -> bool:
    """Return whether a file's name has the date and time of `moment_of`."""
    return any(digits in re.sub(r"\D", "", name) for digits in moment)
