"""Trajectories as TUM files: one pose a line, ``t x y z qx qy qz qw``."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray
from calib.errors import BadFileError, BadInputError
from calib.files import write_text
from calib.motion.poses import Poses

FILE_LIMIT_BYTES = 2 << 30


def write_tum(path: Path, t_s: npt.ArrayLike, poses: Poses, *, force: bool = False) -> Path:
    """Write poses at times in s, each (n,); numbers carry every digit, so that reading gives them back."""
    times = np.asarray(t_s, dtype=np.float64)
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
