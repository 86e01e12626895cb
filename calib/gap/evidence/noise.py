"""The noise of each unit: its covariance over the channels, with scales taken from repeats.

Heading noise along a path becomes lateral error at its end, so the channels of a unit are correlated, each unit in its
own way. The covariance is a sum of known shapes; their scales are found by restricted maximum likelihood from what
differs between units driven alike, after a mean in each channel and a calibration of each condition's own are removed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.campaign.model import NUMERIC_COLUMNS
from calib.gap.predict.path import Path

__all__ = [
    "COMPONENTS",
    "Noise",
    "estimate_noise",
    "interactions",
    "kernels",
    "masked",
    "quantisation",
    "surroundings",
    "whiten",
]

#: components: (name, prior median of the standard deviation's scale, prior spread of its natural logarithm)
COMPONENTS: Final[tuple[tuple[str, float, float], ...]] = (
    ("distance", 1.0, 0.4),  # times the rangefinder's stated sigma
    ("position", 1.0, 0.4),  # times the reference's stated sigma
    ("heading", 1.0, 0.4),  # times the reference's stated sigma
    ("heading_walk", 2e-4, 1.0),  # rad per sqrt(m)
    ("along_walk", 2e-4, 1.0),  # m per sqrt(m)
    ("radius_scatter", 2e-5, 1.0),  # relative, both wheels, from run to run
    ("yaw_scatter", 2e-5, 1.0),  # relative, right against left, from run to run
    ("start_heading", 3e-4, 1.0),  # rad, from run to run
    ("front_walk", 5e-4, 1.0),  # m per sqrt(m)
    ("steering_walk", 1e-3, 1.0),  # rad per sqrt(m)
    ("front_scatter", 3e-4, 1.0),  # relative, front radius, from run to run
    ("steer_scatter", 1e-3, 1.0),  # rad, zero of the steering angle, from run to run
)


#: repeats with fewer degrees of freedom are joined with coarser ones
ENOUGH_DOF: Final = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Covariance of every unit.

    Parameters
    ----------
    covariance : array of float, shape (n_units, 6, 6)
        Over (distance, along, lateral, heading, front, steering); unit variance where a channel is missing.
    scales : mapping of str to float
        Scale of each component.
    dof : float
        Degrees of freedom that repeats give it; small means that the stated instruments carry it.
    weight : array of float, shape (n_units,)
        1 for ordinary units, less for those far from their repeats.
    """

    covariance: FloatArray
    scales: dict[str, float]
    dof: float
    weight: FloatArray

    @property
    def floor(self) -> FloatArray:
        """Standard deviation of each channel in each unit, shape (n_units, 6)."""
        made: FloatArray = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
        return made


def kernels(path: Path) -> FloatArray:
    """Return the covariance of each component at scale 1, shape (n_components, n_units, 6, 6)."""
    s = path.s
    n = len(s)
    made = np.zeros((len(COMPONENTS), n, 6, 6))
    made[0, :, 0, 0] = s.sigma_distance_m**2
    made[1, :, 1, 1] = made[1, :, 2, 2] = s.sigma_xy_m**2
    made[2, :, 3, 3] = s.sigma_theta_rad**2
    c, sn = np.cos(path.frame)[s.unit], np.sin(path.frame)[s.unit]
    length = np.abs(path.ds_m)
    along_x = np.where(s.axis == 1, 1.0, 0.0)[s.unit]
    chord = np.maximum(np.hypot(path.end[:, 0], path.end[:, 1]), 1e-9)
    ux, uy = (path.end[:, 0] / chord)[s.unit], (path.end[:, 1] / chord)[s.unit]
    line = s.axis[s.unit] == 0
    # a kick of the heading at a step, read at the end
    kick = np.zeros((len(s.unit), 6))
    kick[:, 0] = np.where(line, 0.0, np.where(along_x > 0, path.lever_x, ux * path.lever_x + uy * path.lever_y))
    kick[:, 1] = c * path.lever_x + sn * path.lever_y
    kick[:, 2] = c * path.lever_y - sn * path.lever_x
    kick[:, 3] = 1.0
    kick[:, 5] = 1.0
    push = np.zeros((len(s.unit), 6))
    push[:, 0] = np.where(line, 1.0, np.where(along_x > 0, path.cos, ux * path.cos + uy * path.sin))
    push[:, 1] = c * path.cos + sn * path.sin
    push[:, 2] = c * path.sin - sn * path.cos
    push[:, 4] = 1.0
    for number, vector in ((3, kick), (4, push)):
        outer = np.einsum("ka,kb,k->kab", vector, vector, length)
        made[number] = np.add.reduceat(outer, s.starts[:-1], axis=0)
    calibration = path.calibration
    both = calibration[:, :, 0] + calibration[:, :, 1]
    differ = 0.5 * (calibration[:, :, 1] - calibration[:, :, 0])
    start = np.zeros((n, 6))
    start[:, 1] = np.sin(path.frame) * path.end[:, 0] - np.cos(path.frame) * path.end[:, 1]
    start[:, 2] = np.cos(path.frame) * path.end[:, 0] + np.sin(path.frame) * path.end[:, 1]
    start[:, 3] = 1.0
    zero = np.zeros((n, 6))
    zero[:, 4] = -s.vehicle.wheelbase_m * path.end[:, 2]
    zero[:, 5] = s.total(path.ds_m) / s.vehicle.wheelbase_m
    for number, rows in ((5, both), (6, differ), (7, start), (10, calibration[:, :, 3]), (11, zero)):
        made[number] = np.einsum("ua,ub->uab", rows, rows)
    made[8, :, 4, 4] = s.length_m
    made[9, :, 5, 5] = s.length_m
    return made


def quantisation(path: Path) -> FloatArray:
    """Return the covariance that counting in whole counts gives, shape (n_units, 6, 6)."""
    s = path.s
    made = np.zeros((len(s), 6, 6))
    radius = s.vehicle.wheel_radius_m
    for wheel, sign in ((0, -1.0), (1, 1.0)):
        # the first and the last count are each off by a uniform share of a count
        sigma = s.count_rad[wheel] * radius / np.sqrt(6.0)
        rows = np.zeros((len(s), 6))
        rows[:, 0] = rows[:, 1] = rows[:, 4] = 0.5 * sigma
        rows[:, 3] = rows[:, 5] = sign * sigma / s.model.track_m
        made += np.einsum("ua,ub->uab", rows, rows)
    return made


def masked(covariance: FloatArray, usable: BoolArray) -> FloatArray:
    """Give missing channels unit variance and no correlation."""
    both = usable[:, :, None] & usable[:, None, :]
    made = np.where(both, covariance, 0.0)
    index = np.arange(6)
    made[:, index, index] = np.where(usable, np.maximum(made[:, index, index], 1e-18), 1.0)
    # a whisker of independent variance keeps exactly aliased channels factorable
    made[:, index, index] *= 1.0 + 1e-9
    return made


def whiten(covariance: FloatArray, columns: FloatArray) -> FloatArray:
    """Multiply by the inverse Cholesky factor of each unit's covariance.

    Parameters
    ----------
    covariance : array of float, shape (n_units, 6, 6)
    columns : array of float, shape (n_units, 6, k)
        Zero where a channel is missing.

    Returns
    -------
    array of float, shape (n_units, 6, k)
    """
    made: FloatArray = np.linalg.solve(np.linalg.cholesky(covariance), columns)
    return made


def estimate_noise(path: Path, gap: FloatArray) -> Noise:
    """Estimate the noise from repeats.

    Repeats are units of one cell where there are enough of them; else of one condition, with a trend on temperature,
    dwell, session and further columns removed; else of one route; at last all units together.

    Parameters
    ----------
    path : Path
        Where the gap was taken.
    gap : array of float, shape (n_units, 6)
        Measured minus predicted.

    Returns
    -------
    Noise
        Covariances and the scales behind them. Scales that repeats do not determine keep their prior, which is
        the instruments' stated uncertainty for the first three.
    """
    s = path.s
    trend = np.concatenate([surroundings(path), *interactions(path)], axis=2)
    for labels, columns in ((s.cell, None), (s.condition, trend), (s.kind, trend), (np.zeros_like(s.kind), trend)):
        problem = _Problem(path, gap, labels, columns)
        if problem.dof >= ENOUGH_DOF:
            break
    return problem.solve()


def surroundings(path: Path) -> FloatArray:
    """Return what both radii may do with the surroundings, shape (n_units, 6, k)."""
    s = path.s
    waited = s.number("minutes_under_load")
    load = s.number("load_left_N") + s.number("load_right_N")
    values = [s.number("temperature_C"), waited, np.log1p(np.maximum(np.nan_to_num(waited), 0.0) / 5.0) * load]
    values += [s.numbers[name] for name in s.numbers if name not in NUMERIC_COLUMNS]
    sessions = np.unique(s.labels["session"])
    values += [(s.labels["session"] == name).astype(np.float64) for name in sessions[1:]]
    return _on_radii(path, [(column, (0, 1)) for value in values for column in _standardised(value)])


def interactions(path: Path) -> list[FloatArray]:
    """Return what the surroundings may do differently under another load or at another speed.

    One array (n_units, 6, 2) for each of temperature and dwell with each of total load, own load, speed and turning,
    where they vary.
    """
    s = path.s
    left, right = s.number("load_left_N"), s.number("load_right_N")
    total, speed, turned = left + right, s.number("speed_mps"), s.total(np.abs(s.turn_rad))
    others = ((total, total), (left, right), (speed, speed), (turned, turned))
    made = []
    for value in (s.number("temperature_C"), s.number("minutes_under_load")):
        for first in _standardised(value):
            for pair in others:
                columns = [(first * second, (k,)) for k in (0, 1) for second in _standardised(pair[k])]
                if columns:
                    made.append(_on_radii(path, columns))
    return made


def _on_radii(path: Path, columns: Sequence[tuple[FloatArray, tuple[int, ...]]]) -> FloatArray:
    """Return a hundredth of each column acting on the radius of the wheels named, shape (n_units, 6, k)."""
    made = [path.calibration[:, :, k] * column[:, None] * 1e-2 for column, wheels in columns for k in wheels]
    stacked = np.stack(made, axis=2) if made else np.zeros((len(path.s), 6, 0))
    return np.where(path.s.usable[:, :, None], stacked, 0.0)


def _standardised(values: FloatArray) -> list[FloatArray]:
    """Return the values less their mean over their spread; nothing where they do not vary."""
    if not np.isfinite(values).any():
        return []
    filled = np.nan_to_num(values - np.nanmean(values))
    spread = float(filled.std())
    return [filled / spread] if spread > 1e-9 else []


class _Problem:
    """Restricted likelihood of the noise's scales for one way of grouping the units."""

    def __init__(self, path: Path, gap: FloatArray, labels: IntArray, trend: FloatArray | None) -> None:
        s = path.s
        self.kernels, self.fixed = kernels(path), quantisation(path)
        self.usable = s.usable
        both = s.usable[:, :, None] & s.usable[:, None, :]
        self.active = np.array([bool((np.abs(k) * both).sum() > 0) for k in self.kernels])
        self.median = np.log([c[1] for c in COMPONENTS])
        self.spread = np.array([c[2] for c in COMPONENTS])
        self.design, self.prior = _nuisance(path, gap)
        self.gap = gap
        _, self.group = np.unique(labels, return_inverse=True)
        self.n_groups = int(self.group.max()) + 1
        self.repeated = np.bincount(self.group)[self.group] >= 2
        self.counted = np.unique(self.group[self.repeated])
        self.trend = trend if trend is not None else np.zeros((len(s), 6, 0))
        on = self.repeated
        self.dof = max(float(self.usable[on].sum() - _rank(self.design[on], self.group[on], self.usable[on])), 0.0)
        self.dof = max(self.dof - self.trend.shape[2], 0.0)

    def covariance(self, log_scale: FloatArray, weight: FloatArray) -> FloatArray:
        """Return the covariance of each unit, shape (n_units, 6, 6)."""
        variance = np.exp(2 * np.where(self.active, log_scale, self.median)) * self.active
        whole = np.einsum("c,cuab->uab", variance, self.kernels) + self.fixed
        return masked(whole / weight[:, None, None], self.usable)

    def _solved(self, columns: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        """Return what is left (n, 6) and kept (n, 6, 6) of each whitened unit, and the restricted cost's middle.

        `columns` (n, 6, 9 + k + 1) holds the whitened own design of each group, the trend and the gap.
        """
        k = self.trend.shape[2]
        x, rest = columns[:, :, :9], columns[:, :, 9:]
        gram = np.zeros((self.n_groups, 9, 9))
        cross = np.zeros((self.n_groups, 9, k + 1))
        np.add.at(gram, self.group, x.transpose(0, 2, 1) @ x)
        np.add.at(cross, self.group, x.transpose(0, 2, 1) @ rest)
        gram += np.diag(self.prior)
        inverse = np.linalg.inv(gram)
        scaled = x @ inverse[self.group]
        left = rest - scaled @ cross[self.group]
        flat = rest.reshape(-1, k + 1)
        dense = flat.T @ flat - (cross.transpose(0, 2, 1) @ (inverse @ cross)).sum(axis=0)
        middle = float(np.linalg.slogdet(gram[self.counted])[1].sum())
        kept = np.eye(6) - scaled @ x.transpose(0, 2, 1)
        g, square = left[:, :, -1], float(dense[k, k])
        if k:
            inner = dense[:k, :k] + np.eye(k)
            beta = np.linalg.solve(inner, dense[:k, k])
            square -= float(dense[:k, k] @ beta)
            t = left[:, :, :k]
            g = g - t @ beta
            kept = kept - t @ np.linalg.inv(inner) @ t.transpose(0, 2, 1)
            middle += float(np.linalg.slogdet(inner)[1])
        return g, kept, middle + square

    def _whitened(self, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the inverse Cholesky factors (n, 6, 6) and the whitened columns, 0 where a unit stands alone."""
        inverse = np.linalg.inv(np.linalg.cholesky(covariance))
        columns = np.concatenate([self.design, self.trend, self.gap[:, :, None]], axis=2)
        return inverse, (inverse @ columns) * self.repeated[:, None, None]

    def cost(self, log_scale: FloatArray, weight: FloatArray) -> tuple[float, FloatArray]:
        """Return minus the restricted log likelihood, the prior of the scales included, and its gradient."""
        covariance = self.covariance(log_scale, weight)
        factor, columns = self._whitened(covariance)
        on = self.repeated
        log_det = -2 * float(np.log(np.diagonal(factor[on], axis1=1, axis2=2)).sum())
        left, kept, middle = self._solved(columns)
        away = (log_scale - self.median) / self.spread
        turned = factor.transpose(0, 2, 1)
        alpha = (turned @ left[:, :, None])[:, :, 0]
        inner = turned @ kept @ factor - alpha[:, :, None] * alpha[:, None, :]
        both = self.usable[:, :, None] & self.usable[:, None, :]
        inner = np.where(both, inner, 0.0) * (on / weight)[:, None, None]
        slope = np.tensordot(self.kernels, inner, axes=([1, 2, 3], [0, 1, 2])) * self.active
        gradient = slope * np.exp(2 * log_scale) + away / self.spread
        return 0.5 * (log_det + middle + float(away @ away)), gradient

    def weights(self, log_scale: FloatArray) -> FloatArray:
        """Return Student-t weights (5 degrees of freedom) from how far units stand from their repeats."""
        _, columns = self._whitened(self.covariance(log_scale, np.ones(len(self.gap))))
        left, own, _ = self._solved(columns)
        lever = 6.0 - np.trace(own, axis1=1, axis2=2)
        dim = np.maximum(self.usable.sum(axis=1), 1)
        # what a unit keeps of its own after its group's means are removed
        kept = np.maximum(dim - lever, 0.25 * dim)
        square = (left**2).sum(axis=1) / kept * dim
        made: FloatArray = np.where(self.repeated, np.minimum(1.0, (5.0 + dim) / (5.0 + square)), 1.0)
        return made

    def solve(self) -> Noise:
        """Return the noise at the most likely scales."""
        from scipy.optimize import minimize

        best, weight = self.median.copy(), np.ones(len(self.gap))
        if self.dof > 0:
            for _ in range(3):
                options = {"maxiter": 30, "ftol": 1e-6}
                bounds = [(m - 4 * w, m + 5 * w) for m, w in zip(self.median, self.spread, strict=True)]
                best = minimize(
                    self.cost, best, args=(weight,), jac=True, method="L-BFGS-B", bounds=bounds, options=options
                ).x
                fresh = self.weights(best)
                if np.abs(fresh - weight).max() < 0.05:
                    break
                weight = fresh
        scales = {
            name: float(np.exp(v)) for (name, _, _), v, on in zip(COMPONENTS, best, self.active, strict=True) if on
        }
        return Noise(self.covariance(best, weight), scales, self.dof, weight)


def _nuisance(path: Path, gap: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what each group may have of its own, shape (n_units, 6, 9), and its prior precision, shape (9,)."""
    s = path.s
    design = np.zeros((len(s), 6, 9))
    design[:, :, :3] = path.calibration[:, :, :3]
    # on a straight the turn by the wheels is the noise itself
    design[path.led_straight, :, 2] = 0.0
    design[:, np.arange(6), 3 + np.arange(6)] = 1.0
    design = np.where(s.usable[:, :, None], design, 0.0)
    size = np.maximum(np.sqrt((gap**2).mean(axis=0)), 1e-6)
    prior = 1.0 / np.concatenate(([0.03, 0.03, 0.1], 30 * size)) ** 2
    return design, prior


def _rank(design: FloatArray, group: IntArray, usable: BoolArray) -> int:
    """Return how many degrees of freedom the groups' own means and calibrations use up."""
    total = 0
    for label in np.unique(group):
        rows = design[group == label][usable[group == label]]
        if len(rows):
            norm = np.maximum(np.abs(rows).max(axis=0), 1e-12)
            total += int(np.linalg.matrix_rank(rows / norm, tol=1e-3))
    return total
