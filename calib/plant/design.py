"""What is driven: the runs of a campaign and their routes, before anything has moved."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from calib.errors import BadInputError
from calib.types import BoolArray, FloatArray, IntArray, StrArray
from calib.vehicle import Vehicle

PITCH_M: Final = 0.01
#: length of ``corridor_short`` over that of ``corridor``
SHORT: Final = 0.6
_EASE_M: Final = 0.6  # curvature changes over this length, as a steered wheel cannot jump
_TAIL_M: Final = 3.0  # straight run-out behind the end, for runs read while still rolling

Segment = tuple[float, float]  # length in m, curvature in 1/m

_QUARTER: Final = np.pi / 2


def segments_of(kind: str, *, length_m: float, side_m: float, radius_m: float) -> list[Segment]:
    """Return a route as straights and arcs: (length in m, curvature per m), left turns positive.

    ``corridor`` (``corridor_b`` is its second lane, ``corridor_short`` a part of it), ``square_cw``, ``square_ccw``,
    ``figure8``, ``route_left``, ``route_right`` or ``slalom``. The squares have straight sides of `side_m` and corners
    of `radius_m`; the circles of the eight have 1.6 times that radius.
    """
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
    """Return the eased curvature on the grid (run-out included) and the length of the route."""
    end_m = float(sum(length for length, _ in segments))
    s = np.arange(0.0, end_m + _TAIL_M, PITCH_M)
    edges = np.cumsum([0.0, *[length for length, _ in segments]])
    turn = np.concatenate(([0.0], np.cumsum([length * kappa for length, kappa in segments])))
    # the mean of the curvature over +-half the easing length, by differences of the turned angle: keeps the total turn
    half = 0.5 * _EASE_M
    ahead, behind = (np.interp(s + shift, edges, turn) for shift in (half, -half))
    kappa: FloatArray = (ahead - behind) / _EASE_M
    amplitude_m, wavelength_m = weave
    if amplitude_m > 0.0:
        wave = 2 * np.pi / wavelength_m
        kappa = kappa - amplitude_m * wave**2 * np.sin(wave * s)
    return kappa, end_m


def tabulate(
    kinds: Sequence[str], *, length_m: float, side_m: float, radius_m: float, weaves: Sequence[tuple[float, float]]
) -> RouteTables:
    """Tabulate the routes of all runs, see `segments_of`; equal routes share a table.

    `weaves`: amplitude and wavelength of each run's weave about the line, in m; amplitude 0 is none.
    """
    start: dict[tuple[str, tuple[float, float]], tuple[int, int, float]] = {}
    parts: list[FloatArray] = []
    filled = 0
    keys = list(zip(kinds, weaves, strict=True))
    for key in dict.fromkeys(keys):
        kind, weave = key
        kappa, end_m = _grid(segments_of(kind, length_m=length_m, side_m=side_m, radius_m=radius_m), weave)
        lead = weave[0] * 2 * np.pi / weave[1] if weave[0] > 0.0 else 0.0
        theta = np.arctan(lead) + np.concatenate(([0.0], np.cumsum(0.5 * (kappa[1:] + kappa[:-1]) * PITCH_M)))
        middle = 0.5 * (theta[1:] + theta[:-1])
        x = np.concatenate(([0.0], np.cumsum(np.cos(middle) * PITCH_M)))
        y = np.concatenate(([0.0], np.cumsum(np.sin(middle) * PITCH_M)))
        parts.append(np.stack([x, y, np.cos(theta), np.sin(theta), theta, kappa]))
        start[key] = (filled, filled + len(kappa) - 1, end_m)
        filled += len(kappa)
    first, last, ends_m = (np.array(column) for column in zip(*(start[key] for key in keys), strict=True))
    return RouteTables(first, last, ends_m, np.concatenate(parts, axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """The runs to drive, in the order driven, and what is measured on them."""

    #: kind, direction, session: shape (n_runs,): route, ``out`` or ``back`` (corridor only, else empty), label of the
    #: session
    kind: StrArray
    direction: StrArray
    session: StrArray
    #: payload_kg, payload_x_m, payload_y_m: shape (n_runs,): payload as reported
    payload_kg: FloatArray
    payload_x_m: FloatArray
    payload_y_m: FloatArray
    #: speed_mps, temperature_C, minutes_under_load: shape (n_runs,): set speed, hall temperature, minutes since the
    #: payload was put on
    speed_mps: FloatArray
    temperature_C: FloatArray
    minutes_under_load: FloatArray
    flying: BoolArray  #: shape (n_runs,): the run is read while still rolling, without a stop at its end
    stops: IntArray  #: shape (n_runs,): stops on the way, spread evenly over the route
    #: shape (n_runs,): further numeric columns of the run table
    columns: Mapping[str, FloatArray] = field(default_factory=dict)
    #: length_m, side_m, radius_m: corridor, side and corner radius of the squares
    length_m: float = 20.0
    side_m: float = 2.5
    radius_m: float = 1.2
    vehicle: Vehicle = field(default_factory=Vehicle)
    counts_per_rev: float = 4096.0  #: encoder counts per wheel revolution
    slope_per_N: float = 0.0  #: relative load slope that truth and model share; 0 is a rigid wheel
    log_period_s: float = 0.2  #: time between rows of the logs; 0 means that there are no logs
    front: bool = False  #: the logs have the front wheel and the steering angle
    trace: bool = False  #: the logs have a continuous pose reference
    #: which runs have a reference end pose: ``all``, ``turning`` (all but corridor runs) or ``none``
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
        """+1 where the run starts along the map's x axis, -1 against it (``back``), shape (n_runs,)."""
        return np.where(self.direction == "back", -1.0, 1.0)

    @property
    def start_x_m(self) -> FloatArray:
        """Where the runs start on the map's x axis: ``back`` at the far end of its stretch, shape (n_runs,)."""
        stretch = self.length_m * np.where(self.kind == "corridor_short", SHORT, 1.0)
        return np.where(self.direction == "back", stretch, 0.0)

    def select(self, keep: ArrayLike) -> Design:
        """Return the runs that `keep` (mask or indices, repeats allowed) picks."""
        index = np.asarray(keep)
        of_runs = [field.name for field in fields(self) if isinstance(getattr(self, field.name), np.ndarray)]
        columns = {name: column[index] for name, column in self.columns.items()}
        return replace(self, columns=columns, **{name: getattr(self, name)[index] for name in of_runs})


def conditions(design: Design) -> IntArray:
    """Return a number for each run, the same for runs driven under the same conditions, shape (n_runs,)."""
    names = ("kind", "direction", "payload_kg", "payload_x_m", "payload_y_m", "speed_mps", "stops", "flying")
    rows = ["|".join(map(str, row)) for row in zip(*(getattr(design, name) for name in names), strict=True)]
    return np.unique(np.array(rows), return_inverse=True)[1].astype(np.int64)


def lacks(design: Design, needs: Iterable[str]) -> list[str]:
    """Return what a design lacks of an effect's needs; see `calib.plant.world.Form`."""
    turning = bool((~design.corridor).any())
    has = {
        "loads": len(np.unique(design.payload_kg)) > 1,
        "offsets": len(np.unique(design.payload_kg)) > 2 and len(np.unique(design.payload_y_m)) > 1,
        "turns": turning,
        "bends": len(set(design.kind[~design.corridor])) > 2,
        "speeds": len(np.unique(design.speed_mps)) > 1,
        "three_speeds": len(np.unique(design.speed_mps)) > 2,
        "temperatures": float(np.ptp(design.temperature_C)) > 5.0,
        "dwell": len(np.unique(design.minutes_under_load)) > 2,
        "sessions": len(set(design.session)) > 1,
        "directions": len(set(design.direction) & {"out", "back"}) > 1,
        "corridor": bool(design.corridor.any()),
        "laser": design.laser and bool(design.corridor.any()),
        "poses": design.poses == "all" or (design.poses == "turning" and turning),
        "front": design.front,
        "flying": bool(design.flying.any()),
        "stops": bool(design.stops.any()),
        "slope": design.slope_per_N != 0.0,
        "trace": design.trace,
        "lengths": bool((design.kind == "corridor_short").any()),
        "lanes": bool(np.char.endswith(design.kind, "_b").any()),
        "outside": design.outside,
        "no_logs": design.log_period_s == 0.0,
    }
    return sorted(
        one for one in needs if not (one.partition(":")[2] in design.columns if one.startswith("column:") else has[one])
    )
