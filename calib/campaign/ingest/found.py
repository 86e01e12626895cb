"""What is in a file: rows, columns with units and spans, streams with their clocks; nothing is assumed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from calib.campaign.ingest.words import stem_and_unit
from calib.campaign.readers import RawTable, holds_recording, read_recording, read_table
from calib.campaign.readers.recording import refuse_nothing
from calib.campaign.readers.table import comma_evidence, numbers
from calib.campaign.readers.times import TIME_FORMATS, time_format
from calib.campaign.wraps import detect_wrap_bits
from calib.errors import BadFileError

_TEXTS: int = 6
_FEW_TEXTS: int = 40


@dataclass(frozen=True, slots=True)
class ColumnFound:
    """A column."""

    name: str
    #: what its cells are: ``number``, ``text``, ``time`` or ``empty``
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
    #: what times look like
    form: str = ""


@dataclass(frozen=True, slots=True)
class StreamFound:
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


@dataclass(frozen=True, slots=True)
class FileFound:
    """A file."""

    #: as given
    name: str
    #: whether it holds streams rather than one table
    recording: bool
    #: rows, or samples of the longest stream
    n_rows: int
    columns: tuple[ColumnFound, ...]
    #: what was recognised: separator, header row, sheet, encoding, decimal commas, times
    remarks: tuple[str, ...]
    #: of a recording
    streams: tuple[StreamFound, ...] = ()
    #: what a recording says of itself
    properties: Mapping[str, str] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return asdict(self)


def look_into(path: Path) -> FileFound:
    """Return what a file holds.

    Raises BadFileError where it cannot be read.
    """
    shown = str(path)
    if holds_recording(path):
        return _recording(path, shown)
    try:
        raw = read_table(path, shown, lambda _: True)
    except BadFileError:
        # texts among the columns: as read, and each column looked at by itself
        raw = read_table(path, shown)
    columns = _columns(raw, shown)
    remarks = [
        note.text if note.where == shown else f"{note.where.partition(', ')[2]}: {note.text}" for note in raw.notes
    ]
    return FileFound(shown, False, len(raw.line), tuple(columns), tuple(remarks))


def _columns(raw: RawTable, shown: str) -> list[ColumnFound]:
    texts = [cells for cells in raw.columns.values() if cells.dtype == object]
    evidence = comma_evidence(texts)
    out = []
    for name, cells in raw.columns.items():
        if name in raw.epochs:
            high = float(np.nanmax(cells)) if len(cells) else 0.0
            out.append(ColumnFound(name, "time", low=0.0, high=high, form="times of the clock"))
            continue
        out.append(_column(name, cells, shown, raw.line, evidence))
    return out


def _column(
    name: str, cells: npt.NDArray[Any], shown: str, line: npt.NDArray[np.int64], evidence: bool | None
) -> ColumnFound:
    filled = (
        [cell for cell in cells.tolist() if cell is not None and str(cell).strip()] if cells.dtype == object else None
    )
    if filled is not None and not filled:
        return ColumnFound(name, "empty", n_empty=len(cells))
    unit = stem_and_unit(name)[1] or ""
    first = str(filled[0]) if filled else ""
    if filled and (form := time_format(first)):
        return ColumnFound(name, "time", n_empty=len(cells) - len(filled), form=TIME_FORMATS[form], texts=(first,))
    try:
        values, _ = numbers(cells, shown=shown, column=name, line=line, decimal_comma=evidence)
    except BadFileError:
        different = list(dict.fromkeys(str(cell).strip() for cell in filled or ()))
        few = tuple(different if len(different) <= _TEXTS else different[:_TEXTS])
        return ColumnFound(name, "text", texts=few, n_empty=len(cells) - len(filled or ()))
    known = values[np.isfinite(values)]
    if not len(known):
        return ColumnFound(name, "empty", n_empty=len(cells))
    whole = bool((known == np.rint(known)).all())
    offsets = np.asarray([0, len(values)])
    return ColumnFound(
        name,
        "number",
        unit=unit,
        low=float(known.min()),
        high=float(known.max()),
        n_empty=len(values) - len(known),
        wrap_bits=detect_wrap_bits(values, offsets) if whole and len(values) > _FEW_TEXTS else None,
        whole=whole,
    )


def _recording(path: Path, shown: str) -> FileFound:
    recording = read_recording(path, shown)
    refuse_nothing(recording, shown)
    columns, streams = [], []
    for stream in recording.streams:
        line = np.arange(1, len(stream) + 1)
        for name, values in stream.columns.items():
            found = _column(name, values, shown, line, None)
            columns.append(replace(found, unit=stream.units.get(name, found.unit)))
        report = stream.report()
        shown_by_clock: dict[str, Any] = {"behind_arrival_s": stream.behind_arrival_s}
        if report is not None:
            names = ("span_s", "rate_Hz", "n_gaps", "longest_gap_s", "start_ns")
            shown_by_clock |= {name: getattr(report, name) for name in names}
        about = (stream.name, stream.kind, len(stream), stream.clock, tuple(stream.columns))
        streams.append(StreamFound(*about, **shown_by_clock))
    remarks = tuple(note.text for note in recording.notes)
    longest = max((len(stream) for stream in recording.streams), default=0)
    return FileFound(shown, True, longest, tuple(columns), remarks, tuple(streams), recording.properties)
