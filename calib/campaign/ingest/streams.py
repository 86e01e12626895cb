"""Read one log or recording as a mapping says: columns under calib's names, counts whatever the wheels gave."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.campaign.columns import converted, recognise, second_column
from calib.campaign.faults import Border
from calib.campaign.ingest.clocks import estimate_lags, say_clocks
from calib.campaign.ingest.lag import Lag
from calib.campaign.ingest.mapping import COUNT_UNITS, Line, MappingFile
from calib.campaign.logs_file import log_column, refuse_incomplete
from calib.campaign.model import LOG_COLUMNS
from calib.campaign.readers import RawTable, Recording, holds_recording, read_recording, read_table
from calib.campaign.readers.recording import Stream, WantedColumns, interpolated, refuse_nothing
from calib.campaign.readers.times import NS_PER_S
from calib.campaign.settings import Encoder
from calib.campaign.wraps import detect_wrap_bits, unwrap
from calib.errors import BadFileError

#: name under which the column that tells the runs is kept
CUT: Final = "cut"


@dataclass(frozen=True, slots=True, eq=False)
class MappedLog:
    """A log or recording under calib's names."""

    #: of `LOG_COLUMNS`, SI units, ``t_s`` from the first sample; beside them ``cut`` where a column tells the runs,
    #: shape (n_samples,)
    columns: dict[str, FloatArray]
    #: time of the first sample: nanoseconds since 1970, or since midnight or the start of the clock
    start_ns: int
    #: how far other streams lag behind the wheels, by what they measure
    lags: Mapping[str, Lag]
    #: width of the counter where overflows were found before streams were joined
    wrap_bits: int | None = None


def read_mapped(path: Path, shown: str, mapping: MappingFile, encoder: Encoder, border: Border) -> MappedLog:
    """Read one log or recording.

    Parameters
    ----------
    path : Path
        The file, or the folder of a rosbag2 recording.
    shown : str
        Its name in messages.
    mapping : MappingFile
        Its lines for logs.
    encoder : Encoder
        Counts a revolution, and the counter's width where it is known.
    border : Border
        Takes notes.

    Returns
    -------
    MappedLog
        Sampled at the wheels' times.

    Raises
    ------
    BadFileError
        Where a column that the mapping names is missing, or the file has no clock or no wheels.
    """
    lines = {line.name: line for line in mapping.log if line.column}
    if mapping.cut is not None and mapping.cut.column:
        lines[CUT] = Line(CUT, mapping.cut.column)
    lags: dict[str, Lag] = {}
    bits = encoder.wrap_bits
    if holds_recording(path):
        wanted = frozenset(line.column for line in lines.values())
        recording = read_recording(path, shown, WantedColumns(wanted) if lines else None)
        _refuse_absent(recording.column_names, lines.values(), path, shown, mapping.shown)
        base = _base(recording, lines, shown)
        recording, bits = _unwrapped(recording, lines, base, bits)
        time_ns = _times(base, lines, shown)
        if base.time_ns is not None:
            say_clocks(recording, base, shown, border)
            lags = estimate_lags(recording, lines, base, shown, border)
        raw, epoch = _joined(recording, base, time_ns, lines, lags if mapping.log_files.remove_lag else {})
        border.notes.extend(recording.notes)
    else:
        mapped = {line.column for line in lines.values()}
        layout = mapping.log_files.layout
        raw = read_table(path, shown, lambda name: name in mapped or log_column(name).name in LOG_COLUMNS, layout)
        _refuse_absent(tuple(raw.columns), lines.values(), path, shown, mapping.shown)
        border.notes.extend(raw.notes)
        epoch = None
    columns, epoch = _renamed(raw, lines, shown, border, epoch)
    if "t_s" in columns:
        _counts(columns, lines, encoder)
    refuse_incomplete(columns, shown, raw.line)
    if not len(raw.line):
        raise BadFileError(shown, found="no rows", expected="one row a sample", remedy="export the log again")
    start = float(columns["t_s"][0])
    if epoch is None:
        epoch = round(start * NS_PER_S)
    if abs(start) > 1.0:
        border.say(shown, f"times count from the first sample, which stood at {start:.10g} s", "start_time")
        columns["t_s"] = columns["t_s"] - start
    return MappedLog(columns, epoch, lags, bits)


def _refuse_absent(names: Sequence[str], lines: Iterable[Line], path: Path, shown: str, shown_mapping: str) -> None:
    for line in lines:
        if line.column not in names:
            listed = names
            if holds_recording(path):
                whole = read_recording(path, shown)
                refuse_nothing(whole, shown)
                listed = whole.column_names
                if line.column in listed:
                    continue
            raise BadFileError(
                shown,
                row=None if holds_recording(path) else 1,
                column=line.name,
                found=f"no column {line.column!r}, only {', '.join(listed)[:300]}",
                expected="the column that the mapping names",
                remedy=f"correct log.{line.name} in {shown_mapping}; 'calib ingest --describe' lists the columns",
            )


def _base(recording: Recording, lines: Mapping[str, Line], shown: str) -> Stream:
    """Return the stream whose times the log takes: the wheels'."""
    for name in LOG_COLUMNS:
        if name.startswith("counts_") and name in lines:
            stream = recording.stream_of(lines[name].column)
            if stream is not None:
                return stream
    refuse_nothing(recording, shown)
    return max(recording.streams, key=len)


def _times(base: Stream, lines: Mapping[str, Line], shown: str) -> IntArray | None:
    """Return the times of the base where it has a clock; refuse one that has none and gets none."""
    if "t_s" in lines or base.time_ns is None:
        if "t_s" not in lines and "t_s" not in base.columns:
            expected = "times, as waveform properties or as a column"
            remedy = 'name the column of times in the mapping: [log] t_s = "..."'
            raise BadFileError(shown, f"no clock in {base.name!r} ({', '.join(base.columns)[:120]})", expected, remedy)
        return None
    return base.time_ns


def _unwrapped(
    recording: Recording, lines: Mapping[str, Line], base: Stream, bits: int | None
) -> tuple[Recording, int | None]:
    """Undo overflows of counters before anything is interpolated across them."""
    streams = []
    for stream in recording.streams:
        changed: dict[str, FloatArray] = {}
        for name, line in lines.items():
            plain = name.startswith("counts_") and (line.unit or "counts") == "counts"
            if not plain or line.column not in stream.columns or stream is base:
                continue
            counts = stream.columns[line.column]
            whole = np.asarray([0, len(counts)])
            width = bits or detect_wrap_bits(counts, whole)
            if width is not None:
                changed[line.column], _ = unwrap(counts, whole, width)
                bits = width
        streams.append(replace(stream, columns={**stream.columns, **changed}) if changed else stream)
    return replace(recording, streams=tuple(streams)), bits


def _joined(
    recording: Recording,
    base: Stream,
    time_ns: IntArray | None,
    lines: Mapping[str, Line],
    removed: Mapping[str, Lag],
) -> tuple[RawTable, int | None]:
    columns: dict[str, FloatArray] = {}
    for name, line in lines.items():
        stream = recording.stream_of(line.column)
        if stream is None:
            continue
        if stream.name == base.name or stream.time_ns is None or time_ns is None:
            if len(stream) == len(base):
                columns[line.column] = stream.columns[line.column]
            continue
        lag = removed.get("reference" if name.startswith("ref_") else name)
        shift = line.lag_s + (lag.lag_s if lag else 0.0)
        columns[line.column] = interpolated(stream, line.column, time_ns, shift_ns=round(shift * NS_PER_S))
    epoch = None
    if time_ns is not None:
        columns["t_s"] = (time_ns - time_ns[0]) / NS_PER_S
        epoch = int(time_ns[0])
    return RawTable(columns, np.arange(1, len(base) + 1, dtype=np.int64)), epoch


def _renamed(
    raw: RawTable, lines: Mapping[str, Line], shown: str, border: Border, epoch: int | None
) -> tuple[dict[str, FloatArray], int | None]:
    """Give columns calib's names and SI units; those that the mapping names first, then those recognised."""
    columns: dict[str, FloatArray] = {}
    for name, line in lines.items():
        if line.column not in raw.columns:
            continue
        if name == CUT:
            columns[CUT] = np.asarray(raw.columns[line.column], dtype=np.float64)
            continue
        if name == "t_s" and line.column in raw.epochs:
            epoch = raw.epochs[line.column]
            columns[name] = raw.columns[line.column]
            continue
        match = recognise(line.target, LOG_COLUMNS, further=False)
        columns[name] = converted(raw.columns[line.column], match.factor * line.factor, match.offset)
    mapped = {line.column for line in lines.values()}
    for column, cells in raw.columns.items():
        match = log_column(column)
        if column in mapped or match.name not in LOG_COLUMNS or match.name in lines:
            continue
        if match.name in columns:
            raise second_column(match, column, shown)
        if match.said:
            border.say(f"{shown}, column {column}", match.said, "unit" if match.factor != 1.0 else "name")
        if match.name == "t_s" and column in raw.epochs:
            epoch = raw.epochs[column]
        columns[match.name] = converted(cells, match.factor, match.offset)
    ordered: dict[str, FloatArray] = {name: columns[name] for name in (*LOG_COLUMNS, CUT) if name in columns}
    return ordered, epoch


def _counts(columns: dict[str, FloatArray], lines: Mapping[str, Line], encoder: Encoder) -> None:
    """Turn angles, rates and increments of the wheels into counts, in place."""
    time = columns["t_s"]
    for name in [name for name in columns if name.startswith("counts_")]:
        line = lines.get(name)
        kind, turns = COUNT_UNITS[(line.unit if line else None) or "counts"]
        if kind == "counts":
            continue
        values = columns[name]
        per_rev = encoder.counts_per_rev_right if name.endswith("right") else encoder.counts_per_rev_left
        if name == "counts_front":
            per_rev = encoder.front
        if kind == "increments":
            columns[name] = np.cumsum(values)
        elif kind == "angle":
            columns[name] = _continuous_angle(values, 1.0 / turns) * turns * per_rev
        else:
            steps = 0.5 * (values[1:] + values[:-1]) * np.diff(time)
            total = np.concatenate(([0.0], np.cumsum(steps)))
            columns[name] = total * (turns * per_rev if kind == "rate" else 1.0)


def _continuous_angle(angle: FloatArray, turn: float) -> FloatArray:
    """Return an angle that runs on where its sensor starts again after a turn."""
    if np.ptp(angle) > 1.001 * turn:
        return angle
    return np.unwrap(angle, period=turn)
