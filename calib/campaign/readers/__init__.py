"""Readers of tables and recordings; a new format is a function and a line in `READERS`.

MATLAB's element tree is checked before a reader in C, which trusts every tag.
"""

import logging
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from calib.campaign.model import Note
from calib.campaign.readers.recording import Recording, Stream
from calib.campaign.readers.table import GAP_STEPS, NS_PER_S, Layout, RawTable, Wanted
from calib.errors import MATLAB_UNPACKED_BYTES, BadFileError, damage_named, missing_reader
from calib.types import FloatArray, IntArray, floats, grouped

if TYPE_CHECKING:
    from nptdms import TdmsChannel

__all__ = [
    "READERS", "Layout", "RawTable", "Wanted", "holds_recording", "is_bag_folder", "joined_table", "read_recording",
    "read_table",
]  # fmt: skip

#: suffix -> function here or in a module: ``read…(path, shown, wanted, layout)`` returns a `RawTable`, ``record…`` a
#: `Recording`; `shown`: name in messages
READERS: Final[dict[str, str]] = {
    ".csv": "delimited.read",
    ".tsv": "delimited.read",
    ".txt": "delimited.read",
    ".parquet": "workbook.read_parquet",
    ".xlsx": "workbook.read_sheet",
    ".tdms": "record_tdms",
    ".bag": "recording.record_ros",
    ".mcap": "recording.record_ros",
    ".db3": "recording.record_ros",
    ".mat": "record_mat",
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


def read_recording(path: Path, shown: str, wanted: Callable[[str], bool] | None = None) -> Recording:
    """Read a recording: a ROS bag, TDMS, ``.mat`` or trajectory file.

    See `read_table`; `WantedColumns` passes over whole topics. Raises BadFileError also of a table.
    """
    recording: Recording = _read(path, shown, wanted, streams=True)
    return recording


def interpolated(stream: Stream, column: str, at_ns: IntArray, shift_ns: int) -> FloatArray:
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
    recording: Recording, base: Stream | None = None, shifts_s: Mapping[str, float] | None = None, clock: bool = True
) -> RawTable:
    """Return the recording as one table on the times of `base` (by default the longest).

    Others are interpolated. `shifts_s`: column -> lag, taken off; `clock`: whether `base` has one, else columns of its
    length are kept.
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
                columns[name] = interpolated(stream, name, time, shift_ns)
    return RawTable(columns, np.arange(1, len(base) + 1, dtype=np.int64), recording.notes, epochs)


def holds_recording(path: Path) -> bool:
    """Return whether a path's format holds streams."""
    return "record" in _name(path)


def is_bag_folder(path: Path) -> bool:
    """Return whether a path is a rosbag2 folder."""
    return path.is_dir() and (path / BAG_METADATA).is_file()


def _name(path: Path) -> str:
    return READERS.get(".bag" if path.name == BAG_METADATA or is_bag_folder(path) else path.suffix.lower(), "")


def _read(path: Path, shown: str, *asked: Wanted | Layout | None, streams: bool = False) -> Any:
    if not (name := _name(path)):
        expected = f"one of {', '.join(READERS)}, or the folder of a rosbag2 recording"
        raise BadFileError(shown, f"the suffix {path.suffix!r}", expected, "export the table in one of these formats")
    if not path.is_file() and not is_bag_folder(path):
        actual = "a folder or special file" if path.exists() else "no such file"
        raise BadFileError(shown, actual, "a readable file", "correct the path or put the file there")
    if streams and not holds_recording(path):
        raise BadFileError(shown, "a table", "a recording (bag, TDMS, .mat, .tum)", "read it as a table")
    try:
        return resolve_name(f"{__name__}.{name}")(path, shown, *asked)
    except OSError as error:
        actual = error.strerror or "an unreadable file"
        raise BadFileError(shown, actual, "a readable file", "check its rights") from error


_NUMERIC: Final = ("double", "single", "logical", *(f"{sign}int{8 << n}" for sign in ("", "u") for n in range(4)))

_HEADER_BYTES: Final = 128
_TAG_BYTES: Final = 8
_INT32, _UINT32, _MATRIX, _COMPRESSED = 5, 6, 14, 15
#: types of data elements (MAT-File Format, table 1-1)
_ELEMENT_TYPES: Final = frozenset(range(1, 19)) - {8, 10, 11}
#: classes of arrays (table 1-2, with function handles and opaque objects)
_ARRAY_CLASSES: Final = range(1, 18)
_CHARACTERS, _SPARSE, _LAST_NUMERIC = 4, 5, 15
_COMPLEX_FLAG: Final = 0x800
_CONTAINER_CLASSES: Final = range(1, 4)
_MAX_DEPTH: Final = 32


def record_mat(path: Path, shown: str, wanted: Callable[[str], bool] | None) -> Recording:
    """Read a ``.mat`` file; variables of one length are one stream."""
    notes: list[Note] = []
    loaded = _load(path, shown, wanted, notes)
    columns: dict[str, FloatArray] = {}
    properties: dict[str, str] = {}

    def flatten(name: str, value: Any) -> None:
        kind = value.dtype.kind if isinstance(value, np.ndarray) else ""
        if kind == "V" and value.size == 1:
            for part in value.dtype.names or ():
                flatten(f"{name}.{part}", value.flat[0][part])
        elif kind in {"V", "O"}:
            what = "structures" if kind == "V" else "objects"
            notes.append(Note("info", f"{shown}, {name}", f"an array of {what} was omitted", "skipped"))
        elif kind in {*"iufb"} and value.size == 1:
            properties[name] = repr(float(value.flat[0]))
        elif kind in {*"iufb"} and value.size:
            columns.update(_matrix_columns(name, value))

    for name, value in loaded.items():
        flatten(name, value)
    kept = {name: values for name, values in columns.items() if wanted is None or wanted(name)}
    by_length = grouped((len(values), (name, values)) for name, values in kept.items())
    streams = [
        Stream(_numbered("variables", at), "variables", dict(by_length[length]), None, "none")
        for at, length in enumerate(sorted(by_length, reverse=True))
    ]
    return Recording(tuple(streams), tuple(notes), properties)


def _numbered(name: str, index: int) -> str:
    return f"{name}#{index + 1}" if index else name


def _load(path: Path, shown: str, wanted: Callable[[str], bool] | None, notes: list[Note]) -> dict[str, object]:
    import scipy.io

    remedy = "save it again with: save('file.mat', '-v7')"
    with damage_named(shown, "a MATLAB file", "a whole one of version 5 to 7.2", remedy):
        _check_elements(path.read_bytes())
        try:
            listed = scipy.io.whosmat(str(path))
        except NotImplementedError as error:
            remedy = "save it in MATLAB with: save('file.mat', '-v7')"
            raise BadFileError(shown, "a MATLAB 7.3 file (HDF5)", "version 5 to 7.2", remedy) from error
        kept = [name for name, _, kind in listed if kind in _NUMERIC or kind == "struct"]
        others = {name: kind for name, _, kind in listed if name not in kept and kind not in {"char", "sparse"}}
        asked_for = [name for name in others if (not kept if wanted is None else wanted(name))]
        if refused := ", ".join(f"{name} ({others[name]})" for name in asked_for):
            remedy = "save the numbers themselves, as in: t = data{1}; save('file.mat', 't', '-v7')"
            raise BadFileError(shown, f"arrays of objects: {refused[:120]}", "numeric arrays", remedy)
        notes += [Note("info", f"{shown}, {name}", f"a {kind} was omitted", "skipped") for name, kind in others.items()]
        loaded = scipy.io.loadmat(str(path), variable_names=kept, struct_as_record=True) if kept else {}
    return {name: loaded[name] for name in kept if name in loaded}


def _matrix_columns(name: str, values: npt.NDArray[Any]) -> dict[str, FloatArray]:
    matrix = floats(values)
    if matrix.ndim == 1 or (matrix.ndim == 2 and 1 in matrix.shape):
        return {name: matrix.ravel()}
    if matrix.ndim != 2:
        return {}
    long = matrix.T if matrix.shape[0] < matrix.shape[1] else matrix
    return {f"{name}[{index}]": column.copy() for index, column in enumerate(long.T)}


def _check_elements(data: bytes) -> None:
    if (order := {b"IM": "<", b"MI": ">"}.get(data[126:_HEADER_BYTES])) is None:
        raise ValueError("no header of version 5")
    if struct.unpack(f"{order}H", data[124:126])[0] >> 8 == 1:
        _elements(memoryview(data)[_HEADER_BYTES:], order, 0)


def _elements(data: memoryview, order: str, depth: int) -> list[tuple[int, memoryview]]:
    if depth > _MAX_DEPTH:
        raise ValueError(f"arrays more than {_MAX_DEPTH} deep in one another")
    elements, position = [], 0
    while position + _TAG_BYTES <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, position)
        start = position + _TAG_BYTES
        if small := kind >> 16:
            kind, size, start = kind & 0xFFFF, small, position + 4
        if kind not in _ELEMENT_TYPES or (kind == _COMPRESSED and depth) or (small and size > 4):
            raise ValueError(f"an element of type {kind} and {size} bytes")
        if start + size > len(data):
            raise ValueError(f"an element of {size} bytes where {len(data) - start} are left")
        content = data[start : start + size]
        if kind == _MATRIX:
            _array(content, order, depth)
        elif kind == _COMPRESSED:
            _elements(memoryview(_unpacked(content)), order, depth + 1)
        elements.append((kind, content))
        # all but compressed elements end on eight bytes
        position = position + _TAG_BYTES if small else start + (size if kind == _COMPRESSED else (size + 7) // 8 * 8)
    return elements


def _array(content: memoryview, order: str, depth: int) -> None:
    if not len(content):
        return
    parts = _elements(content, order, depth + 1)
    if len(parts) < 2 or parts[0][0] != _UINT32 or len(parts[0][1]) != 8 or parts[1][0] != _INT32:
        raise ValueError("an array without flags and dimensions")
    flags = struct.unpack(f"{order}I", parts[0][1][:4])[0]
    kind, is_complex = flags & 0xFF, bool(flags & _COMPLEX_FLAG)
    if kind not in _ARRAY_CLASSES:
        raise ValueError(f"an array of class {kind}")
    # flags, dimensions, name, a sparse one's places, numbers
    wanted = 3 + (2 if kind == _SPARSE else 0) + 1 + is_complex
    if _CHARACTERS <= kind <= _LAST_NUMERIC and len(parts) < wanted:
        raise ValueError(f"an array of class {kind} with {len(parts)} of {wanted} elements")
    # MATLAB's objects have a name in place of dimensions
    sizes = struct.unpack(f"{order}{len(parts[1][1]) // 4}i", parts[1][1][: len(parts[1][1]) // 4 * 4])
    places = 1
    for size in sizes:
        places *= size
        if size < 0 or places > MATLAB_UNPACKED_BYTES:
            raise ValueError(f"an array of {'x'.join(map(str, sizes))}")
    if kind in _CONTAINER_CLASSES and places > len(content):
        raise ValueError(f"{places} arrays in {len(content)} bytes")


def _unpacked(content: memoryview) -> bytes:
    unpacker = zlib.decompressobj()
    unpacked = unpacker.decompress(content, MATLAB_UNPACKED_BYTES)
    if unpacker.unconsumed_tail:
        raise ValueError(f"more than {MATLAB_UNPACKED_BYTES >> 20} MiB unpacked")
    return unpacked


#: TDMS times count from 1904-01-01, Unix times from 1970-01-01
_FROM_1904_S: Final = 2_082_844_800


def record_tdms(path: Path, shown: str, wanted: Callable[[str], bool] | None) -> Recording:
    """Read a TDMS file; columns are called ``group/channel``."""
    try:
        from nptdms import TdmsFile
    except ImportError as error:
        raise missing_reader(shown, "a TDMS file", "npTDMS", "tdms") from error
    notes: list[Note] = []
    streams: list[Stream] = []
    remedy = "copy it again from the DAQ computer, or export it as CSV"
    with (
        damage_named(shown, "a TDMS file", "a whole one", remedy),
        _quiet(),
        TdmsFile.open(path, raw_timestamps=True) as source,
    ):
        if not source.groups() or source.file_status.incomplete_final_segment:
            raise ValueError("the last segment is not complete")
        properties = _properties("/", source.properties)
        for group in source.groups():
            properties |= _properties(group.name, group.properties)
            channels = {}
            for channel in group.channels():
                name = f"{group.name}/{channel.name}"
                properties |= _properties(name, channel.properties)
                if not len(channel) or np.dtype(channel.dtype).kind not in "iufbMV":
                    notes.append(Note("info", f"{shown}, {name}", "holds no numbers and was omitted", "skipped"))
                elif wanted is None or wanted(name):
                    channels[name] = channel
            streams += _streams(group.name, channels)
    return Recording(tuple(streams), tuple(notes), properties)


@contextmanager
def _quiet() -> Iterator[None]:
    logs = [logging.getLogger(name) for name in logging.root.manager.loggerDict if name.partition(".")[0] == "nptdms"]
    levels = [log.level for log in logs]
    try:
        for log in logs:
            log.setLevel(logging.ERROR)
        yield
    finally:
        for log, level in zip(logs, levels, strict=True):
            log.setLevel(level)


def _moments_ns(stamps: Any) -> IntArray:
    seconds = np.asarray(stamps.seconds, dtype=np.int64) - _FROM_1904_S
    fractions = np.rint(floats(stamps.second_fractions) * (NS_PER_S / 2.0**64)).astype(np.int64)
    return np.asarray(seconds * NS_PER_S + fractions, dtype=np.int64)


def _properties(place: str, values: Mapping[str, Any]) -> dict[str, str]:
    return {f"{place}: {key}": str(value)[:200] for key, value in values.items()}


def _streams(group: str, channels: "Mapping[str, TdmsChannel]") -> list[Stream]:
    keys = ("wf_start_time", "wf_increment", "wf_start_offset")
    together = grouped(
        ((len(channel), *(str(channel.properties.get(key)) for key in keys)), (name, channel))
        for name, channel in channels.items()
    )
    streams = []
    for number, members in enumerate(map(dict, together.values())):
        time, clock, columns = _time(next(iter(members.values()))), "waveform properties", {}
        for name, channel in members.items():
            if channel[0:1].dtype.names:
                time, clock = _moments_ns(channel[:]), f"time stamps of {name}"
            else:
                columns[name] = floats(channel[:])
        units = {name: str(unit) for name in columns if (unit := members[name].properties.get("unit_string"))}
        clock = "none" if time is None else clock
        streams += [Stream(_numbered(group, number), "channels", columns, time, clock, units)] if columns else []
    return streams


def _time(channel: "TdmsChannel") -> IntArray | None:
    step = channel.properties.get("wf_increment")
    if not isinstance(step, int | float) or not step > 0:
        return None
    offset = channel.properties.get("wf_start_offset", 0.0)
    origin = channel.properties.get("wf_start_time")
    start = int(_moments_ns(origin)) if hasattr(origin, "second_fractions") else 0
    index: FloatArray = np.arange(len(channel), dtype=np.float64)
    return start + np.rint((float(offset) + index * float(step)) * NS_PER_S).astype(np.int64)
