"""How much of the gap goes with one covariate, and whether that can be chance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import BoolArray, FloatArray, IntArray, StrArray
from calib.gap.data.channels import Channel
from calib.gap.where.covariates import FEWEST_UNITS
from calib.gap.where.result import CovariateLine


def dependence_on(
    name: str, values: FloatArray | StrArray, scaled: FloatArray, weights: FloatArray, most_dof: float
) -> CovariateLine | None:
    """Test a covariate in every channel by an F test of the gap over its floor; None where no channel allows it.

    Parameters
    ----------
    name : str
        Of the covariate.
    values : array of float or str, shape (n_units,)
        Its values.
    scaled : array of float, shape (n_units, n_channels)
        Gap over floor; NaN where a unit lacks the channel.
    weights : array of float, shape (n_draws, n_units)
        How often the bootstrap draws each unit.
    most_dof : float
        How well the floor is known.

    Returns
    -------
    CovariateLine or None
        The channel with the smallest p, multiplied by the number of channels; not yet held to the table's error.
    """
    best: tuple[float, Channel, _Dependence] | None = None
    tried = 0
    for channel in Channel:
        dependence = _Dependence.of(values, scaled[:, channel])
        if dependence is None:
            continue
        tried += 1
        p = dependence.p_value(most_dof)
        if best is None or p < best[0]:
            best = (p, channel, dependence)
    if best is None:
        return None
    p, channel, dependence = best
    shares = dependence.shares(weights[:, dependence.on])
    return CovariateLine(
        name=name,
        channel=channel,
        share=dependence.share(),
        ci95=interval(shares),
        p_value=float(min(1.0, p * tried)),
        significant=False,
        n_units=int(dependence.on.sum()),
    )


def interval(shares: FloatArray) -> tuple[float, float] | None:
    """Return the middle 95 % of bootstrapped shares (n_draws,); None where most of them are unknown."""
    known = shares[np.isfinite(shares)]
    if len(known) < 0.5 * len(shares):
        return None
    return float(np.quantile(known, 0.025)), float(np.quantile(known, 0.975))


@dataclass(frozen=True, slots=True, eq=False)
class _Dependence:
    """One channel's gap over its floor, y, against one covariate."""

    on: BoolArray
    y: FloatArray
    x: FloatArray | None
    group: IntArray | None

    @staticmethod
    def of(values: FloatArray | StrArray, y: FloatArray) -> _Dependence | None:
        if values.dtype.kind == "f":
            on = np.isfinite(y) & np.isfinite(values)
            x = np.asarray(values[on], dtype=np.float64)
            if on.sum() < FEWEST_UNITS or np.ptp(x) <= 1e-9 * max(float(np.abs(x).max()), 1e-9):
                return None
            return _Dependence(on, y[on], (x - x.mean()) / np.std(x), None)
        on = np.isfinite(y) & (values != "")
        names, group = np.unique(values[on], return_inverse=True)
        if len(names) < 2 or on.sum() < max(FEWEST_UNITS, 2 * len(names)):
            return None
        return _Dependence(on, y[on], None, np.asarray(group, dtype=np.int64))

    @property
    def df(self) -> int:
        """Degrees of freedom of the covariate."""
        return 1 if self.group is None else int(self.group.max())

    def squares(self, weight: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (about the mean, explained, units) for weights (n_draws, n), each shape (n_draws,)."""
        n = weight.sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = weight @ self.y / n
            total = weight @ self.y**2 - n * mean**2
            if self.group is None:
                assert self.x is not None
                mean_x = weight @ self.x / n
                cross = weight @ (self.x * self.y) - n * mean * mean_x
                explained = cross**2 / (weight @ self.x**2 - n * mean_x**2)
            else:
                member = (self.group[:, None] == np.arange(self.df + 1)).astype(np.float64)
                size, summed = weight @ member, weight @ (member * self.y[:, None])
                explained = np.where(size > 0, summed**2 / size, 0.0).sum(axis=1) - n * mean**2
        return total, explained, n

    def p_value(self, most_dof: float) -> float:
        """Return the p of an F test, the residual taken as no smaller than the floor and known no better than that."""
        from scipy.special import fdtrc

        total, explained, n = (float(part[0]) for part in self.squares(np.ones((1, len(self.y)))))
        dof = n - self.df - 1.0
        residual = max((total - explained) / dof, 1.0)
        return float(fdtrc(self.df, min(dof, most_dof), max(explained, 0.0) / self.df / residual))

    def shares(self, weight: FloatArray) -> FloatArray:
        """Return the share of the variance beyond the floor that the covariate explains, for weights (n_draws, n)."""
        total, explained, n = self.squares(weight)
        with np.errstate(divide="ignore", invalid="ignore"):
            residual = np.maximum((total - explained) / np.maximum(n - self.df - 1.0, 1.0), 1.0)
            beyond = total - (n - 1.0)
            share = np.where(beyond > 0, (explained - self.df * residual) / beyond, 0.0)
        return np.asarray(np.clip(share, 0.0, 1.0))

    def share(self) -> float:
        """Return the share itself."""
        return float(self.shares(np.ones((1, len(self.y))))[0])
