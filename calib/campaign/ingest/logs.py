"""Logs and recordings under calib's names: streams joined on the wheels' times, counts, clocks.

The reference and the rangefinder lag behind the wheels by the peak of the correlation of their speeds.
"""

from __future__ import annotations

from collections.abc import Mapping as MappingType
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign.counters import detect_wrap_bits, unwrap
from calib.campaign.ingest.mapping import MappedColumn, Mapping
from calib.campaign.ingest.runs import resolved, without_unit
from calib.campaign.logs_file import log_column, refuse_incomplete
from calib.campaign.model import LOG_COLUMNS, Border
from calib.campaign.readers import RawTable, Recording, holds_recording, read_recording, read_table
from calib.campaign.readers.recording import Stream, WantedColumns, check_not_empty, joined_table
from calib.campaign.readers.sheets import COUNT_UNITS
from calib.campaign.readers.table import NS_PER_S
from calib.campaign.settings import Encoder, converted, recognise, second_column
from calib.errors import BadFileError
from calib.types import BoolArray, FloatArray

#: name under which the column that tells the runs is kept
CUT_COLUMN: Final = "cut"
#: a log whose first sample is later than this is noted: its times count from the first sample
_LATE_START_S: Final = 1.0
#: an angle that spans more than one turn by this share does not start again at each turn
_ONE_TURN: Final = 1.001
#: blocks of the jackknife that gives a lag's interval
_JACKKNIFE_BLOCKS: Final = 12
#: grid points of a correlation; a long recording takes wider steps
_MAX_GRID_POINTS: Final = 40_000
#: ratio of the grid's step to the wheels' (the golden section): the grid stays in step with neither stream
_GRID_RATIO: Final = 0.6180339887498949
#: half the window over which a speed is taken, since it comes from differences of rounded readings
_SPEED_WINDOW_S: Final = 0.2
#: correlation of two speeds below which no lag is given
_LEAST_CORRELATION: Final = 0.5
#: least change of speed, as a share of it, that shows a lag
_LEAST_SPEED_CHANGE: Final = 0.02
#: samples of another stream below which no lag is estimated
_LEAST_LAG_SAMPLES: Final = 20
#: spacing of the poses of a travelled distance, wide enough that their noise lengthens it little
_POSE_SPACING_S: Final = 0.1


#: calib's column -> its source
Lines = MappingType[str, MappedColumn]


@dataclass(frozen=True, slots=True)
class Lag:
    """By how much a stream lags behind another."""

    #: positive where the second stream's clock is late
    lag_s: float
    #: 95 % interval, by leaving out each twelfth of the recording in turn
    ci95_s: tuple[float, float]


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
            lags = _estimate_lags(recording, lines, base, shown, border)
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


def _check_columns(names: Sequence[str], lines: Lines, path: Path, mapping: str) -> None:
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


def _wheel_stream(recording: Recording, lines: Lines, shown: str) -> Stream:
    """Return the stream whose times the log takes: the wheels'."""
    for name in LOG_COLUMNS:
        if name.startswith("counts_") and name in lines:
            stream = recording.stream_of(lines[name].column)
            if stream is not None:
                return stream
    check_not_empty(recording, shown)
    return max(recording.streams, key=len)


def _unwrapped(recording: Recording, lines: Lines, base: Stream, bits: int | None) -> tuple[Recording, int | None]:
    """Undo overflows of the counters that are not in the wheels' stream, before they are interpolated."""
    counters = {
        line.column for name, line in lines.items() if name.startswith("counts_") and line.unit_kind == "counts"
    }
    streams = []
    for stream in recording.streams:
        columns = dict(stream.columns)
        for name in counters & set(columns) if stream is not base else ():
            columns[name], width = continuous_counts(columns[name], bits)
            bits = width or bits
        streams.append(replace(stream, columns=columns))
    return replace(recording, streams=tuple(streams)), bits


def _joined(recording: Recording, base: Stream, lines: Lines, removed: MappingType[str, Lag], shown: str) -> RawTable:
    """Return the mapped columns at the wheels' times, their lags taken off."""
    clock = "t_s" not in lines
    if clock and base.time_ns is None and "t_s" not in base.columns:
        found = f"no clock in {base.name!r} ({', '.join(base.columns)[:120]})"
        remedy = 'name the column of times in the mapping: [log] t_s = "..."'
        raise BadFileError(shown, found, "times, as waveform properties or as a column", remedy)
    shifts_s = {}
    for name, line in lines.items():
        lag = removed.get("reference" if name.startswith("ref_") else name)
        shifts_s[line.column] = line.lag_s + (lag.lag_s if lag else 0.0)
    return joined_table(recording, base, shifts_s, clock)


def _renamed(raw: RawTable, lines: Lines, shown: str, border: Border) -> tuple[dict[str, FloatArray], int | None]:
    """Return columns under calib's names in SI units, mapped ones first, then those recognised; the clock's start."""
    columns: dict[str, FloatArray] = {}
    time_column = "t_s"
    for name, line in lines.items():
        cells = raw.columns.get(line.column)
        if cells is None:
            continue
        time_column = line.column if name == "t_s" else time_column
        if name == CUT_COLUMN or (name == "t_s" and line.column in raw.epochs):
            columns[name] = np.asarray(cells, dtype=np.float64)
        else:
            match = recognise(line.target(name), LOG_COLUMNS, further=False)
            columns[name] = converted(cells, match.factor * line.scale(name), match.offset)
    mapped = {line.column for line in lines.values()}
    for column, cells in raw.columns.items():
        match = log_column(column)
        if column in mapped or match.name not in LOG_COLUMNS or match.name in lines:
            continue
        if match.name in columns:
            raise second_column(match, column, shown)
        if match.said:
            border.say(f"{shown}, column {column}", match.said, "unit" if match.factor != 1.0 else "name")
        time_column = column if match.name == "t_s" else time_column
        columns[match.name] = converted(cells, match.factor, match.offset)
    order = [name for name in (*LOG_COLUMNS, CUT_COLUMN) if name in columns]
    return {name: columns[name] for name in order}, raw.epochs.get(time_column)


def _to_counts(columns: dict[str, FloatArray], lines: Lines, encoder: Encoder) -> None:
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
    own = base.contents()
    for stream in recording.streams:
        clock = stream.contents()
        if clock.start_ns is None:
            continue
        text, level = clock.words(), "info"
        if stream is not base and own.start_ns is not None:
            later_s = (clock.start_ns - own.start_ns) / NS_PER_S
            text += f"; starts {later_s:+.6g} s from the wheels"
            if clock.behind_arrival_s is not None and own.behind_arrival_s is not None:
                apart = clock.behind_arrival_s - own.behind_arrival_s
                text += f", stamps {apart:+.4g} s older at arrival than theirs"
            if later_s + clock.span_s < 0 or later_s > own.span_s:
                text += "; the spans do not meet: the clocks differ"
                level = "suspicious"
        border.say(f"{shown}, {stream.name}", text, "clock", level=level)


def continuous_counts(counts: FloatArray, bits: int | None = None) -> tuple[FloatArray, int | None]:
    """Return counts without overflows, and the counter's width; None where none is seen."""
    offsets = np.asarray([0, len(counts)])
    width = bits or detect_wrap_bits(counts, offsets)
    return (counts, None) if width is None else (unwrap(counts, offsets, width)[0], width)


def _estimate_lags(recording: Recording, lines: Lines, base: Stream, shown: str, border: Border) -> dict[str, Lag]:
    """Estimate by how much the reference and the rangefinder lag behind the wheels, and note it.

    `lines`: calib's column -> the recording's; `base`: the wheels' stream. Returns ``reference`` and ``range_m`` -> the
    lag, where there is one.
    """
    wheels = [
        base.columns[line.column]
        for name, line in lines.items()
        if name.startswith("counts_") and line.column in base.columns and line.unit_kind in {"counts", "angle"}
    ]
    if not wheels or base.time_ns is None:
        return {}
    origin = int(base.time_ns[0])
    time = (base.time_ns - origin) / NS_PER_S
    turned = np.mean([continuous_counts(counts)[0] for counts in wheels], axis=0)
    travelled = np.cumsum(np.abs(np.diff(turned, prepend=turned[:1])))
    lags: dict[str, Lag] = {}
    for name, columns in (("reference", ("ref_x_m", "ref_y_m")), ("range_m", ("range_m",))):
        sources = [lines[column].column for column in columns if column in lines]
        stream = recording.stream_of(sources[0]) if len(sources) == len(columns) else None
        if stream is None or stream.name == base.name or not set(sources) <= set(stream.columns):
            continue
        if stream.time_ns is None or len(stream) < _LEAST_LAG_SAMPLES:
            continue
        other = _travelled(stream, np.column_stack([stream.columns[source] for source in sources]))
        lag = estimate_lag(time, travelled, (stream.time_ns - origin) / NS_PER_S, other)
        if lag is None:
            continue
        lags[name] = lag
        low, high = lag.ci95_s
        text = f"the {name} lags {1e3 * lag.lag_s:+.1f} ms behind the wheels"
        text += f" (95 %: {1e3 * low:+.1f} .. {1e3 * high:+.1f}, by their speeds)"
        border.say(f"{shown}, {stream.name}", text, "lag")
    return lags


def _travelled(stream: Stream, positions: FloatArray) -> FloatArray:
    """Return the distance travelled through positions of shape (n_samples, 1 or 2), at every sample."""
    stride = max(1, round(_POSE_SPACING_S * stream.contents().rate_Hz))
    index = np.flatnonzero(np.isfinite(positions).all(axis=1))[::stride]
    steps = np.linalg.norm(np.diff(positions[index], axis=0), axis=1)
    total = np.concatenate(([0.0], np.cumsum(steps)))
    return np.asarray(np.interp(np.arange(len(positions)), index, total), dtype=np.float64)


def estimate_lag(
    time_s: FloatArray,
    travelled: FloatArray,
    other_time_s: FloatArray,
    other_travelled: FloatArray,
    *,
    largest_s: float = 2.0,
) -> Lag | None:
    """Estimate by how much the second stream lags behind the first.

    Both speeds are taken by central differences on one grid, smoothed alike; the lag is the peak of their correlation,
    found on the grid and then between its points.

    Parameters
    ----------
    time_s, travelled : array of float, shape (n_samples,)
        A travelled distance (or a heading) of the first stream, at its own times.
    other_time_s, other_travelled : array of float, shape (n_other,)
        The same of the second.
    largest_s : float
        Largest lag looked for.

    Returns
    -------
    Lag or None
        None where the speeds change too little to tell, or do not correlate.
    """
    from scipy.optimize import minimize_scalar
    from scipy.stats import t as student

    start, end = max(time_s[0], other_time_s[0]), min(time_s[-1], other_time_s[-1])
    own_step, other_step = float(np.median(np.diff(time_s))), float(np.median(np.diff(other_time_s)))
    step = max(own_step, other_step, 1e-3)
    if not end - start > 4 * largest_s:
        return None
    # an interpolated distance is less noisy between samples: a grid in step with one stream would prefer such a lag
    grid = np.arange(start + largest_s, end - largest_s, max(_GRID_RATIO * own_step, (end - start) / _MAX_GRID_POINTS))
    half_window = max(_SPEED_WINDOW_S, step)

    def speed(at: FloatArray, times: FloatArray, distance: FloatArray) -> FloatArray:
        """Return the mean speed over the window around each time."""
        late, early = (np.interp(at + sign * half_window, times, distance) for sign in (1.0, -1.0))
        return np.asarray((late - early) / (2 * half_window), dtype=np.float64)

    own = speed(grid, time_s, travelled)
    if not np.std(own) > _LEAST_SPEED_CHANGE * np.mean(np.abs(own)):
        return None

    def correlation(lag: float, keep: BoolArray) -> float:
        there, here = speed(grid[keep] + lag, other_time_s, other_travelled), own[keep]
        spread = float(np.std(here) * np.std(there))
        return float(np.mean((here - here.mean()) * (there - there.mean())) / spread) if spread > 0 else 0.0

    everything = np.ones(len(grid), dtype=np.bool_)
    candidates = np.arange(-largest_s, largest_s + step, max(step, 0.01))
    rough = candidates[int(np.argmax([correlation(lag, everything) for lag in candidates]))]
    bounds = (rough - max(0.05, 2.0 * step), rough + max(0.05, 2.0 * step))

    def peak(keep: BoolArray) -> float:
        found = minimize_scalar(lambda lag: -correlation(lag, keep), bounds=bounds, options={"xatol": 1e-6})
        return float(found.x)

    lag = peak(everything)
    if correlation(lag, everything) < _LEAST_CORRELATION:
        return None
    # the 95 % interval, with each block of the grid held out in turn
    block = np.arange(len(grid)) * _JACKKNIFE_BLOCKS // len(grid)
    estimates = np.asarray([peak(block != number) for number in range(_JACKKNIFE_BLOCKS)])
    half = float(student.ppf(0.975, _JACKKNIFE_BLOCKS - 1) * np.std(estimates) * np.sqrt(_JACKKNIFE_BLOCKS - 1))
    return Lag(lag, (lag - half, lag + half))
