"""The exact arc step by step in machine code, where numba is installed (extra `fast`).

A few steps at a time: their headings one after the other, then all their motions at once, then the sums. Headings are
counted from the first of these steps, so that a short series gives their sine and cosine.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from threading import Lock
from typing import Any, Final

import numpy as np

from calib.types import FloatArray

#: steps at a time
_COUNT: Final = 64

#: the series do where the half turns of these steps add up to no more than this: headings within 0.25 rad
_SMALL_RAD: Final = 0.125

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
            if largest * _COUNT <= _SMALL_RAD:
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
