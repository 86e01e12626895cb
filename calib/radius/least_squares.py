"""Ordinary least squares of a line, every run counted as independent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PlainLine:
    """A line and what its intervals rest on."""

    #: value at x = 0 and slope, shape (2,), and their covariance, shape (2, 2)
    coefficients: FloatArray
    covariance: FloatArray
    #: shape (n,): y minus line
    residual: FloatArray
    #: variance of a single value about the line, and its degrees of freedom
    variance: float
    dof: float
    #: covariance that holds whatever the scatter does along x (HC3, MacKinnon and White 1985), shape (2, 2)
    robust_covariance: FloatArray


def fit_line(x: FloatArray, y: FloatArray) -> PlainLine:
    """Fit ``y = a + b x``, shape (n,) both, by QR.

    By hand: statsmodels, whose digits these are, takes longer to import than a thousand logs from the cache.
    """
    design = np.column_stack((np.ones_like(x), x))
    q, r = np.linalg.qr(design)
    coefficients = np.linalg.solve(r, q.T @ y)
    inverse = np.linalg.inv(r.T @ r)
    residual = y - design @ coefficients
    dof = float(len(y) - np.linalg.matrix_rank(r))
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = float(residual @ residual / np.float64(dof))
        # a run that alone carries the line has a leverage of one and no scatter to tell
        weighted = np.linalg.pinv(design) * (residual / (1.0 - np.einsum("ij,jk,ik->i", design, inverse, design)))
    return PlainLine(coefficients, inverse * variance, residual, variance, dof, weighted @ weighted.T)
