"""Routes of planned runs: their shapes, and how long and how fast beside what was driven."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.wheels import odometry_source
from calib.errors import BadInputError
from calib.gap.effects.quantities import driven_speed_mps
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict
from calib.odometry.routes import NAMED, Route, Segment, arc, straight

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
#: recorded distances of corridors
CORRIDOR_RANGE_M: Final = (0.1, 500.0)
#: track of the vehicles that routes are made for, from half to twice as much
USUAL_TRACK_M: Final = 0.7
#: least radius of a car's turn over its wheelbase: at a steering angle of 34 degrees
LEAST_RADIUS: Final = 1.5
#: slow over fast at most: else one speed was driven
SLOWER: Final = 0.7
#: of the fastest: slower runs turn on the spot
LEAST_SPEED: Final = 0.25


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


def dimensions_of(driven: Campaign) -> Dimensions:
    """Return what the vehicle of a campaign can drive where it was driven.

    Corridors as long as those driven, else no longer than any run led; other routes in proportion to the track or, up
    to the usual size, to how far any run led; no faster than it was driven.
    """
    path = predict(observations_of(driven, into_windows=False))
    led_m = [np.hypot(*trace[:, :2].T).max() for trace in path.traces()]
    most_m, ratio = float(np.max(led_m, where=path.s.from_log, initial=0.0)), driven.model.track_m / USUAL_TRACK_M
    scale = 1.0 if 0.5 <= ratio <= 2.0 else ratio
    distance_m, corridor = np.abs(driven.runs.number("distance_m")), driven.runs.label("kind") == "corridor"
    known = np.isfinite(distance_m)
    lengths_m = distance_m[known & corridor] if (known & corridor).any() else distance_m[known]
    length_m = float(np.median(lengths_m)) if len(lengths_m) else 0.0
    if not CORRIDOR_RANGE_M[0] <= length_m <= CORRIDOR_RANGE_M[1]:
        length_m = min(DEFAULT_CORRIDOR_M, max(most_m, DEFAULT_CORRIDOR_M * scale))
    speeds = driven_speed_mps(path.s)
    speeds = speeds[speeds > LEAST_SPEED * np.nanmax(speeds, initial=0.0)]
    slow, fast = np.quantile(speeds, (0.1, 0.9)).tolist() if len(speeds) else (0.3 * scale, 0.7 * scale)
    least_m = LEAST_RADIUS * driven.vehicle.wheelbase_m * (odometry_source(driven) == "shaft")
    return Dimensions(
        length_m, scale, most_m, least_m, (float(f"{min(slow, SLOWER * fast):.2g}"), float(f"{fast:.2g}"))
    )


def route_of(kind: str, dimensions: Dimensions | None = None) -> Route:
    """Return the route of a kind, of usual dimensions by default.

    `kind`: ``corridor`` (and its lanes ``corridor_b`` ...), ``corridor_short``, ``square_cw``, ``square_ccw``,
    ``figure8``, ``route_left``, ``route_right``, ``circle_left``, ``circle_right``, or a named route of ``calib
    simulate``.

    Raises
    ------
    BadInputError
        Where there is no such route.
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


def size_of(route: Route) -> str:
    """Return a route's straights and radii of bends in words."""
    pieces = list(zip(np.abs(route.length_m).tolist(), np.abs(route.turn_rad).tolist(), strict=True))
    straights = ", ".join(dict.fromkeys(f"{length:.3g}" for length, turn in pieces if not turn))
    radii = ", ".join(dict.fromkeys(f"{length / turn:.3g}" for length, turn in pieces if turn))
    return f"{straights} m" * bool(straights) + " and " * bool(straights and radii) + f"radius {radii} m" * bool(radii)
