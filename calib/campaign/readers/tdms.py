"""TDMS files of DAQ programs, with the ``tdms`` extra: groups, channels, properties at three levels, waveform times."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib.campaign.model import Note
from calib.campaign.readers.recording import Recording, Stream
from calib.campaign.readers.table import NS_PER_S
from calib.errors import damage_named, missing_reader
from calib.types import FloatArray, IntArray, floats

if TYPE_CHECKING:
    from nptdms import TdmsChannel

#: TDMS times count from 1904-01-01, Unix times from 1970-01-01
_FROM_1904_S: Final = 2_082_844_800
#: samples read at a time, so that a channel is never held twice
_CHUNK_SAMPLES: Final = 1 << 20


def record(path: Path, shown: str, wanted: Callable[[str], bool] | None) -> Recording:
    """Read a TDMS file; columns are called ``group/channel``; see `calib.campaign.readers.read_recording`."""
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
    """Keep the library from writing warnings to standard error beside the one line of an error."""
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
    """Return nanoseconds since 1970 of time stamps kept as seconds since 1904 and 2^-64 of a second, rounded."""
    seconds = np.asarray(stamps.seconds, dtype=np.int64) - _FROM_1904_S
    fractions = np.rint(floats(stamps.second_fractions) * (NS_PER_S / 2.0**64)).astype(np.int64)
    return np.asarray(seconds * NS_PER_S + fractions, dtype=np.int64)


def _properties(place: str, found: Mapping[str, Any]) -> dict[str, str]:
    return {f"{place}: {key}": str(value)[:200] for key, value in found.items()}


def _streams(group: str, channels: Mapping[str, TdmsChannel]) -> list[Stream]:
    """Gather channels of one group that share length and time track."""
    together: dict[tuple[str | int, ...], dict[str, TdmsChannel]] = {}
    for name, channel in channels.items():
        track = tuple(str(channel.properties.get(key)) for key in ("wf_start_time", "wf_increment", "wf_start_offset"))
        together.setdefault((len(channel), *track), {})[name] = channel
    streams = []
    for number, members in enumerate(together.values(), start=1):
        time, clock, columns, units = _time(next(iter(members.values()))), "waveform properties", {}, {}
        for name, channel in members.items():
            if channel[0:1].dtype.names:
                # a channel of time stamps is the clock of the channels beside it
                time, clock = _moments_ns(channel[:]), f"time stamps of {name}"
                continue
            columns[name] = _values(channel)
            if unit := channel.properties.get("unit_string"):
                units[name] = str(unit)
        if columns:
            name = group if number == 1 else f"{group}#{number}"
            streams.append(Stream(name, "channels", columns, time, clock if time is not None else "none", units))
    return streams


def _values(channel: TdmsChannel) -> FloatArray:
    values: FloatArray = np.empty(len(channel))
    for start in range(0, len(channel), _CHUNK_SAMPLES):
        values[start : start + _CHUNK_SAMPLES] = channel[start : min(start + _CHUNK_SAMPLES, len(channel))]
    return values


def _time(channel: TdmsChannel) -> IntArray | None:
    """Return the times of a waveform channel: start, offset and increment, rounded to the nanosecond once."""
    step = channel.properties.get("wf_increment")
    if not isinstance(step, int | float) or not step > 0:
        return None
    offset = channel.properties.get("wf_start_offset", 0.0)
    origin = channel.properties.get("wf_start_time")
    start = int(_moments_ns(origin)) if hasattr(origin, "second_fractions") else 0
    index: FloatArray = np.arange(len(channel), dtype=np.float64)
    return start + np.rint((float(offset) + index * float(step)) * NS_PER_S).astype(np.int64)
