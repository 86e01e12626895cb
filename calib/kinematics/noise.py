"""Sizes of the noise, and the scatter of radii from run to run beside random walks along the path."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from calib.kinematics.drives import NOMINAL_STD
from calib.kinematics.joint_fit import Fitted
from calib.kinematics.solve import COMPONENTS, DEGREES, LEAST, NOISE_STRETCHES, POWER, STATED_READINGS, kernels
from calib.kinematics.uncertainty import ENOUGH_RUNS, UNBIASED, flattened, whitened
from calib.types import FloatArray

#: of the weights in none to three channels: normal noise keeps its mean square
NORMAL_GAIN: Final = np.array([1.0, 1.2382, 1.1846, 1.1469])
#: steps: most settles in half of them
ROUNDS: Final = 100
#: degrees of freedom with which variances have a mean
FEWEST_DOF: Final = 5
#: scatter -> the walk that it is told from, and relative changes of the radii, left and right
_SCATTERS: Final = {"radius_scatter": ("along_walk", (1.0, 1.0)), "yaw_scatter": ("heading_walk", (-0.5, 0.5))}
_RADII: Final = ("radius_left_m", "radius_right_m")
#: of what the walk is without scatter, all alike likely
_WALK_PARTS: Final = np.linspace(0.05, 1.55, 16)
#: of what the scatter is without other noise: even odds of none, else all alike likely (Gelman, Bayesian Analysis 1,
#: 2006)
_SCATTER_PARTS: Final = np.linspace(0.0, 4.0, 81)
_ODDS: Final = np.where(_SCATTER_PARTS > 0.0, 1.0 / 80.0, 1.0)


def noise_sizes(fitted: Fitted, stated: FloatArray) -> tuple[dict[str, float], dict[str, float]]:
    """Return standard deviations of the noise's components: estimated, and to expect of a further journey.

    `stated`: variances by the settings, shape (4,). The estimate is of residuals enlarged by what the parameters took
    of each block (Bell and McCaffrey). To expect is the mean of the variances possible, with the relative scatter of
    radii from run to run, told from walks by `ENOUGH_RUNS`.
    """
    model, solution = fitted.model, fitted.solution
    segments, scales = model.segments, solution.scales
    thinned = slice(None, None, max(1, len(segments) // NOISE_STRETCHES))
    seen, block, residuals = segments.seen[thinned], segments.block[thinned], _enlarged(fitted)[thinned]
    body, yaw_rad = model.motion(solution.values).body, float(solution.values[-2])
    whole = kernels(solution.prediction.path, body, segments, yaw_rad)
    kernel = whole[:, thinned]
    size = seen.sum(axis=1)
    for _ in range(ROUNDS):
        inverse = np.linalg.inv(np.tensordot(scales, kernel, 1) + np.eye(3) * ~seen[:, None])
        pull, pulled = (inverse @ residuals[:, :, None])[:, :, 0], inverse @ kernel
        squares = (pull * residuals).sum(axis=1)
        weights = NORMAL_GAIN[size] * (DEGREES + size) / (DEGREES + squares)
        parts, traces = np.einsum("n,ni,knij,nj->kn", weights, pull, kernel, pull), np.einsum("knii->kn", pulled)
        readings = STATED_READINGS / scales
        quotient = (parts.sum(axis=1) + readings * stated / scales) / np.maximum(traces.sum(axis=1) + readings, 1e-300)
        scales = np.maximum(scales * np.clip(quotient, 0.05, 20.0) ** POWER, LEAST * stated)

    scores = np.stack([np.bincount(block, row) for row in 0.5 * (parts - traces)])
    kept = (weights * squares * DEGREES / (DEGREES + squares)).sum() / size.sum()
    by_stated = np.diag(0.5 * readings / scales)
    bread = np.linalg.pinv(0.5 * kept * np.einsum("knij,lnji->kl", pulled, pulled) + by_stated, hermitian=True)
    variance_std = np.sqrt(np.diag(bread @ (scores @ scores.T + by_stated) @ bread))
    dof = max(len(np.unique(block)) - int(fitted.parameters.free.sum()), FEWEST_DOF)
    # uncertain by sqrt(2 / dof), an inverse chi squared: its mean is dof / (dof - 4) of
    expected = scales + variance_std * np.sqrt(8.0 * dof) / (dof - 4.0)
    estimated, further = (dict(zip(COMPONENTS, row, strict=True)) for row in np.sqrt([scales, expected]).tolist())
    return estimated, _told_from_walks(fitted, further, whole)


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


def _told_from_walks(fitted: Fitted, expected: Mapping[str, float], kernel: FloatArray) -> dict[str, float]:
    segments, solution, out = fitted.model.segments, fitted.solution, dict(expected)
    run = np.unique(segments.run, return_inverse=True)[1]
    if run.max() + 1 < ENOUGH_RUNS or not set(_RADII) <= set(fitted.parameters.free_names):
        return out
    at = [fitted.parameters.names.index(name) for name in _RADII]
    by_wheel = solution.prediction.jacobian[:, :, at] * solution.values[at]
    for name, (walk, shares) in _SCATTERS.items():
        columns = np.stack([by_wheel @ shares, solution.prediction.residuals], axis=2)
        rows: list[tuple[float, FloatArray, FloatArray]] = []
        for part in _WALK_PARTS:
            scales = solution.scales * np.where(np.array(COMPONENTS) == walk, part**2, 1.0)
            inverse = np.linalg.inv(np.tensordot(scales, kernel, 1) + np.eye(3) * ~segments.seen[:, None])
            each = solution.weights[:, None, None] * (columns.transpose(0, 2, 1) @ inverse @ columns)
            likelihood = 0.5 * float(np.linalg.slogdet(inverse)[1].sum() - each[:, 1, 1].sum())
            size, pull = (np.bincount(run, of).astype(np.float64) for of in each[:, 0].T)
            rows.append((likelihood, size, pull))
        # a single run that does not tell the radii tells no scatter
        if float(np.median(rows[-1][1])) * NOMINAL_STD**2 < 1.0:
            continue
        variances = np.square(_SCATTER_PARTS) * max((pull @ pull) / (size @ size) for _, size, pull in rows)
        likely = np.stack([one + _log_likelihood(size, pull, variances) for one, size, pull in rows])
        likely = np.exp(likely - likely.max()) * _ODDS
        likely /= likely.sum()
        out[name] = float(np.sqrt(likely.sum(axis=0) @ variances))
        out[walk] *= float(np.sqrt(likely.sum(axis=1) @ np.square(_WALK_PARTS)))
    return out


def _log_likelihood(information: FloatArray, pulls: FloatArray, variances: FloatArray) -> FloatArray:
    # of each variance of what runs add; what all have in common is integrated over
    wider = 1.0 + variances[:, None] * information
    common, pull = (information / wider).sum(axis=1), (pulls / wider).sum(axis=1)
    gained = (variances[:, None] * np.square(pulls) / wider - np.log(wider)).sum(axis=1)
    return np.asarray(0.5 * (gained - np.log(common) + np.square(pull) / common))
