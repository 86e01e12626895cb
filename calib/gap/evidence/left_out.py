"""What a fit on some of the runs leaves on the others, to first order about the fit on all of them."""

from __future__ import annotations

from functools import cached_property
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.gap.data.observations import Observations
from calib.gap.evidence.fit import Fitted
from calib.gap.evidence.marginal import CALIBRATION_SD, columns_of_forms, rows
from calib.gap.evidence.noise import Noise
from calib.gap.evidence.system import LinearSystem
from calib.gap.evidence.weighting import Weighting, prior_precision
from calib.gap.predict.path import Path

#: variance of a foretold correction, at most, as a share of its square
FORETELLS: Final = 0.1


class LeftOut:
    """Leaves runs out of a fit in turn.

    Parameters
    ----------
    fitted : Fitted
        The hypothesis, fitted on all runs.
    nominal : Path
        The model alone.
    noise : Noise
        Covariance of each unit.
    weighting : Weighting, optional
        Of the rest beside it; none by default.
    """

    def __init__(self, fitted: Fitted, nominal: Path, noise: Noise, weighting: Weighting | None = None) -> None:
        self.fitted, self.noise = fitted, noise
        if weighting is None:
            system = LinearSystem(fitted, nominal, noise, fitted.forms)
            weighting = Weighting.from_rest(system, -1, 0.0, np.zeros((len(system.gap), 0)))
        self.weighting = weighting
        system = weighting.system
        numbers = [next(k for k, form in enumerate(system.forms) if form is own) for own in fitted.forms]
        self.columns = np.concatenate([system.calibration, *(system.of(k) for k in numbers)], axis=1)
        self.precision = prior_precision(self.columns.shape[1])
        self._solved: dict[bytes, tuple[FloatArray, FloatArray]] = {}

    @property
    def observations(self) -> Observations:
        """Units and steps."""
        return self.fitted.path.s

    @cached_property
    def everything(self) -> FloatArray:
        """Estimates on all runs, shape (p,)."""
        return self.weighting.solve(self.columns, self.precision)[0]

    @cached_property
    def derivative(self) -> FloatArray:
        """What each estimate does to the readings, shape (n_units, n_channels, p)."""
        path = self.fitted.path
        parts = [path.calibration * CALIBRATION_SD, *columns_of_forms(path, self.fitted.forms)]
        return np.where(path.s.usable[:, :, None], np.concatenate(parts, axis=2), 0.0)

    def after(self, out: BoolArray) -> FloatArray:
        """Return the residuals, (n_units, n_channels), of the fit without the units `out`."""
        if out.all():
            return self.fitted.left
        estimates = self._without(out)[0]
        left: FloatArray = self.fitted.left - self.derivative @ (estimates - self.everything)
        return left

    def _without(self, out: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Return estimates (p,) and covariance (p, p) without the units `out`; kept, as both are asked for in turn."""
        key = out.tobytes()
        if key not in self._solved:
            self._solved[key] = self.weighting.solve(self.columns, self.precision, use=~out)
        return self._solved[key]

    def foretells(self, out: BoolArray) -> bool:
        """Return whether the other units determine what the correction does on the units `out`.

        Where they do not (a turn's effect without any turn), leaving out says nothing for the correction or against it.
        """
        covariance = self._without(out)[1]
        on = out[self.weighting.system.blocks.unit]
        correction = self.columns[on] @ self.everything
        uncertain = np.einsum("np,pq,nq->", self.columns[on], covariance, self.columns[on])
        return bool(uncertain < FORETELLS * float(correction @ correction) + on.sum())

    def squares(self, residuals: FloatArray) -> FloatArray:
        """Return the whitened squares of each unit, shape (n_units,)."""
        path = self.fitted.path
        white = rows(path, self.noise, residuals[:, :, None])[:, 0]
        unit = np.repeat(np.arange(len(path.s))[:, None], path.s.usable.shape[1], axis=1)[path.s.usable]
        return np.bincount(unit, white**2, len(path.s)).astype(np.float64)

    def spread(self, change: FloatArray, units: BoolArray) -> float:
        """Return the standard deviation, rest included, of the gap along a change of some units' readings."""
        path, order = self.fitted.path, self.weighting.system.blocks.order
        white = rows(path, self.noise, change[:, :, None])[order, 0]
        return self.weighting.spread(white, units)
