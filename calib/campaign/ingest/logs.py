"""Logs and recordings under calib's names: streams on the wheels' times, counts, clocks."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign import logs
from calib.campaign.ingest.guesses import ONE_TURN, Lag, estimate_lag, guessed_log_column, stem_and_unit
from calib.campaign.ingest.mapping import LabMapping, MappedColumn, counts_per_unit
from calib.campaign.ingest.runs import resolved, sheet_of, whole_name, without_unit
from calib.campaign.model import LOG_COLUMNS, REFERENCE_POSE, Border, Campaign, Note
from calib.campaign.readers import RawTable, Wanted, holds_recording, joined_table, read_recording, read_table
from calib.campaign.readers.recording import Recording, Stream, WantedColumns, check_not_empty
from calib.campaign.readers.sheets import COUNT_UNITS
from calib.campaign.readers.table import NS_PER_S
from calib.campaign.settings import Recognised, converted, recognise
from calib.errors import BadFileError
from calib.types import SUFFIXES, FloatArray, floats, grouped

CUT_COLUMN: Final = "cut"
_LEAST_LAG_SAMPLES: Final = 20
#: at this spacing noise hardly lengthens a travelled distance
_POSE_SPACING_S: Final = 0.1
#: `calib geometry` looks for no longer delay
_LONG_LAG_S: Final = 0.5
Lines = Mapping[str, MappedColumn]
Columns = dict[str, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class MappedLog:
    """A log, recording or part of one under calib's names."""

    shown: str
    #: of `LOG_COLUMNS`, ``t_s`` from the first sample; ``cut`` where a column tells the runs, shape (n_samples,)
    columns: dict[str, FloatArray]
    #: of the first sample: nanoseconds since 1970, midnight or the clock's start
    start_ns: int
    lags: Mapping[str, Lag] = field(default_factory=dict)
    wrap_bits: int | None = None
    #: range and poses count from the run's start
    from_start: bool = False


def read_mapped(files: Mapping[str, Path], mapping: LabMapping, settings: Campaign, border: Border) -> MappedLog:
    """Read the log of a run or a recording, sampled at the wheels' times.

    `files`: one under an empty name, or a run's by the names of ``log.files``. Raises BadFileError where a column of
    the mapping, the clock or the wheels are missing.
    """
    path = next(iter(files.values()))
    shown = str(path)
    lines = {name: line for name, line in mapping.log.columns.items() if line.column}
    if mapping.cut is not None and mapping.cut.column:
        lines[CUT_COLUMN] = MappedColumn(column=mapping.cut.column)
    lags: dict[str, Lag] = {}
    bits = settings.encoder.wrap_bits
    raw, one_table = RawTable({}, np.zeros(0, dtype=np.int64)), "" in files and not holds_recording(path)
    if one_table:
        raw, lines = _table(path, shown, lines, mapping, border)
    if not one_table or _empty_cells(raw.columns, lines):
        if "" in files and not one_table:
            recording = _recording(path, shown, lines, mapping)
        else:
            recording = _gathered(files, lines, mapping)
            lines = resolved({name: line for name, line in lines.items() if name != "t_s"}, recording.column_names)
            _refuse_missing(recording.column_names, lines, shown, mapping)
        base = _wheel_stream(recording, lines, shown)
        recording, bits = _unwrapped(recording, lines, base, bits, shown, border)
        if base.time_ns is not None:
            _note_clocks(recording, base, shown, border)
            lags = _lags(recording, lines, base, shown, border)
            if mapping.log.lag != "remove" and any(abs(lag.lag_s) > _LONG_LAG_S for lag in lags.values()):
                text = 'so long a lag is two clocks: lag = "remove" in [log] takes it off'
                border.say(shown, text, "two_clocks")
        raw = _joined(recording, base, lines, lags if mapping.log.lag == "remove" else {}, shown)
        raw = _of_all_wheels(raw, lines, shown, border)
    border.notes.extend(raw.notes)
    columns, epoch = _renamed(raw, lines, shown, border)
    if "t_s" in columns:
        columns = _rows_once(columns, lines, shown, border)
        _to_counts(columns, lines, settings, shown, border)
    logs.refuse_incomplete(columns, shown, raw.line)
    logs.omit_lost_frames(columns, REFERENCE_POSE, shown, border)
    columns = _without_repeats(columns, shown, border)
    start = logs.from_first_sample(columns, shown, border)
    return MappedLog(shown, columns, round(start * NS_PER_S) if epoch is None else epoch, lags, bits)


def _table(
    path: Path, shown: str, lines: Lines, mapping: LabMapping, border: Border
) -> tuple[RawTable, dict[str, MappedColumn]]:
    sources = {name for line in lines.values() for name in line.sources}

    def wanted(name: str) -> bool:
        return name in sources or without_unit(name) in sources or logs.in_log(name)

    raw = _read(path, wanted, mapping)
    lines = resolved(lines, raw.columns)
    _refuse_missing(raw.columns, lines, shown, mapping, row=1)
    return replace(raw, columns=_with_heading(raw.columns, lines, shown, border)), lines


def _read(path: Path, wanted: Wanted, mapping: LabMapping) -> RawTable:
    book, sheet = sheet_of(path)
    return read_table(book, str(path), wanted, replace(mapping.log.layout, sheet=sheet or mapping.log.sheet))


def _recording(path: Path, shown: str, lines: Lines, mapping: LabMapping) -> Recording:
    wanted = WantedColumns(name for line in lines.values() for name in line.sources)
    recording = read_recording(path, shown, wanted if lines else None)
    if any(not {*line.sources} <= {*recording.column_names} for line in lines.values()):
        whole = read_recording(path, shown)
        check_not_empty(whole, shown)
        _refuse_missing(whole.column_names, lines, shown, mapping)
    return recording


def _gathered(files: Mapping[str, Path], lines: Lines, mapping: LabMapping) -> Recording:
    streams: list[Stream] = []
    notes: list[Note] = []
    for tag, path in files.items():
        clock = mapping.log.clock_of(tag)
        before = f"{tag}:" if tag else ""
        sources = {name.removeprefix(before) for line in lines.values() for name in line.sources} | {clock.column}

        def wanted(name: str, sources: set[str] = sources) -> bool:
            return name in sources or without_unit(name) in sources or logs.log_column(name).name == "t_s"

        raw = _read(path, wanted, mapping)
        own = next((name for name in raw.columns if logs.log_column(name).name == "t_s"), clock.column)
        time = whole_name(clock.column, raw.columns)
        time = time if time in raw.columns else whole_name(own, raw.columns)
        if time not in raw.columns:
            actual, expected = f"no column {clock.column!r} for the times", "times in each file of a run"
            raise BadFileError(str(path), actual, expected, f"correct log.t_s in {mapping.shown}", row=1, column="t_s")
        line = clock.model_copy(update={"column": time})
        match = recognise(line.target("t_s"), LOG_COLUMNS, further=False)
        factor = 1.0 if time in raw.epochs else match.factor * line.scale("t_s")
        raw = raw.select(np.isfinite(raw.columns[time]))
        time_ns = raw.epochs.get(time, 0) + np.rint(raw.columns[time] * factor * NS_PER_S).astype(np.int64)
        order = np.argsort(time_ns, kind="stable")
        columns = {before + name: cells[order] for name, cells in raw.columns.items() if name != time}
        notes += raw.notes
        if not (n_empty := _empty_cells(columns, lines)):
            streams.append(Stream(tag, "file", columns, time_ns[order], "times of the file"))
            continue
        text = f"{n_empty} cells of wheels are empty: each column has times of its own"
        notes.append(Note("info", str(path), text, "empty_cells"))
        for names in grouped((np.isfinite(cells).tobytes(), name) for name, cells in columns.items()).values():
            rows = np.isfinite(columns[names[0]])
            own_columns = {name: columns[name][rows] for name in names}
            streams.append(Stream(names[0], "file", own_columns, time_ns[order][rows], "times of the file"))
    return Recording(tuple(streams), tuple(notes))


def _refuse_missing(
    names: Iterable[str], lines: Lines, shown: str, mapping: LabMapping, row: int | None = None
) -> None:
    known = list(names)
    for name, line in lines.items():
        for column in (source for source in line.sources if source not in known):
            text = f"no column {column!r}, " + (f"only {', '.join(known)[:300]}" if known else "nor any of the others")
            remedy = f"correct log.{name} in {mapping.shown}; 'calib ingest --describe' lists the columns"
            if not known:
                remedy = f"if it is no log, name the logs alone ({Path(shown).parent}/run*.csv); else {remedy}"
            raise BadFileError(shown, text, "the column that the mapping names", remedy, row=row, column=name)


def _empty_cells(columns: Mapping[str, FloatArray], lines: Lines) -> int:
    of_wheels = (one for name, one in lines.items() if name.startswith(("counts_", "speed_")) and one.column in columns)
    return sum(int(np.isnan(columns[one.column]).sum()) for one in of_wheels if one.wheel_unit != "counts/sample")


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
    kinds = {one.column: COUNT_UNITS[one.wheel_unit] for name, one in lines.items() if name.startswith("counts_")}
    streams = []
    for stream in recording.streams:
        columns = _with_heading(stream.columns, lines, shown, border)
        for name in set(kinds) & set(columns) if stream is not base else ():
            kind, turns, _ = kinds[name]
            if kind == "angle":
                columns[name] = continuous_angle(columns[name], 1.0 / turns)
            if kind != "counts":
                continue
            time_s = None if stream.time_ns is None else (stream.time_ns - stream.time_ns[0]) / NS_PER_S
            columns[name], width = continuous_counts(columns[name], bits, time_s)
            bits = width or bits
        streams.append(replace(stream, columns=columns))
    return replace(recording, streams=tuple(streams)), bits


def _with_heading(columns: Mapping[str, FloatArray], lines: Lines, shown: str, border: Border) -> dict[str, FloatArray]:
    out, line = dict(columns), lines.get("ref_theta_rad", MappedColumn(column="ref_theta_rad"))
    poses = [column for name in REFERENCE_POSE if name in lines for column in lines[name].sources]
    logs.omit_lost_frames(out, poses, shown, border)
    for name, cells in out.items():
        mapped = name == line.column
        match = recognise(line.target("ref_theta_rad"), LOG_COLUMNS, further=False) if mapped else logs.log_column(name)
        if mapped and line.w in columns:
            w, match = columns[line.w], Recognised(name, "ref_theta_rad")
            cells = np.arctan2(2.0 * w * cells, w * w - cells * cells)
        if match.name == "ref_theta_rad":
            scale = match.factor * (line.scale(match.name) if mapped else 1.0)
            out[name] = continuous_angle(cells, 2.0 * np.pi / abs(scale))
    return out


def _joined(recording: Recording, base: Stream, lines: Lines, removed: Mapping[str, Lag], shown: str) -> RawTable:
    clock = "t_s" not in lines
    if clock and base.time_ns is None and "t_s" not in base.columns:
        actual = f"no clock in {base.name!r} ({', '.join(base.columns)[:120]})"
        remedy = 'name the column of times in the mapping: [log] t_s = "..."'
        raise BadFileError(shown, actual, "times, as waveform properties or as a column", remedy)
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
            if text := line.on_unit(name):
                border.say(f"{shown}, column {line.column}", text, "unit")
            cells = floats(cells) + line.offset / line.factor
            columns[name] = converted(cells, match.factor * line.scale(name), match.offset)
    time_column = logs.add_recognised(columns, raw, shown, border, {line.column for line in lines.values()})
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


def _rows_once(columns: Columns, lines: Lines, shown: str, border: Border) -> Columns:
    if not any(name in lines and lines[name].wheel_unit == "counts/sample" for name in columns):
        return columns
    rows = np.nan_to_num(np.stack([*columns.values()]))
    if (twice := np.append(False, (np.diff(rows) == 0.0).all(axis=0))).any():
        text = f"{int(twice.sum())} row(s) written twice, with the same time and cells, were taken once"
        border.say(shown, text, "repeated_rows", level="suspicious")
        columns = {name: values[~twice] for name, values in columns.items()}
    return columns


def _refuse_other_units(name: str, line: MappedColumn, shown: str) -> None:
    column, unit = line.column, stem_and_unit(line.column)[1]
    speed = SUFFIXES[unit][0] in {"mps", "radps"} if unit else (guessed_log_column(column) or "").startswith("speed_")
    if speed and line.wheel_unit == "counts" and line.unit is None and line.factor == 1.0:
        remedy = f'map a speed to {name.replace("counts", "speed")}_mps, or state the unit: "rad/s" or "counts"'
        raise BadFileError(shown, f"a speed or rate by its name, mapped to {name}", "counts", remedy, column=column)


def _without_repeats(columns: dict[str, FloatArray], shown: str, border: Border) -> dict[str, FloatArray]:
    if not (again := np.append(np.diff(columns["t_s"]) == 0, False)).any():
        return columns
    text = f"{int(again.sum())} sample(s) whose time stamp comes again were omitted; the last of each was kept"
    border.say(shown, text, "repeated_stamp")
    return {name: values[~again] for name, values in columns.items()}


def _lags(recording: Recording, lines: Lines, base: Stream, shown: str, border: Border) -> dict[str, Lag]:
    counts = [line for name, line in lines.items() if name.startswith("counts_") and line.column in base.columns]
    wheels = [
        base.columns[line.column] for line in counts if COUNT_UNITS[line.wheel_unit][0] in {"counts", "angle", "length"}
    ]
    if not wheels or base.time_ns is None:
        return {}
    origin = int(base.time_ns[0])
    time = (base.time_ns - origin) / NS_PER_S
    turned = np.mean([continuous_counts(counts, None, time)[0] for counts in wheels], axis=0)
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
        if lag := estimate_lag(time, travelled, (stream.time_ns - origin) / NS_PER_S, other):
            lags[name] = lag
            low, high = lag.ci95_s
            text = f"""the {name} lags {1e3 * lag.lag_s:+.1f} ms behind the wheels (95 %: {1e3 * low:+.1f} ..
                {1e3 * high:+.1f}, by their speeds)"""
            border.say(f"{shown}, {stream.name}", text, "lag")
    return lags


def _travelled(stream: Stream, positions: FloatArray) -> FloatArray:
    stride = max(1, round(_POSE_SPACING_S * stream.contents().rate_Hz))
    index = np.flatnonzero(np.isfinite(positions).all(axis=1))[::stride]
    steps = np.linalg.norm(np.diff(positions[index], axis=0), axis=1)
    return floats(np.interp(np.arange(len(positions)), index, np.concatenate(([0.0], np.cumsum(steps)))))


def continuous_counts(counts: FloatArray, bits: int | None, time_s: FloatArray | None) -> tuple[FloatArray, int | None]:
    """Return counts without overflows, and the counter's width, if seen."""
    offsets = np.asarray([0, len(counts)])
    width = bits or logs.detect_wrap_bits(counts, offsets, time_s)
    return (counts, None) if width is None else (logs.unwrap(counts, offsets, width)[0], width)


def continuous_angle(angle: FloatArray, turn: float) -> FloatArray:
    """Return an angle that restarts after each `turn` as a continuous one; NaN stays."""
    known = np.isfinite(angle)
    if not known.any() or np.ptp(angle[known]) > ONE_TURN * turn:
        return angle
    out = angle.copy()
    out[known] = np.unwrap(angle[known], period=turn)
    return out


#: clocks of time zones are half hours apart, but for later starts
ZONE_S, ZONE_WITHIN_S = 1800.0, 60.0


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
                zone_s = ZONE_S * round(later_s / ZONE_S)
                lag_s = zone_s if zone_s and abs(later_s - zone_s) < ZONE_WITHIN_S else later_s
                why = "another time zone" if lag_s == zone_s else "where both began together"
                text += f"""; the spans do not meet: the clocks differ, and without lag_s nothing of it is used; {why}:
                    lag_s = {lag_s:.6g} in each of its lines of the mapping joins them"""
                level = "suspicious"
        border.say(f"{shown}, {stream.name}", text, "clock", level=level)
