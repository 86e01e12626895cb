"""The gap along each run, and where in it it opens: at turns, stops, or on a stretch of a route, a zone or a joint."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from calib.campaign.model import REFERENCE_POSE, Campaign
from calib.campaign.settings import Reference
from calib.campaign.wheels import on_one_axle
from calib.documents import plain_fields
from calib.gap.effects.quantities import MOVING_MPS
from calib.gap.observations import Channel, Observations
from calib.gap.observations.from_campaign import edges_along
from calib.odometry.poses import poses_of_vehicle
from calib.types import FloatArray, IntArray

STRETCH_FIELDS: Final = ("route", "coordinate", "place", "place_ci95", "by_direction", "floor")


@dataclass(frozen=True, slots=True)
class PlaceResult:
    """A place inside the runs where the gap opens."""

    where: str  #: ``zone`` or ``joint`` for a stretch of a route; ``turns`` or ``stops``
    channel: Channel  #: what opens there
    size: float  #: by how much, in `unit`
    ci95: tuple[float, float]
    unit: str  #: ``m``, ``rad``, or either per radian of turn
    p_value: float  #: times the number of places looked at
    n_runs: int
    what: str = ""  #: of turns and stops, what the size counts: ``per stop``
    #: of a stretch: kind of runs, and what counts its place
    route: str = ""
    coordinate: str = ""
    place: tuple[float, float] | None = None  #: its ends in m
    place_ci95: tuple[tuple[float, float], tuple[float, float]] | None = None
    by_direction: bool = False  #: whether its sign changes on the way back
    #: x and y of its ends on the ground, m
    floor: tuple[tuple[float, float], tuple[float, float]] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the line as plain JSON values, without fields that do not apply."""
        absent = STRETCH_FIELDS if self.place is None else ("what",)
        document = plain_fields(self, channel=self.channel.label)
        return {key: value for key, value in document.items() if key not in absent}


#: what counts the place of a stretch that is driven out and back
ON_THE_FLOOR: Final = "x on the floor"
#: chance of any false finding in a table
FALSE_FINDING_PROBABILITY: Final = 0.05
BOOTSTRAP_DRAWS: Final = 300
WINDOW_LENGTH_M: Final = 1.0
MIN_WINDOWS: Final = 10
MIN_STOPS: Final = 5
MIN_TURN_RAD_PER_M: Final = 0.1
#: runs below which errors are not clustered
MIN_CLUSTERS: Final = 8
MIN_SAMPLES: Final = 10
COUNT_COLUMNS: Final = ("t_s", "counts_left", "counts_right")
RANGE_COLUMNS: Final = ("range_m",)
TRACED_CHANNELS: Final = {Channel.ALONG: "along_m", Channel.HEADING: "heading_rad"}
GRID_SPACING_M: Final = 0.25
MAX_GRID_POINTS: Final = 120
#: a longer zone looks like a scale of the whole run
MAX_STRETCH_SHARE: Final = 0.4
MIN_TRACED_RUNS: Final = 4
MIN_TURN_RAD: Final = 0.3
#: share of the usual length below which runs are omitted
WHOLE_RUN_SHARE: Final = 0.95
#: least of a stretch beside the trend, as a share of the grid
MIN_STRETCH_NORM: Final = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Gap along one run: reference minus odometry, accumulated in the vehicle's own frame."""

    run_id: str
    kind: str
    back: bool  #: along a corridor
    #: shape (n,): distance, heading and place in the run's frame, by odometry
    way_m: FloatArray
    turn_rad: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    #: shape (n,): accumulated gap; of the heading NaN with a rangefinder only
    along_m: FloatArray
    heading_rad: FloatArray
    stops: FloatArray  #: shape (n,): so far
    time_s: FloatArray  #: shape (n,): since the start


def traces_of(campaign: Campaign, observations: Observations) -> list[Trace]:
    """Return the gap along runs with a continuous reference or range."""
    if observations.aside_m is not None:
        return []
    campaign = on_one_axle(campaign, observations.model)
    first = {str(name): unit for unit, name in reversed(list(enumerate(observations.labels["run_id"])))}
    encoder, runs = campaign.encoder, campaign.runs
    kinds, directions = runs.label("kind"), runs.label("direction")
    traces = []
    for run, name in enumerate(runs.run_id.astype(str)):
        unit = first.get(name)
        log = _complete(campaign.logs.of(run), campaign.reference)
        if unit is None or log is None:
            continue
        left = log["counts_left"] * (2 * np.pi / encoder.counts_per_rev_left) * observations.radius_left_m[unit]
        right = log["counts_right"] * (2 * np.pi / encoder.counts_per_rev_right) * observations.radius_right_m[unit]
        kind = str(kinds[run])
        back = kind.startswith("corridor") and str(directions[run]) == "back"
        traces.append(_trace(log, left, right, observations.model.track_m, (name, kind, back)))
    return traces


def _complete(log: Mapping[str, FloatArray], reference: Reference) -> dict[str, FloatArray] | None:
    needed = (*COUNT_COLUMNS, *(REFERENCE_POSE if set(REFERENCE_POSE) <= log.keys() else RANGE_COLUMNS))
    if not set(needed) <= log.keys():
        return None
    known = np.all([np.isfinite(log[column]) for column in needed], axis=0)
    if known.sum() < MIN_SAMPLES:
        return None
    complete = {column: log[column][known] for column in needed}
    if REFERENCE_POSE[0] in complete:
        sensor = np.stack([complete[column] for column in REFERENCE_POSE], axis=1)
        complete |= dict(zip(REFERENCE_POSE, poses_of_vehicle(sensor, reference, in_map=True).T, strict=True))
    return complete


def _trace(
    log: Mapping[str, FloatArray], left_m: FloatArray, right_m: FloatArray, track_m: float, label: tuple[str, str, bool]
) -> Trace:
    step = 0.5 * (np.diff(left_m) + np.diff(right_m))
    turn = (np.diff(right_m) - np.diff(left_m)) / track_m
    heading = _summed(turn)
    chord = step * np.sinc(0.5 * turn / np.pi)
    x, y = (_summed(chord * part(heading[:-1] + 0.5 * turn)) for part in (np.cos, np.sin))
    if REFERENCE_POSE[0] in log:
        seen = np.unwrap(log["ref_theta_rad"])
        middle = 0.5 * (seen[1:] + seen[:-1])
        moved = np.diff(log["ref_x_m"]) * np.cos(middle) + np.diff(log["ref_y_m"]) * np.sin(middle)
        along, turned = _summed(moved - chord), (seen - seen[0]) - heading
    else:
        along, turned = np.abs(log["range_m"] - log["range_m"][0]) - np.abs(x), np.full(len(x), np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        moving = np.flatnonzero(np.nan_to_num(np.abs(step) / np.diff(log["t_s"])) > MOVING_MPS)
    stops = _summed(np.bincount(moving[:-1][np.diff(moving) > 1] + 1, minlength=len(step)))
    since_start = log["t_s"] - log["t_s"][0]
    return Trace(*label, _summed(np.abs(step)), heading, x, y, along, turned, stops, since_start)


def _summed(steps: FloatArray | IntArray) -> FloatArray:
    return np.append(0.0, np.cumsum(steps))


@dataclass(frozen=True, slots=True, eq=False)
class _Route:
    traces: list[Trace]
    grid: FloatArray  #: shape (n_grid,): distance from the start, or place on the ground
    spacing_m: float
    length_m: float
    on_floor: bool

    def read(self, trace: Trace, values: FloatArray) -> FloatArray:
        if self.on_floor and trace.back:
            return -np.interp(self.length_m - self.grid, trace.way_m, values)
        return np.interp(self.grid, trace.way_m, values)

    def on_the_floor(self, place_m: float) -> tuple[float, float]:
        trace = self.traces[0]
        way = self.length_m - place_m if self.on_floor and trace.back else place_m
        x, y = (float(np.interp(way, trace.way_m, values)) for values in (trace.x_m, trace.y_m))
        return (self.length_m - x, -y) if trace.back else (x, y)


def scan_route(
    kind: str, traces: list[Trace], channel: Channel, rng: np.random.Generator, *, signed: bool
) -> tuple[PlaceResult, int] | None:
    """Search a route for the stretch where a channel's gap grows, and count those searched.

    None for too few whole runs. `signed`: look for a gap of the other sign on the way back; see `traces_of`.
    """
    from scipy.special import stdtr

    name = TRACED_CHANNELS[channel]
    traces = [trace for trace in traces if np.isfinite(getattr(trace, name)).all()]
    if (route := _route(traces)) is None:
        return None
    gaps = np.stack([route.read(trace, getattr(trace, name)) for trace in route.traces])
    if signed:
        gaps *= np.where([trace.back for trace in route.traces], -1.0, 1.0)[:, None]
    sizes, norm, starts, ends = _sizes(route, gaps)
    n = len(route.traces)
    best = int(np.argmax(sizes.mean(axis=0) ** 2 * norm))
    own = sizes[:, best]
    t = abs(float(own.mean())) / max(float(np.std(own, ddof=1) / np.sqrt(n)), 1e-12)
    draws = rng.multinomial(n, np.full(n, 1.0 / n), BOOTSTRAP_DRAWS) / n
    picked = np.argmax((draws @ sizes) ** 2 * norm, axis=1)
    half = 0.5 * route.spacing_m
    first, last = (
        (float(low - half), float(high + half))
        for low, high in (np.quantile(route.grid[index[picked]], (0.025, 0.975)) for index in (starts, ends))
    )
    size, spread = float(own.mean()), float(np.ptp(np.quantile(draws @ own, (0.025, 0.975)))) / 2
    place = (float(route.grid[starts[best]]), float(route.grid[ends[best]]))
    line = PlaceResult(
        where="joint" if place[1] - place[0] <= 2 * route.spacing_m else "zone",
        channel=channel,
        route=kind,
        coordinate=ON_THE_FLOOR if route.on_floor else "way from the start",
        place=place,
        place_ci95=(first, last),
        by_direction=signed,
        floor=(route.on_the_floor(place[0]), route.on_the_floor(place[1])),
        size=size,
        ci95=(size - spread, size + spread),
        unit=channel.unit,
        p_value=float(2.0 * stdtr(n - 1.0, -t)),
        n_runs=n,
    )
    return line, len(starts)


def _route(traces: list[Trace]) -> _Route | None:
    if len(traces) < MIN_TRACED_RUNS:
        return None
    length = float(np.median([float(trace.way_m[-1]) for trace in traces]))
    traces = [trace for trace in traces if float(trace.way_m[-1]) > WHOLE_RUN_SHARE * length]
    if len(traces) < MIN_TRACED_RUNS or length < 8 * GRID_SPACING_M:
        return None
    spacing = max(GRID_SPACING_M, length / MAX_GRID_POINTS)
    grid = np.arange(0.0, WHOLE_RUN_SHARE * length + 1e-9, spacing)
    if on_floor := any(trace.back for trace in traces):
        grid = grid[grid >= 0.05 * length]
    return _Route(traces, grid, spacing, length, on_floor)


def _sizes(route: _Route, gaps: FloatArray) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
    grid = route.grid
    starts, ends = _stretches(len(grid))
    ramp = np.clip((grid[None, :] - grid[starts][:, None]) / (grid[ends] - grid[starts])[:, None], 0.0, 1.0)
    turned = np.stack([route.read(trace, trace.turn_rad) for trace in route.traces]).mean(axis=0)
    trend = [np.ones_like(grid), grid - grid.mean()]
    if np.ptp(turned) > MIN_TURN_RAD:
        trend.append(turned)
        bend = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(turned)))))
        if not np.allclose(bend, np.abs(turned - turned[0]), atol=0.1):
            trend.append(bend)
    basis, _ = np.linalg.qr(np.stack(trend, axis=1))
    ramp, gaps = ramp - (ramp @ basis) @ basis.T, gaps - (gaps @ basis) @ basis.T
    norm = (ramp**2).sum(axis=1)
    ok = norm > MIN_STRETCH_NORM * len(grid)
    return gaps @ ramp[ok].T / norm[ok], norm[ok], starts[ok], ends[ok]


def _stretches(n: int) -> tuple[IntArray, IntArray]:
    longest = max(2, int(MAX_STRETCH_SHARE * n))
    longer = np.geomspace(8, max(longest, 9), 8).astype(int)
    lengths = np.unique(np.concatenate([np.arange(1, min(9, longest)), longer]))
    starts, ends = np.meshgrid(np.arange(n), lengths, indexing="ij")
    ends = starts + ends
    ok = (ends < n - 1) & (starts > 0)
    return starts[ok], ends[ok]


def find_places(
    campaign: Campaign, observations: Observations, rng: np.random.Generator
) -> tuple[tuple[PlaceResult, ...], tuple[str, ...]]:
    """Return the places inside the runs where the gap opens, smallest p first, and what cannot be asked."""
    if np.isfinite(observations.simulated).any():
        return (), ("the simulated ends have no path: where inside a run the gap opens cannot be determined",)
    traces = traces_of(campaign.included(), observations)
    if not traces:
        note = "no log has a continuous reference or range_m: where inside a run the gap opens cannot be determined"
        return (), (note,)
    notes: list[str] = []
    candidates = compare_windows(traces)
    n_tests = len(candidates)
    for kind in dict.fromkeys(trace.kind for trace in traces):
        group = [trace for trace in traces if trace.kind == kind]
        if len(group) < MIN_TRACED_RUNS:
            few = f"fewer than {MIN_TRACED_RUNS} runs with a trace; no place along it is sought"
            notes.append(f"{kind or 'a route'}: {few}")
            continue
        both_ways = len({trace.back for trace in group}) == 2
        for channel in TRACED_CHANNELS:
            for signed in (False, True) if both_ways and channel is Channel.HEADING else (False,):
                if stretch := scan_route(kind, group, channel, rng, signed=signed):
                    candidates.append(stretch[0])
                    n_tests += stretch[1]
    corrected = (replace(place, p_value=min(1.0, place.p_value * max(n_tests, 1))) for place in candidates)
    significant = [place for place in corrected if place.p_value <= FALSE_FINDING_PROBABILITY]
    return tuple(sorted(significant, key=lambda place: place.p_value)), tuple(notes)


def compare_windows(traces: list[Trace]) -> list[PlaceResult]:
    """Return how much of the gap correlates with turns and stops, beside the way."""
    gained, run = _cut(traces)
    way, turn, stops = (gained[name] for name in ("way_m", "turn_rad", "stops"))
    lines = []
    for channel, name in TRACED_CHANNELS.items():
        on = np.isfinite(gained[name]) & (way > 1e-6)
        turning = on & (np.abs(turn) > MIN_TURN_RAD_PER_M * way)
        questions = []
        if turning.sum() >= MIN_WINDOWS and (on & ~turning).sum() >= MIN_WINDOWS:
            questions.append(("turns", turn, "per rad of signed turn"))
            questions.append(("turns", np.abs(turn), "per rad of total absolute rotation"))
        if (stops[on] > 0).sum() >= MIN_STOPS and (stops[on] == 0).sum() >= MIN_STOPS:
            questions.append(("stops", stops, "per stop"))
        for where, values, what in questions:
            lines.append(_line(np.stack([way, values, gained[name]], axis=1)[on], run[on], channel, where, what))
    return lines


def _cut(traces: list[Trace]) -> tuple[dict[str, FloatArray], IntArray]:
    edges = [edges_along(trace.way_m, float(trace.way_m[-1]) / WINDOW_LENGTH_M) for trace in traces]
    gained = {
        name: np.concatenate([np.diff(getattr(trace, name)[at]) for trace, at in zip(traces, edges, strict=True)])
        for name in (*TRACED_CHANNELS.values(), "way_m", "turn_rad", "stops")
    }
    run = np.repeat([trace.run_id for trace in traces], [len(at) - 1 for at in edges])
    return gained, np.unique(run, return_inverse=True)[1]


def _line(windows: FloatArray, run: IntArray, channel: Channel, where: str, what: str) -> PlaceResult:
    from scipy.special import stdtr

    size, error, dof = _slope(windows[:, :2], windows[:, 2], run)
    return PlaceResult(
        where=where,
        channel=channel,
        what=what,
        size=size,
        ci95=(size - 2 * error, size + 2 * error),
        unit=f"{channel.unit}/rad" if where == "turns" else channel.unit,
        p_value=float(2.0 * stdtr(dof, -abs(size) / max(error, 1e-15))),
        n_runs=len(np.unique(run)),
    )


def _slope(design: FloatArray, gap: FloatArray, run: IntArray) -> tuple[float, float, float]:
    gram = np.linalg.inv(design.T @ design + 1e-12 * np.eye(2))
    beta = gram @ (design.T @ gap)
    left = gap - design @ beta
    runs, cluster = np.unique(run, return_inverse=True)
    if len(runs) >= MIN_CLUSTERS:
        summed = np.zeros((len(runs), 2))
        np.add.at(summed, cluster, design * left[:, None])
        dof = float(len(runs) - 2)
        middle = summed.T @ summed * (len(runs) / dof)
    else:
        dof = float(len(gap) - 2)
        middle = design.T @ design * float(left @ left) / dof
    return float(beta[1]), float(np.sqrt((gram @ middle @ gram)[1, 1])), dof
