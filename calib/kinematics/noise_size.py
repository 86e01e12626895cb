"""Size of the noise, without what robust weights and parameters take from it, and what to expect by its doubt."""

from dataclasses import replace
from typing import Final

import numpy as np

from calib.kinematics.joint_fit import Fitted
from calib.kinematics.solve import COMPONENTS, DEGREES, LEAST, NOISE_STRETCHES, POWER, STATED_READINGS, kernels
from calib.kinematics.uncertainty import UNBIASED, flattened, whitened
from calib.types import FloatArray, IntArray

#: steps at most, and the relative change of all sizes that ends them
ROUNDS: Final = 200
SETTLED: Final = 1e-3
#: degrees of freedom with which variances that are possible have a mean
FEWEST_DOF: Final = 5
#: quantiles that a mean over normal noise is taken at: good to 1e-3
QUANTILES: Final = 1000


def noise_sizes(fitted: Fitted, stated: FloatArray) -> tuple[dict[str, float], dict[str, float]]:
    """Return standard deviations of the noise's components: estimated, and to expect of a further journey.

    `stated`: variances by the settings, shape (4,). The estimate is that of residuals enlarged by what the parameters
    took of each block (Bell and McCaffrey), with weights that leave normal noise its size. Few blocks leave it in
    doubt: what to expect is the mean of the variances that are possible, as that of a Student t is above its normal's.
    """
    from scipy.special import ndtr

    model, solution = fitted.model, fitted.solution
    some = slice(None, None, max(1, len(model.segments) // NOISE_STRETCHES))
    seen, block, rest = model.segments.seen[some], model.segments.block[some], _enlarged(fitted)[some]
    body, yaw_rad = model.motion(solution.values).body, float(solution.values[-2])
    kernel = kernels(solution.prediction.path, body, model.segments, yaw_rad)[:, some]
    size, scales = seen.sum(axis=1), solution.scales
    gain = normal_gain(size)
    for _ in range(ROUNDS):
        inverse = np.linalg.inv(np.tensordot(scales, kernel, 1) + np.eye(3) * ~seen[:, None])
        pull = (inverse @ rest[:, :, None])[:, :, 0]
        squares = (pull * rest).sum(axis=1)
        weights = gain * (DEGREES + size) / (DEGREES + squares)
        parts = np.einsum("ni,knij,nj->kn", pull * weights[:, None], kernel, pull)
        traces = np.einsum("knij,nji->kn", kernel, inverse)
        quotient = parts.sum(axis=1) + STATED_READINGS * stated / scales**2
        quotient /= np.maximum(traces.sum(axis=1) + STATED_READINGS / scales, 1e-300)
        before, scales = scales, np.maximum(scales * np.clip(quotient, 0.05, 20.0) ** POWER, LEAST * stated)
        if np.abs(np.log(scales / before)).max() < SETTLED:
            break

    scores = np.stack([np.bincount(block, row) for row in 0.5 * (parts - traces)])
    by_stated = np.diag(0.5 * STATED_READINGS / scales**2)
    # a weight that falls with the residual tells less of its size
    kept = (weights * squares * DEGREES / (DEGREES + squares)).sum() / size.sum()
    pulled = inverse @ kernel
    information = 0.5 * kept * np.einsum("knij,lnji->kl", pulled, pulled) + by_stated
    # a component that nothing tells of keeps its size
    told = np.diag(information)
    unit = np.diag(np.where(told > 0.0, 1.0 / np.sqrt(np.maximum(told, 1e-300)), 0.0))
    bread = unit @ np.linalg.inv(unit @ information @ unit + 1e-9 * np.eye(4)) @ unit
    doubt = np.sqrt(np.diag(bread @ (scores @ scores.T + by_stated) @ bread))
    dof = max(len(np.unique(block)) - int(fitted.parameters.free.sum()), FEWEST_DOF)
    # with what it shares a channel with, doubt sqrt(dof / 2), a component is an inverse chi squared, whose mean is
    # dof / (dof - 4) of that where all variances were alike likely; and none is negative
    mean = scales + doubt * np.sqrt(8.0 * dof) / (dof - 4.0)
    ratio = mean / np.maximum(doubt, 1e-9 * mean)
    expected = mean + doubt * np.exp(-0.5 * ratio**2) / np.sqrt(2.0 * np.pi) / ndtr(ratio)
    stds = np.sqrt([scales, expected]).tolist()
    return dict(zip(COMPONENTS, stds[0], strict=True)), dict(zip(COMPONENTS, stds[1], strict=True))


def normal_gain(size: IntArray) -> FloatArray:
    """Return by how much robust weights leave squares of normal noise in `size` channels too small, shape (n,)."""
    from scipy.special import chdtri

    channels = np.arange(1.0, 4.0)[:, None]
    squares = chdtri(channels, (np.arange(QUANTILES) + 0.5) / QUANTILES)
    left = np.mean((DEGREES + channels) * squares / (DEGREES + squares) / channels, axis=1)
    return np.asarray(1.0 / left[np.maximum(size, 1) - 1])


def _enlarged(fitted: Fitted) -> FloatArray:
    solution, block = replace(fitted.solution, shared=None), fitted.model.segments.block
    jacobian, white = whitened(solution, fitted.parameters.free)
    flat = flattened(jacobian)
    columns = jacobian @ np.linalg.inv(np.linalg.cholesky(flat.T @ flat + solution.pull)).T
    for one in np.unique(block):
        rows = block == one
        left, singular, _ = np.linalg.svd(flattened(columns[rows]), full_matrices=False)
        rest = white[rows].ravel()
        rest = rest + left @ ((np.maximum(1.0 - singular**2, 1e-6) ** -UNBIASED - 1.0) * (left.T @ rest))
        white[rows] = rest.reshape(-1, 3)
    white /= np.sqrt(solution.weights)[:, None]
    return np.asarray(np.linalg.solve(solution.whitener, white[:, :, None])[:, :, 0])
