"""Where on the floor the vehicle is: runs are told in the frame of their own start."""

from __future__ import annotations

import numpy as np

from calib.campaign.model import FloatArray, IntArray
from calib.gap.path import Path
from calib.gap.situation import Situation

__all__ = ["corridor_length_m", "floor_place", "is_back", "lanes", "map_heading_rad"]


def is_back(s: Situation) -> FloatArray:
    """Return 1 for units driven back along the floor, 0 for others, shape (n_units,)."""
    return np.where(s.heading_sign < 0.0, 1.0, 0.0)


def corridor_length_m(s: Situation) -> float:
    """Return where runs back start: the median measured length of corridor runs out (else of all corridor runs)."""
    corridor = np.char.startswith(s.labels["kind"].astype(np.str_), "corridor")
    length = np.where(np.isfinite(s.measured[:, 0]), s.measured[:, 0], np.abs(s.measured[:, 1]))
    length = np.where(np.isfinite(length), length, s.length_m)
    for chosen in (corridor & (s.heading_sign > 0), corridor):
        if chosen.any():
            return float(np.median(length[chosen]))
    return 0.0


def lanes(s: Situation) -> IntArray:
    """Return the lane of each unit: a number for each kind of corridor, 0 for ``corridor`` and all other routes."""
    kind = s.labels["kind"].astype(np.str_)
    other = np.char.startswith(kind, "corridor") & (kind != "corridor")
    _, number = np.unique(np.where(other, kind, ""), return_inverse=True)
    # the empty text sorts first; without it every unit is on another lane, which numbers from 1
    return np.asarray(number + (0 if (~other).any() else 1), dtype=np.int64)


def map_heading_rad(path: Path) -> FloatArray:
    """Return the heading on the floor at the middle of each step, shape (n_steps,)."""
    return path.mid_rad + np.pi * is_back(path.s)[path.s.unit]


def floor_place(path: Path) -> tuple[FloatArray, FloatArray]:
    """Return the place on the floor at the middle of each step in m, each shape (n_steps,).

    Runs out start at the origin heading along x; corridor runs back start at the corridor's far end heading back; other
    routes start at the origin whatever their label.
    """
    s = path.s
    corridor = np.char.startswith(s.labels["kind"].astype(np.str_), "corridor")
    turned = (corridor & (s.heading_sign < 0.0))[s.unit]
    return (
        np.where(turned, corridor_length_m(s) - path.x_m, path.x_m),
        np.where(turned, -path.y_m, path.y_m),
    )
