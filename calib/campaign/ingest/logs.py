"""Logs and recordings under calib's names: streams joined on the wheels' times, counts, clocks."""

from collections.abc import Iterable
from collections.abc import Mapping as MappingType
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign.ingest.guesses import (
    Lag,
    Lines,
    continuous_angle,
    continuous_counts,
    estimate_lags,
    guessed_log_column,
    stem_and_unit,
)
from calib.campaign.ingest.mapping import MappedColumn, Mapping, counts_per_unit
from calib.campaign.ingest.runs import resolved, whole_name, without_unit
from calib.campaign.logs import (
    add_recognised,
    from_first_sample,
    in_log,
    log_column,
    omit_lost_frames,
    refuse_incomplete,
)
from calib.campaign.model import LOG_COLUMNS, REFERENCE_POSE, Border, Campaign, Note
from calib.campaign.readers import RawTable, holds_recording, joined_table, read_recording, read_table
from calib.campaign.readers.recording import Recording, Stream, WantedColumns, check_not_empty
from calib.campaign.readers.sheets import COUNT_UNITS
from calib.campaign.readers.table import NS_PER_S
from calib.campaign.settings import Recognised, converted, recognise
from calib.errors import BadFileError
from calib.types import SUFFIXES, FloatArray, floats

#: name of the column that tells the runs
CUT_COLUMN: Final = "cut"


@dataclass(frozen=True, slots=True, eq=False)
class MappedLog:
    """A log, recording or part of one under calib's names."""

    #: for messages
    shown: str
    #: of `LOG_COLUMNS`, SI units, ``t_s`` from the first sample; ``cut`` where a column tells the runs, shape
    #: (n_samples,)
    columns: dict[str, FloatArray]
    #: time of the first sample: nanoseconds since 1970, or since midnight or the start of the clock
    start_ns: int
    #: stream -> its lag behind the wheels
    lags: MappingType[str, Lag] = field(default_factory=dict)
    #: where overflows were undone
    wrap_bits: int | None = None
    #: range and poses count from the run's start
    from_start: bool = False


def read_mapped(files: MappingType[str, Path], mapping: Mapping, settings: Campaign, border: Border) -> MappedLog:
    """Read the log of a run or a recording, sampled at the wheels' times.

    `files`: one file, or a rosbag2 folder, under an empty name; or those of a run by the names of ``log.files``. Raises
    BadFileError where a column that the mapping names is missing, or the file has no clock or no wheels.
    """
    path = next(iter(files.values()))
    shown = str(path)
    lines = {name: line for name, line in mapping.log.columns.items() if line.column}
    if mapping.cut is not None and mapping.cut.column:
        lines[CUT_COLUMN] = MappedColumn(column=mapping.cut.column)
    lags: dict[str, Lag] = {}
    bits = settings.encoder.wrap_bits
    if "" not in files or holds_recording(path):
        if "" in files:
            recording = _recording(path, shown, lines, mapping)
        else:
            recording = _gathered(files, lines, mapping)
            lines = resolved({name: line for name, line in lines.items() if name != "t_s"}, recording.column_names)
            _refuse_missing(recording.column_names, lines, shown, mapping)
        base = _wheel_stream(recording, lines, shown)
        recording, bits = _unwrapped(recording, lines, base, bits, shown, border)
        if base.time_ns is not None:
            _note_clocks(recording, base, shown, border)
            lags = estimate_lags(recording, lines, base, shown, border)
        raw = _joined(recording, base, lines, lags if mapping.log.lag == "remove" else {}, shown)
        raw = _of_all_wheels(raw, lines, shown, border)
        border.notes.extend(recording.notes)
    else:
        sources = {name for line in lines.values() for name in line.sources}

        def wanted(name: str) -> bool:
            return name in sources or without_unit(name) in sources or in_log(name)

        raw = read_table(path, shown, wanted, mapping.log.layout)
        lines = resolved(lines, raw.columns)
        raw = replace(raw, columns=_with_heading(raw.columns, lines, shown, border))
        _refuse_missing(raw.columns, lines, shown, mapping, row=1)
        border.notes.extend(raw.notes)
    columns, epoch = _renamed(raw, lines, shown, border)
    if "t_s" in columns:
        _to_counts(columns, lines, settings, shown, border)
    refuse_incomplete(columns, shown, raw.line)
    omit_lost_frames(columns, REFERENCE_POSE, shown, border)
    columns = _without_repeats(columns, shown, border)
    start = from_first_sample(columns, shown, border)
    return MappedLog(shown, columns, round(start * NS_PER_S) if epoch is None else epoch, lags, bits)


def _recording(path: Path, shown: str, lines: Lines, mapping: Mapping) -> Recording:
    wanted = WantedColumns(name for line in lines.values() for name in line.sources)
    recording = read_recording(path, shown, wanted if lines else None)
    if any(not {*line.sources} <= {*recording.column_names} for line in lines.values()):
        # not the named columns alone
        whole = read_recording(path, shown)
        check_not_empty(whole, shown)
        _refuse_missing(whole.column_names, lines, shown, mapping)
    return recording


def _gathered(files: MappingType[str, Path], lines: Lines, mapping: Mapping) -> Recording:
    streams: list[Stream] = []
    notes: list[Note] = []
    for tag, path in files.items():
        clock = mapping.log.clock_of(tag)
        sources = {name.removeprefix(f"{tag}:") for line in lines.values() for name in line.sources} | {clock.column}

        def wanted(name: str, sources: set[str] = sources) -> bool:
            return name in sources or without_unit(name) in sources or log_column(name).name == "t_s"

        raw = read_table(path, str(path), wanted, mapping.log.layout)
        own = next((name for name in raw.columns if log_column(name).name == "t_s"), clock.column)
        time = whole_name(clock.column, raw.columns)
        time = time if time in raw.columns else whole_name(own, raw.columns)
        if time not in raw.columns:
            found, expected = f"no column {clock.column!r} for the times", "times in each file of a run"
            remedy = f"correct log.t_s in {mapping.shown}"
            raise BadFileError(str(path), found, expected, remedy, row=1, column="t_s")
        line = clock.model_copy(update={"column": time})
        match = recognise(line.target("t_s"), LOG_COLUMNS, further=False)
        factor = 1.0 if time in raw.epochs else match.factor * line.scale("t_s")
        time_ns = raw.epochs.get(time, 0) + np.rint(raw.columns[time] * factor * NS_PER_S).astype(np.int64)
        order = np.argsort(time_ns, kind="stable")
        columns = {f"{tag}:{name}": cells[order] for name, cells in raw.columns.items() if name != time}
        streams.append(Stream(tag, "file", columns, time_ns[order], "times of the file"))
        notes += raw.notes
    return Recording(tuple(streams), tuple(notes))


def _refuse_missing(names: Iterable[str], lines: Lines, shown: str, mapping: Mapping, row: int | None = None) -> None:
    known = list(names)
    for name, line in lines.items():
        for column in (source for source in line.sources if source not in known):
            found = f"no column {column!r}, " + (f"only {', '.join(known)[:300]}" if known else "nor any of the others")
            remedy = f"correct log.{name} in {mapping.shown}; 'calib ingest --describe' lists the columns"
            if not known:
                remedy = f"if it is no log, name the logs alone ({Path(shown).parent}/run*.csv); else {remedy}"
            raise BadFileError(shown, found, "the column that the mapping names", remedy, row=row, column=name)


def _of_all_wheels(raw: RawTable, lines: Lines, shown: str, border: Border) -> RawTable:
    wheels = [raw.columns[line.column] for name, line in lines.items() if name.startswith(("counts_", "speed_"))]
    known = np.isfinite(np.sum(wheels, axis=0)) if wheels else np.ones(len(raw.line), dtype=np.bool_)
    if known.all() or not known.any():
        return raw
    text = f"{int((~known).sum())} sample(s) at which another wheel has none near in time were omitted"
    border.say(shown, text, "one_wheel")
    return raw.select(known)


def _wheel_stream(recording: Recording, lines: Lines, shown: str) -> Stream:
    wheels = (lines[name].column for name in LOG_COLUMNS if name.startswith("counts_") and name in lines)
    if stream := next(filter(None, map(recording.stream_of, wheels)), None):
        return stream
    check_not_empty(recording, shown)
    return max(recording.streams, key=len)


def _unwrapped(
    recording: Recording, lines: Lines, base: Stream, bits: int | None, shown: str, border: Border
) -> tuple[Recording, int | None]:
    counters = {one.column for name, one in lines.items() if name.startswith("counts_") and one.wheel_unit == "counts"}
    streams = []
    for stream in recording.streams:
        columns = _with_heading(stream.columns, lines, shown, border)
        for name in counters & set(columns) if stream is not base else ():
            time_s = None if stream.time_ns is None else (stream.time_ns - stream.time_ns[0]) / NS_PER_S
            columns[name], width = continuous_counts(columns[name], bits, time_s)
            bits = width or bits
        streams.append(replace(stream, columns=columns))
    return replace(recording, streams=tuple(streams)), bits


def _with_heading(
    columns: MappingType[str, FloatArray], lines: Lines, shown: str, border: Border
) -> dict[str, FloatArray]:
    out, line = dict(columns), lines.get("ref_theta_rad", MappedColumn(column="ref_theta_rad"))
    poses = [column for name in REFERENCE_POSE if name in lines for column in lines[name].sources]
    omit_lost_frames(out, poses, shown, border)
    for name, cells in out.items():
        mapped = name == line.column
        match = recognise(line.target("ref_theta_rad"), LOG_COLUMNS, further=False) if mapped else log_column(name)
        if mapped and line.w in columns:
            w, match = columns[line.w], Recognised(name, "ref_theta_rad")
            cells = np.arctan2(2.0 * w * cells, w * w - cells * cells)
        if match.name == "ref_theta_rad":
            scale = match.factor * (line.scale(match.name) if mapped else 1.0)
            out[name] = continuous_angle(cells, 2.0 * np.pi / abs(scale))
    return out


def _joined(recording: Recording, base: Stream, lines: Lines, removed: MappingType[str, Lag], shown: str) -> RawTable:
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
    columns: dict[str, FloatArray] = {}
    for name, line in lines.items():
        if line.column not in raw.columns:
            continue
        cells = raw.columns[line.column]
        if name == CUT_COLUMN or (name == "t_s" and line.column in raw.epochs):
            columns[name] = floats(cells)
        else:
            match = recognise(line.target(name), LOG_COLUMNS, further=False)
            columns[name] = converted(cells, match.factor * line.scale(name), match.offset)
    time_column = add_recognised(columns, raw, shown, border, {line.column for line in lines.values()})
    time_column = lines["t_s"].column if "t_s" in lines else time_column
    order = [name for name in (*LOG_COLUMNS, CUT_COLUMN) if name in columns]
    return {name: columns[name] for name in order}, raw.epochs.get(time_column)


def _to_counts(columns: dict[str, FloatArray], lines: Lines, settings: Campaign, shown: str, border: Border) -> None:
    for name in [name for name in columns if name.startswith("counts_") and name in lines]:
        unit, values = lines[name].wheel_unit, columns[name]
        (kind, turns, _), counts = COUNT_UNITS[unit], counts_per_unit(name, unit, settings)
        _refuse_other_units(name, lines[name], shown)
        if kind == "increments":
            columns[name] = np.cumsum(values)
        elif kind == "angle":
            columns[name] = continuous_angle(values, 1.0 / turns) * counts
        elif kind == "length":
            columns[name] = values * counts
            border.say(shown, f"{name} computed from what the wheel rolled, by the nominal radius", "lengths")
        elif kind != "counts":
            steps = 0.5 * (values[1:] + values[:-1]) * np.diff(columns["t_s"])
            columns[name] = np.concatenate(([0.0], np.cumsum(steps))) * counts


def _refuse_other_units(name: str, line: MappedColumn, shown: str) -> None:
    column, unit = line.column, stem_and_unit(line.column)[1]
    speed = SUFFIXES[unit][0] in {"mps", "radps"} if unit else (guessed_log_column(column) or "").startswith("speed_")
    if speed and line.wheel_unit == "counts" and line.unit is None and line.factor == 1.0:
        found = f"a speed or rate by its name{f', in {unit}' if unit else ''}, mapped to {name}"
        remedy = f'map a speed to {name.replace("counts", "speed")}_mps, or state the unit: "rad/s" or "counts"'
        raise BadFileError(shown, found, "counts, or a unit on the line of the mapping", remedy, column=column)


def _without_repeats(columns: dict[str, FloatArray], shown: str, border: Border) -> dict[str, FloatArray]:
    if not (again := np.append(np.diff(columns["t_s"]) == 0, False)).any():
        return columns
    text = f"{int(again.sum())} sample(s) whose time stamp comes again were omitted; the last of each was kept"
    border.say(shown, text, "repeated_stamp")
    return {name: values[~again] for name, values in columns.items()}


def _note_clocks(recording: Recording, base: Stream, shown: str, border: Border) -> None:
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
                text += f"""; the spans do not meet: the clocks differ, and nothing of it is used; where both began
                    together, lag_s = {later_s:.6g} in each of its lines of the mapping joins them"""
                level = "suspicious"
        border.say(f"{shown}, {stream.name}", text, "clock", level=level)
