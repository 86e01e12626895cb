"""Recordings: streams with own clocks in integer nanoseconds; readers of TUM trajectories and ROS."""

import math
import re
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import compress
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.campaign.model import Note
from calib.campaign.readers.table import GAP_STEPS, NS_PER_S
from calib.errors import BadFileError, error_words, missing_reader
from calib.types import FloatArray, IntArray, unwrapped

UNREAD_TYPES: Final = "skipped"
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
    rate_Hz: float = 0.0
    n_gaps: int = 0
    longest_gap_s: float = 0.0
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
    #: median of arrival minus stamp; it differs between clocks
    behind_arrival_s: float | None = None

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.columns else 0

    def contents(self) -> StreamContents:
        """Return what the stream holds."""
        held = (self.name, self.kind, len(self), self.clock, tuple(self.columns))
        times = np.zeros(0, dtype=np.int64) if self.time_ns is None else self.time_ns
        steps_s = np.diff(times) / NS_PER_S
        usual_s = float(np.median(steps_s)) if len(steps_s) else 0.0
        gaps_s = steps_s[steps_s > GAP_STEPS * usual_s] if usual_s > 0 else steps_s[:0]
        return StreamContents(
            *held,
            span_s=float(np.ptp(times)) / NS_PER_S if len(times) else 0.0,
            rate_Hz=1.0 / usual_s if usual_s > 0 else 0.0,
            n_gaps=len(gaps_s),
            longest_gap_s=float(gaps_s.max(initial=0.0)),
            start_ns=int(times.min()) if len(times) else None,
            behind_arrival_s=self.behind_arrival_s,
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


def check_not_empty(recording: Recording, shown: str) -> None:
    """Raise BadFileError where no stream holds a sample."""
    if any(len(stream) for stream in recording.streams):
        return
    unread = next((note.text for note in recording.notes if note.code == UNREAD_TYPES), "")
    expected = "wheels (JointState, or numbers of std_msgs) and what measures the path (poses, Odometry, TF, Range)"
    remedy = "record these topics too, or leave the recording out" if unread else "record again, or leave it out"
    raise BadFileError(shown, f"nothing but {unread}" if unread else "no messages or samples at all", expected, remedy)


def _planar_pose(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    if "qw" not in columns:
        return dict(columns)
    qx, qy, qz, qw = (columns[name] for name in POSE[3:])
    size = qx * qx + qy * qy + qz * qz + qw * qw
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), size - 2.0 * (qy * qy + qz * qz))
    yaw = unwrapped(np.where(size > _LEAST_QUATERNION, yaw, np.nan))
    out = {name: values for name, values in columns.items() if name not in POSE[3:]} | {"yaw": yaw}
    order = [*POSE[:3], "yaw", *(name for name in out if name not in (*POSE, "yaw"))]
    return {name: out[name] for name in order if name in out}


def record_tum(path: Path, shown: str, wanted: Callable[[str], bool] | None) -> Recording:
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
    columns = _planar_pose(dict(zip(POSE, np.asarray(poses).T.copy(), strict=True)))
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


#: of messages, from which stamps are the clock
_STAMPED_SHARE: Final = 0.99
_TWIST: Final = ("v_x", "v_y", "omega")

#: suffix of a message part's stream, columns, numbers, header with a stamp
Part = tuple[str, tuple[str, ...], Sequence[float], Any]


def record_ros(path: Path, shown: str, wanted: Callable[[str], bool] | None) -> Recording:
    """Read topics of known message types; only wanted numbers are kept."""
    with _opened(path, shown) as reader:
        known = [connection for connection in reader.connections if connection.msgtype in MESSAGE_TYPES]
        if isinstance(wanted, WantedColumns):
            known = [connection for connection in known if wanted.of_topic(connection.topic)]
        buffers: dict[tuple[str, tuple[str, ...]], _Buffer] = {}
        with _damage_named(shown):
            for connection, arrival, data in reader.messages(connections=known) if known else ():
                kind, topic = connection.msgtype, connection.topic
                for suffix, names, numbers, header in MESSAGE_TYPES[kind](reader.deserialize(data, kind)):
                    key = (topic + suffix, names)
                    if key not in buffers:
                        buffers[key] = _Buffer(topic + suffix, kind, names, wanted)
                    buffers[key].add(numbers, arrival, header)
        unread = sorted({connection.msgtype for connection in reader.connections} - set(MESSAGE_TYPES))
    notes: list[Note] = []
    if unread and (wanted is None or not buffers):
        notes.append(Note("info", shown, f"messages that calib does not read: {', '.join(unread)[:200]}", UNREAD_TYPES))
    return Recording(tuple(_named_apart([buffer.stream(shown, notes) for buffer in buffers.values()])), tuple(notes))


class _Buffer:
    def __init__(self, name: str, kind: str, names: Sequence[str], wanted: Callable[[str], bool] | None) -> None:
        self.name, self.kind = name, kind
        self.arrival, self.stamp, self.numbers = array("q"), array("q"), array("d")
        self.unstamped = 0
        yaw = wanted is not None and wanted(f"{name}:yaw")
        asked = [wanted is None or wanted(f"{name}:{column}") or (yaw and column in POSE[3:]) for column in names]
        kept = [index for index, taken in enumerate(asked) if taken]
        self.names = [names[index] for index in kept]
        self.kept = kept if len(kept) < len(names) else None

    def add(self, numbers: Sequence[float], arrival: int, header: Any) -> None:
        self.arrival.append(arrival)
        stamp = header and header.stamp.sec * NS_PER_S + header.stamp.nanosec
        self.unstamped += not stamp
        self.stamp.append(stamp or arrival)
        self.numbers.extend(numbers if self.kept is None else [numbers[index] for index in self.kept])

    def stream(self, shown: str, notes: list[Note]) -> Stream:
        table = np.frombuffer(self.numbers, dtype=np.float64).reshape(len(self.arrival), len(self.names))
        arrival, stamp = (np.frombuffer(times, dtype=np.int64) for times in (self.arrival, self.stamp))
        stamped = self.unstamped < (1.0 - _STAMPED_SHARE) * len(arrival)
        time = stamp if stamped else arrival
        if backward := int((np.diff(time) < 0).sum()):
            order = np.argsort(time, kind="stable")
            time, table = time[order], table[order]
            text = f"{backward} message(s) out of order were sorted by time"
            notes.append(Note("info", f"{shown}, {self.name}", text, "order"))
        columns = _planar_pose(dict(zip(self.names, table.T, strict=True)))
        return Stream(
            name=self.name,
            kind=self.kind,
            columns={f"{self.name}:{name}": np.ascontiguousarray(values) for name, values in columns.items()},
            time_ns=np.ascontiguousarray(time),
            clock="stamps of the messages" if stamped else "arrival of the messages",
            units={f"{self.name}:{name}": COLUMN_UNITS[name] for name in columns if name in COLUMN_UNITS},
            behind_arrival_s=float(np.median(arrival - stamp)) / NS_PER_S if stamped else None,
        )


def _named_apart(streams: Iterable[Stream]) -> Iterator[Stream]:
    taken: dict[str, int] = {}
    for stream in sorted(streams, key=len, reverse=True):
        number = taken[stream.name] = taken.get(stream.name, 0) + 1
        name = f"{stream.name}#{number}"
        columns = {name + column[len(stream.name) :]: values for column, values in stream.columns.items()}
        yield stream if number == 1 else replace(stream, name=name, columns=columns, units={})


@contextmanager
def _opened(path: Path, shown: str) -> Iterator[Any]:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise missing_reader(shown, "a ROS recording", "rosbags", "ros") from error
    source = path.parent if path.name == "metadata.yaml" else path
    if source.is_file() and source.stat().st_size == 0:
        raise _damaged(shown, "the file is empty")
    with _damage_named(shown):
        try:
            reader = AnyReader([source], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
            reader.open()
        except OSError as error:
            remedy = "check the path and its rights"
            raise BadFileError(shown, str(error)[:120], "a readable recording", remedy) from error
    try:
        encodings = {getattr(connection.ext, "serialization_format", "cdr") for connection in reader.connections}
        if unknown := sorted(map(str, encodings - {"cdr", ""})):
            raise _unknown_encoding(shown, ", ".join(unknown))
        yield reader
    finally:
        reader.close()


@contextmanager
def _damage_named(shown: str) -> Iterator[None]:
    try:
        yield
    except (MemoryError, BadFileError):
        raise
    except Exception as error:
        if "erialization format" in str(error):
            raise _unknown_encoding(shown, str(error)) from error
        raise _damaged(shown, error_words(error).rstrip(".")) from error


def _unknown_encoding(shown: str, text: str) -> BadFileError:
    name = text.partition("{")[2].partition("}")[0].strip("'") or text
    expected = "ROS messages in 'cdr', the encoding that ROS 2 records in"
    remedy = "convert the recording with 'ros2 bag convert' (serialization cdr), or record it again with the default"
    return BadFileError(shown, f"messages in the encoding {name!r}, which calib cannot read", expected, remedy)


def _damaged(shown: str, reason: str) -> BadFileError:
    expected = "a whole one, closed by its recorder"
    remedy = "copy it again, or repair it with 'mcap recover', 'ros2 bag reindex' or 'rosbag reindex'"
    return BadFileError(shown, f"a recording that is cut or damaged ({reason})", expected, remedy)


def _seven(place: Any, turn: Any) -> tuple[float, ...]:
    return (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)


def _pose(pose: Any) -> tuple[float, ...]:
    return _seven(pose.position, pose.orientation)


def _twist(twist: Any) -> tuple[float, ...]:
    return (twist.linear.x, twist.linear.y, twist.angular.z)


@lru_cache(maxsize=256)
def _joint_columns(names: tuple[str, ...], lengths: tuple[int, ...]) -> tuple[tuple[str, ...], tuple[bool, ...]]:
    names = names or tuple(str(index) for index in range(max(lengths)))
    filled = tuple(length == len(names) for length in lengths)
    fields = compress(("position", "velocity", "effort"), filled)
    return tuple(f"{field}.{name}" for field in fields for name in names), filled


def _joint_state(message: Any) -> list[Part]:
    values = message.position, message.velocity, message.effort
    names, filled = _joint_columns(tuple(message.name), tuple(map(len, values)))
    return [("", names, [number for part in compress(values, filled) for number in part.tolist()], message.header)]


def _transform(message: Any) -> Part:
    numbers = _seven(message.transform.translation, message.transform.rotation)
    return f"[{message.header.frame_id}>{message.child_frame_id}]", POSE, numbers, message.header


def _laser_scan(message: Any) -> list[Part]:
    beams, ahead = len(message.ranges), 0
    if beams > 1 and message.angle_increment:
        ahead = min(max(round(-message.angle_min / message.angle_increment), 0), beams - 1)
    distance = _finite(message.ranges[ahead]) if beams else math.nan
    return [("", ("range" if beams < 2 else "range_ahead",), (distance,), message.header)]


def _finite(value: float) -> float:
    return float(value) if math.isfinite(value) else math.nan


NUMBERS: Final = ("Float32", "Float64", *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)))
MESSAGE_TYPES: Final[Mapping[str, Callable[[Any], Sequence[Part]]]] = {
    "sensor_msgs/msg/JointState": _joint_state,
    "nav_msgs/msg/Odometry": lambda m: [("", POSE + _TWIST, _pose(m.pose.pose) + _twist(m.twist.twist), m.header)],
    "geometry_msgs/msg/PoseStamped": lambda m: [("", POSE, _pose(m.pose), m.header)],
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: [("", POSE, _pose(m.pose.pose), m.header)],
    "geometry_msgs/msg/TransformStamped": lambda m: [_transform(m)],
    **dict.fromkeys(("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"), lambda m: list(map(_transform, m.transforms))),
    "geometry_msgs/msg/Twist": lambda m: [("", _TWIST, _twist(m), None)],
    "geometry_msgs/msg/TwistStamped": lambda m: [("", _TWIST, _twist(m.twist), m.header)],
    "sensor_msgs/msg/Range": lambda m: [("", ("range",), (_finite(m.range),), m.header)],
    "sensor_msgs/msg/LaserScan": _laser_scan,
    "sensor_msgs/msg/Imu": lambda m: [("", ("angular_velocity_z",), (_finite(m.angular_velocity.z),), m.header)],
    **{f"std_msgs/msg/{kind}": lambda m: [("", ("data",), (float(m.data),), None)] for kind in NUMBERS},
}

COLUMN_UNITS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("x", "y", "z", "range", "range_ahead"), "m"),
    **dict.fromkeys(("v_x", "v_y"), "mps"),
    "yaw": "rad",
    **dict.fromkeys(("omega", "angular_velocity_z"), "rad/s"),
}
