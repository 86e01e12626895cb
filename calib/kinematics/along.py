"""Standard deviations of sums of parameters along a path of blocks, and their degrees of freedom."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.types import FloatArray, IntArray

#: a length that turns determine relative to a radius -> these radii, of which the mean counts
_BESIDE: Final[Mapping[str, tuple[str, ...]]] = {
    "track_m": ("radius_left_m", "radius_right_m"),
    "wheelbase_m": ("front_radius_m",),
    "half_length_plus_half_width_m": ("wheel_radius_m",),
}
_WHEELS: Final = ("radius_left_m", "radius_right_m")


@dataclass(frozen=True, slots=True, eq=False)
class Freedom:
    """Degrees of freedom of the standard deviations."""

    #: rows: sums of parameters whose errors are nearly independent, shape (n_parameters, n_parameters)
    directions: FloatArray
    #: of each, shape (n_parameters,)
    std: FloatArray
    #: of `std`, shape (n_parameters,)
    dof: FloatArray

    def of(self, contrast: FloatArray) -> float:
        """Return the degrees of freedom of the variance of a sum of parameters (Welch and Satterthwaite)."""
        parts = np.square(np.linalg.solve(self.directions.T, contrast) * self.std)
        return float(parts.sum() ** 2 / max(float(np.sum(np.square(parts) / self.dof)), 1e-300))

    def select(self, kept: IntArray) -> "Freedom":
        """Return that of sums of some parameters alone."""
        return Freedom(self.directions[np.ix_(kept, kept)], self.std[kept], self.dof[kept])


def own_directions(names: Sequence[str], values: FloatArray) -> FloatArray:
    """Return sums of parameters with separate errors: mean radius, ratios of radii and lengths.

    Distances determine the mean radius, headings the ratios.

    `values` (shape (n,)). Shape (n, n): a row a direction, of full rank.
    """
    at, out = {name: number for number, name in enumerate(names)}, np.eye(len(names))
    for name, radii in _BESIDE.items():
        if name in at and all(radius in at for radius in radii):
            places = [at[radius] for radius in radii]
            out[at[name], places] = -values[at[name]] / values[places].sum()
    if all(name in at for name in _WHEELS):
        left, right = (at[name] for name in _WHEELS)
        out[left, [left, right]] = 0.5
        out[right, [left, right]] = -1.0 / values[left], 1.0 / values[right]
    return out


#: cosines for n blocks: this times n^(2/3), so that of many blocks only the slower part counts
COSINES: Final = 3.3
#: how much steeper than level a spectrum may be: by the slope at zero over the square of the frequency
STEEPNESS: Final = np.concatenate([-np.logspace(2.0, -1.0, 13), [0.0], np.logspace(-1.0, 2.0, 13)])


def _cosines(n: int) -> tuple[FloatArray, FloatArray]:
    number = np.arange(1.0, min(round(COSINES * n ** (2.0 / 3.0)), n - 1) + 1.0)
    waves = np.sqrt(2.0 / n) * np.cos(np.pi * np.outer(number, (np.arange(n) + 0.5) / n))
    return waves, 4.0 * np.square(np.sin(0.5 * np.pi * number / n))


def level_at_zero(powers: FloatArray, squares: FloatArray, dof: float) -> tuple[float, float, FloatArray]:
    """Return a spectrum's level at frequency zero, its degrees of freedom, and its shape.

    `powers`, `squares` (shape (n_cosines,)): squared amplitudes and frequencies; `dof`: degrees of freedom of the
    amplitudes together; fewer than there are of them where blocks are unequal.

    For each steepness the level has a scaled inverse chi squared distribution, weighted by the likelihood; the mixture
    is met by that of the same mean and variance of the logarithm.
    """
    from scipy.special import digamma, polygamma

    raised = 1.0 + np.abs(STEEPNESS)[:, None] * squares
    shapes = np.where(STEEPNESS[:, None] >= 0.0, raised, 1.0 / raised)
    levels = np.maximum((powers / shapes).mean(axis=1), 1e-300)
    likelihood = -0.5 * np.log(shapes).sum(axis=1) - 0.5 * len(powers) * np.log(levels)
    weights = np.exp(likelihood - likelihood.max())
    weights /= weights.sum()
    logs = np.log(levels) + np.log(0.5 * dof) - digamma(0.5 * dof)
    mean = float(weights @ logs)
    variance = float(weights @ np.square(logs - mean) + polygamma(1, 0.5 * dof))
    grid = np.geomspace(0.2, 2e4, 2000)
    matched = float(np.interp(-variance, -polygamma(1, 0.5 * grid), grid))
    level = float(np.exp(mean + digamma(0.5 * matched) - np.log(0.5 * matched)))
    return level, matched, np.asarray(np.exp(weights @ np.log(shapes)))


def covariance_along(pulls: FloatArray, information: FloatArray, directions: FloatArray) -> tuple[FloatArray, Freedom]:
    """Return the covariance of sums of parameters, and its degrees of freedom.

    `pulls` (shape (n_blocks, n_parameters)): of each block, in the order driven, in columns in which all blocks
    together have unit information; `information` (shape (n_blocks, n_parameters, n_parameters)): of each block in the
    same columns; `directions` (shape (n_parameters, n_parameters)): rows: sums of parameters with separate sources of
    error, in the same columns. The covariance, of the directions, has the same shape.
    """
    waves, squares = _cosines(len(pulls))
    number, amplitudes = len(squares), waves @ pulls @ directions.T
    std, dof, flat = np.empty(len(directions)), np.empty(len(directions)), np.empty_like(amplitudes)
    for at, direction in enumerate(directions):
        seen = information @ direction
        # what independent blocks of this information would leave in each cosine after the fit has taken its part
        taken = waves @ seen
        left = (waves * (seen @ direction)) @ waves.T - taken @ taken.T
        share = np.maximum(len(pulls) * np.diag(left) / max(float(direction @ seen.sum(axis=0)), 1e-300), 1e-6)
        own = max(float(np.trace(left) ** 2 / max(float(np.square(left).sum()), 1e-300)), 1.0)
        level, dof[at], shape = level_at_zero(np.square(amplitudes[:, at]) / share, squares, own)
        std[at] = np.sqrt(len(pulls) * level)
        flat[:, at] = amplitudes[:, at] / np.sqrt(shape * share)
    products = flat.T @ flat
    size = np.sqrt(np.maximum(np.diag(products), 1e-300))
    # correlations by no more cosines than parameters would leave some sum of them without any spread
    correlation = (number * products / np.outer(size, size) + np.eye(len(size))) / (number + 1.0)
    return correlation * np.outer(std, std), Freedom(np.eye(len(std)), std, dof)
