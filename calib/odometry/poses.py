"""Poses, their errors along and across a reference, and trajectories in time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from calib.errors import BadFileError, BadInputError
from calib.io import write_text
from calib.types import FloatArray, floats

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
    def from_stacked(stacked: ArrayLike) -> Poses:
        """Return the poses of an array whose last axis holds x, y, theta."""
        values = floats(stacked)
        return Poses(values[..., 0], values[..., 1], values[..., 2])

    def from_origin(self) -> Poses:
        """Return the poses with (0, 0, 0) before the first in the last axis."""
        parts = (self.x_m, self.y_m, self.theta_rad)
        return Poses(*(np.concatenate((np.zeros_like(part[..., :1]), part), axis=-1) for part in parts))

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
    return PoseErrors(
        along_m=np.asarray(cosine * dx + sine * dy),
        lateral_m=np.asarray(cosine * dy - sine * dx),
        heading_rad=wrapped(true.theta_rad - reference.theta_rad),
        global_x_m=np.asarray(dx),
        global_y_m=np.asarray(dy),
    )


def rows_of(columns: Mapping[str, FloatArray]) -> list[dict[str, float]]:
    """Return the rows of columns of equal length (n,), each a mapping by name."""
    return [dict(zip(columns, row, strict=True)) for row in np.stack(list(columns.values()), axis=1).tolist()]


FILE_LIMIT_BYTES = 2 << 30


def write_tum(path: Path, t_s: ArrayLike, poses: Poses, *, force: bool = False) -> Path:
    """Write poses at times in s, each (n,); numbers carry every digit, so that reading gives them back."""
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
    """Return times in s and poses of a trajectory, each (n,); the heading is the quaternion's yaw, unwrapped."""
    path = Path(path)
    try:
        if path.stat().st_size > FILE_LIMIT_BYTES:
            raise BadFileError(
                path, found="a file above 2 GiB", expected="a trajectory", remedy="cut it into several files"
            )
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        found = getattr(error, "strerror", None) or "no UTF-8 text"
        raise BadFileError(path, found=found, expected="a TUM trajectory", remedy="give the path of one") from error
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            values = [float(part) for part in line.replace(",", " ").split()]
        except ValueError:
            values = []
        if len(values) != 8 or not all(map(math.isfinite, values)) or not math.hypot(*values[4:]) > 0.0:
            raise BadFileError(
                path,
                row=number,
                found=repr(line.strip()[:60]),
                expected="t x y z qx qy qz qw, eight finite numbers and a quaternion that is not zero",
                remedy="correct the line",
            )
        rows.append(values)
    if not rows:
        raise BadFileError(path, found="no pose", expected="one line or more", remedy="write the trajectory again")
    t, x, y, _, qx, qy, qz, qw = np.array(rows).T
    yaw = np.arctan2(2 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
    return t, Poses(x, y, np.unwrap(yaw))
