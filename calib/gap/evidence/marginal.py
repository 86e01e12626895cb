"""The whitened linear picture of the gap about one path, and the evidence of Gaussian hypotheses in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Form
from calib.gap.evidence.noise import Noise
from calib.gap.predict.path import Path, signature

#: prior standard deviation of a plain recalibration: left, right radius, track, front radius (relative); the front
#: radius is held, because a front wheel that disagrees with the rear ones is a gap to be named
CALIBRATION_SD: Final = np.array([0.03, 0.03, 0.1, 1e-6])

#: degrees of freedom by which the floor as a whole is known before the gap is looked at; the rest of what is known of
#: it comes from the same runs
FLOOR_DOF: Final = 20.0


def rows(path: Path, noise: Noise, columns: FloatArray) -> FloatArray:
    """Whiten columns (n_units, 6, k) and lay the usable rows end to end, shape (n_rows, k)."""
    masked = np.where(path.s.usable[:, :, None], columns, 0.0)
    whitened: FloatArray = (noise.whitener @ masked)[path.s.usable]
    return whitened


def form_columns(path: Path, form: Form) -> FloatArray:
    """Return the signatures of a form's parameters, each times its typical size, shape (n_units, 6, n_parameters)."""
    return columns_of_forms(path, [form])[0]


def columns_of_forms(path: Path, forms: Sequence[Form]) -> list[FloatArray]:
    """Return `form_columns` of many forms, every part of the path gone through once for all of them."""
    if not forms:
        return []
    pushes = [None if form.by_parts else form.pushes(path) for form in forms]
    columns = [np.zeros((len(path.s), path.s.usable.shape[1], len(form.parameters))) for form in forms]
    for units, part in path.parts():
        for form, whole, column in zip(forms, pushes, columns, strict=True):
            some = form.pushes(part) if whole is None else [push.part(units, path.s) for push in whole]
            for number, (push, parameter) in enumerate(zip(some, form.parameters, strict=True)):
                column[units, :, number] = signature(part, push) * parameter.typical
    return columns


@dataclass(frozen=True, slots=True, eq=False)
class Nuisance:
    """What is left out of the judgement: a recalibration, and what known effects may deviate by.

    Parameters
    ----------
    columns : array of float, shape (n_rows, k)
        Whitened, each scaled to unit prior variance.
    factor : array of float, shape (k, k)
        Inverse Cholesky factor of I + X^T X.
    log_det : float
        log |I + X X^T|.
    """

    columns: FloatArray
    factor: FloatArray
    log_det: float

    @staticmethod
    def of(columns: FloatArray) -> Nuisance:
        """Make it of whitened columns scaled to unit prior variance, shape (n_rows, k)."""
        gram = np.eye(columns.shape[1]) + columns.T @ columns
        # scaled to a unit diagonal: columns of very different size, or exactly alike, stay factorable
        root = np.sqrt(np.diag(gram))
        lower = np.linalg.cholesky(gram / np.outer(root, root) + 1e-11 * np.eye(len(gram)))
        inverse = np.linalg.solve(lower, np.diag(1.0 / root))
        return Nuisance(columns, inverse, float(2 * (np.log(np.diag(lower)) + np.log(root)).sum()))

    def scalar(self, left: FloatArray, right: FloatArray) -> FloatArray:
        """Return left^T (I + X X^T)^-1 right for columns (n_rows, p) and (n_rows, q), shape (p, q)."""
        a, b = self.factor @ (self.columns.T @ left), self.factor @ (self.columns.T @ right)
        made: FloatArray = left.T @ right - a.T @ b
        return made


def log_marginal(square: float | FloatArray, log_det: float | FloatArray, n_rows: int) -> FloatArray:
    """Return the log evidence of a Gaussian hypothesis whose floor is known up to a common factor.

    The factor is integrated out, so that a floor too small by a quarter, or tails heavier than normal, do not pass for
    a cause: Student's t in place of the normal density, without its constant.

    Parameters
    ----------
    square : float or array of float
        y^T C^-1 y of the hypothesis' covariance C in units of the floor.
    log_det : float or array of float
        log |C|, same shape.
    n_rows : int
        Length of y.
    """
    spread = -0.5 * (FLOOR_DOF + n_rows) * np.log1p(np.asarray(square) / FLOOR_DOF)
    return np.asarray(spread - 0.5 * np.asarray(log_det))


def project(nuisance: Nuisance, columns: FloatArray) -> FloatArray:
    """Return (I + X X^T)^(-1/2)-like projected columns: what is left of them once the nuisance took its share.

    The result P has P^T P equal to the scalar product of `Nuisance.scalar` in the limit of a broad nuisance.
    """
    weights = nuisance.factor.T @ (nuisance.factor @ (nuisance.columns.T @ columns))
    made: FloatArray = columns - nuisance.columns @ weights
    return made


def ridge_solve(gram: FloatArray, right: FloatArray, ridge: float) -> FloatArray:
    """Solve (G + ridge I) x = g, scaled to a unit diagonal so that columns exactly alike do no harm.

    Parameters
    ----------
    gram : array of float, shape (..., p, p)
        Scalar products of the columns.
    right : array of float, shape (..., p)
        Their scalar products with the residual.
    ridge : float
        Added to the diagonal.

    Returns
    -------
    array of float, shape (..., p)
    """
    eye = np.eye(gram.shape[-1])
    size = np.sqrt(np.diagonal(gram, axis1=-2, axis2=-1) + ridge)
    scaled = (gram + ridge * eye) / (size[..., :, None] * size[..., None, :]) + 1e-10 * eye
    made: FloatArray = np.linalg.solve(scaled, (right / size)[..., None])[..., 0] / size
    return made
