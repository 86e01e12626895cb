"""A vehicle that follows a route closed on its own odometry: the radii and track it believes are not the real ones.

Where the controller keeps the believed pose on the route, each wheel turns by what the believed radius asks for, and
the real radius says how far it rolls. On a straight or an arc both ratios are constant, so the real path is an arc too
and is known exactly; nothing has to be stepped through in time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray
from calib.errors import BadInputError
from calib.motion.odometry.arc import shorten
from calib.motion.odometry.integrate import integrate
from calib.motion.poses import Poses
from calib.motion.routes import Route

#: vehicles a block: the arrays in use stay in the second-level cache
BLOCK: Final = 16384
#: radii, their ratios and tracks that a vehicle can have
SHORTEST_M: Final = 1e-4
LONGEST_M: Final = 1e4


@dataclass(frozen=True, slots=True, eq=False)
class Axle:
    """Rear wheels as somebody believes them to be, or as they are."""

    #: radius_left_m, radius_right_m, track_m: shape () or (vehicles,): effective radii and the distance of the contact
    #: points; shapes that broadcast
    radius_left_m: npt.ArrayLike
    radius_right_m: npt.ArrayLike
    track_m: npt.ArrayLike

    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return left radius, right radius and track, each () or (vehicles,), checked to be lengths of a vehicle."""
        parts = tuple(
            np.asarray(part, dtype=np.float64) for part in (self.radius_left_m, self.radius_right_m, self.track_m)
        )
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
    parts = np.broadcast_arrays(
        ratio_left * (route.length_m - half),
        ratio_right * (route.length_m + half),
        np.atleast_1d(real_track)[:, None],
    )
    return parts[0], parts[1], parts[2][:, :1]


def follow(route: Route, believed: Axle, real: Axle) -> Poses:
    """Return the real poses at the start and at the end of each segment, shape (vehicles, n_segments + 1).

    The believed pose follows the route; divide the route for more poses.
    """
    left, right, track = wheel_travel(route, believed, real)
    driven = integrate(left, right, track)
    zero = np.zeros((len(left), 1))
    return Poses(*(np.concatenate((zero, part), axis=1) for part in (driven.x_m, driven.y_m, driven.theta_rad)))


def end_of_route(route: Route, believed: Axle, real: Axle) -> Poses:
    """Return the real end poses alone, shape (vehicles,): `follow` for many thousands of vehicles at once."""
    left, right, track = believed.arrays()
    real_left, real_right, real_track = real.arrays()
    ratio_left, ratio_right, track, inverse = (
        np.atleast_1d(part)
        for part in (real_left / left, real_right / right, np.asarray(track), np.asarray(1.0 / real_track))
    )
    n = max(len(part) for part in (ratio_left, ratio_right, track, inverse))
    try:
        end = np.zeros((3, *np.broadcast_shapes((n,), *(p.shape for p in (ratio_left, ratio_right, track, inverse)))))
    except ValueError as error:
        raise BadInputError(f"axles: found arrays of unlike lengths; expected one value or {n}") from error
    store = np.empty((4, min(BLOCK, n)))
    for first in range(0, n, BLOCK):
        part = slice(first, first + BLOCK)
        block = tuple(a[part] if len(a) > 1 else a for a in (ratio_left, ratio_right, track, inverse))
        _drive(route, block, end[:, part], store)
    return Poses(end[0], end[1], end[2])


def _drive(route: Route, block: tuple[FloatArray, ...], end: FloatArray, store: FloatArray) -> None:
    """Drive a block of vehicles over the route, segment by segment; `end` (3, vehicles) is moved along."""
    ratio_left, ratio_right, track, inverse = block
    x, y, theta = end
    turn, path, work, tangent = (row[: len(x)] for row in store)
    common = float(track[0]) if len(track) == 1 else None
    for length, bend in zip(route.length_m.tolist(), route.turn_rad.tolist(), strict=True):
        half = 0.5 * bend * (track if common is None else common)
        np.multiply(ratio_left, length - half, out=work)
        np.multiply(ratio_right, length + half, out=path)
        np.subtract(path, work, out=turn)
        turn *= inverse
        path += work
        shorten(path, turn, work, tangent)
        # the tangent of half the heading in the segment's middle gives sine and cosine
        turn *= 0.5
        theta += turn
        np.multiply(theta, 0.5, out=tangent)
        theta += turn
        np.tan(tangent, out=tangent)
        np.multiply(tangent, tangent, out=work)
        work += 1.0
        np.divide(path, work, out=work)
        work *= 2.0
        tangent *= work
        y += tangent
        work -= path
        x += work
