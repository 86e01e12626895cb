"""Fitting a hypothesis: a recalibration and named effects together, re-simulated and re-linearised until settled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calib.arrays import BoolArray, FloatArray
from calib.gap.data.observations import Observations
from calib.gap.effects.effect import Form
from calib.gap.evidence.marginal import CALIBRATION_SD, columns_of_forms, rows
from calib.gap.evidence.noise import Noise
from calib.gap.predict.path import Path, predict
from calib.gap.predict.push import Push
from calib.gap.predict.residuals import residuals

#: prior standard deviation of each size in typical sizes; wide, it only keeps the solution finite
SIZE_SD = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A fitted hypothesis.

    Parameters
    ----------
    forms : tuple of Form
        Its effects.
    theta : tuple of array, each shape (n_parameters,)
        Their parameters, in the parameters' units.
    calibration : array of float, shape (4,)
        Relative change of left radius, right radius, track, front radius.
    covariance : array of float, shape (4 + n_parameters, 4 + n_parameters)
        Of (calibration, all theta), given the noise.
    path : Path
        The path at the fit.
    chi_square : float
        Whitened sum of squares of what is left.
    left : array of float, shape (n_units, 6)
        What is left, not whitened.
    """

    forms: tuple[Form, ...]
    theta: tuple[FloatArray, ...]
    calibration: FloatArray
    covariance: FloatArray
    path: Path
    chi_square: float
    left: FloatArray

    @property
    def parameters(self) -> FloatArray:
        """All theta end to end in units of their typical size, shape (n_parameters,)."""
        parts = [theta / form.typical for form, theta in zip(self.forms, self.theta, strict=True)]
        return np.concatenate(parts) if parts else np.zeros(0)


def calibration_pushes(s: Observations, calibration: FloatArray, path: Path | None) -> list[Push]:
    """Return the pushes of a recalibration (left, right, track, front), relative, shape (4,)."""
    ones = np.ones(len(s))
    made = [Push(left=ones * calibration[0], right=ones * calibration[1], track=ones * calibration[2])]
    if calibration[3] != 0 and path is not None:
        made.append(Push(reading=path.calibration[:, :, 3] * calibration[3]))
    return made


def hypothesis_path(
    s: Observations, calibration: FloatArray, forms: Sequence[Form], theta: Sequence[FloatArray], about: Path
) -> Path:
    """Re-simulate under a hypothesis whose pushes are taken about a path.

    Parameters
    ----------
    s : Observations
        Units and steps.
    calibration : array of float, shape (4,)
        Relative change of left radius, right radius, track, front radius.
    forms : sequence of Form
        The hypothesis.
    theta : sequence of array of float, each shape (n_parameters,)
        Sizes of each form's parameters, in the parameters' units.
    about : Path
        Where the pushes are taken.
    """
    pushes = calibration_pushes(s, calibration, about)
    for form, sizes in zip(forms, theta, strict=True):
        if np.any(sizes != 0):
            pushes += [push.scaled(float(size)) for push, size in zip(form.pushes(about), sizes, strict=True)]
    return predict(s, pushes)


def fit(
    nominal: Path,
    noise: Noise,
    forms: Sequence[Form] = (),
    *,
    free: npt.ArrayLike = (True, True, True, True),
    use: BoolArray | None = None,
    start: Fitted | None = None,
    steps: int = 10,
    theta_sd: float = SIZE_SD,
) -> Fitted:
    """Fit a recalibration and effects by Gauss-Newton on the re-simulated path.

    Parameters
    ----------
    nominal : Path
        The model alone.
    noise : Noise
        Covariance of each unit.
    forms : sequence of Form
        Effects to fit.
    free : array of bool, shape (4,)
        Which of left radius, right radius, track, front radius may change.
    use : array of bool, shape (n_units,), optional
        Units to fit on; all by default.
    start : Fitted, optional
        Where to begin (its calibration; its parameters where the forms are the same).
    steps : int
        Most Gauss-Newton steps; it ends when a step is below a hundredth of the standard uncertainty.
    theta_sd : float
        Prior standard deviation of each parameter in typical sizes; wide, it only keeps the solution finite.

    Returns
    -------
    Fitted
    """
    s = nominal.s
    freedom = np.asarray(free, dtype=bool).copy()
    if not s.usable[:, 4:].any():
        freedom[3] = False
    calibration = np.zeros(4) if start is None else np.where(freedom, start.calibration, 0.0)
    typical = [form.typical for form in forms]
    known = {} if start is None else {id(f): t for f, t in zip(start.forms, start.theta, strict=True)}
    theta = [known.get(id(form), np.zeros(len(t))).copy() for form, t in zip(forms, typical, strict=True)]
    path = nominal if start is None else hypothesis_path(s, calibration, forms, theta, nominal)
    n_theta = sum(len(t) for t in typical)
    precision = np.concatenate([np.where(freedom, 1.0, 1e12), np.full(n_theta, 1.0 / theta_sd**2)])
    mask = np.ones(len(s), dtype=bool) if use is None else use
    row_mask = np.repeat(mask[:, None], 6, axis=1)[s.usable]
    normal = np.diag(precision)
    for _ in range(steps):
        gap = residuals(path, nominal)
        columns = [path.calibration * CALIBRATION_SD, *columns_of_forms(path, forms)]
        whole = rows(path, noise, np.concatenate([*columns, gap[:, :, None]], axis=2))[row_mask]
        a, r = whole[:, :-1], whole[:, -1]
        now = np.concatenate([calibration / CALIBRATION_SD, *(t / u for t, u in zip(theta, typical, strict=True))])
        normal = a.T @ a + np.diag(precision)
        # a whisker keeps columns exactly alike solvable
        normal += 1e-11 * np.diag(np.diag(normal))
        step = np.linalg.solve(normal, a.T @ r - precision * now)
        scale = np.abs(step) * np.sqrt(np.diag(normal))
        now = now + step
        calibration = np.where(freedom, now[:4] * CALIBRATION_SD, 0.0)
        cuts = np.cumsum([4, *(len(t) for t in typical)])
        theta = [now[a0:b0] * u for a0, b0, u in zip(cuts[:-1], cuts[1:], typical, strict=True)]
        path = hypothesis_path(s, calibration, forms, theta, path)
        if scale.max() < 1e-2:
            break
    left = residuals(path, nominal)
    white = rows(path, noise, left[:, :, None])[:, 0]
    units = np.concatenate([CALIBRATION_SD, *typical]) if typical else CALIBRATION_SD
    covariance = np.linalg.inv(normal) * np.outer(units, units)
    return Fitted(
        forms=tuple(forms),
        theta=tuple(theta),
        calibration=calibration,
        covariance=covariance,
        path=path,
        chi_square=float((white[row_mask] ** 2).sum()),
        left=left,
    )
