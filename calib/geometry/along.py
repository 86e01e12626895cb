"""Covariance of the parameters from blocks that follow one another along the way, whatever neighbours share.

Neighbours that share an error, of the pose between them or of a reference that errs alike for long, do not add up as
independent ones do. What counts is the spectrum of their pulls on the parameters at frequency nought. Over cosines it
is a level at nought, raised along the frequencies where the error of a pose pulls one block forth and the next one
back, lowered where an error lasts over several blocks; by how much, the cosines themselves say. (Muller and Watson,
Low-frequency econometrics, 2017, on what a few cosines know of a spectrum at nought; the likelihood is Whittle's.)
"""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.geometry.freedom import Freedom

#: cosines for n blocks: this times n to the power 2/3, so that of many blocks only the slower part of them counts
COSINES: Final = 3.3
#: how much steeper than level a spectrum may be: by the slope at nought over the square of the frequency
STEEPNESS: Final = np.concatenate([-np.logspace(2.0, -1.0, 13), [0.0], np.logspace(-1.0, 2.0, 13)])


def _cosines(n: int) -> tuple[FloatArray, FloatArray]:
    """Return orthonormal cosines over n blocks, the slowest first, and the squares of their frequencies."""
    number = np.arange(1.0, min(round(COSINES * n ** (2.0 / 3.0)), n - 1) + 1.0)
    waves = np.sqrt(2.0 / n) * np.cos(np.pi * np.outer(number, (np.arange(n) + 0.5) / n))
    return waves, 4.0 * np.square(np.sin(0.5 * np.pi * number / n))


def level_at_nought(powers: FloatArray, squares: FloatArray, dof: float) -> tuple[float, float, FloatArray]:
    """Return the level of a spectrum at frequency nought, its degrees of freedom, and the spectrum's shape.

    `powers` (shape (n_cosines,)): squared amplitudes; `squares` (shape (n_cosines,)): squares of the frequencies;
    `dof`: degrees of freedom of the amplitudes together; fewer than there are of them where blocks are unequal.

    For each steepness the level has a scaled inverse chi squared distribution; steepnesses are weighted by the
    likelihood with the level integrated out. The mixture is met by the one such distribution whose logarithm has the
    same mean and variance, so that a t distribution gives the intervals.
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
    """Return the covariance of sums of parameters, and what is known of it.

    `pulls` (shape (n_blocks, n_parameters)): of each block, in the order driven, in columns in which all blocks
    together have unit information; `information` (shape (n_blocks, n_parameters, n_parameters)): of each block in the
    same columns; their sum is the identity; `directions` (shape (n_parameters, n_parameters)): rows: sums of parameters
    that err for reasons of their own, in the same columns. Returns `covariance` (shape (n_parameters, n_parameters)):
    of the directions; `freedom`: standard deviations of the directions, and their degrees of freedom.
    """
    waves, squares = _cosines(len(pulls))
    number = len(squares)
    amplitudes = waves @ pulls @ directions.T
    std, dof = np.empty(len(directions)), np.empty(len(directions))
    flat = np.empty_like(amplitudes)
    for at, direction in enumerate(directions):
        seen = information @ direction
        # what independent blocks of this information would leave in each cosine after the fit has taken its part
        taken = waves @ seen
        left = (waves * (seen @ direction)) @ waves.T - taken @ taken.T
        share = np.maximum(len(pulls) * np.diag(left) / max(float(direction @ direction), 1e-300), 1e-6)
        own = max(float(np.trace(left) ** 2 / max(float(np.square(left).sum()), 1e-300)), 1.0)
        level, dof[at], shape = level_at_nought(np.square(amplitudes[:, at]) / share, squares, own)
        std[at] = np.sqrt(len(pulls) * level)
        flat[:, at] = amplitudes[:, at] / np.sqrt(shape * share)
    products = flat.T @ flat
    size = np.sqrt(np.maximum(np.diag(products), 1e-300))
    # correlations by no more cosines than parameters would leave some sum of them without any spread
    correlation = (number * products / np.outer(size, size) + np.eye(len(size))) / (number + 1.0)
    return correlation * np.outer(std, std), Freedom(np.eye(len(std)), std, dof)
