"""Recordings: streams with clocks of their own in integer nanoseconds; the reader of TUM trajectories.

A TUM trajectory (``.tum``) has lines of ``timestamp tx ty tz qx qy qz qw``, with ``#`` before remarks.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from calib.campaign.model import Note
from calib.campaign.readers.table import NS_PER_S, RawTable
from calib.errors import BadFileError
from calib.types import FloatArray, IntArray, unwrapped

#: a gap exceeds so many usual steps
GAP_STEPS: Final = 5.0
#: note of message types not read
UNREAD_TYPES: Final = "skipped"
#: see `planar_pose`
POSE: Final = ("x", "y", "z", "qx", "qy", "qz", "qw")
#: squared length: of an unset one 0
_LEAST_QUATERNION: Final = 0.25


@dataclass(frozen=True, slots=True)
class StreamContents:
    """What a stream holds; zeros without a clock."""

    name: str
    kind: str
    n_samples: int
    clock: str
    columns: tuple[str, ...]
    span_s: float = 0.0
    #: by the median step
    rate_Hz: float = 0.0
    n_gaps: int = 0
    longest_gap_s: float = 0.0
    #: as recorded
    start_ns: int | None = None
    behind_arrival_s: float | None = None

    def words(self) -> str:
        """Return samples, span, rate and gaps in words."""
        text = f"{self.n_samples} samples"
        if self.start_ns is None:
            return text + ", without a clock"
        text += f" over {self.span_s:.6g} s at {self.rate_Hz:.4g} Hz, clock: {self.clock}"
        return text + (f", {self.n_gaps} gap(s) up to {self.longest_gap_s:.3g} s" if self.n_gaps else "")


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """A stream of a recording: a topic, a group of channels, variables of a file."""

    name: str
    #: message type, or ``channels``, ``variables``, ``poses``
    kind: str
    #: by names unique in the recording (``/odom:x``), shape (n_samples,)
    columns: Mapping[str, FloatArray]
    #: None without a clock of its own, shape (n_samples,)
    time_ns: IntArray | None
    clock: str
    #: as in the file, by column
    units: Mapping[str, str] = field(default_factory=dict)
    #: median of arrival minus stamp, where messages have stamps; it differs between clocks
    behind_arrival_s: float | None = None

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.columns else 0

    def contents(self) -> StreamContents:
        """Return what the stream holds, and its clock's span, rate and gaps."""
        given = (self.name, self.kind, len(self), self.clock, tuple(self.columns))
        held = StreamContents(*given, behind_arrival_s=self.behind_arrival_s)
        if self.time_ns is None or not len(self.time_ns):
            return held
        steps_s = np.diff(self.time_ns) / NS_PER_S
        usual_s = float(np.median(steps_s)) if len(steps_s) else 0.0
        gaps_s = steps_s[steps_s > GAP_STEPS * usual_s] if usual_s > 0 else steps_s[:0]
        return replace(
            held,
            span_s=float(np.ptp(self.time_ns)) / NS_PER_S,
            rate_Hz=1.0 / usual_s if usual_s > 0 else 0.0,
            n_gaps=len(gaps_s),
            longest_gap_s=float(gaps_s.max(initial=0.0)),
            start_ns=int(self.time_ns.min()),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A recording as read."""

    streams: tuple[Stream, ...]
    notes: tuple[Note, ...] = ()
    #: by place (``/``, ``group``, ``group/channel``)
    properties: Mapping[str, str] = field(default_factory=dict)

    def stream_of(self, column: str) -> Stream | None:
        """Return the stream that holds `column`."""
        return next((stream for stream in self.streams if column in stream.columns), None)

    @property
    def column_names(self) -> tuple[str, ...]:
        """Names of all columns."""
        return tuple(name for stream in self.streams for name in stream.columns)


class WantedColumns(frozenset[str]):
    """Names of the columns to keep."""

    def __call__(self, name: str) -> bool:
        """Return whether the column is to be kept."""
        return name in self

    def of_topic(self, topic: str) -> bool:
        """Return whether a column of the topic may be wanted."""
        return any(name.startswith((f"{topic}:", f"{topic}[", f"{topic}#")) for name in self)


def interpolated(stream: Stream, column: str, at_ns: IntArray, *, shift_ns: int = 0) -> FloatArray:
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


def check_not_empty(recording: Recording, shown: str) -> None:
    """Raise BadFileError where no stream holds a sample."""
    if any(len(stream) for stream in recording.streams):
        return
    unread = next((note.text for note in recording.notes if note.code == UNREAD_TYPES), "")
    expected = "wheels (JointState, or numbers of std_msgs) and what measures the path (poses, Odometry, TF, Range)"
    remedy = "record these topics too, or leave the recording out" if unread else "record again, or leave it out"
    raise BadFileError(shown, f"nothing but {unread}" if unread else "no messages or samples at all", expected, remedy)


def planar_pose(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return columns with a quaternion (qx, qy, qz, qw) replaced by its continuous yaw."""
    if "qw" not in columns:
        return dict(columns)
    qx, qy, qz, qw = (columns[name] for name in POSE[3:])
    size = qx * qx + qy * qy + qz * qz + qw * qw
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), size - 2.0 * (qy * qy + qz * qz))
    yaw = unwrapped(np.where(size > _LEAST_QUATERNION, yaw, np.nan))
    out = {name: values for name, values in columns.items() if name not in POSE[3:]} | {"yaw": yaw}
    # yaw follows the place, further columns both
    order = [*POSE[:3], "yaw", *(name for name in out if name not in (*POSE, "yaw"))]
    return {name: out[name] for name in order if name in out}


def record(path: Path, shown: str, wanted: Callable[[str], bool] | None) -> Recording:
    """Read a TUM trajectory."""
    times: list[int] = []
    poses: list[list[float]] = []
    with path.open(encoding="utf-8", errors="replace") as lines:
        for number, line in enumerate(lines, start=1):
            if not (cells := line.split("#", 1)[0].replace(",", " ").split()):
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
    """Return decimal seconds as nanoseconds, exactly; raises ValueError."""
    if (match := re.fullmatch(r"([+-]?)(\d+)(?:\.(\d*))?", text.strip(), re.ASCII)) is None:
        return round(float(text) * NS_PER_S)
    digits = (match[3] or "")[:10].ljust(10, "0")
    nanoseconds = int(match[2]) * NS_PER_S + (int(digits) + 5) // 10
    return -nanoseconds if match[1] == "-" else nanoseconds
