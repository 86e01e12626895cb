"""ROS recordings, with the ``ros`` extra: ROS 1 bags, rosbag2 folders and files (sqlite3, MCAP), plain MCAP."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.campaign.model import Note
from calib.campaign.readers.recording import UNREAD, Recording, Stream, WantedColumns, in_order
from calib.campaign.readers.ros_messages import POSE, SUPPORTED, UNITS, finished, parts
from calib.errors import BadFileError

#: stamps of most messages have to be set for the stamps to be the clock
_STAMPED: Final = 0.99


def record(path: Path, shown: str, wanted: Callable[[str], bool] | None) -> Recording:
    """Read the topics whose message types calib knows, message by message; see `calib.campaign.readers.read_recording`.

    What is kept is eight bytes a number that is wanted; messages themselves are not kept, whatever their size.
    """
    with _opened(path, shown) as reader:
        known = [connection for connection in reader.connections if connection.msgtype in SUPPORTED]
        if isinstance(wanted, WantedColumns):
            known = [connection for connection in known if wanted.of_topic(connection.topic)]
        gathered: dict[tuple[str, tuple[str, ...]], _Gathered] = {}
        with _decoding(shown):
            for connection, arrival, data in reader.messages(connections=known) if known else ():
                kind, topic = connection.msgtype, connection.topic
                for suffix, names, numbers, stamp in parts(kind, reader.deserialize(data, kind)):
                    key = (topic + suffix, names)
                    stream = gathered.get(key)
                    if stream is None:
                        stream = gathered[key] = _Gathered(topic + suffix, kind, names, wanted)
                    stream.add(numbers, arrival, stamp)
        skipped = sorted({connection.msgtype for connection in reader.connections} - set(SUPPORTED))
    notes: list[Note] = []
    if skipped and (wanted is None or not gathered):
        notes.append(Note("info", shown, f"messages that calib does not read: {', '.join(skipped)[:200]}", UNREAD))
    streams = _named([numbers.stream(shown, notes) for numbers in gathered.values() if len(numbers.arrival)])
    return Recording(tuple(streams), tuple(notes))


@dataclass(slots=True)
class _Gathered:
    """Numbers of one stream as they come, kept as packed arrays."""

    name: str
    kind: str
    names: tuple[str, ...]
    wanted: Callable[[str], bool] | None
    arrival: array[int] = field(default_factory=lambda: array("q"))
    stamp: array[int] = field(default_factory=lambda: array("q"))
    numbers: array[float] = field(default_factory=lambda: array("d"))
    unstamped: int = 0
    kept: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        if self.wanted is not None:
            turn = self.wanted(f"{self.name}:yaw")
            self.kept = tuple(
                index
                for index, name in enumerate(self.names)
                if self.wanted(f"{self.name}:{name}") or (turn and name in POSE[3:])
            )
            if len(self.kept) == len(self.names):
                self.kept = None

    def add(self, numbers: Sequence[float], arrival: int, stamp: int | None) -> None:
        self.arrival.append(arrival)
        if stamp is None:
            self.unstamped += 1
            stamp = arrival
        self.stamp.append(stamp)
        if self.kept is None:
            self.numbers.extend(numbers)
        else:
            for index in self.kept:
                self.numbers.append(numbers[index])

    def stream(self, shown: str, notes: list[Note]) -> Stream:
        names = self.names if self.kept is None else tuple(self.names[index] for index in self.kept)
        table = np.frombuffer(self.numbers, dtype=np.float64).reshape(len(self.arrival), len(names))
        arrival: IntArray = np.frombuffer(self.arrival, dtype=np.int64)
        stamp: IntArray = np.frombuffer(self.stamp, dtype=np.int64)
        stamped = self.unstamped < (1.0 - _STAMPED) * len(arrival)
        behind = float(np.median(arrival - stamp)) / 1e9 if stamped else None
        time, columns, backward = in_order(stamp if stamped else arrival, list(table.T))
        if backward:
            notes.append(
                Note(
                    "info", f"{shown}, {self.name}", f"{backward} message(s) out of order were sorted by time", "order"
                )
            )
        ready: dict[str, FloatArray] = finished(dict(zip(names, columns, strict=True)))
        full = {f"{self.name}:{name}": np.ascontiguousarray(values) for name, values in ready.items()}
        return Stream(
            name=self.name,
            kind=self.kind,
            columns=full,
            time_ns=np.ascontiguousarray(time),
            clock="stamps of the messages" if stamped else "arrival of the messages",
            units={f"{self.name}:{name}": UNITS[name] for name in ready if name in UNITS},
            behind_arrival_s=behind,
        )


def _named(streams: list[Stream]) -> Iterator[Stream]:
    """Give streams of one topic that hold different joints names of their own; the largest keeps the topic's."""
    taken: dict[str, int] = {}
    for stream in sorted(streams, key=len, reverse=True):
        number = taken[stream.name] = taken.get(stream.name, 0) + 1
        if number == 1:
            yield stream
            continue
        name = f"{stream.name}#{number}"
        columns = {name + column[len(stream.name) :]: values for column, values in stream.columns.items()}
        yield Stream(name, stream.kind, columns, stream.time_ns, stream.clock, {}, stream.behind_arrival_s)


@contextmanager
def _opened(path: Path, shown: str) -> Iterator[Any]:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise BadFileError(
            shown, "a ROS recording, and no reader for it", "rosbags", "install it with: pip install 'calib[ros]'"
        ) from error
    source = path.parent if path.name == "metadata.yaml" else path
    if source.is_file() and source.stat().st_size == 0:
        raise _damaged(shown, "the file is empty")
    try:
        # definitions come from the file; those of the library stand in for a file that has none
        reader = AnyReader([source], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    except OSError as error:
        raise BadFileError(shown, str(error)[:120], "a readable recording", "check the path and its rights") from error
    except MemoryError:
        raise
    except Exception as error:
        # the library answers damage with errors of many kinds (its own, struct, assertions, sqlite, YAML)
        if "erialization format" in str(error):
            raise _encoding(shown, str(error)) from error
        raise _damaged(shown, _words(error)) from error
    try:
        strange = {
            str(form)
            for connection in reader.connections
            if (form := getattr(connection.ext, "serialization_format", "cdr")) not in {"cdr", ""}
        }
        if strange:
            raise _encoding(shown, ", ".join(sorted(strange)))
        yield reader
    finally:
        reader.close()


@contextmanager
def _decoding(shown: str) -> Iterator[None]:
    try:
        yield
    except (MemoryError, KeyboardInterrupt):
        raise
    except Exception as error:
        raise _damaged(shown, _words(error)) from error


def _words(error: Exception) -> str:
    text = " ".join(str(error).split())
    return (text or type(error).__name__)[:120].rstrip(".")


def _encoding(shown: str, text: str) -> BadFileError:
    name = text.partition("{")[2].partition("}")[0].strip("'") or text
    expected = "ROS messages in 'cdr', the encoding that ROS 2 records in"
    remedy = "convert the recording with 'ros2 bag convert' (serialization cdr), or record it again with the default"
    return BadFileError(shown, f"messages in the encoding {name!r}, which nothing here can read", expected, remedy)


def _damaged(shown: str, reason: str) -> BadFileError:
    expected = "a whole one, closed by its recorder"
    remedy = "copy it again, or repair it with 'mcap recover', 'ros2 bag reindex' or 'rosbag reindex'"
    return BadFileError(shown, f"a recording that is cut or damaged ({reason})", expected, remedy)
