"""Which parameters the data determine: singular values of the Jacobian, scaled by what is known beforehand."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.geometry.parameters import Parameters
from calib.geometry.solve import Solution

#: a direction in which data leave more than this part of the prior spread is not determined
TOLERATED: Final = 0.5
#: how well the scale of radii and track is known beforehand, relative
NOMINAL_STD: Final = 0.01
#: part that each of three parameters has in a direction in which all grow alike; 0.58 where they do so exactly
ALIKE: Final = 0.3


def weakest(solution: Solution, parameters: Parameters) -> str | None:
    """Return the parameter that the least determined direction is mostly made of; None where all are determined.

    `solution`: its whitened Jacobian, in units of the prior spread of each parameter, is decomposed; `parameters`:
    which are free, and their prior spread.
    """
    singular, directions = _directions(solution, parameters)
    if singular[-1] * TOLERATED >= 1.0:
        return None
    return parameters.free_names[int(np.argmax(np.abs(directions[-1])))]


def scale_is_open(covariance: FloatArray, values: FloatArray) -> bool:
    """Return whether data know the common scale of radii and track less well than their nominal values do.

    `covariance` (shape (3, 3)): of both radii and the track; `values` (shape (3,)).
    """
    return bool(np.mean(covariance / np.outer(values, values)) > NOMINAL_STD**2)


def scale_is_weakest(solution: Solution, parameters: Parameters) -> bool:
    """Return whether the least determined direction is that in which radii and track grow alike.

    `solution`: of two wheels on one axle; `parameters`: both radii and the track come first and are free.
    """
    return bool(np.min(np.abs(_directions(solution, parameters)[1][-1, :3])) > ALIKE)


def loosest(std: FloatArray, parameters: Parameters) -> str | None:
    """Return the parameter whose standard deviation is largest beside its prior spread, where that is too large.

    `std` (shape (n_free,)): standard deviations that allow for shared noise; `parameters`: which are free, and their
    prior spread.
    """
    ratio = std / parameters.prior_std[parameters.free]
    at = int(np.argmax(ratio))
    return parameters.free_names[at] if ratio[at] > TOLERATED else None


def _directions(solution: Solution, parameters: Parameters) -> tuple[FloatArray, FloatArray]:
    """Return singular values of the whitened Jacobian in units of the prior spread, and its directions as rows."""
    free, prior = parameters.free, parameters.prior_std
    root = np.sqrt(solution.weights)[:, None, None]
    jacobian = (solution.whitener @ solution.prediction.jacobian[:, :, free]) * root * prior[free]
    _, singular, directions = np.linalg.svd(jacobian.reshape(-1, int(free.sum())), full_matrices=False)
    return singular, directions
