"""Planned runs: their routes, candidates, and the campaign that an exact model would record."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise, product
from typing import Any, Final

import numpy as np

from calib.campaign import wheels
from calib.campaign.model import Campaign, Logs, RunTable, stacked
from calib.campaign.read import CLOSED, GYRO_SIGMA, GYRO_TURN
from calib.campaign.settings import Encoder, FrontModel, OdometryModel, Rangefinder, Reference
from calib.campaign.wheels import WHEEL_COLUMNS, counts_per_rev, mecanum_model, odometry_source, without_rear_wheels
from calib.documents import plain_fields
from calib.errors import PLANNED_SAMPLES, BadInputError
from calib.odometry.routes import NAMED, Route, Segment, arc, radii_of_model, straight
from calib.types import FloatArray
from calib.vehicle import Vehicle, wheel_loads_N

#: short over long corridor: tells an offset from a scale
SHORT_CORRIDOR: Final = 0.6
DEFAULT_CORRIDOR_M: Final = 20.0
#: routes beside those of `calib simulate`, each with its mirror image
LEFT_ROUTES: Final = {
    "route_left": (straight(5.0), arc(3.0, 0.5 * np.pi), straight(5.0), arc(1.5, 0.5 * np.pi), straight(3.0)),
    "circle_left": (arc(1.2, 4 * np.pi),),
}
KINDS: Final = (
    *(name.replace("_left", side) for name in LEFT_ROUTES for side in ("_left", "_right")),
    *(name for name in NAMED if name != "corridor"),
)
#: of a route's samples
ROUTE_SPACING_M: Final = 0.05


@dataclass(frozen=True, slots=True)
class Dimensions:
    """How long and how fast planned runs are; by default those of a transport vehicle in a hall."""

    corridor_m: float = DEFAULT_CORRIDOR_M
    scale: float = 1.0  #: of other routes, at least
    reach_m: float = np.inf  #: to which they lead up to their usual size
    least_radius_m: float = 0.0  #: of a turn
    speeds_mps: tuple[float, float] = (0.3, 0.7)

    def of(self, kind: str, segments: Sequence[Segment]) -> Route:
        """Return the route of a kind in its size; `segments`: lengths (m) and turns (rad) at the usual size."""
        usual = Route.from_segments(kind, *segments)
        bends = usual.turn_rad != 0.0
        radii_m = np.abs(usual.length_m[bends] / usual.turn_rad[bends])
        poses = usual.divided(ROUTE_SPACING_M).poses()
        led = min(1.0, self.reach_m / float(np.hypot(poses.x_m, poses.y_m).max()))
        scale = max(self.scale, led, self.least_radius_m / float(radii_m.min(initial=np.inf)))
        return Route(kind, scale * usual.length_m, usual.turn_rad)


def route_of(kind: str, dimensions: Dimensions | None = None) -> Route:
    """Return the route of a kind, of usual dimensions by default.

    `kind`: ``corridor`` (and its lanes ``corridor_b`` ...), ``corridor_short``, ``square_cw``, ``square_ccw``,
    ``figure8``, ``route_left``, ``route_right``, ``circle_left``, ``circle_right``, or a named route of ``calib
    simulate``. Raises BadInputError where there is no such route.
    """
    dimensions = dimensions or Dimensions()
    if kind == "corridor" or kind.startswith("corridor_"):
        length_m = dimensions.corridor_m * (SHORT_CORRIDOR if kind == "corridor_short" else 1.0)
        return Route.from_segments(kind, straight(length_m))
    if kind not in KINDS:
        known = ["corridor", "corridor_short", *KINDS]
        raise BadInputError(f"route: found {kind!r}; expected one of {', '.join(known)}; name one of these")
    left = kind.replace("_right", "_left")
    route = dimensions.of(kind, LEFT_ROUTES.get(left) or NAMED[kind])
    return route.mirrored() if kind != left else route


#: numbers that matter at zero too
SHOWN_AT_ZERO: Final = frozenset({"payload_kg", "speed_mps", "temperature_C", "minutes_under_load", "distance"})
#: routes that end as they begin
CORRIDORS: Final = (("corridor", "out"), ("corridor", "back"))
SQUARES: Final = (("square_cw", ""), ("square_ccw", ""))
BENDS: Final = (("route_left", ""), ("route_right", ""))
CLOSED_ROUTES: Final = ("square_cw", "square_ccw", "figure8")
#: ramps of a laden vehicle
ACCELERATION_MPS2: Final = 0.5
#: of vehicles' logs
LOG_PERIOD_S: Final = 0.1
#: no hall changes so far within a session (K)
OTHER_DAYS: Final = {"next_cold": -10.0, "next_warm": 10.0}
#: conditions of a run, as the run table names them
CONDITIONS: Final = ("payload_kg", "payload_x_m", "payload_y_m", "speed_mps", "temperature_C", "minutes_under_load")


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """A run to drive; fields as in the run table, NaN for any."""

    kind: str  #: a route; see `route_of`
    direction: str = ""  #: ``out``, ``back`` or empty
    session: str = field(default="next", metadata={"json": False})
    payload_kg: float = 0.0
    payload_x_m: float = 0.0
    payload_y_m: float = 0.0
    speed_mps: float = 0.5
    temperature_C: float = float("nan")
    minutes_under_load: float = float("nan")
    read_rolling: bool = False  #: end measured while rolling
    stops: int = 0  #: between start and end
    loop: str = ""  #: ``closed``: ends on the mark of its start
    tape: bool = False  #: a corridor's length by tape, beside a rangefinder its end's place
    count: int = 1  #: how often to drive it
    columns: Mapping[str, float] = field(default_factory=dict)  #: further numeric ones
    why: str = ""  #: what a recommended run would tell
    size: str = ""  #: straights and bends in words, if recommended
    distance: float | None = None  #: standard deviations then between the nearest confounded effects

    def to_dict(self) -> dict[str, Any]:
        """Return the fields that are set as plain JSON values."""
        document = plain_fields(self)
        del document["columns"]
        if self.count == 1:
            del document["count"]
        kept = {key: value for key, value in document.items() if value or (value is not None and key in SHOWN_AT_ZERO)}
        return kept | dict(self.columns)


def usual_temperature_C(campaign: Campaign) -> float:
    """Return a campaign's median temperature, NaN if not recorded."""
    temperature = campaign.runs.number("temperature_C")
    return float(np.nanmedian(temperature)) if np.isfinite(temperature).any() else float("nan")


def default_candidates(
    campaign: Campaign, dimensions: Dimensions | None = None, *, loops: bool = False, tape: bool = False
) -> list[PlannedRun]:
    """Return candidates over routes, directions, payloads and their place, speeds, temperatures and dwell.

    `dimensions`: of routes and speeds; usual ones by default. Without motion capture `loops` close on a mark, `tape`
    measures corridors. Payloads reach the campaign's largest, else twice the vehicle's mass.
    """
    dimensions = dimensions or Dimensions()
    carried_kg = float(np.nan_to_num(campaign.runs.number("payload_kg")).max(initial=0.0))
    most_kg = carried_kg if carried_kg > 0.0 else 2.0 * campaign.vehicle.mass_kg
    usual_C = usual_temperature_C(campaign)
    ahead, aside = 0.3 * min(1.0, campaign.vehicle.wheelbase_m), 0.15 * min(1.0, campaign.vehicle.wheelbase_m)
    payloads = [(0.0, 0.0, 0.0), (0.5 * most_kg, ahead, 0.0), (most_kg, ahead, 0.0)]
    payloads += [(0.5 * most_kg, ahead, aside), (0.5 * most_kg, ahead, -aside)]
    routes = (*CORRIDORS, *SQUARES, ("figure8", ""), *BENDS)
    candidates = [
        PlannedRun(
            kind,
            direction,
            temperature_C=usual_C,
            speed_mps=speed,
            payload_kg=payload,
            payload_x_m=x,
            payload_y_m=y,
            minutes_under_load=10.0 if payload else 0.0,
            loop="closed" if loops and kind in CLOSED_ROUTES else "",
            tape=tape and kind == "corridor",
        )
        for (kind, direction), (payload, x, y), speed in product(routes, payloads, dimensions.speeds_mps)
    ]
    out = PlannedRun("corridor", "out", temperature_C=usual_C, speed_mps=dimensions.speeds_mps[1], tape=tape)
    loaded = replace(out, payload_kg=most_kg, payload_x_m=ahead)
    candidates += [replace(loaded, minutes_under_load=minutes) for minutes in (1.0, 60.0)]
    candidates += [replace(out, stops=4), replace(out, read_rolling=True)]
    candidates += [replace(out, kind=kind) for kind in ("corridor_short", "corridor_b")]
    if np.isfinite(usual_C):
        candidates += [replace(out, temperature_C=usual_C + k, session=day) for day, k in OTHER_DAYS.items()]
    return candidates


def joined(first: Campaign, second: Campaign) -> Campaign:
    """Return the runs of two campaigns of one vehicle as one, the second's last."""
    tables, logs = (first.runs, second.runs), (first.logs, second.logs)
    if any(len(log.offsets) != len(table) + 1 for log, table in zip(logs, tables, strict=True)):
        raise BadInputError("campaigns whose numbers of logs and runs differ cannot be joined")
    columns = dict.fromkeys(name for log in logs for name in log.columns)

    def column(name: str) -> FloatArray:
        return np.concatenate([log.columns.get(name, np.full(int(log.offsets[-1]), np.nan)) for log in logs])

    offsets = np.concatenate([logs[0].offsets, logs[0].offsets[-1] + logs[1].offsets[1:]])
    return replace(first, runs=stacked(tables), logs=Logs(offsets, {name: column(name) for name in columns}))


@dataclass(frozen=True, slots=True)
class Measured:
    """What is measured on runs."""

    distance: bool = True  #: by laser on corridors
    position: bool = True  #: by reference at the end
    heading: bool = True  #: by reference at the end
    front: bool = False  #: counts and steering angle, in the log
    log: bool = True
    gyro: bool = False
    beside: bool = True  #: position and heading on corridors, too


def drive(
    campaign: Campaign, runs: Sequence[PlannedRun], measured: Measured, dimensions: Dimensions | None = None
) -> Campaign:
    """Return the noise-free campaign of runs of a campaign's vehicle, if it were exactly as its model."""
    logs = [_log(campaign, run, measured, dimensions or Dimensions()) for run in runs]
    ends = np.array([[log["_x"][-1], log["_y"][-1], log["_theta"][-1]] for log in logs])
    corridor = np.array([run.kind.startswith("corridor") for run in runs])
    numbers: dict[str, FloatArray] = {
        name: np.array([float(getattr(run, name)) for run in runs]) for name in CONDITIONS
    }
    laden = numbers["payload_kg"] > 0
    numbers |= {name: np.where(laden, numbers[name], 0.0) for name in ("payload_x_m", "payload_y_m")}
    numbers |= {name: np.array([log[name][-1] for log in logs]) for name in WHEEL_COLUMNS["rear"] if name in logs[0]}
    place = (numbers[name] for name in ("payload_kg", "payload_x_m", "payload_y_m"))
    numbers |= zip(("load_left_N", "load_right_N"), wheel_loads_N(campaign.vehicle, *place)[1:], strict=True)
    if (by_length := corridor & np.array([run.tape or measured.distance for run in runs])).any():
        numbers["distance_m"] = np.where(by_length, ends[:, 0], np.nan)
    closed = np.array([run.loop == CLOSED for run in runs])
    seen = ~corridor | measured.beside
    placed = (np.array([run.tape for run in runs]) & measured.distance) | (seen & (closed | measured.position))
    by_reference = {"ref_x_m": placed, "ref_y_m": placed, "ref_theta_rad": seen & (closed | measured.heading)}
    for values, (name, known) in zip(ends.T, by_reference.items(), strict=True):
        if known.any():
            numbers[name] = np.where(known, values, np.nan)
    if measured.gyro:
        sigma = campaign.runs.number(GYRO_SIGMA)
        usual = float(np.nanmedian(sigma)) if np.isfinite(sigma).any() else campaign.reference.sigma_theta_rad
        numbers |= {GYRO_TURN: ends[:, 2], GYRO_SIGMA: np.full(len(runs), usual)}
    further = {name for run in runs for name in run.columns}
    numbers |= {name: np.array([float(run.columns.get(name, np.nan)) for run in runs]) for name in further}
    labels = {name: np.array([getattr(run, name) for run in runs]) for name in ("session", "kind", "direction", "loop")}
    labels["run_id"] = np.array([f"next{number:03d}" for number in range(len(runs))])
    table = RunTable(labels, numbers, np.zeros(len(runs), dtype=bool), np.arange(2, len(runs) + 2))
    if not measured.log:
        return replace(campaign, runs=table, logs=Logs.empty(len(logs)))
    names = [name for name in logs[0] if not name.startswith("_")]
    offsets = np.concatenate(([0], np.cumsum([len(log["t_s"]) for log in logs]))).astype(np.int64)
    columns = {name: np.concatenate([log[name] for log in logs]) for name in names}
    return replace(campaign, runs=table, logs=Logs(offsets, columns))


def _log(campaign: Campaign, run: PlannedRun, measured: Measured, dimensions: Dimensions) -> dict[str, FloatArray]:
    vehicle = campaign.vehicle
    route = route_of(run.kind, dimensions).divided(ROUTE_SPACING_M)
    along_m = route.distance_m()
    stops_m = np.linspace(0.0, along_m[-1], run.stops + 2)
    time, driven_m = stop_and_go(stops_m, run.speed_mps, read_rolling=run.read_rolling)
    poses = route.poses()
    length_m = np.interp(driven_m, along_m, np.append(0.0, np.cumsum(route.length_m)))
    x, y, heading = (np.interp(driven_m, along_m, part) for part in (poses.x_m, poses.y_m, poses.theta_rad))
    loads = wheel_loads_N(vehicle, run.payload_kg, run.payload_x_m, run.payload_y_m)
    counts = _wheel_counts(campaign, length_m, heading, (float(loads[1]), float(loads[2])), front=measured.front)
    return {"t_s": time, **counts, "_x": x, "_y": y, "_theta": heading}


def _wheel_counts(
    campaign: Campaign, distance_m: FloatArray, heading_rad: FloatArray, loads_N: tuple[float, float], *, front: bool
) -> dict[str, FloatArray]:
    if not without_rear_wheels(campaign):
        half_m = 0.5 * campaign.model.track_m * heading_rad
        sides = _both_sides(campaign.encoder, distance_m, half_m, radii_of_model(campaign.model, *loads_N))
        counts = dict(zip(WHEEL_COLUMNS["rear"], sides, strict=True))
        model = FrontModel(campaign.vehicle.front_radius_m, campaign.vehicle.wheelbase_m)
        return counts | _steered(campaign, distance_m, heading_rad, model, "front") if front else counts
    source = odometry_source(campaign)
    if source in wheels.STEERED:
        model = campaign.model.steered(campaign.vehicle)
        return _steered(campaign, distance_m, heading_rad, model, source)
    mecanum = mecanum_model(campaign)
    axle_m = np.stack(radii_of_model(campaign.model, *loads_N))
    radii_m = mecanum.radius_m / campaign.model.mean_radius_m * axle_m
    sides = _both_sides(campaign.encoder, distance_m, mecanum.arm_m * heading_rad, [*radii_m])
    return {name: sides[name.endswith("right")] for name in WHEEL_COLUMNS["wheels"]}


def _both_sides(
    encoder: Encoder, distance_m: FloatArray, half_m: FloatArray, radii_m: Sequence[FloatArray | float]
) -> tuple[FloatArray, FloatArray]:
    left = (distance_m - half_m) / radii_m[0] * encoder.counts_per_rev_left / (2 * np.pi)
    return left, (distance_m + half_m) / radii_m[1] * encoder.counts_per_rev_right / (2 * np.pi)


def _steered(
    campaign: Campaign, distance_m: FloatArray, heading_rad: FloatArray, model: FrontModel, source: str
) -> dict[str, FloatArray]:
    ahead, turn = np.diff(distance_m), np.diff(heading_rad)
    if source == "shaft":
        name, per_rev, rolled_m = "counts_rear", counts_per_rev(campaign.encoder, "shaft")[0], distance_m
        rolling = np.abs(ahead) > 0.0
        angle = np.where(rolling, np.arctan(model.wheelbase_m * turn / np.where(rolling, ahead, 1.0)), 0.0)
    else:
        step_m = np.hypot(ahead, model.wheelbase_m * turn)
        name, per_rev, rolled_m = "counts_front", campaign.encoder.front, np.append(0.0, np.cumsum(step_m))
        angle = np.where(step_m > 0.0, np.arctan2(model.wheelbase_m * turn, np.abs(ahead)), 0.0)
    steer = (np.append(angle[:1], angle) - model.zero_rad) / model.scale
    return {name: rolled_m / model.radius_m * per_rev / (2 * np.pi), "steer_rad": steer}


def stop_and_go(stops_m: FloatArray, speed: float, *, read_rolling: bool) -> tuple[FloatArray, FloatArray]:
    """Return times (s) and ways (m) from stop to stop (n_stops,), start and end included.

    Stops last half a second; with `read_rolling` the log ends in motion. Less often than `LOG_PERIOD_S` beyond
    `calib.errors.PLANNED_SAMPLES`.
    """
    if not speed > 0.0:
        raise BadInputError(f"speed_mps: found {speed!r}; expected a speed above 0; correct the planned run")
    total = float(np.ptp(stops_m)) / speed + len(stops_m) * speed / ACCELERATION_MPS2
    period = max(LOG_PERIOD_S, total / PLANNED_SAMPLES)
    time, distance = [np.zeros(1)], [np.zeros(1)]
    start = 0.0
    for number, (begin, end) in enumerate(pairwise(stops_m.tolist())):
        top = min(speed, float(np.sqrt(ACCELERATION_MPS2 * (end - begin))))
        ramp = top / ACCELERATION_MPS2
        rolling_end = read_rolling and number == len(stops_m) - 2
        cruise = (end - begin - (0.5 if rolling_end else 1.0) * top * ramp) / top
        last = ramp + cruise + (0.0 if rolling_end else ramp)
        t = np.append(np.arange(period, last, period), last)
        speeding, slowing = np.minimum(t, ramp), np.maximum(t - ramp - cruise, 0.0)
        d = 0.5 * ACCELERATION_MPS2 * speeding**2 + top * np.clip(t - ramp, 0.0, cruise)
        d = d + top * slowing - 0.5 * ACCELERATION_MPS2 * slowing**2
        pause = np.zeros(0) if rolling_end else LOG_PERIOD_S * np.arange(1.0, 6.0)
        time.append(np.append(start + t, start + last + pause))
        distance.append(np.append(begin + d, np.full(len(pause), end)))
        start = float(time[-1][-1])
    return np.concatenate(time), np.concatenate(distance)


#: route and direction of six runs in three sessions under changing conditions
ROUTES: Final = (*CORRIDORS, *SQUARES, *BENDS)
SESSIONS: Final = ("mon", "tue", "wed")
#: payload, its place ahead of the axle and left of the middle
PAYLOADS: Final = ((0.0, 0.0, 0.0), (100.0, 0.3, -0.1), (200.0, 0.2, 0.0), (100.0, 0.3, 0.1))
SPEEDS_MPS: Final = (0.3, 0.5, 0.6)
TEMPERATURES_C: Final = (14.0, 18.0, 23.0)
UNDER_LOAD_MIN: Final = (0.0, 3.0, 15.0, 40.0)


def demonstration() -> Campaign:
    """Return 36 noise-free runs of a nominal vehicle: a corridor both ways, squares and curved routes.

    Conditions and stops vary; laser, end poses and front wheel are measured, one end in five while rolling.
    """
    radius_m, track_m = 0.100, 0.700
    nominal = Campaign(
        root=None,
        name="demonstration",
        simulated=True,
        vehicle=Vehicle(track_m=track_m, wheelbase_m=1.0, wheel_radius_m=radius_m, mass_kg=100.0, cog_x_m=0.388),
        encoder=Encoder(),
        model=OdometryModel(radius_m, radius_m, track_m, reference_load_N=300.0),
        rangefinder=Rangefinder(),
        reference=Reference(),
        runs=RunTable.empty(),
        logs=Logs.empty(0),
    )
    runs = [_demonstrated(number) for number in range(2 * len(SESSIONS) * len(ROUTES))]
    return drive(nominal, runs, Measured(front=True))


def _demonstrated(number: int) -> PlannedRun:
    lap, (kind, direction) = number // len(ROUTES), ROUTES[number % len(ROUTES)]
    kind += "_short" if kind == "corridor" and lap % 2 else ""
    return PlannedRun(
        kind, direction, SESSIONS[lap // 2], *PAYLOADS[(number + lap) % len(PAYLOADS)],
        speed_mps=SPEEDS_MPS[(number + number // 4) % len(SPEEDS_MPS)],
        temperature_C=TEMPERATURES_C[(lap + number // 3) % len(TEMPERATURES_C)],
        minutes_under_load=UNDER_LOAD_MIN[(2 * lap + number) % len(UNDER_LOAD_MIN)],
        read_rolling=number % 5 == 0, stops=number % 3,
    )  # fmt: skip
