"""Covariance of the parameters that holds where noise is shared within blocks: a sandwich for small samples.

Bell and McCaffrey's bias-reduced form (CR2) and their degrees of freedom (Survey Methodology 28, 2002; Pustejovsky and
Tipton, JBES 36, 2018), on the whitened, weighted problem of the robust fit. Where blocks follow one another along the
way, what neighbours share is allowed for by cosines: see `slow_cosines`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.geometry.solve import DEGREES, Solution

__all__ = ["OF_RUNS", "Uncertainty", "block_scores", "sandwich", "slow_cosines", "whitened"]
#: power that is unbiased for known weights (CR2); 1 is the jackknife (CR3)
UNBIASED: Final = 0.5
#: for single runs, from which the noise's sizes are estimated too; the coverage lies between the two
OF_RUNS: Final = 0.75
#: cosines for n blocks: this times n to the power 2/3
COSINES: Final = 0.41


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
        Groups whose noise was taken for independent, or shared with neighbours.
    apart : array of float, shape (n_free,)
        Standard deviations as if no group shared anything: less right, but steadier, to compare estimates by.
    """

    covariance: FloatArray
    dof: FloatArray
    clusters: int
    apart: FloatArray

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
    flat = jacobian.reshape(-1, jacobian.shape[2])
    return np.asarray(total @ np.linalg.inv(np.linalg.cholesky(flat.T @ flat)).T)


def slow_cosines(n: int, least: int = 1) -> FloatArray:
    """Return the cosines over `n` blocks whose sums of pulls say how much the sum of all pulls may be off.

    Neighbours that share an error, of the pose between them or of a reference that errs alike for long, do not add up
    as independent ones do: either sign of correlation is possible. What matters is the pulls' spectrum at frequency
    nought, and the slowest cosines see it, whatever the correlation along shorter ways. Their number is that of
    Lazarus, Lewis, Stock and Watson (JBES 36, 2018); it is also the number of degrees of freedom (Mueller, Journal of
    Econometrics 141, 2007).

    Parameters
    ----------
    n : int
        Blocks, in the order driven.
    least : int
        So many cosines at least.

    Returns
    -------
    array of float, shape (n_cosines, n)
        Scaled so that independent pulls keep their sum of squares.
    """
    number = np.arange(1.0, min(max(round(COSINES * n ** (2.0 / 3.0)), least), n - 1) + 1.0)
    waves = np.cos(np.pi * np.outer(number, (np.arange(n) + 0.5) / n))
    return np.asarray(np.sqrt(2.0 / len(number)) * waves)


def sandwich(
    solution: Solution, free: BoolArray, cluster: IntArray, *, along: bool = False, power: float = UNBIASED
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
    along : bool
        Clusters are numbered along the way, and neighbours may share some of their noise.
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
    pull = np.stack(pulls) @ root.T
    weigh = slow_cosines(len(pull)) if along else np.eye(len(pull))
    inner = _of_full_rank(pull, weigh) if along else pull.T @ pull
    factor = _influence(solution)
    covariance = factor**2 * inner * np.outer(scale, scale)
    apart = factor * np.sqrt(np.square(pull).sum(axis=0)) * scale
    return Uncertainty(covariance, _degrees(np.stack(sizes), np.stack(shares), weigh), len(pull), apart)


def _of_full_rank(pull: FloatArray, weigh: FloatArray) -> FloatArray:
    """Return the covariance by few cosines, whose correlations leave no direction without any spread.

    Parameters
    ----------
    pull : array of float, shape (n_blocks, n_free)
        Of each block on the parameters.
    weigh : array of float, shape (n_cosines, n_blocks)
        The slowest cosines. With fewer of them than parameters some directions would have no spread: the correlations
        by enough cosines count as those of one cosine more.
    """
    slow, more = weigh @ pull, slow_cosines(len(pull), 2 * max(len(weigh), pull.shape[1])) @ pull
    by_slow, by_more = slow.T @ slow, more.T @ more
    ratio = np.sqrt(np.diag(by_slow) / np.maximum(np.diag(by_more), 1e-300))
    return np.asarray((len(weigh) * by_slow + by_more * np.outer(ratio, ratio)) / (len(weigh) + 1.0))


def _degrees(sizes: FloatArray, shares: FloatArray, weigh: FloatArray) -> FloatArray:
    """Return Bell and McCaffrey's degrees of freedom of each parameter's variance."""
    found = []
    for at in range(sizes.shape[1]):
        inner = weigh @ (np.diag(sizes[:, at]) - shares[:, :, at] @ shares[:, :, at].T) @ weigh.T
        found.append(np.trace(inner) ** 2 / np.maximum(np.square(inner).sum(), 1e-300))
    return np.maximum(np.asarray(found, dtype=np.float64), 1.0)


def _influence(solution: Solution) -> float:
    """Return by how much the weights overstate the information: mean weight over mean slope of the influence."""
    size = np.maximum(solution.prediction.jacobian.any(axis=2).sum(axis=1), 1)
    squares = (DEGREES + size) / solution.weights - DEGREES
    slope = solution.weights * (1.0 - 2.0 * squares / (size * (DEGREES + squares)))
    return float(np.mean(solution.weights) / max(np.mean(slope), 0.2 * np.mean(solution.weights)))
