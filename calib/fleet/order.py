"""Sums of a wheel's runs in the order driven, and intervals that allow for runs that scatter alike.

What `calib.radius.order` does with the runs, from sums: a first-order autoregression within each session, its lag-one
autocorrelation freed of the bias that the session means give it. The slope's variance is that of two autoregressive
series, ``(1 + rho phi) / (1 - rho phi)``, ``phi`` the lag-one autocorrelation of the loads (Bartlett 1935).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from calib.radius.law import LineEstimate
from calib.radius.order import LARGEST, MIN_DOF, PRECISION, WIDENED_BELOW
from calib.radius.sessions import SessionSums
from calib.types import FloatArray, StrArray

#: columns of a row of `WheelSums.order`
N_ORDER: Final = 6


@dataclass(frozen=True, slots=True, eq=False)
class WheelSums:
    """Sums over the runs of a wheel, which add.

    Parameters
    ----------
    runs : SessionSums
        By session.
    order : array of float, shape (n_sessions, 6)
        Over pairs of runs that follow each other in a session: their number; sums of the products of load and load,
        load and radius (half of either way), radius and radius; sums of both loads, of both radii.
    whole : array of float, shape (6,)
        The same over all runs of a file, sessions disregarded.
    """

    runs: SessionSums
    order: FloatArray
    whole: FloatArray

    @staticmethod
    def from_runs(session: StrArray, load_N: FloatArray, radius_m: FloatArray, day: FloatArray) -> WheelSums:
        """Return the sums of runs in the order driven, each argument of shape (n_runs,)."""
        runs = SessionSums.from_runs(session, load_N, radius_m, day)
        index = np.searchsorted(runs.session, session)
        together = np.argsort(index, kind="stable")
        at, pairs = index[together], _pairs(load_N[together], radius_m[together])
        same = at[1:] == at[:-1]
        order = np.zeros((len(runs.session), N_ORDER))
        np.add.at(order, at[1:][same], pairs[same])
        return WheelSums(runs, order, _pairs(load_N, radius_m).sum(axis=0))

    @staticmethod
    def from_dict(value: Mapping[str, Any]) -> WheelSums:
        """Return what was kept."""
        kept = value["runs"]
        table = np.array(kept["table"], dtype=np.float64).reshape(-1, 8)
        labels = np.array(kept["session"], dtype=np.str_)
        runs = SessionSums(labels, table, float(kept["load_min_N"]), float(kept["load_max_N"]))
        order = np.array(value["order"], dtype=np.float64).reshape(-1, N_ORDER)
        return WheelSums(runs, order, np.array(value["whole"], dtype=np.float64))

    def added(self, other: WheelSums) -> WheelSums:
        """Return the sums of both, sessions of the same label as one."""
        runs = self.runs.added(other.runs)
        order = np.zeros((len(runs.session), N_ORDER))
        for part in (self, other):
            np.add.at(order, np.searchsorted(runs.session, part.runs.session), part.order)
        return WheelSums(runs, order, self.whole + other.whole)


def _pairs(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the terms of `WheelSums.order` of each run and the next, shape (n_runs - 1, 6)."""
    x0, x1, y0, y1 = x[:-1], x[1:], y[:-1], y[1:]
    return np.stack([np.ones_like(x0), x0 * x1, 0.5 * (x0 * y1 + y0 * x1), y0 * y1, x0 + x1, y0 + y1], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """Residuals in blocks that are independent of each other, each about its own mean, the loads' slope removed."""

    sizes: FloatArray
    #: lag-one autocorrelation of the residuals, and of the loads where a slope is fitted to them, else None
    lag_one: float
    of_loads: float | None

    def loads_ratio(self, rho: float) -> float:
        """Return the variance of the slope over that of independent runs."""
        product = rho * max(self.of_loads or 0.0, 0.0)
        return (1.0 + product) / (1.0 - product)

    def expected(self, rho: float) -> tuple[float, float, float]:
        """Return what the lag-one product, the square, and the squared covariance of the residuals amount to."""
        product = square = squared = 0.0
        for n, count in zip(*np.unique(self.sizes, return_counts=True), strict=True):
            powers = rho ** np.arange(n)
            # sums of the rows of the correlation matrix
            rows = np.cumsum(powers) + np.cumsum(powers)[::-1] - 1.0
            total, alike = float(rows.sum()), float((n - np.arange(n)) @ (powers**2) * 2.0 - n)
            product += count * ((n - 1) * rho - 2.0 / n * (total - rows[0]) + (n - 1) * total / n**2)
            square += count * (n - total / n)
            squared += count * (alike - 2.0 / n * float(rows @ rows) + (total / n) ** 2)
        if self.of_loads is not None:
            ratio = self.loads_ratio(rho)
            product, square, squared = product - self.of_loads * ratio, square - ratio, squared - ratio**2
        return float(product), float(square), float(squared)

    @property
    def std(self) -> float:
        """Standard deviation of the lag-one autocorrelation of independent runs."""
        n = self.sizes
        squares = float(np.sum(0.5 * (n - 1.0) - 2.0 * (n - 1.5) / n + ((n - 1.0) / n) ** 2))
        squares -= (self.of_loads or 0.0) ** 2
        product, dof, _ = self.expected(0.0)
        return float(np.sqrt(max(2.0 * (dof * squares - product**2) / (dof**2 * (dof + 2.0)), 1e-12)))


def widened(estimate: LineEstimate, sums: WheelSums) -> tuple[LineEstimate, float]:
    """Return an estimate whose intervals allow for autocorrelated runs, and their autocorrelation.

    The autocorrelation is 0 where none is significant, else its upper bound of one standard deviation.
    """
    from scipy.special import ndtr

    by_session = estimate.dof_between > 0
    blocks = _blocks_of(estimate, sums)
    if blocks is None:
        return estimate, 0.0
    product, dof, _ = blocks.expected(0.0)
    std = blocks.std
    if dof < MIN_DOF or float(ndtr((product / dof - blocks.lag_one) / std)) >= WIDENED_BELOW:
        return estimate, 0.0
    low, high = 0.0, LARGEST
    while high - low > PRECISION:
        middle = 0.5 * (low + high)
        product, square, _ = blocks.expected(middle)
        low, high = (middle, high) if product / square < blocks.lag_one + std else (low, middle)
    _, square, squared = blocks.expected(high)
    of_slope = blocks.loads_ratio(high) * dof / square
    scale = np.array([of_slope, of_slope])
    if not by_session:
        # the mean of the runs and the slope make up the radius at the reference load
        n, x = float(sums.runs.n_runs), float(sums.runs.table[:, 1].sum())
        rows = np.cumsum(high ** np.arange(n))
        of_mean = float(2.0 * rows.sum() - n) / n * dof / square
        spread = float(sums.runs.table[:, 3].sum()) - x**2 / n
        lever = (x / n) ** 2 / spread
        scale[0] = (of_slope * lever + of_mean / n) / (lever + 1.0 / n)
    factor = np.sqrt(np.maximum(scale, 1.0))
    cov_within = estimate.cov_within * np.outer(factor, factor)
    dof_within = min(estimate.dof_within, max(square**2 / max(squared, 1.0), 1.0))
    return replace(estimate, cov_within=cov_within, dof_within=dof_within), high


def _blocks_of(estimate: LineEstimate, sums: WheelSums) -> _Blocks | None:
    """Return the residuals' blocks: sessions where there are several, else all runs; None where nothing scatters."""
    n, x, y, xx, xy, yy = sums.runs.table[:, :6].T
    pairs, xx1, xy1, yy1, x_both, y_both = sums.order.T
    if not estimate.dof_between > 0:
        n, x, y, xx, xy, yy = sums.runs.table[:, :6].sum(axis=0, keepdims=True).T
        pairs, xx1, xy1, yy1, x_both, y_both = sums.whole[:, None]
    x_mean, y_mean = x / n, y / n
    info, cross, square = ((own - n * one * other).sum() for own, one, other in
                           ((xx, x_mean, x_mean), (xy, x_mean, y_mean), (yy, y_mean, y_mean)))  # fmt: skip
    near_xx = float((xx1 - x_mean * x_both + pairs * x_mean**2).sum())
    near_xy = float((xy1 - 0.5 * (x_mean * y_both + y_mean * x_both) + pairs * x_mean * y_mean).sum())
    near_yy = float((yy1 - y_mean * y_both + pairs * y_mean**2).sum())
    with_slope = estimate.design != "confounded" and info > 0.0
    slope = cross / info if with_slope else 0.0
    residual = square - slope * cross
    if not residual > 0.0:
        return None
    lag_one = float((near_yy - 2.0 * slope * near_xy + slope**2 * near_xx) / residual)
    return _Blocks(n[n > 1.0], lag_one, float(near_xx / info) if with_slope else None)
