"""Scatter in the order driven: runs that follow each other and scatter alike tell less than as many independent ones.

The residuals of a session are taken as a first-order autoregression, ``corr(e_i, e_j) = rho^|i - j|``. ``rho`` is
estimated from the lag-one autocorrelation of the residuals, freed of the bias that the fitted mean and line give it;
where it is significant, the covariance of the runs' stratum is that of the same least-squares estimates under it, and
its degrees of freedom are Satterthwaite's. All products with the correlation matrix are two recursions, linear in runs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from calib.radius.law import LineEstimate
from calib.radius.sessions import Groups
from calib.types import FloatArray

#: fewer degrees of freedom show no autocorrelation
MIN_DOF: Final = 6
#: below this probability of as large an autocorrelation by chance the intervals are widened: to widen costs little
WIDENED_BELOW: Final = 0.05
#: largest autocorrelation: the mean of runs that follow each other more closely says nothing of its own scatter
LARGEST: Final = 0.95
#: the autocorrelation is solved for to this
PRECISION: Final = 0.01


@dataclass(frozen=True, slots=True)
class Autocorrelation:
    """Autocorrelation of runs that follow each other."""

    #: of one run and the next, freed of bias, plus a standard deviation: its estimate scatters, and too small a one
    #: would leave the intervals too narrow; 0 where none is significant
    rho: float
    #: lag-one autocorrelation of the residuals as it stands, and the probability of a larger one by chance
    lag_one: float
    p_value: float
    #: by how much it widens the interval of the slope, 1 where it does not
    slope_ratio: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class _Series:
    """Residuals in blocks that are independent of each other, and what was fitted: orthonormal columns (n_runs, k)."""

    residual: FloatArray
    fitted: FloatArray
    #: whether each run begins a block, shape (n_runs,)
    begins: FloatArray

    @property
    def dof(self) -> float:
        """Degrees of freedom of the residuals."""
        return float(len(self.residual) - self.fitted.shape[1])

    def neighbours(self, columns: FloatArray) -> FloatArray:
        """Return half the sum of the run before and of the run after of the same block, shape (n_runs, k)."""
        joined = (1.0 - self.begins[1:])[:, None]
        product = np.zeros_like(columns)
        product[1:] += 0.5 * joined * columns[:-1]
        product[:-1] += 0.5 * joined * columns[1:]
        return product

    def correlated(self, columns: FloatArray, rho: float) -> FloatArray:
        """Return columns (n_runs, k) times the correlation matrix."""
        from scipy.signal import lfilter

        edges = [*np.flatnonzero(self.begins), len(columns)]
        product = np.empty_like(columns)
        for first, behind in pairwise(edges):
            block = columns[first:behind]
            forward = lfilter([1.0], [1.0, -rho], block, axis=0)
            product[first:behind] = forward + lfilter([1.0], [1.0, -rho], block[::-1], axis=0)[::-1] - block
        return product

    def expected_lag_one(self, rho: float) -> float:
        """Return the ratio of the expectations of the lag-one product and of the square of the residuals."""
        own, pairs = self.fitted, len(self.residual) - self.begins.sum()
        beside, turned = self.neighbours(own), self.correlated(own, rho)
        cross = own.T @ turned
        product = rho * pairs - 2.0 * float(np.sum(beside * turned)) + float(np.sum((own.T @ beside) * cross))
        return float(product / (len(self.residual) - float(np.trace(cross))))

    def if_independent(self) -> tuple[float, float]:
        """Return mean and standard deviation of the lag-one autocorrelation of independent runs."""
        own, pairs, dof = self.fitted, len(self.residual) - self.begins.sum(), self.dof
        beside = self.neighbours(own)
        inner = own.T @ beside
        trace = -float(np.trace(inner))
        squares = 0.5 * pairs - 2.0 * float(np.sum(beside**2)) + float(np.sum(inner**2))
        variance = 2.0 * (dof * squares - trace**2) / (dof**2 * (dof + 2.0))
        return trace / dof, float(np.sqrt(max(variance, 1e-12)))


def autocorrelation(series: _Series) -> Autocorrelation:
    """Return the autocorrelation of residuals in the order driven, where significant its upper bound of one sd."""
    from scipy.special import ndtr

    square = float(series.residual @ series.residual)
    if series.dof < MIN_DOF or not square > 0.0:
        return Autocorrelation(0.0, 0.0, 1.0)
    lag_one = float(series.residual @ series.neighbours(series.residual[:, None])[:, 0]) / square
    mean, sd = series.if_independent()
    p_value = float(ndtr((mean - lag_one) / sd))
    if p_value >= WIDENED_BELOW:
        return Autocorrelation(0.0, lag_one, p_value)
    low, high = 0.0, LARGEST
    while high - low > PRECISION:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if series.expected_lag_one(middle) < lag_one + sd else (low, middle)
    return Autocorrelation(high, lag_one, p_value)


def widened(
    estimate: LineEstimate, load_N: FloatArray | None, radius_m: FloatArray, groups: Groups
) -> tuple[LineEstimate, Autocorrelation]:
    """Return an estimate whose intervals allow for autocorrelated runs, and their autocorrelation.

    `estimate` counts every run of a session as independent. `load_N` is the load minus the reference load of each run,
    in the order driven, None for a constant; `radius_m` the effective radius; `groups` the sessions of the runs.
    """
    n = len(radius_m)
    by_session = estimate.dof_between > 0
    means = np.eye(len(groups))[groups.index] if by_session else np.ones((n, 1))
    columns = means if load_N is None or estimate.design == "confounded" else np.column_stack((means, load_N))
    fitted = np.linalg.qr(columns)[0]
    begins = np.ones(n)
    begins[1:] = (np.diff(groups.index) != 0) if by_session else 0.0
    series = _Series(radius_m - fitted @ (fitted.T @ radius_m), fitted, begins)
    found = autocorrelation(series)
    if found.rho == 0.0:
        return estimate, found
    turned = series.correlated(fitted, found.rho)
    cross = fitted.T @ turned
    expected = n - float(np.trace(cross))
    dof = expected**2 / max(
        _square_of(series, found.rho) - 2.0 * float(np.sum(turned**2)) + float(np.sum(cross**2)), 1.0
    )
    # variance of each coefficient over that of independent runs of the same residuals
    solve = np.linalg.pinv(columns)
    spread = solve @ series.correlated(np.ascontiguousarray(solve.T), found.rho)
    ratio = np.diag(spread) / np.diag(solve @ solve.T) * series.dof / expected
    scale = np.sqrt(np.array([ratio[0], ratio[-1]]))
    if by_session:
        # of the runs' stratum the slope alone is taken; sessions stand for the mean
        scale = np.full(2, scale[1])
    factor = np.maximum(scale, 1.0)
    return (
        replace(
            estimate,
            cov_within=estimate.cov_within * np.outer(factor, factor),
            dof_within=min(estimate.dof_within, max(dof, 1.0)),
        ),
        replace(found, slope_ratio=float(factor[1])),
    )


def _square_of(series: _Series, rho: float) -> float:
    """Return the sum of the squared entries of the correlation matrix."""
    return float(series.correlated(np.ones((len(series.residual), 1)), rho**2).sum())
