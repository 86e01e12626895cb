"""Routes of straights and arcs, what wheels carry on them, and what they travel, by counts and under loads."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from calib.campaign.settings import Encoder, OdometryModel
from calib.campaign.settings_file import load_toml
from calib.errors import ROUTE_POINTS, BadFileError, BadInputError, refuse_more
from calib.odometry import end_poses, integrate
from calib.odometry.poses import Poses, read_tum, sinc
from calib.radius.law import RadiusLaw
from calib.types import FloatArray, floats
from calib.vehicle import Vehicle, check_wheel_loads, wheel_loads_N

Segment = tuple[float, float]

FORMAT: Final = "calib-route/1"
#: largest length in m, or turn, of a segment
LONGEST: Final = 1e6
#: pieces of routes driven at once, to save memory
BLOCK: Final = 131_072
#: radii, their ratios and tracks that a vehicle can have
SHORTEST_M: Final = 1e-4
LONGEST_M: Final = 1e4
#: spacing of the points that figures and trajectories show
SPACING_M: Final = 0.05


def straight(length_m: float) -> Segment:
    """Return a straight of a length in m; negative is driven backwards."""
    return (length_m, 0.0)


def arc(radius_m: float, turn_rad: float) -> Segment:
    """Return an arc of a radius in m; a positive turn goes left; radius 0: on the spot."""
    return (radius_m * abs(turn_rad), turn_rad)


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """Straights and arcs that the middle of the rear axle follows, starting at (0, 0, 0)."""

    name: str
    length_m: FloatArray  #: shape (n_segments,): length of each segment
    turn_rad: FloatArray  #: shape (n_segments,): turn of each segment, left positive; 0 in a straight

    @staticmethod
    def from_segments(name: str, *segments: Segment) -> "Route":
        """Return the route of `straight` and `arc` segments."""
        rows = np.array(segments, dtype=np.float64).reshape(-1, 2)
        return Route(name, rows[:, 0].copy(), rows[:, 1].copy())

    def __len__(self) -> int:
        return len(self.length_m)

    @property
    def total_m(self) -> float:
        """Length of the whole route."""
        return float(np.abs(self.length_m).sum())

    def divided(self, spacing_m: float) -> "Route":
        """Return the route in pieces of at most `spacing_m` (or 3 degrees)."""
        if not spacing_m > 0.0:
            raise BadInputError(f"spacing: found {spacing_m!r} m; expected a length above 0")
        pieces = np.maximum(np.abs(self.length_m) / spacing_m, np.abs(self.turn_rad) / math.radians(3.0))
        pieces = np.maximum(np.ceil(pieces - 1e-9), 1.0)
        what = f"points along {self.name}, {self.total_m:.4g} m at {spacing_m:g} m each"
        refuse_more(what, float(pieces.sum()), ROUTE_POINTS, "drive a shorter route, or a part of it")
        count = pieces.astype(np.int64)
        return Route(self.name, np.repeat(self.length_m / count, count), np.repeat(self.turn_rad / count, count))

    def cut(self, at_m: ArrayLike) -> "Route":
        """Return the route with a border between segments at each of these distances."""
        wanted, edges, pieces = np.unique(floats(at_m)), self.distance_m(), []
        for length, turn, first, last in zip(self.length_m, self.turn_rad, edges, edges[1:], strict=False):
            inside = wanted[(wanted > first + 1e-9) & (wanted < last - 1e-9)]
            shares = np.diff([first, *inside, last]) / (last - first) if len(inside) else np.ones(1)
            pieces.append(np.outer([length, turn], shares))
        return Route(self.name, *np.concatenate(pieces, axis=1))

    def mirrored(self) -> "Route":
        """Return the route with left and right swapped."""
        return Route(self.name, self.length_m, -self.turn_rad)

    def poses(self) -> Poses:
        """Return the poses at the start and at the end of each segment, shape (n_segments + 1,)."""
        half = 0.5 * self.turn_rad
        return integrate(self.length_m - half, self.length_m + half, 1.0).from_origin()

    def distance_m(self) -> FloatArray:
        """Return the distance driven at the start and at the end of each segment, shape (n_segments + 1,)."""
        return np.concatenate(([0.0], np.cumsum(np.abs(self.length_m))))


QUARTER: Final = math.pi / 2

NAMED: Final[Mapping[str, tuple[Segment, ...]]] = {
    "corridor": (straight(40.0),),
    "straight15": (straight(15.0),),
    "paper_route": (straight(5.0), arc(3.0, QUARTER), straight(5.0)),
    "square_cw": (straight(4.0), arc(0.5, -QUARTER)) * 4,
    "square_ccw": (straight(4.0), arc(0.5, QUARTER)) * 4,
    "figure8": (arc(2.0, 2 * math.pi), arc(2.0, -2 * math.pi)),
}


def find_route(name: str) -> Route:
    """Return a route by its name, from a TOML file, or from a trajectory (``.tum``)."""
    if name in NAMED:
        return Route.from_segments(name, *NAMED[name])
    if name.endswith(".toml"):
        return read_route(Path(name))
    if name.endswith(".tum"):
        return _driven_route(Path(name))
    text = f"route: found {name!r}"
    raise BadInputError(f"{text}; expected {', '.join(NAMED)}, or a file ending in .toml or .tum; choose one of them")


def _driven_route(path: Path) -> Route:
    _, poses = read_tum(path)
    if len(poses) < 2:
        raise BadFileError(path, found="one pose", expected="two or more", remedy="record a longer trajectory")
    turn = np.diff(poses.theta_rad)
    dx, dy = np.diff(poses.x_m), np.diff(poses.y_m)
    middle = poses.theta_rad[:-1] + 0.5 * turn
    sign = np.where(dx * np.cos(middle) + dy * np.sin(middle) < 0.0, -1.0, 1.0)
    return Route(path.stem, sign * np.hypot(dx, dy) / sinc(0.5 * turn), turn)


def read_route(path: Path) -> Route:
    """Read a route file: ``format = "calib-route/1"``, a ``name`` if wanted, and ``[[segment]]`` tables.

    These have ``straight_m``, or ``radius_m`` and ``turn_deg`` (or ``turn_rad``), left positive.
    """

    def bad(actual: str, expected: str, column: str) -> BadFileError:
        return BadFileError(path, found=actual, expected=expected, remedy="correct the route file", column=column)

    document = load_toml(path, str(path), remedy="give the path of a route file")
    if document.get("format") != FORMAT:
        raise bad(repr(document.get("format")), repr(FORMAT), "format")
    pieces = document.get("segment")
    if not isinstance(pieces, list) or not pieces:
        raise bad("no [[segment]]", "one [[segment]] or more", "segment")
    name = document.get("name", path.stem)
    if not isinstance(name, str):
        raise bad(repr(name), "a text", "name")
    segments = []
    for number, piece in enumerate(pieces, start=1):
        where = f"segment {number}"
        if not isinstance(piece, dict) or frozenset(piece) not in _KEYS:
            actual = ", ".join(sorted(piece)) or "nothing" if isinstance(piece, dict) else repr(piece)
            raise bad(actual, "a table of straight_m, or radius_m and turn_deg (or turn_rad)", where)
        for key, value in piece.items():
            number_like = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LONGEST
            if not number_like or (key == "radius_m" and value < 0.0):
                raise bad(f"{key} = {value!r}", "a finite number, a radius not below 0", where)
        if "straight_m" in piece:
            segments.append(straight(float(piece["straight_m"])))
        else:
            turn = math.radians(piece["turn_deg"]) if "turn_deg" in piece else float(piece["turn_rad"])
            segments.append(arc(float(piece["radius_m"]), turn))
    return Route.from_segments(name, *segments)


_KEYS: Final = {frozenset({"straight_m"}), frozenset({"radius_m", "turn_deg"}), frozenset({"radius_m", "turn_rad"})}


@dataclass(frozen=True, slots=True, eq=False)
class Axle:
    """Rear wheels as somebody believes them to be, or as they are."""

    #: shape () or (vehicles,): effective radii and the distance of the contact points; shapes that broadcast
    radius_left_m: ArrayLike
    radius_right_m: ArrayLike
    track_m: ArrayLike

    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return left radius, right radius and track, each () or (vehicles,), within plausible lengths."""
        left, right, track = map(floats, (self.radius_left_m, self.radius_right_m, self.track_m))
        for name, part in (("left radius", left), ("right radius", right), ("track", track)):
            impossible = ~((part >= SHORTEST_M) & (part <= LONGEST_M))
            if part.ndim > 1 or impossible.any():
                actual = f"{part.shape} of them" if part.ndim > 1 else f"{np.atleast_1d(part[impossible])[0]:g} m"
                expected = f"lengths from {SHORTEST_M:g} to {LONGEST_M:g} m, one a vehicle"
                raise BadInputError(f"{name}: found {actual}; expected {expected}")
        return left, right, track


def wheel_travel(route: Route, believed: Axle, real: Axle) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the real wheels' travel in each segment, (vehicles, n_segments), and the track (vehicles, 1)."""
    left, right, track = (np.atleast_1d(part)[:, None] for part in believed.arrays())
    real_left, real_right, real_track = (np.atleast_1d(part)[:, None] for part in real.arrays())
    half = 0.5 * track * route.turn_rad
    travel = real_left / left * (route.length_m - half), real_right / right * (route.length_m + half)
    left, right, track = np.broadcast_arrays(*travel, real_track)
    return left, right, track[:, :1]


def follow(route: Route, believed: Axle, real: Axle) -> Poses:
    """Return the real poses at the start and at the end of each segment, shape (vehicles, n_segments + 1).

    The believed pose follows the route; divide the route for more poses.
    """
    return integrate(*wheel_travel(route, believed, real)).from_origin()


def end_of_route(route: Route, believed: Axle, real: Axle) -> Poses:
    """Return the real end poses, (vehicles,), of many vehicles at once; see `follow`."""
    lengths = [np.atleast_1d(part) for part in (*believed.arrays(), *real.arrays())]
    try:
        vehicles = np.stack(np.broadcast_arrays(*lengths))
    except ValueError as error:
        most = max(map(len, lengths))
        raise BadInputError(f"axles: found arrays of unlike lengths; expected one value or {most}") from error
    ends = []
    for block in np.array_split(vehicles, -(-vehicles.shape[1] * len(route) // BLOCK), axis=1):
        left, right, track = wheel_travel(route, Axle(*block[:3]), Axle(*block[3:]))
        ends.append(end_poses(left, right, track).stacked())
    return Poses.from_stacked(np.concatenate(ends))


def loads_in_steps(run_N: ArrayLike, logged_N: ArrayLike | None, offsets: ArrayLike) -> FloatArray:
    """Return a wheel's load in the step that ends at each sample of runs laid end to end.

    `run_N` holds until the step after a logged one (`logged_N`, NaN: none): the vehicle is loaded standing.
    """
    edges = np.asarray(offsets, dtype=np.int64)
    carried = np.repeat(floats(run_N), np.diff(edges))
    if logged_N is None:
        return carried
    logged = floats(logged_N)
    last = np.maximum.accumulate(np.where(np.isfinite(logged), np.arange(len(carried)), -1))
    last = np.concatenate(([-1], last))[:-1]
    known = last >= np.repeat(edges[:-1], np.diff(edges))
    carried[known] = logged[last[known]]
    return carried


def radii_under_load(law: RadiusLaw, load_left_N: ArrayLike, load_right_N: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the radii of both wheels for loads of any shape, in m (Fig. 7)."""
    return law.left.radius_m(load_left_N), law.right.radius_m(load_right_N)


def radii_of_model(
    model: OdometryModel, load_left_N: ArrayLike, load_right_N: ArrayLike, *, by_shaft: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Return the radii that a simulator uses for loads of any shape, in m.

    `by_shaft`: counted on the drive shaft, both wheels grow by their mean share.
    """
    above_left_N, above_right_N = (floats(load) - model.reference_load_N for load in (load_left_N, load_right_N))
    left_m = np.asarray(model.radius_left_m + model.slope_left_m_per_N * above_left_N)
    right_m = np.asarray(model.radius_right_m + model.slope_right_m_per_N * above_right_N)
    if not by_shaft:
        return left_m, right_m
    grown = 0.5 * (left_m / model.radius_left_m + right_m / model.radius_right_m)
    return model.radius_left_m * grown, model.radius_right_m * grown


def travel_from_counts(
    counts_left: ArrayLike,
    counts_right: ArrayLike,
    encoder: Encoder,
    radius_left_m: ArrayLike,
    radius_right_m: ArrayLike,
    *,
    offsets: ArrayLike | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return the travel of each wheel in the step that ends at each sample (Eqs 10 and 11), 0 at a run's first.

    `counts_left`, `counts_right`: unwrapped (n,); `offsets`: see `integrate`; radii: one, one a run or one a sample.
    """
    edges = np.asarray([0, len(np.atleast_1d(counts_left))] if offsets is None else offsets, dtype=np.int64)
    lengths = np.diff(edges)

    def travel(counts: FloatArray, per_rev: float, radius_m: FloatArray) -> FloatArray:
        n, steps = len(counts), np.diff(counts, prepend=counts[:1])
        steps[edges[:-1][lengths > 0]] = 0.0
        if radius_m.ndim and len(radius_m) not in {n, len(lengths)}:
            text = f"radii: found {len(radius_m)} values"
            raise BadInputError(f"{text}; expected one, one a run ({len(lengths)}) or one a sample ({n})")
        if radius_m.ndim and len(radius_m) != n:
            radius_m = np.repeat(radius_m, lengths)
        return steps * ((2 * np.pi / per_rev) * radius_m)

    left = travel(floats(counts_left), encoder.counts_per_rev_left, floats(radius_left_m))
    return left, travel(floats(counts_right), encoder.counts_per_rev_right, floats(radius_right_m))


@dataclass(frozen=True, slots=True, eq=False)
class Loading:
    """Wheel loads along a route, each from its distance on."""

    from_m: FloatArray  #: shape (n,): distances along the route, rising from 0
    #: shape (n,): wheel loads
    left_N: FloatArray
    right_N: FloatArray

    @staticmethod
    def from_rows(rows: Sequence[tuple[float, float, float]]) -> "Loading":
        """Return a loading of rows (distance in m, left load in N, right load in N) in any order, one at 0 m."""
        ordered = np.array(sorted(rows), dtype=np.float64).reshape(-1, 3)
        if not len(ordered) or ordered[0, 0] != 0.0 or (np.diff(ordered[:, 0]) <= 0.0).any():
            raise BadInputError(
                f"loads along the path: found changes at {', '.join(f'{at:g}' for at in ordered[:, 0])} m; expected "
                "the first at 0 m and each at a place of its own; give each place once"
            )
        if not np.isfinite(ordered).all() or (ordered[:, 1:] <= 0.0).any():
            text = "found one of 0 N or below, or no number; expected loads above 0 N"
            raise BadInputError(f"loads along the path: {text}")
        return Loading(*ordered.T)

    @property
    def rows(self) -> list[tuple[float, float, float]]:
        """Distance in m, and left and right load in N from there on."""
        return list(zip(self.from_m.tolist(), self.left_N.tolist(), self.right_N.tolist(), strict=True))

    def at(self, distance_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the loads (left, right) of pieces that begin at these distances, of their shape."""
        index = np.maximum(np.searchsorted(self.from_m, distance_m + 1e-9, side="right") - 1, 0)
        return self.left_N[index], self.right_N[index]


def carried_loads_N(vehicle: Vehicle, payload_kg: float, x_m: float, y_m: float) -> tuple[float, float]:
    """Return the wheel loads (left, right) under a payload; refused where it is too much."""
    if payload_kg < 0.0:
        raise BadInputError(f"payload: found {payload_kg:g} kg; expected a mass from 0 kg; correct it")
    front, left_N, right_N = wheel_loads_N(vehicle, payload_kg, x_m, y_m)
    check_wheel_loads(vehicle, front, left_N, right_N, what=f"payload {payload_kg:g} kg at x {x_m:g} m, y {y_m:g} m")
    return float(left_N), float(right_N)


def loading_on_the_way(vehicle: Vehicle, rows: Sequence[tuple[float, ...]]) -> Loading:
    """Return the loads of payloads that change on the way; unladen before the first.

    `rows`: distance in m, mass in kg, place x and y in m.
    """
    if any(row[0] < 0.0 for row in rows):
        raise BadInputError("payload_at: found a distance below 0 m; expected one along the route; correct it")
    if min(row[0] for row in rows) > 0.0:
        rows = [*rows, (0.0, 0.0, 0.0, 0.0)]
    return Loading.from_rows([(row[0], *carried_loads_N(vehicle, *row[1:4])) for row in rows])
