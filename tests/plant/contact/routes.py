"""Routes as arrays along their length, and the speed that is allowed on them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calib.errors import BadInputError
from calib.types import FloatArray

__all__ = ["KINDS", "Route", "route", "speed_profile"]


_SPACING_M = 0.01
#: kinds that `route` knows
KINDS = ("corridor", "square_ccw", "square_cw", "route_left", "route_right")


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """A route sampled along its length, in the frame of its start.

    Parameters
    ----------
    s_m, x_m, y_m, theta_rad, curvature_per_m : array of float, shape (n,)
        Length, position, heading and curvature, from 0 to the end in equal steps.
    """

    s_m: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    theta_rad: FloatArray
    curvature_per_m: FloatArray


def _of_pieces(pieces: list[tuple[float, float]]) -> Route:
    """Return the route of pieces (length, curvature), each a straight line or an arc."""
    lengths = np.array([length for length, _ in pieces])
    bends = np.array([bend for _, bend in pieces])
    ends = np.cumsum(lengths)
    s = np.linspace(0.0, ends[-1], round(ends[-1] / _SPACING_M) + 1)
    piece = np.minimum(np.searchsorted(ends, s, side="right"), len(pieces) - 1)
    starts = ends - lengths
    theta = np.concatenate(([0.0], np.cumsum(bends * lengths)))[piece] + bends[piece] * (s - starts[piece])
    step = np.diff(s)
    middle = 0.5 * (theta[1:] + theta[:-1])
    # A centimetre of arc is shorter than its chord by under 1e-6 of itself: far inside what a follower resolves.
    x = np.concatenate(([0.0], np.cumsum(step * np.cos(middle))))
    y = np.concatenate(([0.0], np.cumsum(step * np.sin(middle))))
    return Route(s_m=s, x_m=x, y_m=y, theta_rad=theta, curvature_per_m=bends[piece])


def route(kind: str, *, length_m: float = 12.0, side_m: float = 3.0, turn_radius_m: float = 1.0) -> Route:
    """Return the route called `kind`.

    Parameters
    ----------
    kind : str
        One of `KINDS`: a straight corridor, a square of rounded corners either way round, or 5 m straight, a quarter
        turn of 3 m radius and 5 m straight.
    length_m : float
        Of the corridor.
    side_m, turn_radius_m : float
        Straight part of a side of the square, and radius of its corners.

    Raises
    ------
    BadInputError
        Where the kind is unknown.
    """
    if kind == "corridor":
        return _of_pieces([(length_m, 0.0)])
    quarter = math.pi / 2
    if kind in {"square_ccw", "square_cw"}:
        sign = 1.0 if kind == "square_ccw" else -1.0
        return _of_pieces([(side_m, 0.0), (quarter * turn_radius_m, sign / turn_radius_m)] * 4)
    if kind in {"route_left", "route_right"}:
        sign = 1.0 if kind == "route_left" else -1.0
        return _of_pieces([(5.0, 0.0), (quarter * 3.0, sign / 3.0), (5.0, 0.0)])
    raise BadInputError(f"contact plant: found the route {kind!r}; expected one of {', '.join(KINDS)}; choose one")


def speed_profile(path: Route, *, speed_mps: float, curve_speed_mps: float, acceleration_mps2: float) -> FloatArray:
    """Return the highest speed at each point of `path` that keeps to the limits, shape (n,), in m/s.

    Parameters
    ----------
    path : Route
        The route.
    speed_mps, curve_speed_mps : float
        Limits on straights and in curves.
    acceleration_mps2 : float
        Of speeding up and of slowing down; the profile starts and ends at rest.
    """
    limit = np.where(path.curvature_per_m == 0.0, speed_mps, min(curve_speed_mps, speed_mps))
    # v^2 may grow by 2 a along the path, both ways: the tightest cone under the limits.
    rise = 2.0 * acceleration_mps2 * path.s_m
    square = limit**2
    square[0] = square[-1] = 0.0
    ahead = np.minimum.accumulate(square - rise) + rise
    back = (np.minimum.accumulate((square + rise)[::-1]))[::-1] - rise
    return np.asarray(np.sqrt(np.maximum(np.minimum(ahead, back), 0.0)))
