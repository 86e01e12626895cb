"""Runs that have not been driven: how they would be logged and measured by a vehicle that is as the model says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import LABEL_COLUMNS, Campaign, Logs, RunTable
from calib.campaign.wheels import WHEEL_COLUMNS
from calib.errors import BadInputError
from calib.gap.plan.planned_logs import stop_and_go, wheel_counts
from calib.gap.verdict.outcome import PlannedRunAdvice
from calib.motion.routes import NAMED, Route, arc, straight
from calib.vehicle import wheel_loads_N

SPACING_M: Final = 0.05
SHORT: Final = 0.6
DEFAULT_CORRIDOR_M: Final = 20.0


@dataclass(frozen=True, slots=True)
class Measured:
    """What is measured on a run."""

    #: distance, poses, front, log: laser distance on corridor runs, reference end pose, front wheel and steering in the
    #: log, a log at all
    distance: bool = True
    poses: bool = True
    front: bool = False
    log: bool = True


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """A run to drive; fields as in the run table, NaN where nothing is said."""

    kind: str  #: a route; see `route_of`
    direction: str = ""
    session: str = "next"
    payload_kg: float = 0.0
    payload_x_m: float = 0.0
    payload_y_m: float = 0.0
    speed_mps: float = 0.5
    temperature_C: float = float("nan")
    minutes_under_load: float = float("nan")
    read_rolling: bool = False  #: the end is measured while the vehicle still rolls
    stops: int = 0  #: stops on the way
    columns: Mapping[str, float] = field(default_factory=dict)  #: further numeric columns

    def to_dict(self) -> dict[str, Any]:
        """Return what there is to say of it as plain JSON values."""
        document: dict[str, Any] = {"kind": self.kind}
        if self.direction:
            document["direction"] = self.direction
        numbers = asdict(self)
        for name in ("payload_kg", "payload_x_m", "payload_y_m", "speed_mps", "temperature_C", "minutes_under_load"):
            value = float(numbers[name])
            if np.isfinite(value) and not (name.startswith("payload_") and name != "payload_kg" and value == 0.0):
                document[name] = value
        if self.stops:
            document["stops"] = self.stops
        if self.read_rolling:
            document["read_rolling"] = True
        return document | dict(self.columns)

    def advice(self, why: str, distance: float | None = None) -> PlannedRunAdvice:
        """Return the run as advice to drive it, with what it tells."""

        def known(value: float) -> float | None:
            return float(value) if np.isfinite(value) else None

        return PlannedRunAdvice(
            kind=self.kind,
            why=why,
            direction=self.direction,
            payload_kg=known(self.payload_kg),
            payload_x_m=known(self.payload_x_m) or None,
            payload_y_m=known(self.payload_y_m) or None,
            speed_mps=known(self.speed_mps),
            temperature_C=known(self.temperature_C),
            minutes_under_load=known(self.minutes_under_load),
            stops=self.stops,
            read_rolling=self.read_rolling,
            columns=dict(self.columns),
            distance=distance,
        )


def route_of(kind: str, corridor_m: float = DEFAULT_CORRIDOR_M) -> Route:
    """Return the route of a kind.

    Parameters
    ----------
    kind : str
        ``corridor`` (and its lanes ``corridor_b`` ...), ``corridor_short``, ``square_cw``, ``square_ccw``, ``figure8``,
        ``route_left``, ``route_right``, ``circle_left``, ``circle_right``, or a named route of ``calib simulate``.
    corridor_m : float
        Length of the corridor.

    Raises
    ------
    BadInputError
        Where there is no such route.
    """
    quarter = 0.5 * np.pi
    if kind == "corridor_short":
        return Route.from_segments(kind, straight(SHORT * corridor_m))
    if kind == "corridor" or kind.startswith("corridor_"):
        return Route.from_segments(kind, straight(corridor_m))
    if kind in {"route_left", "route_right"}:
        left = Route.from_segments(
            kind, straight(5.0), arc(3.0, quarter), straight(5.0), arc(1.5, quarter), straight(3.0)
        )
        return left if kind == "route_left" else left.mirrored()
    if kind in {"circle_left", "circle_right"}:
        left = Route.from_segments(kind, arc(1.2, 4 * np.pi))
        return left if kind == "circle_left" else left.mirrored()
    if kind in NAMED:
        return Route.from_segments(kind, *NAMED[kind])
    known = "corridor, corridor_short, route_left, route_right, circle_left, circle_right, " + ", ".join(
        name for name in NAMED if name != "corridor"
    )
    raise BadInputError(f"route: found {kind!r}; expected one of {known}; name one of these")


def default_candidates(campaign: Campaign) -> list[PlannedRun]:
    """Return runs worth considering: routes, payloads and their place, speeds, directions, temperatures, dwell.

    Payloads stay within what the campaign carried (twice the vehicle's own mass where it carried none), temperatures
    are varied by 10 K where the campaign notes them.
    """
    runs = campaign.runs
    carried = runs.number("payload_kg")
    heaviest = float(np.nanmax(carried)) if np.isfinite(carried).any() else 0.0
    most = heaviest if heaviest > 0.0 else 2.0 * campaign.vehicle.mass_kg
    warm = runs.number("temperature_C")
    usual = float(np.nanmedian(warm)) if np.isfinite(warm).any() else float("nan")
    # on the vehicle, whose wheelbase is the longest that a payload is moved on
    ahead, aside = 0.3 * min(1.0, campaign.vehicle.wheelbase_m), 0.15 * min(1.0, campaign.vehicle.wheelbase_m)
    payloads = [(0.0, 0.0, 0.0), (0.5 * most, ahead, 0.0), (most, ahead, 0.0), (0.5 * most, ahead, aside)]
    payloads.append((0.5 * most, ahead, -aside))
    routes = [("corridor", "out"), ("corridor", "back"), ("square_cw", ""), ("square_ccw", ""), ("figure8", "")]
    routes += [("route_left", ""), ("route_right", "")]
    base = PlannedRun("corridor", temperature_C=usual)
    candidates = []
    for kind, direction in routes:
        for payload, x, y in payloads:
            for speed in (0.3, 0.7):
                run = replace(base, kind=kind, direction=direction, speed_mps=speed)
                dwell = 10.0 if payload else 0.0
                candidates.append(
                    replace(run, payload_kg=payload, payload_x_m=x, payload_y_m=y, minutes_under_load=dwell)
                )
    loaded = replace(base, direction="out", payload_kg=most, payload_x_m=ahead, speed_mps=0.5)
    candidates += [replace(loaded, minutes_under_load=minutes) for minutes in (1.0, 60.0)]
    candidates.append(replace(base, direction="out", stops=4))
    candidates.append(replace(base, direction="out", speed_mps=0.7, read_rolling=True))
    candidates.append(replace(base, kind="corridor_short", direction="out"))
    candidates.append(replace(base, kind="corridor_b", direction="out"))
    if np.isfinite(usual):
        candidates += [replace(base, direction="out", temperature_C=usual + step) for step in (-10.0, 10.0)]
    return candidates


def drive(
    campaign: Campaign, runs: Sequence[PlannedRun], measured: Measured, corridor_m: float = DEFAULT_CORRIDOR_M
) -> Campaign:
    """Return the campaign that the runs would make if the vehicle were as the model says, without any noise.

    The campaign given has vehicle, encoders, model and instruments; its own runs are not part of the result.
    """
    logs = [_log(campaign, run, measured, corridor_m) for run in runs]
    ends = np.array([[log["_x"][-1], log["_y"][-1], log["_theta"][-1]] for log in logs])
    corridor = np.array([run.kind.startswith("corridor") for run in runs])
    numbers: dict[str, FloatArray] = {
        name: np.array([float(getattr(run, name)) for run in runs])
        for name in ("payload_kg", "payload_x_m", "payload_y_m", "speed_mps", "temperature_C", "minutes_under_load")
    }
    # a payload of nothing stands nowhere
    for name in ("payload_x_m", "payload_y_m"):
        numbers[name] = np.where(numbers["payload_kg"] > 0, numbers[name], 0.0)
    numbers |= {name: np.array([log[name][-1] for log in logs]) for name in WHEEL_COLUMNS["rear"] if name in logs[0]}
    if measured.distance:
        numbers["distance_m"] = np.where(corridor, ends[:, 0], np.nan)
    if measured.poses:
        for number, name in enumerate(("ref_x_m", "ref_y_m", "ref_theta_rad")):
            numbers[name] = ends[:, number]
    for name in {name for run in runs for name in run.columns}:
        numbers[name] = np.array([float(run.columns.get(name, np.nan)) for run in runs])
    labels = {
        "run_id": np.array([f"next{number:03d}" for number in range(len(runs))]),
        "session": np.array([run.session for run in runs]),
        "kind": np.array([run.kind for run in runs]),
        "direction": np.array([run.direction for run in runs]),
    }
    table = RunTable(labels, numbers, np.zeros(len(runs), dtype=bool), np.arange(2, len(runs) + 2))
    return replace(campaign, runs=table, logs=_laid_out(logs, measured))


def _laid_out(logs: Sequence[Mapping[str, FloatArray]], measured: Measured) -> Logs:
    if not measured.log:
        return Logs.empty(len(logs))
    names = [name for name in logs[0] if not name.startswith("_")]
    lengths = [len(log["t_s"]) for log in logs]
    offsets = np.concatenate(([0], np.cumsum(lengths))).astype(np.int64)
    return Logs(offsets, {name: np.concatenate([log[name] for log in logs]) for name in names})


def _log(campaign: Campaign, run: PlannedRun, measured: Measured, corridor_m: float) -> dict[str, FloatArray]:
    """Return a run's log at a fixed period, with the pose in columns that begin with an underscore."""
    vehicle = campaign.vehicle
    route = route_of(run.kind, corridor_m).divided(SPACING_M)
    way = route.distance_m()
    stopped = np.linspace(0.0, way[-1], run.stops + 2)
    time, driven = stop_and_go(stopped, run.speed_mps, read_rolling=run.read_rolling)
    poses = route.poses()
    # the route's own segments as functions of the way driven
    length = np.interp(driven, way, np.concatenate(([0.0], np.cumsum(route.length_m))))
    heading = np.interp(driven, way, poses.theta_rad)
    x, y = np.interp(driven, way, poses.x_m), np.interp(driven, way, poses.y_m)
    loads = wheel_loads_N(vehicle, run.payload_kg, run.payload_x_m, run.payload_y_m)
    counts = wheel_counts(campaign, length, heading, (float(loads[1]), float(loads[2])), front=measured.front)
    return {"t_s": time, **counts, "_x": x, "_y": y, "_theta": heading}


def joined(first: Campaign, second: Campaign) -> Campaign:
    """Return the runs of two campaigns of one vehicle as one, the second's after the first's."""
    n, m = len(first.runs), len(second.runs)
    numbers = {
        name: np.concatenate([first.runs.number(name), second.runs.number(name)])
        for name in dict.fromkeys([*first.runs.numbers, *second.runs.numbers])
    }
    labels = {name: np.concatenate([first.runs.label(name), second.runs.label(name)]) for name in LABEL_COLUMNS}
    table = RunTable(
        labels,
        numbers,
        np.concatenate([first.runs.excluded, second.runs.excluded]),
        np.concatenate([first.runs.line, second.runs.line]),
    )
    a, b = first.logs, second.logs
    columns = {}
    for name in dict.fromkeys([*a.columns, *b.columns]):
        parts = [logs.columns.get(name, np.full(int(logs.offsets[-1]), np.nan)) for logs in (a, b)]
        columns[name] = np.concatenate(parts)
    offsets = np.concatenate([a.offsets, a.offsets[-1] + b.offsets[1:]])
    if len(offsets) != n + m + 1:
        raise BadInputError("campaigns whose logs and runs do not agree in number cannot be joined")
    return replace(first, runs=table, logs=Logs(offsets, columns))
