"""Repeatability: replicate groups, and the noise scales by restricted maximum likelihood (REML) within them."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from calib.gap.inference.noise_components import (
    COMPONENTS,
    PRIOR_MEDIANS,
    NoiseComponents,
    whitener_of,
)
from calib.gap.predict import Path
from calib.types import BoolArray, FloatArray, IntArray

PRIOR_SPREADS: Final = np.array([spread for _, _, spread in COMPONENTS])
SCALE_BOUNDS: Final = [(m - 4 * w, m + 5 * w) for m, w in zip(np.log(PRIOR_MEDIANS), PRIOR_SPREADS, strict=True)]
#: of normal noise beyond which units weigh less
OUTLIER_PROBABILITY: Final = 0.05
#: most units that scales are found from: known to a few per cent
MAX_REPLICATES: Final = 480
_WEIGHT_ROUNDS: Final = 3
#: what each group may have of its own: a calibration and a mean in each channel
N_GROUP_COLUMNS: Final = 9
#: of sums of products in double precision, relative
_ROUNDING: Final = 1e-14


def neighbours(labels: IntArray, together: int) -> IntArray:
    """Return each unit's neighbourhood among those of its label, in the order driven, (n_units,).

    `labels`: (n_units,); `together`: units of one; those left over join the last.
    """
    number = np.zeros(len(labels), dtype=np.int64)
    used = 0
    for label in np.unique(labels):
        units = np.flatnonzero(labels == label)
        place = np.minimum(np.arange(len(units)) // together, max(len(units) // together - 1, 0))
        number[units] = used + place
        used += int(place[-1]) + 1
    return number


@dataclass(frozen=True, eq=False)
class Replicates:
    """Replicates, group by group; units that stand alone are omitted."""

    units: IntArray  #: shape (n,): their numbers, group by group
    group: IntArray  #: shape (n,): number of the group of each
    first: IntArray  #: shape (n_groups,): start of each group

    @staticmethod
    def by(labels: IntArray) -> "Replicates":
        """Group units by a label, (n_units,)."""
        _, code = np.unique(labels, return_inverse=True)
        units = np.argsort(code, kind="stable")
        units = units[np.bincount(code)[code[units]] >= 2]
        return Replicates._numbered(units, code[units])

    @staticmethod
    def _numbered(units: IntArray, label: IntArray) -> "Replicates":
        _, first, group = np.unique(label, return_index=True, return_inverse=True)
        return Replicates(units, group, first)

    def select(self, keep: BoolArray) -> "Replicates":
        """Return the groups of the units (n,) to keep."""
        return Replicates._numbered(self.units[keep], self.group[keep])

    def summed(self, values: FloatArray) -> FloatArray:
        """Sum values (n, ...) over each group."""
        total: FloatArray = np.add.reduceat(values, self.first, axis=0)
        return total


def thinned_replicates(grouped: Replicates, most: int = MAX_REPLICATES) -> Replicates:
    """Return about `most` units: the same share, at least two, of evenly chosen groups."""
    n = len(grouped.units)
    if n <= most:
        return grouped
    sizes = np.diff(np.append(grouped.first, n))
    wanted = np.maximum(2, np.ceil(sizes * most / n))
    place = np.arange(n) - grouped.first[grouped.group]
    slot = np.floor(place * wanted[grouped.group] / sizes[grouped.group])
    chosen = np.concatenate(([True], (np.diff(slot) > 0) | (np.diff(grouped.group) > 0)))
    stride = max(1, int(np.ceil(2 * len(sizes) / most)))
    return grouped.select(chosen & (grouped.group % stride == 0))


class ScaleLikelihood:
    """Restricted likelihood of the noise's scales, for one way of grouping units.

    `gap`: (n_units, 6), measured minus predicted about `path`; `trends`: (n_units, 6, k), what may differ between
    replicates and is no noise, to unit prior variance.
    """

    def __init__(
        self,
        path: Path,
        gap: FloatArray,
        shapes: NoiseComponents,
        grouped: Replicates,
        trends: FloatArray | None = None,
    ) -> None:
        trends = np.zeros((len(path.s), 6, 0)) if trends is None else trends
        design, self.prior = _group_design(path, gap, grouped)
        self.grouped, units = grouped, grouped.units
        self.shapes = shapes.select(units)
        self.active, self.usable = shapes.active, self.shapes.usable
        self.k = trends.shape[2]
        self.own = path.calibration[units, :, :3]
        self.design = design[units]
        self.columns = np.concatenate([self.design, trends[units], gap[units, :, None]], axis=2)

    @cached_property
    def dof(self) -> float:
        """Degrees of freedom of the noise, at most: by each unit's own derivatives."""
        design = np.concatenate([self.own, self.design[:, :, 3:]], axis=2)
        used = _rank(design, self.grouped, self.usable)
        return float(max(self.usable.sum() - used - self.k, 0))

    def solved(self, whitener: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        """Return residual (n, 6), kept (n, 6, 6) of each whitened unit, and the cost's middle term."""
        k, grouped, columns, n_own = self.k, self.grouped, whitener @ self.columns, N_GROUP_COLUMNS
        x, shared = columns[:, :, :n_own], columns[:, :, n_own:]
        gram = grouped.summed(x.transpose(0, 2, 1) @ columns)
        inner = gram[:, :, :n_own] + np.diag(self.prior)
        root = np.sqrt(np.diagonal(inner, axis1=1, axis2=2))
        lower = np.linalg.cholesky(inner / (root[:, :, None] * root[:, None, :]) + _ROUNDING * np.eye(n_own))
        middle = 2 * float((np.log(np.diagonal(lower, axis1=1, axis2=2)) + np.log(root)).sum())
        factors = np.linalg.inv(lower) / root[:, None, :]
        taken = factors @ gram[:, :, n_own:]
        own = x @ factors.transpose(0, 2, 1)[grouped.group]
        residual, kept = shared - own @ taken[grouped.group], np.eye(6) - own @ own.transpose(0, 2, 1)
        flat, taken = shared.reshape(-1, k + 1), taken.reshape(-1, k + 1)
        dense = flat.T @ flat - taken.T @ taken
        g, square = residual[:, :, -1], float(dense[k, k])
        if k:
            lower = np.asarray(np.linalg.cholesky(dense[:k, :k] + np.eye(k)), dtype=np.float64)
            # one product of large matrices: (I + T^T T)^-1 = F^T F
            factor = np.linalg.inv(lower)
            along = factor @ dense[:k, k]
            half = (residual[:, :, :-1].reshape(-1, k) @ factor.T).reshape(*g.shape, k)
            g = g - half @ along
            kept = kept - half @ half.transpose(0, 2, 1)
            square -= float(along @ along)
            middle += 2 * float(np.log(np.diag(lower)).sum())
        return g, kept, middle + square

    def cost(self, log_scale: FloatArray, weight: FloatArray) -> tuple[float, FloatArray]:
        """Return minus the restricted log likelihood with the scales' prior, and its gradient."""
        factor = whitener_of(self.shapes.covariance(log_scale, weight))
        log_det = -2 * float(np.log(np.diagonal(factor, axis1=1, axis2=2)).sum())
        residual, kept, middle = self.solved(factor)
        away = (log_scale - np.log(PRIOR_MEDIANS)) / PRIOR_SPREADS
        turned = factor.transpose(0, 2, 1)
        alpha = (turned @ residual[:, :, None])[:, :, 0]
        inner = turned @ kept @ factor - alpha[:, :, None] * alpha[:, None, :]
        both = self.usable[:, :, None] & self.usable[:, None, :]
        inner = np.where(both, inner, 0.0) / weight[:, None, None]
        slope = np.tensordot(self.shapes.kernels, inner, axes=([1, 2, 3], [0, 1, 2])) * self.active
        gradient = slope * np.exp(2 * log_scale) + away / PRIOR_SPREADS
        return 0.5 * (log_det + middle + float(away @ away)), gradient

    def weights(self, log_scale: FloatArray) -> FloatArray:
        """Return unit weights, 1 within normal reach of the repeats, (n,)."""
        from scipy.special import chdtri

        residual, own, _ = self.solved(whitener_of(self.shapes.covariance(log_scale, np.ones(len(self.usable)))))
        lever = 6.0 - np.trace(own, axis1=1, axis2=2)
        dim = np.maximum(self.usable.sum(axis=1), 1)
        kept = np.maximum(dim - lever, 0.25 * dim)
        square = (residual**2).sum(axis=1) / kept * dim
        reach = chdtri(dim, OUTLIER_PROBABILITY)
        return np.asarray(reach / np.maximum(square, reach))

    def uncertainty(self, log_scale: FloatArray) -> FloatArray:
        """Return the covariance of the logs of the scales, (n_components, n_components)."""
        variance = np.exp(2 * log_scale) * self.active
        factor = whitener_of(self.shapes.covariance(log_scale, np.ones(len(self.usable))))
        kept = self.solved(factor)[1]
        parts = variance[:, None, None, None] * (factor @ self.shapes.kernels @ factor.transpose(0, 2, 1))
        shape = len(parts), -1
        information = 2 * (kept @ parts @ kept).reshape(shape) @ parts.reshape(shape).T
        return np.asarray(np.linalg.inv(information + np.diag(PRIOR_SPREADS**-2)))

    @cached_property
    def weighted_share(self) -> FloatArray:
        """Share of variance that normal noise keeps under the weights, (n,)."""
        from scipy.special import chdtr, chdtri

        dim = np.maximum(self.usable.sum(axis=1), 1)
        reach = chdtri(dim, OUTLIER_PROBABILITY)
        share: FloatArray = chdtr(dim + 2, reach) + OUTLIER_PROBABILITY * reach / dim
        return share


def most_likely_scales(likelihood: ScaleLikelihood, start: FloatArray) -> FloatArray:
    """Return the logs of the most likely scales, (n_components,), from `start` on; far units weigh less."""
    from scipy.optimize import minimize

    best, weight = start, np.ones(len(likelihood.usable))
    for _ in range(_WEIGHT_ROUNDS):
        how = {"method": "L-BFGS-B", "bounds": SCALE_BOUNDS, "options": {"maxiter": 30, "ftol": 1e-6}}
        best = minimize(likelihood.cost, best, (weight,), jac=True, **how).x
        # what the weights take from normal noise makes scales smaller
        fresh = likelihood.weights(best) / likelihood.weighted_share
        if np.abs(fresh - weight).max() < 0.05:
            break
        weight = fresh
    return best


def _group_design(path: Path, gap: FloatArray, grouped: Replicates) -> tuple[FloatArray, FloatArray]:
    observations = path.s
    design = np.zeros((len(observations), 6, N_GROUP_COLUMNS))
    design[:, :, :3] = _of_their_route(path, grouped)
    design[path.guided, :, 2] = 0.0
    design[:, np.arange(6), 3 + np.arange(6)] = 1.0
    design = np.where(observations.usable[:, :, None], design, 0.0)
    size = np.maximum(np.sqrt((gap**2).mean(axis=0)), 1e-6)
    prior = 1.0 / np.concatenate(([0.03, 0.03, 0.1], 30 * size)) ** 2
    return design, prior


def _of_their_route(path: Path, grouped: Replicates) -> FloatArray:
    """Return the calibration derivatives (n_units, 6, 3), within a group their mean."""
    own: FloatArray = path.calibration[:, :, :3].copy()
    size = np.diff(np.append(grouped.first, len(grouped.units)))
    mean = grouped.summed(own[grouped.units]) / size[:, None, None]
    condition = path.s.condition[grouped.units]
    alike = grouped.summed((condition != condition[grouped.first][grouped.group]).astype(np.int64)) == 0
    along = grouped.summed(np.abs(path.way_m[grouped.units])) > 0
    on = (along & (alike | (not path.s.windowed)))[grouped.group]
    own[grouped.units[on]] = mean[grouped.group[on]]
    return own


def _rank(design: FloatArray, grouped: Replicates, usable: BoolArray) -> int:
    total = 0
    ends = np.append(grouped.first[1:], len(grouped.units))
    for first, end in zip(grouped.first, ends, strict=True):
        rows = design[first:end][usable[first:end]]
        if len(rows):
            norm = np.maximum(np.abs(rows).max(axis=0), 1e-12)
            total += int(np.linalg.matrix_rank(rows / norm, tol=1e-3))
    return total
