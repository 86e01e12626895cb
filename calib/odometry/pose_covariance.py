"""Covariance of the pose along a path (Eq. 17 as error propagation).

The systematic part comes from what the odometry's parameters are uncertain by: the same error acts all along the path,
so Jacobians by radii, slopes and track are accumulated and only then squared. The random part is a random walk of
distance and heading with the square root of the distance, and the reading of the encoders at both ends.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from calib.odometry.poses import Poses, sinc
from calib.radius.law import JOINT
from calib.types import FloatArray, floats


@dataclass(frozen=True, slots=True, eq=False)
class PathSteps:
    """A path drawn in exact arcs, with what its uncertainty needs; steps stand in the last axis."""

    #: left_m, right_m: shape (..., n): travel of the wheels in each step
    left_m: FloatArray
    right_m: FloatArray
    #: radius_left_m, radius_right_m, track_m: radii and track in each step
    radius_left_m: FloatArray
    radius_right_m: FloatArray
    track_m: FloatArray
    #: dx_m, dy_m: shape (..., n): motion in each step
    dx_m: FloatArray
    dy_m: FloatArray
    by_path: FloatArray  #: shape (2, ..., n): derivatives of dx, dy by the length of the step
    by_turn: FloatArray  #: shape (2, ..., n): derivatives of dx, dy by the turn of the step
    poses: Poses  #: poses after each step, shape (..., n)


def steps(
    travel_left_m: ArrayLike,
    travel_right_m: ArrayLike,
    track_m: ArrayLike,
    *,
    radius_left_m: ArrayLike,
    radius_right_m: ArrayLike,
) -> PathSteps:
    """Return a path in exact arcs with its derivatives, from (0, 0) along x.

    Parameters
    ----------
    travel_left_m, travel_right_m : array_like of float, shape (..., n)
        Travel of the wheels in each step.
    track_m, radius_left_m, radius_right_m : array_like of float
        Track, and the radii the travel was computed with; broadcast to the travel's shape.
    """
    left, right = floats(travel_left_m), floats(travel_right_m)
    track = floats(track_m)
    path, turn = 0.5 * (left + right), (right - left) / track
    theta = np.cumsum(turn, axis=-1)
    half = 0.5 * turn
    ratio, slope = sinc(half), _sinc_slope(half)
    cos, sin = np.cos(theta - half), np.sin(theta - half)
    dx, dy = path * ratio * cos, path * ratio * sin
    bend = 0.5 * path * slope
    return PathSteps(
        left_m=left,
        right_m=right,
        radius_left_m=floats(radius_left_m),
        radius_right_m=floats(radius_right_m),
        track_m=track,
        dx_m=dx,
        dy_m=dy,
        by_path=np.stack([ratio * cos, ratio * sin]),
        by_turn=np.stack([bend * cos - 0.5 * dy, bend * sin + 0.5 * dx]),
        poses=Poses(np.cumsum(dx, axis=-1), np.cumsum(dy, axis=-1), theta),
    )


def jacobian(
    path: PathSteps, *, load_offset_left_N: ArrayLike = 0.0, load_offset_right_N: ArrayLike = 0.0
) -> FloatArray:
    """Return the derivatives of the pose (x, y, theta) after each step by `JOINT`, shape (..., n, 3, 5).

    The load offsets are wheel load less the law's reference load in each step; they broadcast to (..., n).
    """
    turn_left, turn_right = path.left_m / path.radius_left_m, path.right_m / path.radius_right_m
    offset_left, offset_right = floats(load_offset_left_N), floats(load_offset_right_N)
    track = path.track_m
    # by radius and slope of either wheel, and by the track: along the path, and in heading
    parts = [
        (0.5 * turned * times, sign * turned * times / track)
        for sign, turned, offset in ((-1.0, turn_left, offset_left), (1.0, turn_right, offset_right))
        for times in (1.0, offset)
    ]
    parts.append((np.zeros(path.left_m.shape), -(path.right_m - path.left_m) / track**2))
    slopes = np.empty((*path.left_m.shape, 3, len(JOINT)))
    for number, (along, turn) in enumerate(parts):
        heading = np.cumsum(turn, axis=-1)
        before = heading - turn
        slopes[..., 0, number] = np.cumsum(
            path.by_path[0] * along + path.by_turn[0] * turn - path.dy_m * before, axis=-1
        )
        slopes[..., 1, number] = np.cumsum(
            path.by_path[1] * along + path.by_turn[1] * turn + path.dx_m * before, axis=-1
        )
        slopes[..., 2, number] = heading
    return slopes


@dataclass(frozen=True, slots=True)
class RandomWalk:
    """Random part of the pose's error."""

    #: sigma_along_m_per_sqrt_m, sigma_heading_rad_per_sqrt_m: standard deviation of distance and heading after one
    #: metre; they grow with its square root
    sigma_along_m_per_sqrt_m: float = 0.0
    sigma_heading_rad_per_sqrt_m: float = 0.0
    count_std: float = 0.0  #: standard uncertainty of one encoder reading in counts
    #: counts_per_rev_left, counts_per_rev_right: counts a revolution
    counts_per_rev_left: float = field(default=4096.0)
    counts_per_rev_right: float = field(default=4096.0)

    def covariance(self, path: PathSteps) -> FloatArray:
        """Return the covariance of the pose after each step, shape (..., n, 3, 3).

        A heading error in a step moves every later point about that step's centre; with running sums over the steps of
        the noise, of the noise times the centre and times its squares, that is one pass for all later points.
        """
        distance = np.abs(0.5 * (path.left_m + path.right_m))
        along = self.sigma_along_m_per_sqrt_m**2 * distance
        heading = self.sigma_heading_rad_per_sqrt_m**2 * distance
        x, y = path.poses.x_m, path.poses.y_m
        # centre about which the turn of each step carries the later points
        cx, cy = x - path.by_turn[1], y + path.by_turn[0]
        q, qx, qy, qxx, qxy, qyy = (
            np.cumsum(part, axis=-1)
            for part in (heading, heading * cx, heading * cy, heading * cx * cx, heading * cx * cy, heading * cy * cy)
        )
        covariance = np.empty((*path.left_m.shape, 3, 3))
        covariance[..., 0, 0] = y * y * q - 2 * y * qy + qyy + np.cumsum(along * path.by_path[0] ** 2, axis=-1)
        covariance[..., 1, 1] = x * x * q - 2 * x * qx + qxx + np.cumsum(along * path.by_path[1] ** 2, axis=-1)
        covariance[..., 0, 1] = covariance[..., 1, 0] = (
            y * qx + x * qy - x * y * q - qxy + np.cumsum(along * path.by_path[0] * path.by_path[1], axis=-1)
        )
        covariance[..., 0, 2] = covariance[..., 2, 0] = qy - y * q
        covariance[..., 1, 2] = covariance[..., 2, 1] = x * q - qx
        covariance[..., 2, 2] = q
        if self.count_std:
            covariance += self._readings(path)
        return covariance

    def _readings(self, path: PathSteps) -> FloatArray:
        """Return what a reading at the start and one at the end add, shape (..., n, 3, 3)."""
        left = 2 * np.pi * path.radius_left_m / self.counts_per_rev_left * self.count_std
        right = 2 * np.pi * path.radius_right_m / self.counts_per_rev_right * self.count_std
        left, right, track = (np.broadcast_to(part, path.left_m.shape) for part in (left, right, path.track_m))
        theta = path.poses.theta_rad
        start = theta[..., :1] - (path.right_m[..., :1] - path.left_m[..., :1]) / track[..., :1]
        covariance = np.zeros((*path.left_m.shape, 3, 3))
        for size, sign in ((left, -1.0), (right, 1.0)):
            turn = sign * size / track
            # at the end: moves and turns the pose where it stands; at the start: turns all that follows, too
            end = np.stack([0.5 * size * np.cos(theta), 0.5 * size * np.sin(theta), turn], axis=-1)
            first, turned = size[..., :1], turn[..., :1]
            along = 0.5 * first * np.cos(start) - path.poses.y_m * turned
            across = 0.5 * first * np.sin(start) + path.poses.x_m * turned
            begin = np.stack(np.broadcast_arrays(along, across, turned), axis=-1)
            covariance += end[..., :, None] * end[..., None, :] + begin[..., :, None] * begin[..., None, :]
        return covariance


@dataclass(frozen=True, slots=True, eq=False)
class Ellipses:
    """Error ellipses of positions."""

    #: major_m, minor_m: shape (...): semi-axes
    major_m: FloatArray
    minor_m: FloatArray
    angle_rad: FloatArray  #: shape (...): direction of the major axis from the x axis, in (-pi/2, pi/2]
    coverage: float  #: probability that the position lies within, for a normal distribution


def ellipses(covariance: ArrayLike, *, coverage: float = 0.95) -> Ellipses:
    """Return the error ellipses of pose covariances, shape (..., 3, 3) or (..., 2, 2), x and y in m^2 first.

    A coverage of 0.95 is 2.45 standard deviations in two dimensions.
    """
    c = floats(covariance)
    mean, half = 0.5 * (c[..., 0, 0] + c[..., 1, 1]), 0.5 * (c[..., 0, 0] - c[..., 1, 1])
    spread = np.hypot(half, c[..., 0, 1])
    k = np.sqrt(-2.0 * np.log1p(-coverage))
    return Ellipses(
        major_m=np.asarray(k * np.sqrt(np.maximum(mean + spread, 0.0))),
        minor_m=np.asarray(k * np.sqrt(np.maximum(mean - spread, 0.0))),
        angle_rad=np.asarray(0.5 * np.arctan2(c[..., 0, 1], half)),
        coverage=coverage,
    )


def _sinc_slope(u: FloatArray) -> FloatArray:
    """Return the derivative of sin(u) / u; by its series near zero, where the quotient loses its digits."""
    small = np.abs(u) < 0.1
    safe = np.where(small, 1.0, u)
    v = u * u
    series = -u / 3.0 * (1.0 - v / 10.0 * (1.0 - v / 28.0 * (1.0 - v / 54.0 * (1.0 - v / 88.0))))
    return np.where(small, series, (safe * np.cos(safe) - np.sin(safe)) / (safe * safe))
