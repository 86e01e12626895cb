"""The Shapiro-Wilk test as Royston computes it (Applied Statistics 44 (1995) 547), for eight values and more.

By hand: `scipy.stats` has it, but its import takes longer than all that a fit does.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import FloatArray

__all__ = ["shapiro_wilk"]

#: Royston's polynomials, lowest power first: the two outermost weights in 1/sqrt(n); mean and logarithm of the standard
#: deviation of the normal that log(1 - W) is turned to, in n up to 11 values and in log(n) beyond
_OUTERMOST: Final = (0.0, 0.221157, -0.147981, -2.07119, 4.434685, -2.706056)
_NEXT: Final = (0.0, 0.042981, -0.293762, -1.752461, 5.682633, -3.582633)
_FEW_MEAN: Final = (0.544, -0.39978, 0.025054, -6.714e-4)
_FEW_LOG_STD: Final = (1.3822, -0.77857, 0.062767, -0.0020322)
_MEAN: Final = (-1.5861, -0.31082, -0.083751, 0.0038915)
_LOG_STD: Final = (-0.4803, -0.082676, 0.0030302)
#: with few values log(1 - W) ends at ``_END + _END_RATE * n``
_END, _END_RATE = -2.273, 0.459
_FEW: Final = 11
FEWEST: Final = 8


def shapiro_wilk(values: FloatArray) -> tuple[float, float]:
    """Return the statistic W and its p-value.

    Parameters
    ----------
    values : array of float, shape (n,)
        Eight or more, not all alike.

    Returns
    -------
    statistic, p_value : float
        Small where the values are not normal.
    """
    from scipy.special import ndtr

    n = len(values)
    if n < FEWEST:
        raise ValueError(f"values: found {n}; expected {FEWEST} or more")
    ordered = np.sort(values)
    away = ordered - ordered.mean()
    statistic = min(float((_weights(n) @ away) ** 2 / (away @ away)), 1.0 - np.finfo(np.float64).epsneg)
    left = np.log1p(-statistic)
    if n <= _FEW:
        end = _END + _END_RATE * n
        if left >= end:
            return statistic, 0.0
        left = -np.log(end - left)
        mean, log_std = (np.polynomial.polynomial.polyval(n, part) for part in (_FEW_MEAN, _FEW_LOG_STD))
    else:
        mean, log_std = (np.polynomial.polynomial.polyval(np.log(n), part) for part in (_MEAN, _LOG_STD))
    return statistic, float(ndtr((mean - left) / np.exp(log_std)))


def _weights(n: int) -> FloatArray:
    """Return the weights of the ordered values, shape (n,): their squares add up to 1."""
    from scipy.special import ndtri

    scores = ndtri((np.arange(1, n + 1) - 0.375) / (n + 0.25))
    square = float(scores @ scores)
    outer, next_outer = (
        float(scores[-place] / np.sqrt(square) + np.polynomial.polynomial.polyval(1 / np.sqrt(n), part))
        for place, part in ((1, _OUTERMOST), (2, _NEXT))
    )
    inner = (square - 2 * scores[-1] ** 2 - 2 * scores[-2] ** 2) / (1 - 2 * outer**2 - 2 * next_outer**2)
    weights = scores / np.sqrt(inner)
    weights[[0, 1, -2, -1]] = -outer, -next_outer, next_outer, outer
    return np.asarray(weights)
