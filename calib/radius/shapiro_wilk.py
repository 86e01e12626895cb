"""The test of normality by Shapiro and Wilk, with Royston's coefficients and p-value (1995, algorithm AS R94)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.polynomial.polynomial import polyval

from calib.arrays import FloatArray

#: numbers of values for which the p-value was worked out here
FEWEST: Final = 8
MOST: Final = 5000
#: largest and second largest coefficient, in powers of one over the root of the number of values
_LARGEST: Final = (0.0, 0.221157, -0.147981, -2.07119, 4.434685, -2.706056)
_SECOND: Final = (0.0, 0.042981, -0.293762, -1.752461, 5.682633, -3.582633)
#: up to so many values the logarithm of 1 - W is bounded, and its law is another
_FEW: Final = 11
_BOUND: Final = (-2.273, 0.459)
_FEW_MEAN: Final = (0.544, -0.39978, 0.025054, -6.714e-4)
_FEW_LOG_STD: Final = (1.3822, -0.77857, 0.062767, -0.0020322)
#: beyond, in powers of the logarithm of their number
_MEAN: Final = (-1.5861, -0.31082, -0.083751, 0.0038915)
_LOG_STD: Final = (-0.4803, -0.082676, 0.0030302)
#: quantiles of the normal distribution as ratios of powers, in the middle and in the tails (Beasley and Springer 1977,
#: algorithm AS 111): to seven digits, but those that `scipy.stats.shapiro` has
_MIDDLE: Final = (2.50662823884, -18.61500062529, 41.39119773534, -25.44106049637)
_MIDDLE_BELOW: Final = (1.0, -8.47351093090, 23.08336743743, -21.06224101826, 3.13082909833)
_TAIL: Final = (-2.78718931138, -2.29796479134, 4.85014127135, 2.32121276858)
_TAIL_BELOW: Final = (1.0, 3.54388924762, 1.63706781897)
_MIDDLE_WIDTH: Final = 0.42


def shapiro_wilk(values: FloatArray) -> tuple[float, float]:
    """Return the statistic W and its p-value.

    `values` (shape (n,), n from 8 to 5,000): not all the same. By hand: `scipy.stats`, whose digits these are, takes
    longer to import than a thousand logs from the cache.
    """
    from scipy.special import ndtr

    n = len(values)
    ordered = np.sort(values - values[n // 2])
    lower = _coefficients(n)
    whole = np.concatenate((-lower, np.zeros(n % 2), lower[::-1]))
    centred = ordered - ordered.mean()
    size = np.sqrt(float(whole @ whole) * float(centred @ centred))
    along = float(whole @ centred)
    lack = (size - along) * (size + along) / size**2
    y = np.log(lack) if lack > 0 else -np.inf
    if n > _FEW:
        mean, log_std = polyval(np.log(n), _MEAN), polyval(np.log(n), _LOG_STD)
    else:
        bound = polyval(n, _BOUND)
        if y >= bound:
            return 1.0 - lack, 0.0
        y, mean, log_std = -np.log(bound - y), polyval(n, _FEW_MEAN), polyval(n, _FEW_LOG_STD)
    return 1.0 - lack, float(ndtr((mean - y) / np.exp(log_std)))


def _coefficients(n: int) -> FloatArray:
    """Return the coefficients of the upper half of `n` values, largest first, shape (n // 2,)."""
    normal = _normal_quantiles(1.0 - np.asarray((np.arange(1, n // 2 + 1) - 0.375) / (n + 0.25), dtype=np.float64))
    square = 2.0 * float(normal @ normal)
    first = normal[0] / np.sqrt(square) + polyval(n**-0.5, _LARGEST)
    second = normal[1] / np.sqrt(square) + polyval(n**-0.5, _SECOND)
    scale = np.sqrt((square - 2.0 * (normal[0] ** 2 + normal[1] ** 2)) / (1.0 - 2.0 * (first**2 + second**2)))
    return np.concatenate(([first, second], normal[2:] / scale))


def _normal_quantiles(probability: FloatArray) -> FloatArray:
    """Return the quantiles of the normal distribution for probabilities of a half and more."""
    above = probability - 0.5
    square, root = above**2, np.sqrt(-np.log(1.0 - probability))
    middle = above * polyval(square, _MIDDLE) / polyval(square, _MIDDLE_BELOW)
    return np.where(above <= _MIDDLE_WIDTH, middle, polyval(root, _TAIL) / polyval(root, _TAIL_BELOW))
