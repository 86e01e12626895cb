"""The studies of the paper's Section 7: a vehicle that follows a route on its own odometry with wrong radii."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from calib.errors import SIMULATED_POSES, BadInputError, refuse_more
from calib.odometry.integrate import end_poses, integrate
from calib.odometry.poses import COMPONENTS, POSE, PoseErrors, Poses, pose_errors, rows_of
from calib.odometry.routes import Route, find_route
from calib.types import FloatArray, floats

#: pieces of routes driven at once: keeps memory small where many vehicles drive long routes
BLOCK: Final = 131_072
#: radii, their ratios and tracks that a vehicle can have
SHORTEST_M: Final = 1e-4
LONGEST_M: Final = 1e4


@dataclass(frozen=True, slots=True, eq=False)
class Axle:
    """Rear wheels as somebody believes them to be, or as they are."""

    #: radius_left_m, radius_right_m, track_m: shape () or (vehicles,): effective radii and the distance of the contact
    #: points; shapes that broadcast
    radius_left_m: ArrayLike
    radius_right_m: ArrayLike
    track_m: ArrayLike

    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return left radius, right radius and track, each () or (vehicles,), checked to be lengths of a vehicle."""
        parts = tuple(floats(part) for part in (self.radius_left_m, self.radius_right_m, self.track_m))
        for name, part in zip(("left radius", "right radius", "track"), parts, strict=True):
            impossible = ~((part >= SHORTEST_M) & (part <= LONGEST_M))
            if part.ndim > 1 or impossible.any():
                found = f"{part.shape} of them" if part.ndim > 1 else f"{np.atleast_1d(part[impossible])[0]:g} m"
                expected = f"lengths from {SHORTEST_M:g} to {LONGEST_M:g} m, one a vehicle"
                raise BadInputError(f"{name}: found {found}; expected {expected}")
        return parts[0], parts[1], parts[2]


def wheel_travel(route: Route, believed: Axle, real: Axle) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what the real wheels travel in each segment, each (vehicles, n_segments), and the track (vehicles, 1)."""
    left, right, track = believed.arrays()
    real_left, real_right, real_track = real.arrays()
    ratio_left, ratio_right = np.atleast_1d(real_left / left)[:, None], np.atleast_1d(real_right / right)[:, None]
    half = 0.5 * np.atleast_1d(track)[:, None] * route.turn_rad
    travel = ratio_left * (route.length_m - half), ratio_right * (route.length_m + half)
    parts = np.broadcast_arrays(*travel, np.atleast_1d(real_track)[:, None])
    return parts[0], parts[1], parts[2][:, :1]


def follow(route: Route, believed: Axle, real: Axle) -> Poses:
    """Return the real poses at the start and at the end of each segment, shape (vehicles, n_segments + 1).

    The believed pose follows the route; divide the route for more poses.
    """
    return integrate(*wheel_travel(route, believed, real)).from_origin()


def end_of_route(route: Route, believed: Axle, real: Axle) -> Poses:
    """Return the real end poses alone, shape (vehicles,): `follow` for many thousands of vehicles at once."""
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


#: spacing of the points that figures and trajectories show
SPACING_M: Final = 0.05

#: which wheel is off -> (left, right) radius over the believed one, for E_r = right / left (Eq. 15)
WHICH: Final = ("right", "left", "both", "equal")


@dataclass(frozen=True, slots=True)
class Study:
    """A study by name."""

    title: str
    routes: tuple[str, ...]
    ratios: tuple[float, ...]
    which: tuple[str, ...]  #: which wheels are off, of `WHICH`
    figures: tuple[str, ...]  #: figures of the paper that it corresponds to, one a route


STUDIES: Final[Mapping[str, Study]] = {
    "symmetric": Study(
        "Both wheels roll at E times the radius that the odometry believes",
        ("paper_route",),
        (0.98, 0.98825, 0.98971, 0.99, 1.0),
        ("equal",),
        ("fig12",),
    ),
    "asymmetric": Study(
        "The radii differ by E_r = r_R / r_L, and the odometry believes that they do not",
        ("straight15", "paper_route"),
        (0.99, 0.995, 1.0, 1.005, 1.01),
        ("right", "left", "both"),
        ("fig13", "fig14"),
    ),
    "corrected": Study(
        "The radii follow the load; only the 95 % band of the regression",
        ("paper_route",),
        (0.9994, 0.9997, 1.0, 1.0003, 1.0006),
        ("right", "left", "both"),
        ("fig16",),
    ),
}


def ratios(which: str, ratio: float) -> tuple[float, float]:
    """Return the left and right radius over the believed one, where E_r = r_R / r_L is `ratio`.

    ``both`` shares it about the mean; ``equal`` scales both wheels alike by it.
    """
    if not (math.isfinite(ratio) and ratio > 0.0):
        raise BadInputError(f"ratio of radii: found {ratio!r}; expected a number above 0, near 1")
    if which == "right":
        return 1.0, ratio
    if which == "left":
        return 1.0 / ratio, 1.0
    if which == "both":
        return 2.0 / (1.0 + ratio), 2.0 * ratio / (1.0 + ratio)
    if which == "equal":
        return ratio, ratio
    raise BadInputError(f"which wheel: found {which!r}; expected one of {', '.join(WHICH)}; choose one of them")


@dataclass(frozen=True, slots=True)
class Case:
    """One vehicle of a sweep: which wheel is off, by how much, and the radii over the believed one."""

    which: str
    ratio: float
    left: float
    right: float

    @property
    def label(self) -> str:
        """Short name for tables and legends."""
        if self.which == "given":
            return f"given radii, E_r = {self.ratio:.6g}"
        if self.which == "equal":
            return f"both alike, E = {self.ratio:g}"
        return f"{self.which} off, E_r = {self.ratio:g}"

    @staticmethod
    def off(which: str, ratio: float) -> Case:
        """Return the case of a wheel that is off by a ratio; see `ratios`."""
        return Case(which, ratio, *ratios(which, ratio))

    @staticmethod
    def given(left: float, right: float) -> Case:
        """Return the case of radii (left, right) over the believed ones."""
        return Case("given", right / left, left, right)


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Vehicles with different radii on one route."""

    route: Route  #: the route, undivided
    track_m: float
    cases: tuple[Case, ...]
    distance_m: FloatArray  #: shape (n_points,): distance along the route at each point
    reference: Poses  #: route at the points, shape (n_points,)
    poses: Poses  #: real poses, shape (n_cases, n_points)
    errors: PoseErrors  #: real minus route, shape (n_cases, n_points)
    corners: Poses  #: real poses at the ends of the undivided segments, shape (n_cases, n_segments + 1)

    def ends(self) -> list[dict[str, str | float]]:
        """Return the numbers at the end of the route, one row a case."""
        columns = {"first_segment_m": np.hypot(self.corners.x_m[:, 1], self.corners.y_m[:, 1])}
        columns |= {f"end_{name}": getattr(self.poses, name)[:, -1] for name in POSE}
        columns |= {f"error_{name}": getattr(self.errors, name)[:, -1] for name in (*COMPONENTS, "distance_m")}
        rows = zip(self.cases, rows_of(columns), strict=True)
        return [{"case": case.label, "which": case.which, "ratio": case.ratio, **row} for case, row in rows]

    def along(self) -> list[dict[str, str | float]]:
        """Return poses and errors along the route, one row a case and point."""
        rows: list[dict[str, str | float]] = []
        for number, case in enumerate(self.cases):
            columns = {"distance_m": self.distance_m} | {name: getattr(self.poses, name)[number] for name in POSE}
            columns |= {f"error_{name}": getattr(self.errors, name)[number] for name in COMPONENTS}
            rows += [{"which": case.which, "ratio": case.ratio, **row} for row in rows_of(columns)]
        return rows

    def largest_m(self) -> float:
        """Return the largest error in global x at the end of the route, by absolute value."""
        return float(np.abs(self.errors.global_x_m[:, -1]).max())


def run_sweep(
    route: Route | str, cases: Sequence[Case], *, track_m: float = 0.7, real_track_m: float | None = None
) -> Sweep:
    """Drive vehicles with different radii over a route (or one of that name); the real track is `track_m` by default.

    Only the ratios of real to believed radii matter.
    """
    way = find_route(route) if isinstance(route, str) else route
    vehicles = tuple(cases)
    believed = Axle(1.0, 1.0, track_m)
    left, right = np.array([case.left for case in vehicles]), np.array([case.right for case in vehicles])
    real = Axle(left, right, track_m if real_track_m is None else real_track_m)
    fine = way.divided(SPACING_M)
    what = f"poses of {len(vehicles)} vehicles along {way.name}"
    refuse_more(what, len(vehicles) * (len(fine) + 1), SIMULATED_POSES, "simulate fewer vehicles, or a shorter route")
    reference, poses = fine.poses(), follow(fine, believed, real)
    return Sweep(
        route=way,
        track_m=track_m,
        cases=vehicles,
        distance_m=fine.distance_m(),
        reference=reference,
        poses=poses,
        errors=pose_errors(poses, reference),
        corners=follow(way, believed, real),
    )


#: end error along the route without and with the load correction, as the paper prints them (Sect. 7.3)
PAPER_BEFORE_M: Final = 1.1
PAPER_AFTER_M: Final = 0.06

#: the vehicle's track as the paper states it
PAPER_TRACK_M: Final = 0.7


@dataclass(frozen=True, slots=True)
class Improvement:
    """End errors without and with a correction, and their ratio; None where the corrected error is zero."""

    before_m: float
    after_m: float
    ratio: float | None


@dataclass(frozen=True, slots=True)
class Headline:
    """End error without and with the correction, each the largest case of its sweep, and their ratio."""

    which: str  #: wheel that is off
    #: without_m, corrected_m: largest global e_x by absolute value
    without_m: float
    corrected_m: float
    ratio: float  #: how many times smaller the corrected one is


def headlines(route: Route, track_m: float) -> tuple[Headline, ...]:
    """Set the study of corrected radii against that of uncorrected ones, on the same route, wheel by wheel."""
    before, after = STUDIES["asymmetric"], STUDIES["corrected"]
    lines = []
    for which in before.which:
        first, second = (
            run_sweep(route, [Case.off(which, ratio) for ratio in study.ratios], track_m=track_m).largest_m()
            for study in (before, after)
        )
        lines.append(Headline(which, first, second, first / second))
    return tuple(lines)


@cache
def paper_headline() -> Improvement:
    """Return the paper's end errors as printed, and their ratio before rounding."""
    largest = max(headlines(find_route("paper_route"), PAPER_TRACK_M), key=lambda line: line.without_m)
    return Improvement(PAPER_BEFORE_M, PAPER_AFTER_M, largest.ratio)
