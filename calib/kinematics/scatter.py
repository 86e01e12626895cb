"""Scatter of the radii from run to run, told from random walks along the path.

Both leave the same at the ends of runs that are alike; a walk grows with the root of the way, scatter with the way.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np

from calib.kinematics.drives import NOMINAL_STD
from calib.kinematics.joint_fit import Fitted
from calib.kinematics.solve import COMPONENTS, kernels
from calib.kinematics.uncertainty import ENOUGH_RUNS
from calib.types import FloatArray

#: scatter -> the walk that it is told from, and relative changes of the radii, left and right
_SCATTERS: Final = {"radius_scatter": ("along_walk", (1.0, 1.0)), "yaw_scatter": ("heading_walk", (-0.5, 0.5))}
_RADII: Final = ("radius_left_m", "radius_right_m")
#: of what without scatter the walk is: none to more than all, all alike likely before
_WALK_PARTS: Final = np.linspace(0.05, 1.55, 16)
#: as of scatter (Gelman, Bayesian Analysis 1, 2006), beside that of all runs if there was no other noise
_SCATTER_PARTS: Final = np.linspace(0.0, 4.0, 81)


def told_from_walks(fitted: Fitted, expected: Mapping[str, float]) -> dict[str, float]:
    """Return the noise to expect of a further journey, with the relative scatter of radii from run to run.

    `expected`: standard deviations of the noise's components without it. Means of the variances possible; none is told
    by fewer than `ENOUGH_RUNS`, or by runs of which a single one does not tell the radii to `NOMINAL_STD`.
    """
    model, solution, out = fitted.model, fitted.solution, dict(expected)
    segments, run = model.segments, np.unique(model.segments.run, return_inverse=True)[1]
    if run.max() + 1 < ENOUGH_RUNS or not set(_RADII) <= set(fitted.parameters.free_names):
        return out
    at = [fitted.parameters.names.index(name) for name in _RADII]
    by_wheel = solution.prediction.jacobian[:, :, at] * solution.values[at]
    body, yaw_rad = model.motion(solution.values).body, float(solution.values[-2])
    kernel = kernels(solution.prediction.path, body, segments, yaw_rad)
    unseen = np.eye(3) * ~segments.seen[:, None]
    for name, (walk, shares) in _SCATTERS.items():
        columns = np.stack([by_wheel @ shares, solution.prediction.residuals], axis=2)
        bases, products = [], []
        for part in _WALK_PARTS:
            scales = solution.scales * np.where(np.array(COMPONENTS) == walk, part**2, 1.0)
            inverse = np.linalg.inv(np.tensordot(scales, kernel, 1) + unseen)
            each = solution.weights[:, None, None] * (columns.transpose(0, 2, 1) @ inverse @ columns)
            sums = np.stack([np.bincount(run, row) for row in (each[:, 0, 0], each[:, 0, 1])])
            bases.append(0.5 * float(np.linalg.slogdet(inverse)[1].sum() - each[:, 1, 1].sum()))
            products.append(sums)
        information, pulls = np.stack(products, axis=1)
        if float(np.median(information[-1])) * NOMINAL_STD**2 < 1.0:
            continue
        largest = np.sqrt(np.square(pulls).sum(axis=1) / np.square(information).sum(axis=1)).max()
        variances = np.square(largest * _SCATTER_PARTS)
        each_part = zip(bases, information, pulls, strict=True)
        likely = np.stack([base + _log_likelihood(seen, pull, variances) for base, seen, pull in each_part])
        likely = np.exp(likely - likely.max()) * np.where(variances > 0.0, 1.0 / (len(variances) - 1), 1.0)
        likely /= likely.sum()
        out[name] = float(np.sqrt(likely.sum(axis=0) @ variances))
        out[walk] *= float(np.sqrt(likely.sum(axis=1) @ np.square(_WALK_PARTS)))
    return out


def _log_likelihood(information: FloatArray, pulls: FloatArray, variances: FloatArray) -> FloatArray:
    # of each variance of what runs add; what all have in common was estimated, and is integrated over
    wider = 1.0 + variances[:, None] * information
    common, pull = (information / wider).sum(axis=1), (pulls / wider).sum(axis=1)
    gained = (variances[:, None] * np.square(pulls) / wider - np.log(wider)).sum(axis=1)
    return np.asarray(0.5 * (gained - np.log(common) + np.square(pull) / common))
