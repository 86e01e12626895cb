"""Runs and routes, in good and poor designs that a lab would drive."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from calib.errors import BadInputError
from calib.types import BoolArray, FloatArray, IntArray, StrArray
from calib.vehicle import Vehicle

PITCH_M: Final = 0.01
#: at which truth and model agree on a radius
REFERENCE_LOAD_N: Final = 300.0
#: length of ``corridor_short`` over that of ``corridor``
SHORT: Final = 0.6
_EASE_M: Final = 0.6  # a steered wheel cannot jump
_TAIL_M: Final = 3.0  # run-out, for runs read while still rolling

Segment = tuple[float, float]  # length in m, curvature in 1/m

_QUARTER: Final = np.pi / 2


def _segments(kind: str, *, length_m: float, side_m: float, radius_m: float) -> list[Segment]:
    big, bend = 1.6 * radius_m, 3.0
    weave = [(0.6 * bend, 1 / bend), (1.2 * bend, -1 / bend), (0.6 * bend, 1 / bend)]
    routes = {
        "corridor": [(length_m, 0.0)],
        "corridor_short": [(SHORT * length_m, 0.0)],
        "square_cw": [(side_m, 0.0), (_QUARTER * radius_m, -1 / radius_m)] * 4,
        "square_ccw": [(side_m, 0.0), (_QUARTER * radius_m, 1 / radius_m)] * 4,
        "figure8": [(1.0, 0.0), (2 * np.pi * big, 1 / big), (2 * np.pi * big, -1 / big), (1.0, 0.0)],
        "route_left": [(5.0, 0.0), (_QUARTER * bend, 1 / bend), (5.0, 0.0)],
        "route_right": [(5.0, 0.0), (_QUARTER * bend, -1 / bend), (5.0, 0.0)],
        "slalom": [(2.0, 0.0), *(weave * 3), (2.0, 0.0)],
    }
    stem = kind.removesuffix("_b")
    if stem not in routes:
        raise BadInputError(f"route {kind!r} found; expected one of {', '.join(routes)}; name one of these")
    return routes[stem]


@dataclass(frozen=True, slots=True, eq=False)
class RouteTables:
    """All routes of a design laid end to end on a grid of `PITCH_M`."""

    first: np.ndarray  #: shape (n_runs,): grid index at which the route of a run starts
    last: np.ndarray  #: shape (n_runs,): grid index of its last point, run-out included
    end_m: FloatArray  #: shape (n_runs,): length of the route
    #: shape (6, n_grid): planned x and y in m, cosine and sine of the heading, heading in rad, curvature in 1/m
    plan: FloatArray


def _grid(segments: Sequence[Segment], weave: tuple[float, float]) -> tuple[FloatArray, float]:
    end_m = float(sum(length for length, _ in segments))
    s = np.arange(0.0, end_m + _TAIL_M, PITCH_M)
    edges = np.cumsum([0.0, *(length for length, _ in segments)])
    turn = np.cumsum([0.0, *(length * kappa for length, kappa in segments)])
    # the curvature's mean over +-half the easing length keeps the total turn
    half = 0.5 * _EASE_M
    ahead, behind = (np.interp(s + shift, edges, turn) for shift in (half, -half))
    wave = 2 * np.pi / weave[1]
    return np.asarray((ahead - behind) / _EASE_M - weave[0] * wave**2 * np.sin(wave * s)), end_m


def tabulate(
    kinds: Sequence[str], *, length_m: float, side_m: float, radius_m: float, weaves: Sequence[tuple[float, float]]
) -> RouteTables:
    """Tabulate the routes of all runs; equal routes share a table.

    `weaves`: amplitude and wavelength of each run's weave in m; see `Design`.
    """
    start: dict[tuple[str, tuple[float, float]], tuple[int, int, float]] = {}
    parts, filled, keys = list[FloatArray](), 0, list(zip(kinds, weaves, strict=True))
    for kind, weave in dict.fromkeys(keys):
        kappa, end_m = _grid(_segments(kind, length_m=length_m, side_m=side_m, radius_m=radius_m), weave)
        lead = weave[0] * 2 * np.pi / weave[1]
        theta = np.arctan(lead) + np.concatenate(([0.0], np.cumsum(0.5 * (kappa[1:] + kappa[:-1]) * PITCH_M)))
        middle = 0.5 * (theta[1:] + theta[:-1])
        x, y = (np.concatenate(([0.0], np.cumsum(part * PITCH_M))) for part in (np.cos(middle), np.sin(middle)))
        parts.append(np.stack([x, y, np.cos(theta), np.sin(theta), theta, kappa]))
        start[kind, weave] = (filled, filled + len(kappa) - 1, end_m)
        filled += len(kappa)
    first, last, ends_m = (np.array(column) for column in zip(*(start[key] for key in keys), strict=True))
    return RouteTables(first, last, ends_m, np.concatenate(parts, axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """The runs in the order driven, and what is measured."""

    #: shape (n_runs,): route, ``out`` or ``back`` (corridor only, else empty), label of the session
    kind: StrArray
    direction: StrArray
    session: StrArray
    #: shape (n_runs,): payload as reported
    payload_kg: FloatArray
    payload_x_m: FloatArray
    payload_y_m: FloatArray
    #: shape (n_runs,): set speed, hall temperature, minutes since the payload was put on
    speed_mps: FloatArray
    temperature_C: FloatArray
    minutes_under_load: FloatArray
    flying: BoolArray  #: shape (n_runs,): the run is read while still rolling, without a stop at its end
    stops: IntArray  #: shape (n_runs,): stops on the way, spread evenly over the route
    #: shape (n_runs,): further numeric columns of the run table
    columns: Mapping[str, FloatArray] = field(default_factory=dict)
    #: corridor, side and corner radius of the squares
    length_m: float = 20.0
    side_m: float = 2.5
    radius_m: float = 1.2
    vehicle: Vehicle = field(default_factory=Vehicle)
    counts_per_rev: float = 4096.0
    slope_per_N: float = 0.0  #: relative load slope that truth and model share; 0 is a rigid wheel
    log_period_s: float = 0.2  #: time between rows of the logs; 0: no logs
    front: bool = False  #: the logs have the front wheel and the steering angle
    trace: bool = False  #: the logs have a continuous pose reference
    #: runs with a reference end pose: ``all``, ``turning`` (all but corridor runs) or ``none``
    poses: str = "all"
    laser: bool = True  #: corridor runs have a distance by laser
    weighed: bool = False  #: the run table has weighed wheel loads
    outside: bool = False  #: the run table has an outside simulator's end poses

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def corridor(self) -> BoolArray:
        """Whether a run goes along the corridor, shape (n_runs,)."""
        return np.char.startswith(self.kind, "corridor")

    @property
    def posed(self) -> BoolArray:
        """Whether a run has a reference end pose, shape (n_runs,)."""
        everywhere = np.ones(len(self), dtype=bool)
        return {"all": everywhere, "turning": ~self.corridor}.get(self.poses, ~everywhere)

    @property
    def heading_sign(self) -> FloatArray:
        """+1 where the run starts along the map's x axis, -1 for ``back``, shape (n_runs,)."""
        return np.where(self.direction == "back", -1.0, 1.0)

    @property
    def start_x_m(self) -> FloatArray:
        """Start on the map's x axis, of ``back`` at the far end, shape (n_runs,)."""
        stretch = self.length_m * np.where(self.kind == "corridor_short", SHORT, 1.0)
        return np.where(self.direction == "back", stretch, 0.0)

    def select(self, keep: ArrayLike) -> "Design":
        """Return the runs that `keep` (mask or indices, repeats allowed) picks."""
        index = np.asarray(keep)
        of_runs = [field.name for field in fields(self) if isinstance(getattr(self, field.name), np.ndarray)]
        columns = {name: column[index] for name, column in self.columns.items()}
        return replace(self, columns=columns, **{name: getattr(self, name)[index] for name in of_runs})


def conditions(design: Design) -> IntArray:
    """Return a number for each run, equal under equal conditions, shape (n_runs,)."""
    names = ("kind", "direction", "payload_kg", "payload_x_m", "payload_y_m", "speed_mps", "stops", "flying")
    rows = ["|".join(map(str, row)) for row in zip(*(getattr(design, name) for name in names), strict=True)]
    return np.unique(np.array(rows), return_inverse=True)[1].astype(np.int64)


COLUMNS = ("humidity_pct", "battery_V", "floor_gloss_GU")

DESIGNS: Final = ("load_a_session", "corridor_only", "squares_one_load", "few_repeats")

_WAYS: Final = ("out", "back")
_TURNING: Final = ("square_cw", "square_ccw", "figure8", "route_left", "route_right", "slalom")


@dataclass(frozen=True, slots=True)
class _Run:
    kind: str = "corridor"
    direction: str = ""
    session: str = "s1"
    payload_kg: float = 0.0
    payload_x_m: float = 0.4
    payload_y_m: float = 0.0
    speed_mps: float = 0.5
    temperature_C: float = 20.0
    minutes_under_load: float = 0.0
    flying: bool = False
    stops: int = 0


def _design(runs: Sequence[_Run], **settings: Any) -> Design:
    columns = {field.name: np.array([getattr(run, field.name) for run in runs]) for field in fields(_Run)}
    return Design(**(settings | columns))


def _vehicle(rng: np.random.Generator) -> Vehicle:
    return Vehicle(
        track_m=round(float(rng.uniform(0.6, 0.8)), 3),
        wheelbase_m=round(float(rng.uniform(0.9, 1.2)), 3),
        cog_x_m=round(float(rng.uniform(0.35, 0.42)), 3),
        cog_z_m=round(float(rng.uniform(0.35, 0.6)), 2),
    )


def good_design(rng: np.random.Generator, *, n_runs: int = 60, needs: Iterable[str] = (), **settings: Any) -> Design:
    """Return a crossed design: what varies varies apart, with repeats.

    `needs`: see `calib.plant.signal.lacks`; `settings`: fields of `Design` given instead of drawn.
    """
    need = set(needs)
    n_sessions = int(rng.integers(3, 6))
    rows = _scheduled(rng, _crossed(rng, max(8, n_runs // 3), need), n_runs, n_sessions)
    return _design(rows, **{**_surroundings(rng, need, n_runs), **settings})


def _crossed(rng: np.random.Generator, n_conditions: int, need: set[str]) -> list[_Run]:
    payloads = [0.0, *sorted(rng.choice([50.0, 80.0, 100.0, 120.0, 150.0, 200.0], 3, replace=False))]
    quick = [0.25, 0.35, 0.5, 0.65, *([] if "three_speeds" in need else [0.8])]
    speeds = sorted(rng.choice(quick, 3, replace=False).tolist())

    def deal(values: list[Any]) -> list[Any]:
        return [values[number % len(values)] for number in rng.permutation(n_conditions)]

    half = n_conditions // 2
    route = ["corridor"] * half + [_TURNING[number % len(_TURNING)] for number in range(n_conditions - half)]
    if "lanes" in need:
        route[:half:2] = ["corridor_b"] * len(route[:half:2])
    elif "lengths" in need or rng.random() < 0.5:
        route[1:half:3] = ["corridor_short"] * len(route[1:half:3])
    payload, side, ahead, speed = map(deal, (payloads, [-0.15, 0.0, 0.15], [0.15, 0.4, 0.6], speeds))
    stops = deal([0, 0, 1, 3] if "stops" in need else [0, 0, 0, 1])
    flying = deal([True, False] if "flying" in need else [False])
    conditions = []
    for number, kind in enumerate(route):
        corridor, loaded = kind.startswith("corridor"), payload[number] > 0
        direction, (x_m, y_m) = _WAYS[number // 2 % 2], (ahead[number], side[number]) if loaded else (0.0, 0.0)
        speed_mps = speed[number] if corridor or kind.startswith("route") else min(speed[number], 0.65)
        run = _Run(kind, direction if corridor else "", "", payload[number], x_m, y_m, speed_mps)
        conditions.append(replace(run, stops=stops[number], flying=flying[number]))
    return conditions


def _scheduled(rng: np.random.Generator, conditions: Sequence[_Run], n_runs: int, n_sessions: int) -> list[_Run]:
    levels = []
    for _ in range(n_sessions):
        cold = float(rng.uniform(10, 20))
        halves = [cold, cold + float(rng.uniform(6, 12))]
        levels.append(halves if rng.random() < 0.5 else halves[::-1])
    driven = [conditions[number] for number in np.resize(np.arange(len(conditions)), n_runs).tolist()]
    minutes = [float(rng.choice([2.0, 10.0, 30.0, 60.0])) if run.payload_kg > 0 else 0.0 for run in driven]
    shuffle = np.concatenate([rng.permutation(part) for part in np.array_split(np.arange(n_runs), len(conditions))])
    runs = []
    for number, at in enumerate(rng.permutation(shuffle)):
        place = number * n_sessions / n_runs
        temperature_C = round(levels[int(place)][int(2 * (place % 1))] + float(rng.uniform(-0.3, 0.3)), 1)
        session = f"s{number * n_sessions // n_runs + 1}"
        runs.append(replace(driven[at], session=session, minutes_under_load=minutes[at], temperature_C=temperature_C))
    return runs


def _surroundings(rng: np.random.Generator, need: set[str], n_runs: int) -> dict[str, object]:
    drawn: dict[str, object] = {
        "length_m": round(float(rng.uniform(15.0, 25.0)), 1),
        "side_m": round(float(rng.uniform(2.0, 3.5)), 1),
        "radius_m": round(float(rng.uniform(0.9, 1.4)), 2),
        "vehicle": _vehicle(rng),
        "counts_per_rev": float(rng.choice([2048, 4096, 8192])),
        "slope_per_N": float(rng.uniform(0.8e-5, 1.4e-5)) if "slope" in need else 0.0,
        "log_period_s": 0.0 if "no_logs" in need else float(rng.choice([0.1, 0.1, 0.12])),
        **{name: name in need for name in ("front", "trace", "outside")},
    }
    if "no_logs" in need:
        drawn["poses"] = "none"
    column_names = [want.partition(":")[2] for want in need if want.startswith("column:")]
    if not column_names and rng.random() < 0.3:
        column_names = [str(rng.choice(COLUMNS))]
    return drawn | {"columns": {name: np.round(rng.uniform(0, 100, n_runs), 1) for name in column_names}}


def poor_design(name: str, rng: np.random.Generator, *, n_runs: int = 40, **settings: Any) -> Design:
    """Return a design that cannot answer everything; for `settings` see `good_design`.

    One of `DESIGNS`; ``load_a_session`` is the paper's, a corridor out and back.
    """
    if name not in DESIGNS:
        raise BadInputError(f"design {name!r} found; expected one of {', '.join(DESIGNS)}; name one of these")
    drawn: dict[str, object] = {
        "length_m": round(float(rng.uniform(15.0, 30.0)), 1),
        "vehicle": _vehicle(rng),
        "log_period_s": float(rng.choice([0.1, 0.12])),
    }
    if name == "few_repeats":
        whole = good_design(rng, n_runs=3 * n_runs, **settings)
        what = np.char.add(np.char.add(whole.kind, whole.direction), whole.payload_kg.astype(np.str_))
        first = np.unique(what, return_index=True)[1]
        return whole.select(np.sort(np.concatenate((first, np.setdiff1d(np.arange(3 * n_runs), first)))[:n_runs]))
    rows = [_poor_run(name, rng, number, n_runs) for number in range(n_runs)]
    if name == "load_a_session":
        drawn["poses"] = str(rng.choice(["all", "none"]))
    drawn["laser"] = name != "squares_one_load"
    return _design(rows, **{**drawn, **settings})


def _poor_run(name: str, rng: np.random.Generator, number: int, n_runs: int) -> _Run:
    session = number * {"load_a_session": 5, "corridor_only": 3, "squares_one_load": 2}[name] // n_runs
    run = _Run(direction=_WAYS[number % 2], session=f"s{session + 1}", minutes_under_load=10.0)
    if name == "squares_one_load":
        return replace(run, kind=_TURNING[number % 2], direction="", payload_kg=100.0, speed_mps=0.4)
    if name == "load_a_session":
        temperature_C = round(19.0 + float(rng.uniform(-0.5, 0.5)), 1)
        run = replace(run, payload_kg=50.0 * session, payload_x_m=0.3, temperature_C=temperature_C)
    else:
        payload = float(rng.choice([0.0, 100.0, 200.0]))
        y_m = float(rng.choice([-0.15, 0.0, 0.15])) if payload else 0.0
        speed_mps, temperature_C = float(rng.choice([0.3, 0.6])), round(float(rng.uniform(12, 28)), 1)
        run = replace(run, payload_kg=payload, payload_y_m=y_m, speed_mps=speed_mps, temperature_C=temperature_C)
    return run if run.payload_kg else replace(run, payload_x_m=0.0, minutes_under_load=0.0)
