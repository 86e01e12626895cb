"""Recordings: streams with clocks of their own in integer nanoseconds; the reader of TUM trajectories.

A TUM trajectory (``.tum``) has lines of ``timestamp tx ty tz qx qy qz qw``, with ``#`` before remarks.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from calib.campaign.model import Note
from calib.campaign.readers.table import HEADER_ROWS, NS_PER_S, Layout, RawTable, is_number
from calib.errors import BadFileError
from calib.types import FloatArray, IntArray

#: a step is a gap where it exceeds so many usual steps
GAP_STEPS: Final = 5.0
#: code of a note that lists the types of messages that calib does not read
UNREAD_TYPES: Final = "skipped"
#: columns of a pose in space; `planar_pose` makes x, y, z and yaw of them
POSE: Final = ("x", "y", "z", "qx", "qy", "qz", "qw")
#: least squared length of a quaternion that stands for an orientation; a unit quaternion has 1, an unset one 0
_LEAST_QUATERNION: Final = 0.25


@dataclass(frozen=True, slots=True)
class ClockReport:
    """What a stream's clock shows."""

    n_samples: int
    #: first and last time, nanoseconds as recorded
    start_ns: int
    end_ns: int
    #: median step
    period_s: float
    #: steps longer than five usual ones
    n_gaps: int
    #: the longest of them, 0 where there is none
    longest_gap_s: float
    #: steps backward in time
    n_backward: int

    @property
    def span_s(self) -> float:
        """Time from the first to the last sample."""
        return (self.end_ns - self.start_ns) / NS_PER_S

    @property
    def rate_Hz(self) -> float:
        """Samples a second, from the median step; 0 where there is none."""
        return 1.0 / self.period_s if self.period_s > 0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """One stream of a recording: a topic, a group of channels, the variables of a file."""

    #: topic or group
    name: str
    #: message type, or ``channels``, ``variables``, ``poses``
    kind: str
    #: under names that are unique in the recording (``/odom:x``), shape (n_samples,)
    columns: Mapping[str, FloatArray]
    #: nanoseconds as recorded, exact; None where the stream has no clock of its own, shape (n_samples,)
    time_ns: IntArray | None
    #: where the times come from, in words
    clock: str
    #: units that the file names, by column
    units: Mapping[str, str] = field(default_factory=dict)
    #: median of arrival minus stamp where messages carry stamps; it differs between streams whose clocks differ
    behind_arrival_s: float | None = None

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.columns else 0

    def report(self) -> ClockReport | None:
        """Return span, rate and gaps; None without a clock or samples."""
        if self.time_ns is None or not len(self.time_ns):
            return None
        steps = np.diff(self.time_ns)
        usual = float(np.median(steps)) / NS_PER_S if len(steps) else 0.0
        gaps = steps[steps > GAP_STEPS * usual * NS_PER_S] if usual > 0 else steps[:0]
        return ClockReport(
            n_samples=len(self.time_ns),
            start_ns=int(self.time_ns.min()),
            end_ns=int(self.time_ns.max()),
            period_s=usual,
            n_gaps=len(gaps),
            longest_gap_s=float(gaps.max()) / NS_PER_S if len(gaps) else 0.0,
            n_backward=int((steps < 0).sum()),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A recording as read."""

    #: those that hold a wanted column
    streams: tuple[Stream, ...]
    #: what was recognised or omitted
    notes: tuple[Note, ...] = ()
    #: properties that the file names, by place (``/``, ``group``, ``group/channel``)
    properties: Mapping[str, str] = field(default_factory=dict)

    def stream_of(self, column: str) -> Stream | None:
        """Return the stream that holds `column`."""
        return next((stream for stream in self.streams if column in stream.columns), None)

    @property
    def column_names(self) -> tuple[str, ...]:
        """Names of all columns."""
        return tuple(name for stream in self.streams for name in stream.columns)


@dataclass(frozen=True, slots=True)
class WantedColumns:
    """Names of the columns to keep, so that a reader can pass over whole topics unread."""

    names: frozenset[str]

    def __call__(self, name: str) -> bool:
        """Return whether the column is to be kept."""
        return name in self.names

    def of_topic(self, topic: str) -> bool:
        """Return whether a column of the topic may be wanted; names of frames and joints follow the topic's."""
        return any(name.startswith((f"{topic}:", f"{topic}[", f"{topic}#")) for name in self.names)


def interpolated(stream: Stream, column: str, at_ns: IntArray, *, shift_ns: int = 0) -> FloatArray:
    """Return a column at other times, linearly between samples and empty across gaps.

    `stream`: with a clock that does not run backward; `at_ns` (shape (n_times,)): where it is wanted, on the clock of
    the recording; `shift_ns`: taken off the stream's times first: the time that the stream lags behind. Shape
    (n_times,): NaN outside the stream's span and within its gaps.
    """
    if stream.time_ns is None or not len(stream.time_ns):
        return np.full(len(at_ns), np.nan)
    values = stream.columns[column]
    known = ~np.isnan(values)
    times = stream.time_ns[known] - shift_ns
    values = values[known]
    if not len(times):
        return np.full(len(at_ns), np.nan)
    # differences of integers first: nanoseconds since 1970 are no longer exact as float
    origin = int(times[0])
    since, wanted = (times - origin).astype(np.float64), (at_ns - origin).astype(np.float64)
    out: FloatArray = np.interp(wanted, since, values, left=np.nan, right=np.nan)
    steps = np.diff(since)
    if len(steps):
        step = steps[np.clip(np.searchsorted(since, wanted), 1, len(steps)) - 1]
        in_gap = step > max(GAP_STEPS * float(np.median(steps)), 1.0)
        out[in_gap & ~np.isin(wanted, since)] = np.nan
    return out


def joined_table(recording: Recording) -> RawTable:
    """Return the recording as one table on the times of the stream with most samples, the others interpolated.

    The columns under their names and, where there is a clock, ``t_s`` from the first sample.
    """
    if not recording.streams:
        return RawTable({}, np.zeros(0, dtype=np.int64), recording.notes)
    base = max(recording.streams, key=len)
    columns: dict[str, npt.NDArray[Any]] = {}
    time = base.time_ns
    if time is not None and len(time) and "t_s" not in recording.column_names:
        columns["t_s"] = (time - time[0]) / NS_PER_S
    for stream in recording.streams:
        for name, values in stream.columns.items():
            if stream is base or (len(values) == len(base) and stream.time_ns is None):
                columns[name] = values
            elif time is not None and stream.time_ns is not None:
                columns[name] = interpolated(stream, name, time)
    return RawTable(columns, np.arange(1, len(base) + 1, dtype=np.int64), recording.notes)


def check_not_empty(recording: Recording, shown: str) -> None:
    """Refuse a recording without a number that calib reads, naming what it holds instead.

    Raises BadFileError where no stream holds a sample.
    """
    if any(len(stream) for stream in recording.streams):
        return
    unread = next((note.text for note in recording.notes if note.code == UNREAD_TYPES), "")
    expected = "wheels (JointState, or numbers of std_msgs) and what measures the path (poses, Odometry, TF, Range)"
    remedy = "record these topics too, or leave the recording out" if unread else "record again, or leave it out"
    raise BadFileError(shown, f"nothing but {unread}" if unread else "no messages or samples at all", expected, remedy)


def planar_pose(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return columns with a quaternion (qx, qy, qz, qw) replaced by its yaw, continuous over the turn.

    `columns` (shape (n_samples,)); without a quaternion they are returned as they are.
    """
    if "qw" not in columns:
        return dict(columns)
    qx, qy, qz, qw = (columns[name] for name in POSE[3:])
    size = qx * qx + qy * qy + qz * qz + qw * qw
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), size - 2.0 * (qy * qy + qz * qz))
    known = size > _LEAST_QUATERNION
    yaw = np.where(known, yaw, np.nan)
    yaw[known] = np.unwrap(yaw[known])
    out = {name: values for name, values in columns.items() if name not in POSE[3:]} | {"yaw": yaw}
    # yaw follows the place; further columns of the message follow both
    order = [*POSE[:3], "yaw", *(name for name in out if name not in (*POSE, "yaw"))]
    return {name: out[name] for name in order if name in out}


def record(path: Path, shown: str, wanted: Callable[[str], bool] | None) -> Recording:
    """Read a TUM trajectory: x, y, z, yaw, times exact to the nanosecond; see `calib.campaign.readers`."""
    times: list[int] = []
    poses: list[list[float]] = []
    with path.open(encoding="utf-8", errors="replace") as lines:
        for number, line in enumerate(lines, start=1):
            cells = line.split("#", 1)[0].replace(",", " ").split()
            if not cells:
                continue
            try:
                if len(cells) != 1 + len(POSE):
                    raise ValueError(f"{len(cells)} numbers")
                times.append(decimal_ns(cells[0]))
                pose = [float(cell) for cell in cells[1:]]
                if not np.isfinite(pose).all():
                    raise ValueError("a number that is not finite")
            except ValueError as error:
                expected = f"the {1 + len(POSE)} numbers: timestamp {' '.join(POSE)}"
                remedy = "correct or remove the line; the file may have been cut"
                raise BadFileError(shown, str(error)[:80], expected, remedy, row=number) from error
            poses.append(pose)
    if not times:
        raise BadFileError(shown, found="no poses", expected="lines of 8 numbers", remedy="export it again")
    columns = planar_pose(dict(zip(POSE, np.asarray(poses).T.copy(), strict=True)))
    kept = {name: values for name, values in columns.items() if wanted is None or wanted(name)}
    units = {"x": "m", "y": "m", "z": "m", "yaw": "rad"}
    stream = Stream("poses", "poses", kept, np.asarray(times, dtype=np.int64), "timestamps of the lines", units)
    return Recording((stream,) if kept else ())


def decimal_ns(text: str) -> int:
    """Return seconds written as a decimal number as nanoseconds, exactly; further digits are rounded off.

    Raises ValueError where the text is no such number.
    """
    match = re.fullmatch(r"([+-]?)(\d+)(?:\.(\d*))?", text.strip(), re.ASCII)
    if match is None:
        return round(float(text) * NS_PER_S)
    digits = (match[3] or "")[:10].ljust(10, "0")
    nanoseconds = int(match[2]) * NS_PER_S + (int(digits) + 5) // 10
    return -nanoseconds if match[1] == "-" else nanoseconds


_REMARK: Final = re.compile(rb"(?m)^[ \t]*#[^\n]*")
_BLANKS: Final = re.compile(rb"[ \t]+")
#: bytes in which it is seen how the cells are separated
_HEAD_BYTES: Final = 1 << 16
#: lines of numbers that show that blanks separate the cells
_LEAST_LINES: Final = 2


def tidy(data: bytes, layout: Layout, shown: str) -> tuple[bytes, list[Note]]:
    """Return a text file with the lines that hold no cells emptied, so that rows keep their numbers, and notes.

    Lines that begin with ``#`` are remarks, but for the one right above the numbers where it names as many columns.
    Runs of blanks become tabs where nothing else separates the cells.
    """
    notes: list[Note] = []
    if layout.skip_rows:
        lines = data.split(b"\n")
        for row in layout.skip_rows:
            lines[row - 1 : row] = [b""] * len(lines[row - 1 : row])
        data = b"\n".join(lines)
    if _REMARK.search(data):
        data, n_remarks = _without_remarks(data)
        text = f"{n_remarks} line(s) that begin with # are remarks"
        notes += [Note("info", shown, text, "remarks")] if n_remarks else []
    if _by_blanks(data):
        data = b"\n".join(_BLANKS.sub(b"\t", line.strip()) for line in data.split(b"\n"))
        notes.append(Note("info", shown, "columns are separated by blanks", "delimiter"))
    return data.rstrip(b"\n") + b"\n" if data.strip() else data, notes


def _without_remarks(data: bytes) -> tuple[bytes, int]:
    head = data[:_HEAD_BYTES].decode("utf-8", errors="ignore").split("\n")
    first = next((at for at, line in enumerate(head) if line.strip() and not line.lstrip().startswith("#")), None)
    names = None
    if first:
        above = max((at for at, line in enumerate(head[:first]) if line.strip()), default=None)
        if above is not None and _names(head[above], head[first]):
            names = above
    remarks = _REMARK.findall(data)
    if names is None:
        return _REMARK.sub(b"", data), len(remarks)
    lines = data.split(b"\n", names + 1)
    text = lines[names].lstrip()[1:].lstrip(b" ") + b"\n"
    before = _REMARK.sub(b"", b"\n".join(lines[:names]) + (b"\n" if names else b""))
    return before + text + _REMARK.sub(b"", lines[-1]), len(remarks) - 1


def _names(remark: str, below: str) -> bool:
    """Return whether a remark names the columns of the line below it."""
    for separator in (";", "\t", ",", None):
        cells = [cell.strip() for cell in remark.strip()[1:].strip().split(separator)]
        numbers = [cell.strip() for cell in below.strip().split(separator)]
        if len(cells) == len(numbers) > 1 and any(map(is_number, numbers)):
            return not any(is_number(cell) for cell in cells if cell)
    return False


def _by_blanks(data: bytes) -> bool:
    """Return whether nothing but blanks separates the cells: numbers, as many in every line."""
    lines = data[:_HEAD_BYTES].decode("utf-8", errors="ignore").split("\n")
    if len(data) > _HEAD_BYTES:
        lines.pop()
    lines = [line.strip() for line in lines if line.strip()][-HEADER_ROWS:]
    lines = lines[-max(_LEAST_LINES, len(lines) // 2) :]
    if len(lines) < _LEAST_LINES or any(mark in line for line in lines for mark in (";", "\t", '"')):
        return False
    rows = [line.split() for line in lines]
    widths = {len(row) for row in rows}
    return (
        widths != {1} and len(widths) == 1 and all(is_number(cell) and cell[-1] != "," for row in rows for cell in row)
    )


def utf8(data: bytes, shown: str) -> tuple[bytes, list[Note]]:
    """Return the file as UTF-8 without a byte order mark, with line feeds only, and notes of what was changed."""
    notes: list[Note] = []
    encoding = None
    if data.startswith(codecs.BOM_UTF8):
        data = data[3:]
        notes.append(Note("info", shown, "a UTF-8 byte order mark was skipped", "encoding"))
    elif data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encoding = "utf-16"
    elif b"\0" in data[:2000]:
        even, odd = data[0:2000:2].count(0), data[1:2000:2].count(0)
        encoding = "utf-16-le" if odd > 20 * (even + 1) else "utf-16-be" if even > 20 * (odd + 1) else None
    try:
        if encoding:
            data = data.decode(encoding).encode("utf-8")
            notes.append(Note("info", shown, "the text is UTF-16", "encoding"))
        elif not data.isascii():
            data.decode("utf-8")
    except UnicodeError:
        if encoding:
            raise BadFileError(shown, "broken UTF-16 text", "whole characters", "export the file again") from None
        data = data.decode("latin-1").encode("utf-8")
        notes.append(Note("info", shown, "the text is not UTF-8; it was read as Latin-1", "encoding"))
    if b"\0" in data:
        row = data[: data.index(b"\0")].count(b"\n") + 1
        raise BadFileError(shown, "a NUL byte", "text", "export the file again; it is damaged or binary", row=row)
    if b"\r" in data and b"\n" not in data:
        data = data.replace(b"\r", b"\n")
    return data, notes
