"""Readers of tables and recordings; a new format is one function and one line here."""

import importlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from calib.campaign.readers.table import GAP_STEPS, NS_PER_S, Layout, RawTable, Wanted
from calib.errors import BadFileError
from calib.types import FloatArray, IntArray

if TYPE_CHECKING:
    from calib.campaign.readers.recording import Recording, Stream

__all__ = [
    "READERS", "Layout", "RawTable", "Wanted", "holds_recording", "is_bag_folder", "joined_table", "read_recording",
    "read_table",
]  # fmt: skip

#: suffix -> module and function of this package: ``read…(path, shown, wanted, layout)`` returns a `RawTable`,
#: ``record…(path, shown, wanted)`` a `Recording`. `shown` is the file's name in messages
READERS: Final[dict[str, str]] = {
    ".csv": "delimited.read",
    ".tsv": "delimited.read",
    ".txt": "delimited.read",
    ".parquet": "workbook.read_parquet",
    ".xlsx": "workbook.read_sheet",
    ".tdms": "daq.record_tdms",
    ".bag": "recording.record_ros",
    ".mcap": "recording.record_ros",
    ".db3": "recording.record_ros",
    ".mat": "daq.record_mat",
    ".tum": "recording.record_tum",
}
BAG_METADATA: Final = "metadata.yaml"


def read_table(path: Path, shown: str, wanted: Wanted | None = None, layout: Layout | None = None) -> RawTable:
    """Read a table, or the joined streams of a recording, with its suffix's reader.

    `wanted`: which columns to keep, as numbers; None keeps all as read. Raises BadFileError where the file is missing,
    unknown or damaged, or an extra is not installed.
    """
    if holds_recording(path):
        return joined_table(_read(path, shown, wanted))
    table: RawTable = _read(path, shown, wanted, layout or Layout())
    return table


def read_recording(path: Path, shown: str, wanted: Callable[[str], bool] | None = None) -> "Recording":
    """Read a recording: a ROS bag, TDMS, ``.mat`` or trajectory file.

    See `read_table`; a `WantedColumns` lets whole topics be passed over. Raises BadFileError also of a table.
    """
    recording: Recording = _read(path, shown, wanted, streams=True)
    return recording


def interpolated(stream: "Stream", column: str, at_ns: IntArray, *, shift_ns: int = 0) -> FloatArray:
    """Return a column at other times, (n_times,), NaN outside the span and in gaps.

    `shift_ns`: the stream's lag, taken off first.
    """
    known = ~np.isnan(stream.columns[column])
    if stream.time_ns is None or not known.any():
        return np.full(len(at_ns), np.nan)
    times, values = stream.time_ns[known] - shift_ns, stream.columns[column][known]
    # nanoseconds since 1970 are not exact as float
    origin = int(times[0])
    since, wanted = (times - origin).astype(np.float64), (at_ns - origin).astype(np.float64)
    out: FloatArray = np.interp(wanted, since, values, left=np.nan, right=np.nan)
    if len(steps := np.diff(since)):
        step = steps[np.clip(np.searchsorted(since, wanted), 1, len(steps)) - 1]
        out[(step > max(GAP_STEPS * float(np.median(steps)), 1.0)) & ~np.isin(wanted, since)] = np.nan
    return out


def joined_table(
    recording: "Recording",
    base: "Stream | None" = None,
    shifts_s: Mapping[str, float] | None = None,
    clock: bool = True,
) -> RawTable:
    """Return the recording as one table on the times of `base` (by default the longest), the others interpolated.

    `shifts_s`: column -> lag, taken off; `clock`: whether `base` has the clock, else columns of its length are kept.
    """
    if not recording.streams:
        return RawTable({}, np.zeros(0, dtype=np.int64), recording.notes)
    base = base or max(recording.streams, key=len)
    columns: dict[str, npt.NDArray[Any]] = {}
    epochs: dict[str, int] = {}
    time = base.time_ns if clock else None
    if time is not None and len(time) and "t_s" not in recording.column_names:
        columns["t_s"], epochs["t_s"] = (time - time[0]) / NS_PER_S, int(time[0])
    for stream in recording.streams:
        for name, values in stream.columns.items():
            if stream is base or (len(values) == len(base) and (stream.time_ns is None or time is None)):
                columns[name] = values
            elif time is not None and stream.time_ns is not None:
                shift_ns = round((shifts_s or {}).get(name, 0.0) * NS_PER_S)
                columns[name] = interpolated(stream, name, time, shift_ns=shift_ns)
    return RawTable(columns, np.arange(1, len(base) + 1, dtype=np.int64), recording.notes, epochs)


def holds_recording(path: Path) -> bool:
    """Return whether a path's format holds streams."""
    return ".record" in _name(path)


def is_bag_folder(path: Path) -> bool:
    """Return whether a path is a rosbag2 folder."""
    return path.is_dir() and (path / BAG_METADATA).is_file()


def _name(path: Path) -> str:
    return READERS.get(".bag" if path.name == BAG_METADATA or is_bag_folder(path) else path.suffix.lower(), "")


def _read(path: Path, shown: str, *asked: Wanted | Layout | None, streams: bool = False) -> Any:
    module, _, function = _name(path).partition(".")
    if not module:
        expected = f"one of {', '.join(READERS)}, or the folder of a rosbag2 recording"
        raise BadFileError(shown, f"the suffix {path.suffix!r}", expected, "export the table in one of these formats")
    if not path.is_file() and not is_bag_folder(path):
        found = "a folder or special file" if path.exists() else "no such file"
        raise BadFileError(shown, found, "a readable file", "correct the path or put the file there")
    if streams and not holds_recording(path):
        raise BadFileError(shown, "a table", "a recording (bag, TDMS, .mat, .tum)", "read it as a table")
    reader: Callable[..., Any] = getattr(importlib.import_module(f"{__name__}.{module}"), function)
    try:
        return reader(path, shown, *asked)
    except OSError as error:
        found = error.strerror or "an unreadable file"
        raise BadFileError(shown, found, "a readable file", "check its rights") from error
