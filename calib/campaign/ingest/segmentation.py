"""Segmentation of recordings into runs, each in its start frame."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.campaign.ingest import with_number
from calib.campaign.ingest.logs import CUT_COLUMN, MappedLog, continuous_counts, read_mapped
from calib.campaign.ingest.mapping import LabMapping, MappedColumn, Segmentation
from calib.campaign.ingest.runs import mapped_runs, sheet_of
from calib.campaign.model import REFERENCE_POSE, Border, Campaign, RunTable
from calib.campaign.readers import RawTable
from calib.campaign.readers.table import NS_PER_S, moment_ns, object_array
from calib.errors import BadFileError
from calib.io import sha256_file
from calib.types import BoolArray, FloatArray, Progress, in_frame, stepped

_MAX_TOGGLE_COUNTS: Final = 3.0
_MAX_STANDSTILL_COUNTS: Final = 1.5
_MOVING_WINDOW_S: Final = 0.5
_MARGIN_S: Final = 0.5


@dataclass(frozen=True, slots=True)
class Segment:
    """The part of a recording that is a run."""

    run_id: str
    source: str
    start_s: float
    end_s: float
    start_ns: int
    end_ns: int


@dataclass(slots=True)
class Ingestion:
    """The files of an ingestion, what was read, and what is said of it."""

    mapping: LabMapping
    settings: Campaign
    border: Border
    progress: Progress
    #: path -> SHA-256
    hashes: dict[str, str] = field(default_factory=dict)
    recordings: dict[str, MappedLog] = field(default_factory=dict)
    segments: list[Segment] = field(default_factory=list)

    def read_log(self, files: Mapping[str, Path]) -> MappedLog:
        """Read the log of a run or a recording; see `read_mapped`."""
        log = read_mapped(files, self.mapping, self.settings, self.border)
        for path, _ in map(sheet_of, files.values()):
            parts = sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]
            self.hashes |= {str(part): sha256_file(part) for part in parts}
        return log

    def read_logs(self, logs_of_runs: Mapping[int, Mapping[str, Path]]) -> dict[int, MappedLog]:
        """Read logs of one run each, in its start frame where the mapping says so."""
        stated = [name for name, line in self.mapping.log.columns.items() if line.from_start is True]
        distance = "range_m" in stated
        poses = self.settings.reference.frame != "map" and any(name.startswith("ref_") for name in stated)
        logs = {}
        for index, files in stepped(list(logs_of_runs.items()), self.progress, "logs"):
            log = self.read_log(files)
            turned = from_start(log.columns, poses=poses, distance=distance)
            logs[index] = replace(log, columns=turned, from_start=distance or poses)
        return logs


def segment_recordings(
    work: Ingestion, runs: RunTable | None, table: RawTable | None, recordings: Mapping[Path, MappedLog]
) -> tuple[RunTable, dict[int, MappedLog]]:
    """Return rows, and each run's log by number; `work` gets recordings and segments.

    Raises BadFileError where there are not as many segments as rows.

    `runs`: in the order driven (None: numbered), as `recordings`; `table`: as read, for times; see `find_runs`.
    """
    mapping, settings = work.mapping, work.settings
    cut = mapping.cut or Segmentation()
    if cut.by == "times" and cut.start and table is not None:
        cut = cut.model_copy(update={"times": _table_times(table, cut, mapping.shown)})
    m_per_count = 2.0 * np.pi * settings.vehicle.wheel_radius_m / settings.encoder.counts_per_rev_left
    poses = settings.reference.frame != "map"
    distance = mapping.log.columns.get("range_m", MappedColumn(column="range_m")).from_start is not False
    logs: dict[int, MappedLog] = {}
    segments: list[Segment] = []
    names: list[str] = []
    for path, recording in recordings.items():
        log = _unwrapped(recording, settings.encoder.wrap_bits)
        name = path.stem if path.stem not in work.recordings else f"{path.stem}_{len(work.recordings) + 1}"
        work.recordings[name] = log
        for part in find_runs(cut, log.columns, m_per_count=m_per_count, start_ns=log.start_ns, shown=str(path)):
            columns = from_start(_columns_of(log.columns, part), poses=poses, distance=distance)
            logs[len(logs)] = replace(log, columns=columns, from_start=True)
            names.append(name)
            span_s = log.columns["t_s"][[part.start, part.stop - 1]].tolist()
            segments.append(Segment("", str(path), *span_s, *(log.start_ns + round(s * NS_PER_S) for s in span_s)))
    shown = ", ".join(map(str, recordings))
    if not logs:
        expected = f"drives of at least {cut.min_length_m:g} m"
        remedy = "see what moves with 'calib ingest --describe', or cut by times"
        raise BadFileError(shown, f"no run, cut by {cut.by}", expected, remedy)
    if runs is None:
        numbered = {"run_id": object_array([with_number(cut.run_id, n) for n in range(1, len(names) + 1)])}
        sessions = {} if "session" in mapping.table.columns else {"session": object_array(names)}
        raw = RawTable(numbered | sessions, np.arange(2, len(names) + 2, dtype=np.int64))
        runs = mapped_runs(raw, mapping, settings, "the runs cut", work.border)
    elif len(runs) != len(logs):
        spans = ", ".join(f"{segment.start_s:.4g}-{segment.end_s:.4g}" for segment in segments[:12])
        actual = f"{len(logs)} runs, cut by {cut.by} ({spans} s), and {len(runs)} rows of the table"
        raise BadFileError(shown, actual, "as many", "correct min_stop_s or min_length_m of [cut], or cut by times")
    work.segments += [replace(part, run_id=str(run_id)) for part, run_id in zip(segments, runs.run_id, strict=True)]
    return runs, logs


def _unwrapped(log: MappedLog, bits: int | None) -> MappedLog:
    columns = dict(log.columns)
    wrap_bits = log.wrap_bits if bits is None else bits
    for name in [name for name in columns if name.startswith("counts_")]:
        columns[name], width = continuous_counts(columns[name], bits, columns["t_s"])
        wrap_bits = width or wrap_bits
    return replace(log, columns=columns, wrap_bits=wrap_bits)


def _columns_of(columns: Mapping[str, FloatArray], part: slice) -> dict[str, FloatArray]:
    out = {name: values[part] for name, values in columns.items() if name != CUT_COLUMN}
    out["t_s"] = np.round(out["t_s"] - out["t_s"][0], 9)
    return {name: values - values[0] if name.startswith("counts_") else values for name, values in out.items()}


def _table_times(table: RawTable, cut: Segmentation, shown: str) -> list[list[Any]]:
    for name in (name for name in (cut.start, cut.end) if name not in table.columns):
        actual = f"the table's columns {', '.join(table.columns)[:200]}"
        raise BadFileError(shown, actual, f"a column {name!r}", "correct the mapping", column="cut.start")
    return [list(pair) for pair in zip(table.columns[cut.start], table.columns[cut.end], strict=True)]


def find_runs(
    cut: Segmentation, log: Mapping[str, FloatArray], *, m_per_count: float, start_ns: int, shown: str
) -> list[slice]:
    """Return the runs of a recording.

    `log`: times from its start, counts, and ``cut`` where a column tells the runs; see `Segmentation`.
    """
    time = log["t_s"]
    if cut.by == "times":
        return [_between(pair, time, start_ns, shown) for pair in cut.times]
    wheels = _wheels(log)
    steps = [np.abs(np.nan_to_num(np.diff(counts, prepend=counts[:1]))) for counts in wheels]
    counted: FloatArray = np.cumsum(np.mean(steps, axis=0)) if wheels else np.arange(len(time), dtype=np.float64)
    travelled = counted * m_per_count
    if cut.by == "stops":
        parts = _between_stops(time, wheels, cut.min_stop_s)
    elif cut.by == "length":
        along = travelled / cut.length_m if cut.length_m > 0 else (time - time[0]) / cut.length_s
        parts = _by_change(np.floor(along + 1e-9), np.ones(len(time), dtype=np.bool_))
    else:
        values = log[CUT_COLUMN]
        parts = _by_change(values, ~np.isnan(values) & (values != 0))
    ends = [(part, part.start, part.stop - 1) for part in parts]
    return [part for part, a, b in ends if b > a and travelled[b] - travelled[a] >= cut.min_length_m]


def moving(time: FloatArray, wheels: Sequence[FloatArray]) -> BoolArray:
    """Return where a wheel turns by more than it toggles within half a second, shape (n_samples,)."""
    out: BoolArray = np.zeros(len(time), dtype=np.bool_)
    later = np.minimum(np.searchsorted(time, time + _MOVING_WINDOW_S), len(time) - 1)
    for counts in wheels:
        out |= np.abs(counts[later] - counts) > _MAX_TOGGLE_COUNTS
    return out


def _between_stops(time: FloatArray, wheels: Sequence[FloatArray], min_stop_s: float) -> list[slice]:
    edges = np.flatnonzero(np.diff(np.concatenate(([False], moving(time, wheels), [False]))))
    starts, ends = edges[::2], edges[1::2] - 1
    # the window looks ahead: a drive ends after its last flag
    ends = np.minimum(np.searchsorted(time, time[ends] + _MOVING_WINDOW_S), len(time) - 1)
    apart = time[starts[1:]] - time[ends[:-1]] >= min_stop_s
    starts, ends = starts[np.concatenate(([True], apart))[: len(starts)]], ends[np.append(apart, True)[: len(ends)]]
    beside = min(_MARGIN_S, 0.5 * min_stop_s)
    first = np.searchsorted(time, time[starts] - beside)
    after = np.searchsorted(time, time[ends] + beside, side="right")
    return [slice(int(start), int(stop)) for start, stop in zip(first, after, strict=True)]


def _by_change(values: FloatArray, within: BoolArray) -> list[slice]:
    change = np.flatnonzero((values[1:] != values[:-1]) | (within[1:] != within[:-1])) + 1
    bounds = [0, *change.tolist(), len(values)]
    return [slice(start, stop) for start, stop in itertools.pairwise(bounds) if within[start]]


def _between(pair: Sequence[Any], time: FloatArray, start_ns: int, shown: str) -> slice:
    low, high = (_seconds(end, start_ns, shown) for end in pair)
    first = int(np.searchsorted(time, low - 1e-9))
    after = int(np.searchsorted(time, high + 1e-9, side="right"))
    if not first < after - 1:
        actual = f"no samples from {pair[0]} to {pair[1]}; it spans {time[0]:.6g} to {time[-1]:.6g} s"
        remedy = "correct cut.times, in seconds from its start or as times of the clock with their zone"
        raise BadFileError(shown, actual, "times within the recording", remedy)
    return slice(first, after)


def _seconds(value: Any, start_ns: int, shown: str) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    try:
        text = value.isoformat() if hasattr(value, "isoformat") else str(value)
        return (moment_ns(text) - start_ns) / NS_PER_S
    except ValueError as error:
        expected = "seconds from the recording's start, or a time of the clock"
        remedy = "write it as 41.5 or as 2026-05-04T10:15:30+02:00"
        raise BadFileError(shown, f"{value!r:.40}", expected, remedy) from error


def from_start(columns: Mapping[str, FloatArray], *, poses: bool, distance: bool) -> dict[str, FloatArray]:
    """Return a run's columns, poses in its start frame, the range from the start.

    The start is the median before the wheels turn: one noisy sample does not turn the path. `poses`, `distance`: what
    to change.
    """
    out = dict(columns)
    before = max(1, int(np.argmax(moving(columns["t_s"], _wheels(columns)))))

    def start(values: FloatArray) -> float:
        known = values[np.isfinite(values)]
        value = _median(values[:before])
        return float(known[0]) if np.isnan(value) and len(known) else value

    if poses and all(name in out for name in REFERENCE_POSE):
        starts = [start(out[name]) for name in REFERENCE_POSE]
        apart = np.stack([out[name] - first for name, first in zip(REFERENCE_POSE, starts, strict=True)])
        out |= dict(zip(REFERENCE_POSE, in_frame(apart, np.array(starts[2])).T.copy(), strict=True))
    if distance and "range_m" in out:
        out["range_m"] = np.abs(out["range_m"] - start(out["range_m"]))
    return out


def end_values(columns: Mapping[str, FloatArray]) -> dict[str, float]:
    """Return distance and end pose from the start: medians after the wheels stopped."""
    time, wheels = columns["t_s"], _wheels(columns)
    first = len(time) - 1
    if moving(time, wheels).any():
        turning = [np.flatnonzero(np.abs(values - values[-1]) > _MAX_STANDSTILL_COUNTS) for values in wheels]
        first = min(max((int(places[-1]) + 1 for places in turning if len(places)), default=0), first)
    sources = {"distance_m": "range_m", **{name: name for name in REFERENCE_POSE}}
    ends = {name: _median(columns[source][first:]) for name, source in sources.items() if source in columns}
    return {name: value for name, value in ends.items() if np.isfinite(value)}


def _wheels(columns: Mapping[str, FloatArray]) -> list[FloatArray]:
    return [values for name, values in columns.items() if name.startswith("counts_")]


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")
