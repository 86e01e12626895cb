"""Covariance of the parameters that holds where noise is shared within blocks: a sandwich for small samples.

Bell and McCaffrey's bias-reduced form (CR2) and their degrees of freedom (Survey Methodology 28, 2002; Pustejovsky and
Tipton, JBES 36, 2018), on the whitened, weighted problem of the robust fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.geometry.solve import DEGREES, Solution

__all__ = ["OF_RUNS", "Uncertainty", "block_scores", "sandwich", "unit_information", "whitened"]
#: power that is unbiased for known weights (CR2); 1 is the jackknife (CR3)
UNBIASED: Final = 0.5
#: for single runs and blocks, from which the noise's sizes are estimated too; the coverage lies between the two
OF_RUNS: Final = 0.75
#: part of the scores' variance that errors shared with neighbours can take away
MOST_SHARED: Final = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """Covariance of the free parameters and the degrees of freedom of each.

    Parameters
    ----------
    covariance : array of float, shape (n_free, n_free)
        Of the free parameters.
    dof : array of float, shape (n_free,)
        Degrees of freedom of each standard deviation.
    clusters : int
        Groups whose noise was taken for independent.
    """

    covariance: FloatArray
    dof: FloatArray
    clusters: int

    @property
    def std(self) -> FloatArray:
        """Standard deviations, shape (n_free,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def half_widths(self, level: float = 0.95) -> FloatArray:
        """Return the half widths of intervals of probability `level`, shape (n_free,)."""
        from scipy.special import stdtrit

        return np.asarray(self.std * stdtrit(self.dof, 0.5 + 0.5 * level))


def whitened(solution: Solution, free: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return Jacobian, shape (n, 3, n_free), and residuals, shape (n, 3), whitened and weighted."""
    root = np.sqrt(solution.weights)[:, None]
    jacobian = (solution.whitener @ solution.prediction.jacobian[:, :, free]) * root[:, :, None]
    return jacobian, np.einsum("nij,nj->ni", solution.whitener, solution.prediction.residuals) * root


def block_scores(solution: Solution, free: BoolArray, block: IntArray) -> FloatArray:
    """Return the pull of each block on the parameters, in units of unit information, shape (n_blocks, n_free)."""
    jacobian, residuals = whitened(solution, free)
    scores = np.einsum("nip,ni->np", jacobian, residuals)
    total = np.stack([np.bincount(block, scores[:, at]) for at in range(scores.shape[1])], axis=1)
    return np.asarray(total @ unit_information(solution, free).T)


def unit_information(solution: Solution, free: BoolArray) -> FloatArray:
    """Return what turns pulls on the parameters into pulls in units of unit information, shape (n_free, n_free)."""
    flat = whitened(solution, free)[0].reshape(-1, int(free.sum()))
    return np.asarray(np.linalg.inv(np.linalg.cholesky(flat.T @ flat)))


def sandwich(
    solution: Solution, free: BoolArray, cluster: IntArray, shared: FloatArray | None = None, *, power: float = UNBIASED
) -> Uncertainty:
    """Return the covariance of the free parameters.

    Parameters
    ----------
    solution : Solution
        Of the robust fit.
    free : array of bool, shape (n_parameters,)
        Which parameters were free.
    cluster : array of int, shape (n,)
        Stretches of one cluster share their noise.
    shared : array of float, shape (n_free, n_free), optional
        Products of the scores of neighbouring clusters, from `calib.geometry.shared_ends.shared_end_scores`.
    power : float
        Of what leverage takes from the residuals; they are enlarged by it.
    """
    jacobian, residuals = whitened(solution, free)
    n_free = jacobian.shape[2]
    flat = jacobian.reshape(-1, n_free)
    scale = 1.0 / np.sqrt(np.maximum(np.square(flat).sum(axis=0), 1e-300))
    flat = flat * scale
    root = np.linalg.cholesky(np.linalg.inv(flat.T @ flat))
    # columns of unit information: the normal matrix is the identity
    flat = flat @ root
    cluster = np.unique(cluster, return_inverse=True)[1]
    order = np.argsort(np.repeat(cluster, 3), kind="stable")
    ends = np.concatenate(([0], np.cumsum(3 * np.bincount(cluster))))
    pulls, sizes, shares = [], [], []
    contrast = root.T  # columns: what a unit of each parameter is in the new columns
    for low, high in pairwise(ends):
        rows = order[low:high]
        part, rest = flat[rows], residuals.ravel()[rows]
        left, singular, right = np.linalg.svd(part, full_matrices=False)
        grow = np.maximum(1.0 - singular**2, 1e-6) ** -power - 1.0
        lever = part + left @ ((grow * singular)[:, None] * right)
        pulls.append(lever.T @ rest)
        seen = lever @ contrast
        sizes.append(np.square(seen).sum(axis=0))
        shares.append(part.T @ seen)
    meat = np.stack(pulls)
    factor = _influence(solution)
    total = meat.T @ meat
    if shared is not None:
        total = _with_neighbours(total, root.T @ (shared * np.outer(scale, scale)) @ root)
    inner = root @ total @ root.T
    covariance = factor**2 * inner * np.outer(scale, scale)
    dof = _degrees(np.stack(sizes), np.stack(shares))
    return Uncertainty(covariance, dof, len(meat))


def _with_neighbours(total: FloatArray, shared: FloatArray) -> FloatArray:
    """Return the covariance of the scores with that of neighbours; no direction loses more than `MOST_SHARED` of it."""
    root = np.linalg.cholesky(total + 1e-12 * np.trace(total) * np.eye(len(total)))
    inverse = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inverse @ (shared + shared.T) @ inverse.T)
    inner = (vectors * np.maximum(1.0 + values, 1.0 - MOST_SHARED)) @ vectors.T
    return np.asarray(root @ inner @ root.T)


def _degrees(sizes: FloatArray, shares: FloatArray) -> FloatArray:
    """Return Bell and McCaffrey's degrees of freedom of each parameter's variance."""
    found = []
    for at in range(sizes.shape[1]):
        inner = np.diag(sizes[:, at]) - shares[:, :, at] @ shares[:, :, at].T
        found.append(np.trace(inner) ** 2 / np.maximum(np.square(inner).sum(), 1e-300))
    return np.maximum(np.asarray(found, dtype=np.float64), 1.0)


def _influence(solution: Solution) -> float:
    """Return by how much the weights overstate the information: mean weight over mean slope of the influence."""
    size = np.maximum(solution.prediction.jacobian.any(axis=2).sum(axis=1), 1)
    squares = (DEGREES + size) / solution.weights - DEGREES
    slope = solution.weights * (1.0 - 2.0 * squares / (size * (DEGREES + squares)))
    return float(np.mean(solution.weights) / max(np.mean(slope), 0.2 * np.mean(solution.weights)))
