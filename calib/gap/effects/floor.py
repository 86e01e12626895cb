"""Where on the floor the vehicle is: runs are told in the frame of their own start."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.gap.data.driven_alike import LENGTH_SHARE, lane_names
from calib.gap.data.observations import Observations
from calib.gap.predict.path import LED_STRAIGHT_RAD, Path


def common_frame(observations: Observations) -> bool:
    """Return whether a place on the floor is the same place in every run: in a map, or from one mark, out and back.

    A window of a recording has a place in a map only.
    """
    return observations.common_frame and (not observations.windowed or bool(np.isfinite(observations.start_pose).all()))


def is_back(observations: Observations) -> FloatArray:
    """Return 1 for units driven back along the floor, 0 for others, shape (n_units,)."""
    return np.where(observations.heading_sign < 0.0, 1.0, 0.0)


def far_end_m(observations: Observations) -> FloatArray:
    """Return where on x each unit starts: 0, or for straight runs back the corridor's length, shape (n_units,).

    The length is the median measured one of the runs out of about the same length (else of those back).
    """
    length = np.where(
        np.isfinite(observations.measured[:, 0]), observations.measured[:, 0], np.abs(observations.measured[:, 1])
    )
    length = np.where(np.isfinite(length), length, observations.length_m)
    straight = np.abs(observations.total(observations.turn_rad)) < LED_STRAIGHT_RAD
    back, out = straight & (observations.heading_sign < 0), straight & (observations.labels["direction"] == "out")
    start = np.zeros(len(observations))
    for route in np.unique(observations.kind[back]):
        mine = back & (observations.kind == route)
        with np.errstate(divide="ignore", invalid="ignore"):
            # a turn on the spot has no length, and is like none
            alike = np.abs(np.log(length / np.median(length[mine]))) < LENGTH_SHARE
        start[mine] = np.median(length[out & alike if (out & alike).any() else mine])
    return start


def lanes(observations: Observations) -> IntArray:
    """Return the lane of each unit: 0, or a number for each ending of the kind of route such as ``_b`` or ``_2``."""
    names = lane_names(observations.labels["kind"])
    others = [name for name in np.unique(names) if name]
    number = np.zeros(len(observations), dtype=np.int64)
    for place, name in enumerate(others, start=1):
        number[names == name] = place
    return number


def map_heading_rad(path: Path) -> FloatArray:
    """Return the heading on the floor at the middle of each step, shape (n_steps,)."""
    observations = path.s
    start = observations.start_pose[:, 2]
    return path.mid_rad + np.where(np.isfinite(start), start, np.pi * is_back(observations))[observations.unit]


def floor_place(path: Path, far_end_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the place on the floor at the middle of each step in m, each shape (n_steps,).

    In a map units start where they were seen to. Else runs out start at the origin heading along x; runs back head the
    other way, in a corridor from its far end (`far_end_m` of the units of the path).
    """
    observations = path.s
    known = np.isfinite(observations.start_pose).all(axis=1)
    x, y = (
        np.where(known, observations.start_pose[:, 0], far_end_m),
        np.where(known, observations.start_pose[:, 1], 0.0),
    )
    heading = np.where(known, observations.start_pose[:, 2], np.pi * is_back(observations))
    unit, steps = observations.unit, path.steps
    c, sn = np.cos(heading)[unit], np.sin(heading)[unit]
    return x[unit] + c * steps.x_m - sn * steps.y_m, y[unit] + sn * steps.x_m + c * steps.y_m
