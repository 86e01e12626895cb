"""Covariance of the parameters that holds where noise is shared within blocks: a sandwich for small samples.

Bell and McCaffrey's bias-reduced form (CR2) and their degrees of freedom (Survey Methodology 28, 2002; Pustejovsky and
Tipton, JBES 36, 2018), on the whitened, weighted problem of the robust fit. Where blocks follow one another along the
way, what neighbours share is allowed for by cosines: see `calib.geometry.along`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.geometry.along import covariance_along
from calib.geometry.freedom import Freedom
from calib.geometry.solve import DEGREES, Solution

#: power that is unbiased for known weights (CR2); 1 is the jackknife (CR3)
UNBIASED: Final = 0.5
#: for single runs, from which the noise's sizes are estimated too; the coverage lies between the two
OF_RUNS: Final = 0.75


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """Covariance of the free parameters and the degrees of freedom of each."""

    #: of the free parameters, shape (n_free, n_free)
    covariance: FloatArray
    #: degrees of freedom of each standard deviation, shape (n_free,)
    dof: FloatArray
    #: groups whose noise was taken for independent, or shared with neighbours
    clusters: int
    #: standard deviations as if no group shared anything: less right, but steadier, to compare estimates by, shape
    #: (n_free,)
    apart: FloatArray
    #: degrees of freedom of sums of parameters, where these are known
    freedom: Freedom | None = None

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


def _unit_columns(solution: Solution, free: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return Jacobian in columns of unit information, residuals, and what turns these columns into parameters."""
    jacobian, residuals = whitened(solution, free)
    flat = jacobian.reshape(-1, jacobian.shape[2])
    scale = 1.0 / np.sqrt(np.maximum(np.square(flat).sum(axis=0), 1e-300))
    flat = flat * scale
    root = np.linalg.cholesky(np.linalg.inv(flat.T @ flat))
    return flat @ root, residuals.ravel(), root, scale


def _rows_of(cluster: IntArray) -> Iterator[IntArray]:
    """Yield the rows, three a stretch, of each cluster."""
    order = np.argsort(np.repeat(cluster, 3), kind="stable")
    ends = np.concatenate(([0], np.cumsum(3 * np.bincount(cluster))))
    for low, high in pairwise(ends):
        yield order[low:high]


def sandwich_along(solution: Solution, free: BoolArray, block: IntArray, directions: FloatArray) -> Uncertainty:
    """Return the covariance of the free parameters from blocks along the way, which share noise with neighbours.

    `solution`: of the robust fit; `free` (shape (n_parameters,)): which parameters were free; `block` (shape (n,)):
    blocks are numbered along the way; `directions` (shape (n_free, n_free)): rows: sums of parameters that err for
    reasons of their own.
    """
    flat, residuals, root, scale = _unit_columns(solution, free)
    parts = [(flat[rows], residuals[rows]) for rows in _rows_of(block)]
    pulls = _influence(solution) * np.stack([part.T @ rest for part, rest in parts])
    information = np.stack([part.T @ part for part, _ in parts])
    covariance, freedom = covariance_along(pulls, information, (directions * scale) @ root)
    back = np.linalg.inv(directions)
    freedom = replace(freedom, directions=directions)
    return replace(
        sandwich(solution, free, block),
        covariance=back @ covariance @ back.T,
        dof=np.array([freedom.of(unit) for unit in np.eye(len(directions))]),
        freedom=freedom,
    )


def sandwich(solution: Solution, free: BoolArray, cluster: IntArray, *, power: float = UNBIASED) -> Uncertainty:
    """Return the covariance of the free parameters.

    `solution`: of the robust fit; `free` (shape (n_parameters,)): which parameters were free; `cluster` (shape (n,)):
    stretches of one cluster share their noise; `power`: of what leverage takes from the residuals; they are enlarged by
    it.
    """
    flat, residuals, root, scale = _unit_columns(solution, free)
    cluster = np.unique(cluster, return_inverse=True)[1]
    pulls, sizes, shares = [], [], []
    contrast = root.T  # columns: what a unit of each parameter is in the new columns
    for rows in _rows_of(cluster):
        part, rest = flat[rows], residuals[rows]
        left, singular, right = np.linalg.svd(part, full_matrices=False)
        grow = np.maximum(1.0 - singular**2, 1e-6) ** -power - 1.0
        lever = part + left @ ((grow * singular)[:, None] * right)
        pulls.append(lever.T @ rest)
        seen = lever @ contrast
        sizes.append(np.square(seen).sum(axis=0))
        shares.append(part.T @ seen)
    pull = np.stack(pulls) @ root.T
    factor = _influence(solution)
    covariance = factor**2 * (pull.T @ pull) * np.outer(scale, scale)
    apart = factor * np.sqrt(np.square(pull).sum(axis=0)) * scale
    return Uncertainty(covariance, _degrees(np.stack(sizes), np.stack(shares)), len(pull), apart)


def _degrees(sizes: FloatArray, shares: FloatArray) -> FloatArray:
    """Return Bell and McCaffrey's degrees of freedom of each parameter's variance."""
    degrees = []
    for at in range(sizes.shape[1]):
        inner = np.diag(sizes[:, at]) - shares[:, :, at] @ shares[:, :, at].T
        degrees.append(np.trace(inner) ** 2 / np.maximum(np.square(inner).sum(), 1e-300))
    return np.maximum(np.asarray(degrees, dtype=np.float64), 1.0)


def _influence(solution: Solution) -> float:
    """Return by how much the weights overstate the information: mean weight over mean slope of the influence."""
    size = np.maximum(solution.prediction.jacobian.any(axis=2).sum(axis=1), 1)
    squares = (DEGREES + size) / solution.weights - DEGREES
    slope = solution.weights * (1.0 - 2.0 * squares / (size * (DEGREES + squares)))
    return float(np.mean(solution.weights) / max(np.mean(slope), 0.2 * np.mean(solution.weights)))
