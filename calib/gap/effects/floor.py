"""Where on the floor the vehicle is: runs are told in the frame of their own start."""

from __future__ import annotations

import re
from typing import Final

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.gap.data.observations import Observations
from calib.gap.predict.path import Path

__all__ = ["common_frame", "far_end_m", "floor_place", "is_back", "lanes", "map_heading_rad"]


#: a kind that ends so is driven on another lane of the same floor
_LANE: Final = re.compile(r"_([b-z]|\d+)$")


def common_frame(s: Observations) -> bool:
    """Return whether the poses stand in one frame, so that a place on the floor is the same place in every run.

    A campaign that does not say is taken to: its runs begin at one mark.
    """
    return not s.windowed and bool(getattr(s, "common_frame", True))


def is_back(s: Observations) -> FloatArray:
    """Return 1 for units driven back along the floor, 0 for others, shape (n_units,)."""
    return np.where(s.heading_sign < 0.0, 1.0, 0.0)


def far_end_m(s: Observations) -> FloatArray:
    """Return where on x each unit starts: 0, or for corridor runs back the corridor's length, shape (n_units,).

    The length is the median measured one of the runs out of the same kind (else of all of that kind).
    """
    kind = s.labels["kind"].astype(np.str_)
    length = np.where(np.isfinite(s.measured[:, 0]), s.measured[:, 0], np.abs(s.measured[:, 1]))
    length = np.where(np.isfinite(length), length, s.length_m)
    start = np.zeros(len(s))
    for name in np.unique(kind[np.char.startswith(kind, "corridor")]):
        mine = kind == name
        out = mine & (s.heading_sign > 0)
        start[mine & (s.heading_sign < 0)] = np.median(length[out if out.any() else mine])
    return start


def lanes(s: Observations) -> IntArray:
    """Return the lane of each unit: 0, or a number for each ending of the kind of route such as ``_b`` or ``_2``."""
    ending = [_LANE.search(str(kind)) for kind in s.labels["kind"]]
    names = np.array([found.group(1) if found else "" for found in ending])
    others = [name for name in np.unique(names) if name]
    number = np.zeros(len(s), dtype=np.int64)
    for place, name in enumerate(others, start=1):
        number[names == name] = place
    return number


def map_heading_rad(path: Path) -> FloatArray:
    """Return the heading on the floor at the middle of each step, shape (n_steps,)."""
    return path.mid_rad + np.pi * is_back(path.s)[path.s.unit]


def floor_place(path: Path) -> tuple[FloatArray, FloatArray]:
    """Return the place on the floor at the middle of each step in m, each shape (n_steps,).

    Runs out start at the origin heading along x; runs back head the other way, in a corridor from its far end.
    """
    s = path.s
    sign = s.heading_sign[s.unit]
    return far_end_m(s)[s.unit] + sign * path.x_m, sign * path.y_m
