"""A fit of a few linear steps, which tells at little cost that no fit explains a recording."""

from typing import Final

import numpy as np

from calib.kinematics.adequacy import FEW_OUTLIERS, travelled
from calib.kinematics.drives import Parameters
from calib.kinematics.model import Model
from calib.kinematics.solve import LONGEST, RIDGE
from calib.types import FloatArray

#: turns of less say little: added to the rotation that heading residuals are relative to
LEAST_TURN_RAD: Final = 0.2
#: solutions of each step, the next by weights from what the last one leaves
REWEIGHTED: Final = 6


def residual_share(model: Model, values: FloatArray, residuals: FloatArray) -> float:
    """Return the rms of residuals, shape (n, 3), as a share of distance and rotation, without a few outliers."""
    return _trimmed(np.square(residuals / _sizes(model, values)).sum(axis=1))


def rough_fit(model: Model, parameters: Parameters, most: float) -> tuple[FloatArray, float]:
    """Return values, shape (n_parameters,), and the share that they leave to first order.

    Turns are fitted first: they are nearly linear in all parameters, and a path bends by them. The search ends at the
    nominal values where a step leaves more than a share `most`.
    """
    values, free, spread = parameters.nominal, parameters.free, parameters.prior_std[parameters.free]
    sizes = _sizes(model, values)
    for turns in (True, True, False):
        if turns:
            residuals, jacobian = (each[:, None] for each in model.turns(values))
        else:
            residuals, jacobian = (there := model.predict(values)).residuals, there.jacobian
        size = sizes[:, -residuals.shape[1] :]
        step, share = _step(residuals / size, jacobian[:, :, free] * spread / size[:, :, None], most)
        if not share < most:
            return parameters.nominal, share
        values[free] += spread * step / (max(float(np.abs(step).max()) / LONGEST, 1.0) if turns else 1.0)
    return values, share


def _sizes(model: Model, values: FloatArray) -> FloatArray:
    path, rotation = travelled(model, values)
    path = np.maximum(path, 1e-9)
    return np.stack([path, path, rotation + LEAST_TURN_RAD], axis=1)


def _step(residuals: FloatArray, jacobian: FloatArray, most: float) -> tuple[FloatArray, float]:
    flat, left = jacobian.reshape(-1, jacobian.shape[2]), residuals
    for _ in range(REWEIGHTED):
        weights = 1.0 / (1.0 + np.square(left / most).sum(axis=1))
        scaled = flat * np.repeat(weights, residuals.shape[1])[:, None]
        normal = scaled.T @ flat
        normal.flat[:: len(normal) + 1] += RIDGE * max(float(np.trace(normal)), 1e-9)
        step = np.linalg.solve(normal, residuals.ravel() @ scaled)
        left = residuals - jacobian @ step
    return step, _trimmed(np.square(left).sum(axis=1))


def _trimmed(squares: FloatArray) -> float:
    if not len(squares) or not np.isfinite(squares).all():
        return np.inf
    kept = len(squares) - max(1, int(FEW_OUTLIERS * len(squares)))
    return float(np.sqrt(np.mean(np.sort(squares)[: max(kept, 1)])))
