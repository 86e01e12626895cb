"""From the length of an arc to that of its chord."""

from __future__ import annotations

from math import factorial, sqrt
from typing import Final

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray

#: sin(d/2)/d as a series in d^2: half the ratio of chord to arc for a turn of d
_SERIES: Final = tuple((-1) ** k / (2 ** (2 * k + 1) * factorial(2 * k + 1)) for k in range(12))

#: how many of its terms are good to the last digit up to which d
_TERMS: Final = ((3, 8e-3), (4, 4e-2), (5, 0.2), (7, 1.0), (9, 2.0), (12, 3.2))

#: turn up to which two terms do, if the second one bears its part of the third
_SMALL_RAD: Final = 1.2e-3

#: the third term, d^4 / 3840, as a multiple of d^2 that misses it least up to there: by 2e-16 of the path
_TWO: Final = (0.5, _SERIES[1] + 2.0 * (sqrt(2.0) - 1.0) * _SERIES[2] * _SMALL_RAD**2)


def sinc(u: npt.ArrayLike) -> FloatArray:
    """Return sin(u) / u, 1 at 0; any shape, u in rad: the ratio of chord to arc for a turn of 2 u."""
    return np.asarray(np.sinc(np.asarray(u, dtype=np.float64) / np.pi))


def shorten(path: FloatArray, turn: FloatArray, square: FloatArray, work: FloatArray, *, unit: float = 1.0) -> None:
    """Turn twice the length of arcs into the length of their chords, in place.

    Parameters
    ----------
    path : array of float, shape (n,)
        Twice the length of each arc in m; becomes the chord.
    turn : array of float, shape (n,)
        Turn of each arc, in units of `unit`.
    square, work : array of float, shape (n,)
        Overwritten.
    unit : float
        Unit of `turn` in rad.
    """
    np.square(turn, out=square)
    largest = float(square.max()) * unit * unit
    if largest <= _SMALL_RAD**2:
        square *= _TWO[1] * unit * unit
        square += _TWO[0]
        path *= square
        return
    for terms, limit in _TERMS:
        if largest <= limit * limit:
            series = [coefficient * unit ** (2 * k) for k, coefficient in enumerate(_SERIES[:terms])]
            np.multiply(square, series[-1], out=work)
            for coefficient in series[-2:0:-1]:
                work += coefficient
                work *= square
            work += series[0]
            path *= work
            return
    path *= 0.5 * sinc(0.5 * unit * turn)
