"""One Gauss-Newton step of a hypothesis, as far as the linear picture holds."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.evidence.fit import Fitted, hypothesis_path
from calib.gap.evidence.marginal import CALIBRATION_SD, rows
from calib.gap.evidence.system import LinearSystem
from calib.gap.evidence.weighting import Weighting, prior_precision
from calib.gap.predict.residuals import residuals

#: of a step that runs away: to a sixty-fourth, which is next to none
_HALVINGS: Final = 6
#: what a step may leave over what was left before or is to be left, whichever is more
_MOST: Final = 2.0


def stepped(system: LinearSystem, model: Sequence[int], weighting: Weighting) -> Fitted:
    """Return a hypothesis fitted in the linear picture about a path, and re-simulated.

    From the sizes at that path it goes as far as the picture holds: a step that leaves more than twice what was left
    before, and than what it was to leave, is halved.

    Parameters
    ----------
    system : LinearSystem
        About the path.
    model : sequence of int
        Forms of the hypothesis, by their numbers in the system.
    weighting : Weighting
        The rest, and what effects may deviate by.
    """
    columns = np.concatenate([system.calibration, *(system.of(k) for k in model)], axis=1)
    units = np.concatenate([CALIBRATION_SD, *(system.forms[k].typical for k in model)])
    sizes, covariance = weighting.solve(columns, prior_precision(columns.shape[1]))
    if not system.path.s.usable[:, 4:].any():
        sizes[3] = 0.0
    present, before = _present(system, model) / units, weighting.square(system.left)
    for halvings in range(_HALVINGS + 1):
        values = present + (sizes - present) / 2**halvings
        fitted, left = _at(system, model, values * units, covariance * np.outer(units, units))
        if weighting.square(left) <= _MOST * max(before, weighting.square(system.gap - columns @ values)):
            break
    return fitted


def _present(system: LinearSystem, model: Sequence[int]) -> FloatArray:
    """Return the calibration and the sizes of a model's forms at the path, shape (4 + n_parameters,)."""
    held = {id(form): theta for form, theta in zip(system.fitted.forms, system.fitted.theta, strict=True)}
    forms = [system.forms[k] for k in model]
    sizes = [held.get(id(form), np.zeros(len(form.parameters))) for form in forms]
    return np.concatenate([system.fitted.calibration, *sizes])


def _at(
    system: LinearSystem, model: Sequence[int], values: FloatArray, covariance: FloatArray
) -> tuple[Fitted, FloatArray]:
    """Return a hypothesis re-simulated at (4 + n_parameters,) values, and what is left, whitened, shape (n_rows,)."""
    forms, calibration = tuple(system.forms[k] for k in model), values[:4]
    cuts = np.cumsum([4, *(len(form.parameters) for form in forms)])
    theta = tuple(values[first:last] for first, last in pairwise(cuts))
    path = hypothesis_path(system.path.s, calibration, forms, theta, system.path)
    left = residuals(path, system.nominal)
    white = rows(path, system.noise, left[:, :, None])[system.blocks.order, 0]
    return Fitted(forms, theta, calibration, covariance, path, float(white @ white), left), white
