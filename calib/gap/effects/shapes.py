"""Quantities that several effects share: driven speed, usable curvature, distances and the speed at the end."""

from __future__ import annotations

import numpy as np

from calib.campaign.model import FloatArray
from calib.gap.path import Path
from calib.gap.situation import Situation

__all__ = [
    "MOVING_MPS",
    "curvature_per_m",
    "distance_m",
    "driven_speed_mps",
    "end_motion",
    "shows_curves",
    "start_to_end_frame",
]

#: slower than this counts as standing still
MOVING_MPS = 0.05
#: the motion at the end is the mean over this time
_END_S = 0.3


def driven_speed_mps(s: Situation) -> FloatArray:
    """Return the speed of each unit as a mean over its path, shape (n_units,); NaN where it is not known.

    A mean over the path, not over time: it is what an effect on the radii that is linear in speed sums up to.
    """
    way = np.abs(s.path_m)
    total = s.total(way)
    with np.errstate(divide="ignore", invalid="ignore"):
        logged = s.total(way * np.abs(s.speed_mps)) / total
    logged = np.where(logged > 0.0, logged, np.nan)
    return np.where(s.from_log & np.isfinite(logged), logged, np.abs(s.number("speed_mps")))


def curvature_per_m(s: Situation) -> FloatArray:
    """Return the curvature of each step, no tighter than a turn about one rear wheel, shape (n_steps,)."""
    tightest = 2.0 / s.model.track_m
    return np.clip(s.curvature_per_m, -tightest, tightest)


def shows_curves(s: Situation) -> bool:
    """Return whether any unit turns by more than a tenth of a radian in all."""
    return bool((s.total(np.abs(curvature_per_m(s) * s.path_m)) > 0.1).any())


def distance_m(path: Path) -> FloatArray:
    """Return what a perfect laser would read, without any push on the readings, shape (n_units,)."""
    s = path.s
    x, y = path.end[:, 0], path.end[:, 1]
    line = np.abs(s.total(path.ds_m * path.weave_cos))
    return np.where(s.axis == 1, x, np.where(s.axis == 2, np.hypot(x, y), line))


def start_to_end_frame(path: Path, x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Turn changes of x and y, each shape (n_units,), into along and lateral in the end frame."""
    c, sn = np.cos(path.frame), np.sin(path.frame)
    return c * x_m + sn * y_m, c * y_m - sn * x_m


def end_motion(s: Situation) -> tuple[FloatArray, FloatArray]:
    """Return signed speed (m/s) and turn rate (rad/s) at the end of each unit, each shape (n_units,).

    By the last three tenths of a second of the log. A unit without a log is taken as read at its set speed, 0 where
    that is not known.
    """
    last = s.time_s[s.starts[1:] - 1]
    with np.errstate(invalid="ignore"):
        near = s.time_s > (last - _END_S)[s.unit] + 1e-9
    near[s.starts[1:] - 1] = True
    seconds = s.total(np.where(near, np.nan_to_num(s.duration_s), 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        speed = s.total(np.where(near, s.path_m, 0.0)) / seconds
        rate = s.total(np.where(near, s.turn_rad, 0.0)) / seconds
    known = s.from_log & (seconds > 0)
    set_speed = np.nan_to_num(s.number("speed_mps")) * np.sign(s.total(s.path_m))
    last_curvature = curvature_per_m(s)[s.starts[1:] - 1]
    return np.where(known, speed, set_speed), np.where(known, rate, np.abs(set_speed) * last_curvature)
