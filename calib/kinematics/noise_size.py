"""Size of the noise, without what weights and parameters take from it, and what to expect of a further journey."""

from dataclasses import replace
from typing import Final

import numpy as np

from calib.kinematics.joint_fit import Fitted
from calib.kinematics.solve import COMPONENTS, DEGREES, LEAST, NOISE_STRETCHES, POWER, STATED_READINGS, kernels
from calib.kinematics.uncertainty import UNBIASED, flattened, whitened
from calib.types import FloatArray

#: of the weights, by which they leave the squares of normal noise in none to three channels their mean
NORMAL_GAIN: Final = np.array([1.0, 1.2382, 1.1846, 1.1469])
#: steps: what the data tell well settles in half of them
ROUNDS: Final = 100
#: degrees of freedom with which possible variances have a mean
FEWEST_DOF: Final = 5


def noise_sizes(fitted: Fitted, stated: FloatArray) -> list[dict[str, float]]:
    """Return standard deviations of the noise's components: estimated, and to expect of a further journey.

    `stated`: variances by the settings, shape (4,). The estimate is of residuals enlarged by what the parameters took
    of each block (Bell and McCaffrey). Few blocks leave variances uncertain: to expect is the mean of those possible.
    """
    model, solution = fitted.model, fitted.solution
    segments, scales = model.segments, solution.scales
    some = slice(None, None, max(1, len(segments) // NOISE_STRETCHES))
    seen, block, rest = segments.seen[some], segments.block[some], _enlarged(fitted)[some]
    body, yaw_rad = model.motion(solution.values).body, float(solution.values[-2])
    kernel = kernels(solution.prediction.path, body, segments, yaw_rad)[:, some]
    size = seen.sum(axis=1)
    for _ in range(ROUNDS):
        inverse = np.linalg.inv(np.tensordot(scales, kernel, 1) + np.eye(3) * ~seen[:, None])
        pull, pulled = (inverse @ rest[:, :, None])[:, :, 0], inverse @ kernel
        squares = (pull * rest).sum(axis=1)
        weights = NORMAL_GAIN[size] * (DEGREES + size) / (DEGREES + squares)
        parts, traces = np.einsum("n,ni,knij,nj->kn", weights, pull, kernel, pull), np.einsum("knii->kn", pulled)
        readings = STATED_READINGS / scales
        quotient = (parts.sum(axis=1) + readings * stated / scales) / np.maximum(traces.sum(axis=1) + readings, 1e-300)
        scales = np.maximum(scales * np.clip(quotient, 0.05, 20.0) ** POWER, LEAST * stated)

    scores = np.stack([np.bincount(block, row) for row in 0.5 * (parts - traces)])
    # a weight that falls with the residual tells less of its size
    kept = (weights * squares * DEGREES / (DEGREES + squares)).sum() / size.sum()
    by_stated = np.diag(0.5 * readings / scales)
    bread = np.linalg.pinv(0.5 * kept * np.einsum("knij,lnji->kl", pulled, pulled) + by_stated, hermitian=True)
    variance_std = np.sqrt(np.diag(bread @ (scores @ scores.T + by_stated) @ bread))
    dof = max(len(np.unique(block)) - int(fitted.parameters.free.sum()), FEWEST_DOF)
    # with what shares its channel, uncertain by sqrt(2 / dof), an inverse chi squared: its mean is dof / (dof - 4) of
    # that where all variances were alike likely
    expected = scales + variance_std * np.sqrt(8.0 * dof) / (dof - 4.0)
    return [dict(zip(COMPONENTS, row, strict=True)) for row in np.sqrt([scales, expected]).tolist()]


def _enlarged(fitted: Fitted) -> FloatArray:
    solution, block = replace(fitted.solution, shared=None), fitted.model.segments.block
    jacobian, white = whitened(solution, fitted.parameters.free)
    flat = flattened(jacobian)
    columns = jacobian @ np.linalg.inv(np.linalg.cholesky(flat.T @ flat + solution.pull)).T
    for one in np.unique(block):
        rows = block == one
        left, singular, _ = np.linalg.svd(flattened(columns[rows]), full_matrices=False)
        grow = np.maximum(1.0 - singular**2, 1e-6) ** -UNBIASED - 1.0
        white[rows] += (left @ (grow * (left.T @ white[rows].ravel()))).reshape(-1, 3)
    white = white[:, :, None] / np.sqrt(solution.weights)[:, None, None]
    return np.asarray(np.linalg.solve(solution.whitener, white)[:, :, 0])
