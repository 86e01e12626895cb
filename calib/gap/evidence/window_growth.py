"""How what is left grows with the length of a window: constant, as the root of the length, or in proportion to it.

Windows that follow each other are joined, two, four and eight at a time, measured and predicted motion alike. What the
reference reads wrongly at both ends does not grow; a random walk grows as the root of the length; what grows in
proportion is systematic, and no noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.predict.path import Path

#: windows joined to a longer one
JOINED: Final = (1, 2, 4, 8)
#: fewest windows of a length
FEWEST: Final = 4
#: channels of a pose
POSE: Final = slice(1, 4)


@dataclass(frozen=True, slots=True, eq=False)
class Growth:
    """What the mean squares of what is left in windows of several lengths are made of.

    Parameters
    ----------
    length_m : array of float, shape (n_lengths,)
        Mean length of the windows.
    parts : array of float, shape (3, 3)
        For what is left along, lateral and in the heading, mean squares at the shortest length that are constant, grow
        with the length, and grow with its square.
    """

    length_m: FloatArray
    parts: FloatArray

    @property
    def noise_rms(self) -> FloatArray:
        """Root mean square that is noise in the shortest windows, along, lateral, heading, shape (3,)."""
        rms: FloatArray = np.sqrt(self.parts[:, 0] + self.parts[:, 1])
        return rms


def window_growth(path: Path) -> Growth | None:
    """Return how what a path leaves grows with the length of the windows; None where there are too few of them.

    Parameters
    ----------
    path : Path
        Of observations that were cut into windows.
    """
    from scipy.optimize import nnls

    chains = _chains(path)
    lengths, squares = [], []
    for joined in JOINED:
        left = [_left(path, first, first + joined) for a, b in chains for first in range(a, b - joined + 1, joined)]
        if len(left) < FEWEST:
            break
        rows = np.array(left)
        lengths.append(float(rows[:, 0].mean()))
        squares.append((rows[:, 1:] ** 2).mean(axis=0))
    if len(lengths) < len(JOINED) - 1:
        return None
    length, square = np.array(lengths), np.array(squares)
    times = length / length[0]
    laws = np.stack([np.ones(len(times)), times, times**2], axis=1)
    # each length weighs as its relative uncertainty: half as many windows, a root of two more uncertain
    weight = 1.0 / (np.maximum(square, 1e-300) * np.sqrt(times)[:, None])
    parts = np.stack([nnls(laws * weight[:, [k]], square[:, k] * weight[:, k])[0] for k in range(3)])
    return Growth(length, parts)


def _chains(path: Path) -> list[tuple[int, int]]:
    """Return stretches (first, behind the last) of windows that follow each other and all have a measured pose."""
    observations = path.s
    posed = np.asarray(observations.usable[:, POSE].all(axis=1))
    follows = (np.diff(observations.run) == 0) & (np.diff(observations.window) == 1)
    breaks = np.flatnonzero(~(follows & posed[1:] & posed[:-1])) + 1
    edges = [0, *breaks.tolist(), len(posed)]
    return [(a, b) for a, b in pairwise(edges) if posed[a]]


def _left(path: Path, first: int, behind: int) -> FloatArray:
    """Return the length of joined windows and what is left along, lateral and in the heading at their end."""
    measured, predicted = path.s.measured[first:behind, POSE], path.end[first:behind]
    real, model = _joined(measured), _joined(predicted)
    dx, dy = real[:2] - model[:2]
    c, s = np.cos(real[2]), np.sin(real[2])
    length = path.s.length_m[first:behind].sum()
    return np.array([length, c * dx + s * dy, c * dy - s * dx, real[2] - model[2]])


def _joined(motions: FloatArray) -> FloatArray:
    """Return the pose after several motions (n, 3), each in the frame of its own start."""
    heading = np.concatenate(([0.0], np.cumsum(motions[:, 2])))
    place = ((motions[:, 0] + 1j * motions[:, 1]) * np.exp(1j * heading[:-1])).sum()
    return np.array([place.real, place.imag, heading[-1]])
