"""What a reader of recordings returns: streams with clocks of their own, in integer nanoseconds, and what they say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray, IntArray
from calib.campaign.model import Note
from calib.campaign.readers.table import RawTable
from calib.campaign.readers.times import NS_PER_S
from calib.errors import BadFileError

#: a step is a gap where it exceeds so many usual steps
GAP_STEPS: Final = 5.0
#: code of a note that lists the types of messages that nothing here reads
UNREAD: Final = "skipped"


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
    #: what was recognised or left out
    notes: tuple[Note, ...] = ()
    #: what the file says of itself, by place (``/``, ``group``, ``group/channel``)
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
        usual = float(np.median(steps))
        after = np.searchsorted(since, wanted)
        within = (after > 0) & (after < len(since))
        long = np.zeros(len(out), dtype=np.bool_)
        exact = np.isin(wanted, since)
        long[within] = steps[after[within] - 1] > max(GAP_STEPS * usual, 1.0)
        out = np.where(long & ~exact, np.nan, out)
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


def matrix_columns(name: str, values: npt.NDArray[Any]) -> dict[str, FloatArray]:
    """Return an array of one or two dimensions as columns, ``name`` or ``name[0]``, ``name[1]``, ..."""
    flat = np.asarray(values)
    if flat.ndim == 1:
        return {name: flat.astype(np.float64)}
    if flat.ndim == 2 and 1 in flat.shape:
        return {name: flat.ravel().astype(np.float64)}
    if flat.ndim == 2:
        wide = flat.T if flat.shape[0] < flat.shape[1] else flat
        return {f"{name}[{index}]": column.astype(np.float64) for index, column in enumerate(wide.T)}
    return {}


def refuse_nothing(recording: Recording, shown: str) -> None:
    """Refuse a recording without a single number that calib reads, naming what it holds instead.

    Raises BadFileError where no stream holds a sample.
    """
    if any(len(stream) for stream in recording.streams):
        return
    unread = next((note.text for note in recording.notes if note.code == UNREAD), "")
    expected = "wheels (JointState, or numbers of std_msgs) and what measures the path (poses, Odometry, TF, Range)"
    remedy = "record these topics too, or leave the recording out" if unread else "record again, or leave it out"
    raise BadFileError(shown, f"nothing but {unread}" if unread else "no messages or samples at all", expected, remedy)


def in_order(time_ns: IntArray, columns: Sequence[FloatArray]) -> tuple[IntArray, list[FloatArray], int]:
    """Return times and columns sorted by time, and how many samples stood out of order."""
    backward = int((np.diff(time_ns) < 0).sum()) if len(time_ns) > 1 else 0
    if not backward:
        return time_ns, list(columns), 0
    order = np.argsort(time_ns, kind="stable")
    return time_ns[order], [column[order] for column in columns], backward
