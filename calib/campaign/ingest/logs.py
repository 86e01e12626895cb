"""Logs and recordings under calib's names: streams joined on the wheels' times, counts, clocks and lags."""

from __future__ import annotations

from collections.abc import Mapping as MappingType
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign.ingest.lags import Lag, continuous_counts, estimate_lags
from calib.campaign.ingest.mapping import COUNT_UNITS, MappedColumn, Mapping
from calib.campaign.ingest.runs import resolved, without_unit
from calib.campaign.logs_file import log_column, refuse_incomplete
from calib.campaign.model import LOG_COLUMNS, Border
from calib.campaign.readers import RawTable, Recording, holds_recording, read_recording, read_table
from calib.campaign.readers.recording import Stream, WantedColumns, check_not_empty, interpolated
from calib.campaign.readers.table import NS_PER_S
from calib.campaign.settings import Encoder, converted, recognise, second_column
from calib.errors import BadFileError
from calib.types import FloatArray

#: name under which the column that tells the runs is kept
CUT_COLUMN: Final = "cut"
#: a log whose first sample is later than this is noted: its times count from the first sample
_LATE_START_S: Final = 1.0
#: an angle that spans more than one turn by this share does not start again at each turn
_ONE_TURN: Final = 1.001


@dataclass(frozen=True, slots=True, eq=False)
class MappedLog:
    """A log, recording or part of one under calib's names."""

    #: its source, for messages
    shown: str
    #: of `LOG_COLUMNS`, SI units, ``t_s`` from the first sample; beside them ``cut`` where a column tells the runs,
    #: shape (n_samples,)
    columns: dict[str, FloatArray]
    #: time of the first sample: nanoseconds since 1970, or since midnight or the start of the clock
    start_ns: int
    #: stream -> its lag behind the wheels
    lags: MappingType[str, Lag] = field(default_factory=dict)
    #: width of the counter where overflows were undone
    wrap_bits: int | None = None
    #: whether range and poses count from the run's start
    from_start: bool = False


def read_mapped(path: Path, mapping: Mapping, encoder: Encoder, border: Border) -> MappedLog:
    """Read one log or recording, sampled at the wheels' times.

    `path`: the file, or the folder of a rosbag2 recording; `encoder`: counts a revolution, and the counter's width
    where it is known; `border`: takes notes. Raises BadFileError where a column that the mapping names is missing, or
    the file has no clock or no wheels.
    """
    shown = str(path)
    lines = {name: line for name, line in mapping.log.columns.items() if line.column}
    if mapping.cut is not None and mapping.cut.column:
        lines[CUT_COLUMN] = MappedColumn(column=mapping.cut.column)
    sources = {line.column for line in lines.values()}
    lags: dict[str, Lag] = {}
    bits = encoder.wrap_bits
    if holds_recording(path):
        recording = read_recording(path, shown, WantedColumns(frozenset(sources)) if lines else None)
        _check_columns(recording.column_names, lines, path, mapping.shown)
        base = _wheel_stream(recording, lines, shown)
        recording, bits = _unwrapped(recording, lines, base, bits)
        if base.time_ns is not None:
            _note_clocks(recording, base, shown, border)
            lags = estimate_lags(recording, lines, base, shown, border)
        raw = _joined(recording, base, lines, lags if mapping.log.lag == "remove" else {}, shown)
        border.notes.extend(recording.notes)
    else:
        layout = mapping.log.layout

        def wanted(name: str) -> bool:
            return name in sources or without_unit(name) in sources or log_column(name).name in LOG_COLUMNS

        raw = read_table(path, shown, wanted, layout)
        lines = resolved(lines, raw.columns)
        _check_columns(tuple(raw.columns), lines, path, mapping.shown)
        border.notes.extend(raw.notes)
    columns, epoch = _renamed(raw, lines, shown, border)
    if "t_s" in columns:
        _to_counts(columns, lines, encoder)
    refuse_incomplete(columns, shown, raw.line)
    if not len(raw.line):
        raise BadFileError(shown, found="no rows", expected="one row a sample", remedy="export the log again")
    columns = _without_repeats(columns, shown, border)
    start = float(columns["t_s"][0])
    if abs(start) > _LATE_START_S:
        border.say(shown, f"times count from the first sample, which was at {start:.10g} s", "start_time")
        columns["t_s"] = columns["t_s"] - start
    return MappedLog(shown, columns, round(start * NS_PER_S) if epoch is None else epoch, lags, bits)


def _check_columns(names: Sequence[str], lines: MappingType[str, MappedColumn], path: Path, mapping: str) -> None:
    """Refuse a file without a column that the mapping names, listing those it has."""
    shown, is_recording = str(path), holds_recording(path)
    missing = [name for name, line in lines.items() if line.column not in names]
    if missing and is_recording:
        # only the columns named were read
        whole = read_recording(path, shown)
        check_not_empty(whole, shown)
        names = whole.column_names
        missing = [name for name in missing if lines[name].column not in names]
    if missing:
        name = missing[0]
        found = f"no column {lines[name].column!r}, only {', '.join(names)[:300]}"
        remedy = f"correct log.{name} in {mapping}; 'calib ingest --describe' lists the columns"
        row = None if is_recording else 1
        raise BadFileError(shown, found, "the column that the mapping names", remedy, row=row, column=name)


def _wheel_stream(recording: Recording, lines: MappingType[str, MappedColumn], shown: str) -> Stream:
    """Return the stream whose times the log takes: the wheels'."""
    for name in LOG_COLUMNS:
        if name.startswith("counts_") and name in lines:
            stream = recording.stream_of(lines[name].column)
            if stream is not None:
                return stream
    check_not_empty(recording, shown)
    return max(recording.streams, key=len)


def _unwrapped(
    recording: Recording, lines: MappingType[str, MappedColumn], base: Stream, bits: int | None
) -> tuple[Recording, int | None]:
    """Undo overflows of counters before they are interpolated."""
    streams = []
    for stream in recording.streams:
        columns = dict(stream.columns)
        for name, line in lines.items():
            is_counter = name.startswith("counts_") and line.wheel_unit == "counts"
            if is_counter and line.column in columns and stream is not base:
                columns[line.column], width = continuous_counts(columns[line.column], bits)
                bits = width or bits
        streams.append(stream if stream is base else replace(stream, columns=columns))
    return replace(recording, streams=tuple(streams)), bits


def _joined(
    recording: Recording,
    base: Stream,
    lines: MappingType[str, MappedColumn],
    removed: MappingType[str, Lag],
    shown: str,
) -> RawTable:
    """Return the mapped columns at the wheels' times, with the clock's start as epoch of ``t_s``."""
    time_ns = None if "t_s" in lines else base.time_ns
    if time_ns is None and "t_s" not in lines and "t_s" not in base.columns:
        found = f"no clock in {base.name!r} ({', '.join(base.columns)[:120]})"
        remedy = 'name the column of times in the mapping: [log] t_s = "..."'
        raise BadFileError(shown, found, "times, as waveform properties or as a column", remedy)
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
        shift_s = line.lag_s + (lag.lag_s if lag else 0.0)
        columns[line.column] = interpolated(stream, line.column, time_ns, shift_ns=round(shift_s * NS_PER_S))
    line_numbers = np.arange(1, len(base) + 1, dtype=np.int64)
    if time_ns is None:
        return RawTable(columns, line_numbers)
    columns["t_s"] = (time_ns - time_ns[0]) / NS_PER_S
    return RawTable(columns, line_numbers, epochs={"t_s": int(time_ns[0])})


def _renamed(
    raw: RawTable, lines: MappingType[str, MappedColumn], shown: str, border: Border
) -> tuple[dict[str, FloatArray], int | None]:
    """Return columns under calib's names in SI units, mapped ones first, then those recognised; the clock's start."""
    columns: dict[str, FloatArray] = {}
    time_column = "t_s"
    for name, line in lines.items():
        if line.column not in raw.columns:
            continue
        if name == "t_s":
            time_column = line.column
        if name == CUT_COLUMN or (name == "t_s" and line.column in raw.epochs):
            columns[name] = np.asarray(raw.columns[line.column], dtype=np.float64)
            continue
        match = recognise(line.target(name), LOG_COLUMNS, further=False)
        columns[name] = converted(raw.columns[line.column], match.factor * line.scale(name), match.offset)
    mapped = {line.column for line in lines.values()}
    for column, cells in raw.columns.items():
        match = log_column(column)
        if column in mapped or match.name not in LOG_COLUMNS or match.name in lines:
            continue
        if match.name in columns:
            raise second_column(match, column, shown)
        if match.said:
            border.say(f"{shown}, column {column}", match.said, "unit" if match.factor != 1.0 else "name")
        if match.name == "t_s":
            time_column = column
        columns[match.name] = converted(cells, match.factor, match.offset)
    order: tuple[str, ...] = (*LOG_COLUMNS, CUT_COLUMN)
    ordered = {name: columns[name] for name in order if name in columns}
    return ordered, raw.epochs.get(time_column)


def _to_counts(columns: dict[str, FloatArray], lines: MappingType[str, MappedColumn], encoder: Encoder) -> None:
    """Turn angles, rates and increments of the wheels into counts, in place."""
    time = columns["t_s"]
    for name in [name for name in columns if name.startswith("counts_") and name in lines]:
        kind, turns = COUNT_UNITS[lines[name].wheel_unit]
        values = columns[name]
        per_rev = encoder.counts_per_rev_right if name.endswith("right") else encoder.counts_per_rev_left
        per_rev = encoder.front if name == "counts_front" else per_rev
        if kind == "increments":
            columns[name] = np.cumsum(values)
        elif kind == "angle":
            turn = 1.0 / turns
            # an angle that starts again after each turn is made continuous
            angle = values if np.ptp(values) > _ONE_TURN * turn else np.unwrap(values, period=turn)
            columns[name] = angle * turns * per_rev
        elif kind != "counts":
            steps = 0.5 * (values[1:] + values[:-1]) * np.diff(time)
            total = np.concatenate(([0.0], np.cumsum(steps)))
            columns[name] = total * (turns * per_rev if kind == "rate" else 1.0)


def _without_repeats(columns: dict[str, FloatArray], shown: str, border: Border) -> dict[str, FloatArray]:
    """Return columns with the last sample of each time stamp that comes again at once; counts lose nothing by it."""
    again = np.append(np.diff(columns["t_s"]) == 0, False)
    if not again.any():
        return columns
    text = f"{int(again.sum())} sample(s) whose time stamp comes again were omitted; the last of each was kept"
    border.say(shown, text, "repeated_stamp")
    return {name: values[~again] for name, values in columns.items()}


def _note_clocks(recording: Recording, base: Stream, shown: str, border: Border) -> None:
    """Note what the streams' clocks show: span, rate, gaps, and offsets from the wheels' stream `base`."""
    for stream in recording.streams:
        report = stream.report()
        if report is None:
            continue
        text = f"{report.n_samples} samples over {report.span_s:.6g} s at {report.rate_Hz:.4g} Hz ({stream.clock})"
        level = "info"
        if report.n_gaps:
            text += f"; {report.n_gaps} gap(s), the longest {report.longest_gap_s:.3g} s"
        if stream is not base and base.time_ns is not None and stream.time_ns is not None:
            text += f"; starts {(report.start_ns - int(base.time_ns[0])) / NS_PER_S:+.6g} s from the wheels"
            if stream.behind_arrival_s is not None and base.behind_arrival_s is not None:
                apart = stream.behind_arrival_s - base.behind_arrival_s
                text += f", stamps {apart:+.4g} s older at arrival than theirs"
            if report.end_ns < int(base.time_ns[0]) or report.start_ns > int(base.time_ns[-1]):
                text += "; the spans do not meet: the clocks differ"
                level = "suspicious"
        border.say(f"{shown}, {stream.name}", text, "clock", level=level)
