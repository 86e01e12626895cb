"""Poses after steps laid end to end: by array operations, block by block, or step by step in machine code.

By arrays: sums run within a block and are carried from block to block, which keeps their rounding below that of a
sample-by-sample loop. In machine code, where numba is installed (extra `fast`): a few steps at a time, their headings
counted from the first of them, so that a short series gives sine and cosine; then their motions at once; then the sums.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from threading import Lock
from typing import Any, Final

import numpy as np

from calib.odometry.poses import sinc
from calib.types import FloatArray, IntArray

#: scheme -> share of a step's turn by which the heading used lies behind the heading at its end
HEADING_BEHIND: Final = {"exact": 0.5, "mid_point": 0.5, "euler": 1.0, "end_point": 0.0}

#: steps a block: its arrays stay in the second-level cache, and no BLAS starts threads for its products
BLOCK: Final = 16_384

#: turn up to which three terms of the series of sin(u) / u for its half hold to 2e-16
_SMALL_TURN_RAD: Final = 0.02

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
    """Write the poses after the steps into x, y and theta (n,), by a scheme of `HEADING_BEHIND`; see `Flat`."""
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
    if float(square.max()) <= _SMALL_TURN_RAD**2:
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


#: steps at a time
_COUNT: Final = 64

#: the series do where the half turns of these steps add up to no more than this: headings within 0.25 rad
_SMALL_HALVES_RAD: Final = 0.125

#: coefficients of sin(u)/u and cos(u) by the square of u, after the first
_SINE: Final = (-1 / 6, 1 / 120, -1 / 5040, 1 / 362_880, -1 / 39_916_800)
_COSINE: Final = (-1 / 2, 1 / 24, -1 / 720, 1 / 40_320, -1 / 3_628_800)

#: two threads that come first together do not both ask for machine code
_ONE_AT_A_TIME: Final = Lock()


@cache
def is_installed() -> bool:
    """Return whether numba is there; it is not imported."""
    return find_spec("numba") is not None


def machine_code() -> Callable[..., None]:
    """Return `_loop` in machine code; it releases the interpreter's lock."""
    with _ONE_AT_A_TIME:
        return _machine_code()


@cache
def _machine_code() -> Callable[..., None]:
    """Return the loop in machine code, kept on disk where a folder can be written to."""
    import numba

    try:
        loop: Any = numba.njit(nogil=True, cache=True, error_model="numpy")(_loop)
    except RuntimeError:
        # nowhere to keep it
        loop = numba.njit(nogil=True, error_model="numpy")(_loop)
    return loop  # type: ignore[no-any-return]


def _loop(
    travel: tuple[FloatArray, FloatArray],
    per_m: FloatArray,
    starts: Any,
    pose: FloatArray,
    out: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Write the poses; what numba compiles."""
    left, right = travel
    x, y, theta = out
    varies = len(per_m) > 1
    halves, middle, dx, dy = np.empty(_COUNT), np.empty(_COUNT), np.empty(_COUNT), np.empty(_COUNT)
    for run in range(len(starts)):
        stop = starts[run + 1] if run + 1 < len(starts) else len(left)
        so_far, rest = pose[:, run].copy(), np.zeros(3)
        for first in range(starts[run], stop, _COUNT):
            count = min(_COUNT, stop - first)
            at_x, at_y, at_theta = so_far[0] + rest[0], so_far[1] + rest[1], so_far[2] + rest[2]
            turned = largest = 0.0
            for k in range(count):
                half = 0.5 * (right[first + k] - left[first + k]) * per_m[first + k if varies else 0]
                halves[k] = half
                middle[k] = turned + half
                turned += 2.0 * half
                theta[first + k] = at_theta + turned
                largest = max(largest, abs(half))
            cos, sin = math.cos(at_theta), math.sin(at_theta)
            if largest * _COUNT <= _SMALL_HALVES_RAD:
                for k in range(count):
                    u = halves[k] * halves[k]
                    chord = 0.5 * (left[first + k] + right[first + k]) * (1.0 + u * (_SINE[0] + u * _SINE[1]))
                    u = middle[k] * middle[k]
                    sine = _SINE[2] + u * (_SINE[3] + u * _SINE[4])
                    sine = middle[k] * (1.0 + u * (_SINE[0] + u * (_SINE[1] + u * sine)))
                    cosine = _COSINE[2] + u * (_COSINE[3] + u * _COSINE[4])
                    cosine = 1.0 + u * (_COSINE[0] + u * (_COSINE[1] + u * cosine))
                    dx[k] = chord * (cos * cosine - sin * sine)
                    dy[k] = chord * (sin * cosine + cos * sine)
            else:
                for k in range(count):
                    chord = 0.5 * (left[first + k] + right[first + k])
                    if halves[k] != 0.0:
                        chord *= math.sin(halves[k]) / halves[k]
                    dx[k] = chord * math.cos(at_theta + middle[k])
                    dy[k] = chord * math.sin(at_theta + middle[k])
            gone_x = gone_y = 0.0
            for k in range(count):
                gone_x += dx[k]
                gone_y += dy[k]
                x[first + k] = at_x + gone_x
                y[first + k] = at_y + gone_y
            for j, gone in enumerate((gone_x, gone_y, turned)):
                # summed with its rounding (Neumaier), so that equal steps do not add up a bias
                ahead, before = so_far[j] + gone, so_far[j]
                rest[j] += (before - ahead) + gone if abs(before) >= abs(gone) else (gone - ahead) + before
                so_far[j] = ahead
