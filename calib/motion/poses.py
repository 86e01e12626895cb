"""Poses along paths, and how far one pose is from another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray

#: what a pose is made of
POSE: Final = ("x_m", "y_m", "theta_rad")
#: components of an error: along and left of the path, of the heading, and in the global frame
COMPONENTS: Final = ("along_m", "lateral_m", "heading_rad", "global_x_m", "global_y_m")


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Poses of the middle of the rear axle."""

    #: x_m, y_m: position
    x_m: FloatArray
    y_m: FloatArray
    theta_rad: FloatArray  #: heading, counter-clockwise from the x axis, not wrapped

    def __len__(self) -> int:
        return len(self.x_m)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of each array."""
        return self.x_m.shape

    def __getitem__(self, index: Any) -> Poses:
        """Return the poses that a numpy index picks."""
        return Poses(np.asarray(self.x_m[index]), np.asarray(self.y_m[index]), np.asarray(self.theta_rad[index]))

    def stacked(self) -> FloatArray:
        """Return x, y, theta in the last axis, shape (..., 3)."""
        return np.stack([self.x_m, self.y_m, self.theta_rad], axis=-1)

    @staticmethod
    def from_stacked(stacked: npt.ArrayLike) -> Poses:
        """Return the poses of an array whose last axis holds x, y, theta."""
        values = np.asarray(stacked, dtype=np.float64)
        return Poses(values[..., 0], values[..., 1], values[..., 2])

    def moved(self, by: Poses) -> Poses:
        """Return the poses seen as relative to `by`, expressed in the frame in which `by` stands (``by`` o self)."""
        cosine, sine = np.cos(by.theta_rad), np.sin(by.theta_rad)
        return Poses(
            by.x_m + cosine * self.x_m - sine * self.y_m,
            by.y_m + sine * self.x_m + cosine * self.y_m,
            by.theta_rad + self.theta_rad,
        )


@dataclass(frozen=True, slots=True, eq=False)
class PoseErrors:
    """True minus reference, along the reference path and in the global frame."""

    #: along_m, lateral_m: ``e_x`` along the reference heading and ``e_y`` to its left
    along_m: FloatArray
    lateral_m: FloatArray
    heading_rad: FloatArray  #: ``e_theta``, in (-pi, pi]
    #: global_x_m, global_y_m: the same displacement in the frame of the route
    global_x_m: FloatArray
    global_y_m: FloatArray

    @property
    def distance_m(self) -> FloatArray:
        """Distance between the true and the reference position."""
        return np.asarray(np.hypot(self.global_x_m, self.global_y_m))


def wrapped(angle_rad: npt.ArrayLike) -> FloatArray:
    """Return angles in (-pi, pi], same shape."""
    angle = np.asarray(angle_rad, dtype=np.float64)
    return np.asarray(angle - 2 * np.pi * np.ceil((angle - np.pi) / (2 * np.pi)))


def pose_errors(true: Poses, reference: Poses) -> PoseErrors:
    """Return true minus reference, pose by pose; shapes broadcast."""
    dx, dy = true.x_m - reference.x_m, true.y_m - reference.y_m
    cosine, sine = np.cos(reference.theta_rad), np.sin(reference.theta_rad)
    return PoseErrors(
        along_m=np.asarray(cosine * dx + sine * dy),
        lateral_m=np.asarray(cosine * dy - sine * dx),
        heading_rad=wrapped(true.theta_rad - reference.theta_rad),
        global_x_m=np.asarray(dx),
        global_y_m=np.asarray(dy),
    )
