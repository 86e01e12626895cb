"""Which parameters the data determine: singular values of the Jacobian, scaled by what is known beforehand."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.geometry.parameters import Parameters
from calib.geometry.solve import Solution

__all__ = ["loosest", "weakest"]

#: a direction in which data leave more than this part of the prior spread is not determined
TOLERATED: Final = 0.5


def weakest(solution: Solution, parameters: Parameters) -> str | None:
    """Return the parameter that the least determined direction is mostly made of; None where all are determined.

    Parameters
    ----------
    solution : Solution
        Its whitened Jacobian, in units of the prior spread of each parameter, is decomposed.
    parameters : Parameters
        Which are free, and their prior spread.
    """
    free, prior = parameters.free, parameters.prior_std
    root = np.sqrt(solution.weights)[:, None, None]
    jacobian = (solution.whitener @ solution.prediction.jacobian[:, :, free]) * root * prior[free]
    _, singular, directions = np.linalg.svd(jacobian.reshape(-1, int(free.sum())), full_matrices=False)
    if singular[-1] * TOLERATED >= 1.0:
        return None
    return parameters.free_names[int(np.argmax(np.abs(directions[-1])))]


def loosest(std: FloatArray, parameters: Parameters) -> str | None:
    """Return the parameter whose standard deviation is largest beside its prior spread, where that is too large.

    Parameters
    ----------
    std : array of float, shape (n_free,)
        Standard deviations that allow for shared noise.
    parameters : Parameters
        Which are free, and their prior spread.
    """
    ratio = std / parameters.prior_std[parameters.free]
    at = int(np.argmax(ratio))
    return parameters.free_names[at] if ratio[at] > TOLERATED else None
