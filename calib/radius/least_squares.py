"""Least squares of few columns, by Householder's QR; a statistics package's own import takes longer than many a fit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.arrays import FloatArray

__all__ = ["LeastSquares", "least_squares"]


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """A least-squares fit.

    Parameters
    ----------
    params : array of float, shape (k,)
        Coefficients.
    residual : array of float, shape (n,)
        What the fit leaves.
    design : array of float, shape (n, k)
        Columns.
    inverse : array of float, shape (k, k)
        Of the normal matrix.
    """

    params: FloatArray
    residual: FloatArray
    design: FloatArray
    inverse: FloatArray

    @property
    def dof(self) -> float:
        """Degrees of freedom of the residuals; the columns are independent of one another."""
        return float(len(self.residual) - len(self.params))

    @property
    def variance(self) -> float:
        """Mean square of the residuals."""
        return float(self.residual @ self.residual) / self.dof

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the coefficients where all rows scatter alike, shape (k, k)."""
        return np.asarray(self.inverse * self.variance)

    @cached_property
    def covariance_hc3(self) -> FloatArray:
        """Covariance where the scatter may differ from row to row (HC3, MacKinnon and White 1985), shape (k, k)."""
        leverage = np.einsum("ij,ik,kj->i", self.design, self.design, self.inverse)
        square = (self.residual / (1 - leverage)) ** 2
        pseudo_inverse = np.linalg.pinv(self.design)
        return np.asarray(pseudo_inverse @ (square[:, None] * pseudo_inverse.T))


def least_squares(y: FloatArray, columns: FloatArray) -> LeastSquares:
    """Fit ``y`` by a sum of columns.

    Parameters
    ----------
    y : array of float, shape (n,)
        What is to be fitted.
    columns : array of float, shape (n, k)
        Linearly independent of one another.

    Returns
    -------
    LeastSquares
    """
    orthogonal, upper = np.linalg.qr(columns)
    params = np.linalg.solve(upper, orthogonal.T @ y)
    return LeastSquares(params, y - columns @ params, columns, np.linalg.inv(upper.T @ upper))
