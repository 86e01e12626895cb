"""Poses, their errors along and across a reference, and trajectories in time."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from calib.campaign.readers import read_recording
from calib.campaign.readers.table import NS_PER_S
from calib.campaign.settings import Reference
from calib.errors import BadFileError, BadInputError
from calib.io import write_text
from calib.radius.law import JOINT
from calib.types import WAY_PER_RAD_M, FloatArray, floats

POSE: Final = ("x_m", "y_m", "theta_rad")
#: components of an error: along and left of the path, of the heading, and in the global frame
COMPONENTS: Final = ("along_m", "lateral_m", "heading_rad", "global_x_m", "global_y_m")


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Poses of the middle of the rear axle."""

    x_m: FloatArray
    y_m: FloatArray
    theta_rad: FloatArray  #: heading, counter-clockwise from the x axis, not wrapped

    def __len__(self) -> int:
        return len(self.x_m)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of each array."""
        return self.x_m.shape

    def __getitem__(self, index: Any) -> "Poses":
        return Poses(np.asarray(self.x_m[index]), np.asarray(self.y_m[index]), np.asarray(self.theta_rad[index]))

    def stacked(self) -> FloatArray:
        """Return x, y, theta in the last axis, shape (..., 3)."""
        return np.stack([self.x_m, self.y_m, self.theta_rad], axis=-1)

    @staticmethod
    def from_stacked(stacked: ArrayLike) -> "Poses":
        """Return the poses of an array whose last axis holds x, y, theta."""
        values = floats(stacked)
        return Poses(values[..., 0], values[..., 1], values[..., 2])

    def from_origin(self) -> "Poses":
        """Return the poses with (0, 0, 0) before the first in the last axis."""
        parts = (self.x_m, self.y_m, self.theta_rad)
        return Poses(*(np.concatenate((np.zeros_like(part[..., :1]), part), axis=-1) for part in parts))


@dataclass(frozen=True, slots=True, eq=False)
class PoseErrors:
    """True minus reference, along the reference path and in the global frame."""

    #: ``e_x`` along the reference heading and ``e_y`` to its left
    along_m: FloatArray
    lateral_m: FloatArray
    heading_rad: FloatArray  #: ``e_theta``, in (-pi, pi]
    #: the same displacement in the frame of the route
    global_x_m: FloatArray
    global_y_m: FloatArray

    @property
    def distance_m(self) -> FloatArray:
        """Distance between the true and the reference position."""
        return np.asarray(np.hypot(self.global_x_m, self.global_y_m))


def sinc(u: ArrayLike) -> FloatArray:
    """Return sin(u) / u, 1 at 0; any shape, u in rad: the ratio of chord to arc for a turn of 2 u."""
    return np.asarray(np.sinc(floats(u) / np.pi))


def wrapped(angle_rad: ArrayLike) -> FloatArray:
    """Return angles in (-pi, pi], same shape."""
    angle = floats(angle_rad)
    return np.asarray(angle - 2 * np.pi * np.ceil((angle - np.pi) / (2 * np.pi)))


def pose_errors(true: Poses, reference: Poses) -> PoseErrors:
    """Return true minus reference, pose by pose; shapes broadcast."""
    dx, dy = true.x_m - reference.x_m, true.y_m - reference.y_m
    cosine, sine = np.cos(reference.theta_rad), np.sin(reference.theta_rad)
    along, lateral = np.asarray(cosine * dx + sine * dy), np.asarray(cosine * dy - sine * dx)
    return PoseErrors(along, lateral, wrapped(true.theta_rad - reference.theta_rad), np.asarray(dx), np.asarray(dy))


def poses_of_vehicle(sensor: FloatArray, reference: Reference, *, in_map: bool) -> FloatArray:
    """Turn poses of the sensor (n, 3) into poses of the vehicle.

    Outside a map they are motions since the start, V = X S X^-1 with the sensor's place X on the vehicle. Without a
    heading a position is of use on the axle only.
    """
    place, yaw = complex(reference.sensor_x_m, reference.sensor_y_m), reference.sensor_yaw_rad
    if place == 0.0 and yaw == 0.0:
        return sensor
    at, heading = sensor[:, 0] + 1j * sensor[:, 1], sensor[:, 2] - yaw
    if not in_map:
        at, heading = place + np.exp(1j * yaw) * at, sensor[:, 2]
    if place != 0.0:
        at = at - np.exp(1j * heading) * place
    return np.stack([at.real, at.imag, heading], axis=1)


def write_tum(path: Path, t_s: ArrayLike, poses: Poses, *, force: bool = False) -> Path:
    """Write poses at times in s, each (n,), with every digit."""
    times = floats(t_s)
    if times.shape != poses.shape or times.ndim != 1:
        raise BadInputError(f"trajectory: found {times.shape} times for {poses.shape} poses; expected one a pose")
    half = 0.5 * poses.theta_rad
    columns = np.stack([times, poses.x_m, poses.y_m, np.sin(half), np.cos(half)], axis=1)
    if not np.isfinite(columns).all():
        raise BadInputError("trajectory: found a pose or time that is not finite; expected numbers; leave it out")
    lines = [f"{t!r} {x!r} {y!r} 0 0 0 {qz!r} {qw!r}" for t, x, y, qz, qw in columns.tolist()]
    return write_text(path, "\n".join(["# t_s x_m y_m z_m qx qy qz qw", *lines]) + "\n", force=force)


def read_tum(path: Path) -> tuple[FloatArray, Poses]:
    """Return times in s, to a nanosecond, and poses of a trajectory, each (n,); headings unwrapped."""
    (stream,) = read_recording(path, str(path)).streams
    x_m, y_m, yaw_rad = (stream.columns[name] for name in ("x", "y", "yaw"))
    if (lost := np.isnan(yaw_rad)).any():
        actual = f"a quaternion of zeros in pose {int(lost.argmax()) + 1}"
        raise BadFileError(path, actual, "a rotation", "correct the line")
    return np.asarray(stream.time_ns) / NS_PER_S, Poses(x_m, y_m, yaw_rad)


@dataclass(frozen=True, slots=True, eq=False)
class PathSteps:
    """A path in exact arcs, with what its uncertainty needs."""

    #: shape (..., n): travel of the wheels in each step
    left_m: FloatArray
    right_m: FloatArray
    radius_left_m: FloatArray
    radius_right_m: FloatArray
    track_m: FloatArray
    #: shape (2, ..., n): derivatives of each step's motion by length, turn, and heading before it
    by_path: FloatArray
    by_turn: FloatArray
    by_heading: FloatArray
    poses: Poses  #: poses after each step, shape (..., n)


def steps(
    travel_left_m: ArrayLike,
    travel_right_m: ArrayLike,
    track_m: ArrayLike,
    *,
    radius_left_m: ArrayLike,
    radius_right_m: ArrayLike,
) -> PathSteps:
    """Return a path in exact arcs with its derivatives, from (0, 0) along x; see `PathSteps`.

    Travel has shape (..., n), to which its track and radii broadcast.
    """
    left, right, track = floats(travel_left_m), floats(travel_right_m), floats(track_m)
    path, turn = 0.5 * (left + right), (right - left) / track
    theta = np.cumsum(turn, axis=-1)
    half = 0.5 * turn
    ratio, slope = sinc(half), _sinc_slope(half)
    ahead = np.stack([np.cos(theta - half), np.sin(theta - half)])
    dx, dy = path * ratio * ahead
    by_heading = np.stack([-dy, dx])
    by_turn = 0.5 * path * slope * ahead + 0.5 * by_heading
    poses = Poses(np.cumsum(dx, axis=-1), np.cumsum(dy, axis=-1), theta)
    radii = floats(radius_left_m), floats(radius_right_m)
    return PathSteps(left, right, *radii, track, ratio * ahead, by_turn, by_heading, poses)


def jacobian(
    path: PathSteps, *, load_offset_left_N: ArrayLike = 0.0, load_offset_right_N: ArrayLike = 0.0
) -> FloatArray:
    """Return the derivatives of the pose (x, y, theta) after each step by `JOINT`, shape (..., n, 3, 5).

    The load offsets, above the reference load, broadcast to (..., n).
    """
    wheels = (
        (-1.0, path.left_m / path.radius_left_m, floats(load_offset_left_N)),
        (1.0, path.right_m / path.radius_right_m, floats(load_offset_right_N)),
    )
    parts = [
        (0.5 * turned * times, sign * turned * times / path.track_m)
        for sign, turned, offset in wheels
        for times in (1.0, offset)
    ]
    parts.append((np.zeros(path.left_m.shape), -(path.right_m - path.left_m) / path.track_m**2))
    slopes = np.empty((*path.left_m.shape, 3, len(JOINT)))
    for number, (along, turn) in enumerate(parts):
        heading = np.cumsum(turn, axis=-1)
        moved = path.by_path * along + path.by_turn * turn + path.by_heading * (heading - turn)
        slopes[..., :2, number] = np.moveaxis(np.cumsum(moved, axis=-1), 0, -1)
        slopes[..., 2, number] = heading
    return slopes


@dataclass(frozen=True, slots=True)
class RandomWalk:
    """Random part of the pose's error."""

    #: standard deviation of distance and heading after one metre, with turns by `WAY_PER_RAD_M`; they grow with its
    #: root
    sigma_along_m_per_sqrt_m: float = 0.0
    sigma_heading_rad_per_sqrt_m: float = 0.0
    count_std: float = 0.0  #: standard uncertainty of one encoder reading in counts
    counts_per_rev_left: float = 4096.0
    counts_per_rev_right: float = 4096.0

    def covariance(self, path: PathSteps) -> FloatArray:
        """Return the covariance of the pose after each step, shape (..., n, 3, 3).

        A heading error in a step turns every later point about that step's centre.
        """
        turn = (path.right_m - path.left_m) / path.track_m
        distance = np.abs(0.5 * (path.left_m + path.right_m)) + WAY_PER_RAD_M * np.abs(turn)
        x, y = path.poses.x_m, path.poses.y_m
        centre = np.stack([y + path.by_turn[0], path.by_turn[1] - x, np.ones_like(x)])
        to_end = np.zeros((*x.shape, 3, 3)) + np.eye(3)
        to_end[..., 0, 2], to_end[..., 1, 2] = -y, x
        of_heading = _running(self.sigma_heading_rad_per_sqrt_m**2 * distance, centre)
        covariance = to_end @ of_heading @ np.swapaxes(to_end, -1, -2)
        covariance[..., :2, :2] += _running(self.sigma_along_m_per_sqrt_m**2 * distance, path.by_path)
        return covariance + self._readings(path) if self.count_std else covariance

    def _readings(self, path: PathSteps) -> FloatArray:
        left_m = 2 * np.pi * path.radius_left_m / self.counts_per_rev_left * self.count_std
        right_m = 2 * np.pi * path.radius_right_m / self.counts_per_rev_right * self.count_std
        left, right, track, _ = np.broadcast_arrays(left_m, right_m, path.track_m, path.left_m)
        theta = path.poses.theta_rad
        start = theta[..., :1] - (path.right_m[..., :1] - path.left_m[..., :1]) / track[..., :1]
        covariance = np.zeros((*path.left_m.shape, 3, 3))
        for size, sign in ((left, -1.0), (right, 1.0)):
            turn = sign * size / track
            end = np.stack([0.5 * size * np.cos(theta), 0.5 * size * np.sin(theta), turn], axis=-1)
            first, turned = size[..., :1], turn[..., :1]
            along = 0.5 * first * np.cos(start) - path.poses.y_m * turned
            across = 0.5 * first * np.sin(start) + path.poses.x_m * turned
            begin = np.stack(np.broadcast_arrays(along, across, turned), axis=-1)
            covariance += end[..., :, None] * end[..., None, :] + begin[..., :, None] * begin[..., None, :]
        return covariance


def _running(variance: FloatArray, direction: FloatArray) -> FloatArray:
    return np.moveaxis(np.cumsum(variance * direction[:, None] * direction, axis=-1), (0, 1), (-2, -1))


def ellipses(covariance: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the ellipses that hold 95 % of positions: major and minor semi-axis in m, direction in rad, each (...).

    The direction is the major axis', in (-pi/2, pi/2]. `covariance`: shape (..., 3, 3) or (..., 2, 2), x and y first.
    """
    c = floats(covariance)
    mean, half = 0.5 * (c[..., 0, 0] + c[..., 1, 1]), 0.5 * (c[..., 0, 0] - c[..., 1, 1])
    spread = np.hypot(half, c[..., 0, 1])
    # 2.45 standard deviations in two dimensions
    k = np.sqrt(-2.0 * np.log1p(-0.95))
    major, minor = (np.asarray(k * np.sqrt(np.maximum(square, 0.0))) for square in (mean + spread, mean - spread))
    return major, minor, np.asarray(0.5 * np.arctan2(c[..., 0, 1], half))


def _sinc_slope(u: FloatArray) -> FloatArray:
    small = np.abs(u) < 0.1
    safe = np.where(small, 1.0, u)
    v = u * u
    series = -u / 3.0 * (1.0 - v / 10.0 * (1.0 - v / 28.0 * (1.0 - v / 54.0 * (1.0 - v / 88.0))))
    return np.where(small, series, (safe * np.cos(safe) - np.sin(safe)) / (safe * safe))
