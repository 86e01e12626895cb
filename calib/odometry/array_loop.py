"""Steps of all runs laid end to end, and their poses by array operations, block by block.

The arrays in use stay in the processor's cache. Sums run within a block and are carried from block to block, which
keeps their rounding below that of a sample-by-sample loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.odometry.poses import sinc
from calib.types import FloatArray, IntArray

#: scheme -> share of a step's turn by which the heading used lies behind the heading at its end
HEADING_BEHIND: Final = {"exact": 0.5, "mid_point": 0.5, "euler": 1.0, "end_point": 0.0}

#: steps a block: its arrays stay in the second-level cache, and no BLAS starts threads for its products
BLOCK: Final = 16_384

#: turn up to which three terms of the series of sin(u) / u for its half hold to 2e-16
_SMALL_RAD: Final = 0.02

#: steps that are summed by one row of a product
_ROW: Final = 16
_ONES: Final = np.ones(_ROW)
_TRIANGLE: Final = np.triu(np.ones((_ROW, _ROW)))


@dataclass(frozen=True, slots=True, eq=False)
class Flat:
    """Steps of runs laid end to end."""

    #: left, right: shape (n,): travel of the wheels in m
    left: FloatArray
    right: FloatArray
    per_m: FloatArray  #: shape (n,) or (1,): one over the track
    #: starts, runs: shape (filled,): first step and number of each run that has steps
    starts: IntArray
    runs: IntArray
    pose: FloatArray  #: shape (3, n_runs): start poses
    shape: tuple[int, ...]  #: shape that the travel came in


def fill_arrays(flat: Flat, x: FloatArray, y: FloatArray, theta: FloatArray, *, scheme: str) -> None:
    """Write the poses after steps laid flat.

    Parameters
    ----------
    flat : Flat
        The steps.
    x, y, theta : array of float, shape (n,)
        Where the poses go.
    scheme : str
        How a step is drawn: one of `HEADING_BEHIND`.
    """
    n = len(flat.left)
    buffers = np.empty((4, min(BLOCK, n)))
    edges = np.append(np.arange(0, n, BLOCK), n)
    first_runs = np.searchsorted(flat.starts, edges[:-1], side="right") - 1
    last_runs = np.searchsorted(flat.starts, edges[1:], side="left")
    for first, last, k0, k1 in zip(edges[:-1].tolist(), edges[1:].tolist(), first_runs, last_runs, strict=True):
        steps = slice(first, last)
        begins = flat.starts[k0:k1] - first
        pose = flat.pose[:, flat.runs[k0:k1]]
        if begins[0] < 0:
            begins[0], pose[:, 0] = 0, (x[first - 1], y[first - 1], theta[first - 1])
        turn, path, angle, work = buffers[:, : last - first]
        left, right = flat.left[steps], flat.right[steps]
        np.subtract(right, left, out=turn)
        turn *= flat.per_m[steps] if len(flat.per_m) > 1 else flat.per_m
        np.add(left, right, out=path)
        path *= 0.5
        if scheme == "exact":
            _shorten(path, turn, angle, work)
        np.multiply(turn, -HEADING_BEHIND[scheme], out=angle)
        heading = theta[steps]
        _running(turn, begins, pose[2], heading)
        angle += heading
        # with t = tan(a / 2): cos a = 2 / (1 + t^2) - 1 and sin a = 2 t / (1 + t^2), one vectorised function for both
        angle *= 0.5
        tangent = np.tan(angle, out=angle)
        np.multiply(tangent, tangent, out=work)
        work += 1.0
        np.divide(path, work, out=work)
        work *= 2.0
        tangent *= work
        work -= path
        _running(work, begins, pose[0], x[steps])
        _running(tangent, begins, pose[1], y[steps])


def _shorten(path: FloatArray, turn: FloatArray, square: FloatArray, work: FloatArray) -> None:
    """Turn the length of arcs (n,) into that of their chords, in place, for turns (n,); two arrays are overwritten."""
    np.multiply(turn, turn, out=square)
    if float(square.max()) <= _SMALL_RAD**2:
        # the series of sin(u) / u for half the turn
        np.multiply(square, 1.0 / 1920.0, out=work)
        work -= 1.0 / 24.0
        work *= square
        work += 1.0
        path *= work
    else:
        path *= sinc(0.5 * turn)


def _running(steps: FloatArray, begins: IntArray, start: FloatArray, out: FloatArray) -> None:
    """Write running sums of steps (n,) that begin anew at steps `begins`, from `start`, each of shape (pieces,).

    The steps are used up. Sums of `_ROW` steps are a product with a triangle of ones, which takes half the time of
    adding one step after the other.
    """
    if len(begins) > 1:
        ends = start + np.add.reduceat(steps, begins)
        # the first step of a run leads from the end of the run before to its own start
        steps[begins[1:]] += start[1:] - ends[:-1]
    steps[0] += start[0]
    if len(steps) % _ROW == 0:
        rows = steps.reshape(-1, _ROW)
        totals = np.cumsum(rows @ _ONES)
        # a product would spread a NaN over its row
        if np.isfinite(totals[-1]):
            rows[1:, 0] += totals[:-1]
            np.dot(rows, _TRIANGLE, out=out.reshape(-1, _ROW))
            return
    np.cumsum(steps, out=out)
