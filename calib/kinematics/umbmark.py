"""UMBmark: radii and track from squares driven both ways (Borenstein and Feng, IEEE T-RA 12, 1996).

A wrong track turns every corner by alpha too much, unequal wheels bend every side by beta. Clockwise and
counter-clockwise the two add and subtract, so that the mean end position errors of both senses give them apart.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from calib.kinematics.model import Prediction, Segments
from calib.types import BoolArray, FloatArray

#: how far from a side's direction a piece of the way may point and still belong to it
SIDE_RAD: Final = 0.35
#: share of the way that belongs to sides, and of the shortest side beside the mean one
SIDES_SHARE: Final = 0.8
SHORTEST_SIDE: Final = 0.7
#: runs of each sense below which the scatter says nothing
FEWEST: Final = 2


@dataclass(frozen=True, slots=True)
class Umbmark:
    """Radius ratio and track factor from squares driven both ways."""

    #: whether there are squares of both senses
    applies: bool
    #: right diameter over left one; actual track over nominal one
    E_d: float = float("nan")
    E_b: float = float("nan")
    #: factors on the nominal diameters that keep their mean
    c_left: float = field(default=float("nan"), metadata={"json": "c_L"})
    c_right: float = field(default=float("nan"), metadata={"json": "c_R"})
    #: standard deviations from the scatter of the runs; NaN with fewer than two runs of a sense
    E_d_std: float = field(default=float("nan"), metadata={"json": "E_d_sd"})
    E_b_std: float = field(default=float("nan"), metadata={"json": "E_b_sd"})
    #: mean side of the squares
    side_m: float = float("nan")
    #: squares of each sense
    n_cw: int = 0
    n_ccw: int = 0
    #: why it does not apply; empty where it does
    why: str = ""


def squares(prediction: Prediction, segments: Segments) -> tuple[FloatArray, BoolArray]:
    """Return the mean side of each stretch that is a square, NaN of others, and whether it is counter-clockwise.

    A square starts along a side, and its way points along four directions at right angles for nearly all its length.
    """
    pose = prediction.path.pose
    side, left = np.full(len(segments), np.nan), np.zeros(len(segments), dtype=np.bool_)
    for at, (first, last) in enumerate(zip(segments.first, segments.last, strict=True)):
        theta = pose[2, first : last + 1] - pose[2, first]
        step = np.hypot(np.diff(pose[0, first : last + 1]), np.diff(pose[1, first : last + 1]))
        turn = float(theta[-1])
        if not 1.4 * np.pi < abs(turn) < 2.1 * np.pi or step.sum() <= 0.0:
            continue
        quarter = 0.5 * (theta[1:] + theta[:-1]) * np.sign(turn) / (0.5 * np.pi)
        number = np.rint(quarter)
        near = (np.abs(quarter - number) * 0.5 * np.pi < SIDE_RAD) & (number >= 0) & (number <= 3)
        lengths = np.bincount(number[near].astype(np.int64), step[near], minlength=4)
        if lengths.sum() > SIDES_SHARE * step.sum() and lengths.min() > SHORTEST_SIDE * lengths.mean():
            side[at], left[at] = step.sum() / 4.0, turn > 0.0
    return side, left


def umbmark(prediction: Prediction, calibrated: Prediction, segments: Segments, track_m: float) -> Umbmark:
    """Return what the squares among whole runs say, from the residuals of the nominal vehicle.

    `prediction`: of the nominal vehicle: its errors are what is looked at; `calibrated`: of the calibrated one: its way
    shows which runs are squares; `track_m`: nominal track.
    """
    side, left = squares(calibrated, segments)
    square = np.isfinite(side) & segments.seen[:, :2].all(axis=1)
    n_ccw, n_cw = int((square & left).sum()), int((square & ~left).sum())
    if not n_ccw or not n_cw:
        missing = (
            "squares" if not n_ccw and not n_cw else "clockwise squares" if not n_cw else "counter-clockwise squares"
        )
        return Umbmark(False, n_cw=n_cw, n_ccw=n_ccw, why=f"no {missing} among the runs")
    from scipy.linalg import block_diag

    error = prediction.residuals[:, :2]
    side_m = float(np.mean(side[square]))
    both = [error[square & left], error[square & ~left]]
    centres = np.stack([part.mean(axis=0) for part in both])
    ratios = _ratios(centres, side_m, track_m)
    std = np.full(2, np.nan)
    if min(n_ccw, n_cw) >= FEWEST:
        # both ratios are nearly linear in the four means
        step = 1e-6 * np.eye(4).reshape(4, 2, 2)
        slopes = np.array([np.subtract(_ratios(centres + d, side_m, track_m), ratios) for d in step]) / 1e-6
        spread = block_diag(*(np.cov(part.T) / len(part) for part in both))
        std = np.sqrt(np.diag(slopes.T @ spread @ slopes))
    E_d, E_b = ratios
    return Umbmark(
        True, E_d, E_b, 2.0 / (E_d + 1.0), 2.0 / (1.0 / E_d + 1.0), float(std[0]), float(std[1]), side_m, n_cw, n_ccw
    )


def _ratios(centres: FloatArray, side_m: float, track_m: float) -> tuple[float, float]:
    """Return E_d and E_b of mean end position errors, rows counter-clockwise and clockwise, both axes averaged."""
    (x_ccw, y_ccw), (x_cw, y_cw) = centres
    alpha = 0.5 * ((x_cw + x_ccw) + (y_cw - y_ccw)) / (4.0 * side_m)
    beta = 0.5 * ((x_ccw - x_cw) - (y_ccw + y_cw)) / (4.0 * side_m)
    curvature = 2.0 * np.sin(0.5 * beta) / side_m
    return float((1.0 + 0.5 * track_m * curvature) / (1.0 - 0.5 * track_m * curvature)), float(
        0.5 * np.pi / (0.5 * np.pi + alpha)
    )
