"""The evidence of models integrated over the scales of the noise, component by component.

All runs tell the scales under each model: the integral is taken about the most likely ones (Laplace; Tierney and
Kadane, JASA 81 (1986) 82).
"""

from collections.abc import Iterable
from typing import Final

import numpy as np

from calib.gap.inference.least_squares import LinearSystem, Weighting
from calib.gap.inference.local_search import LocalSearch, Model
from calib.gap.inference.marginal_likelihood import log_marginal, prior_scale, ridge_solve
from calib.gap.inference.noise_components import COMPONENTS, N_CHANNELS, PRIOR_MEDIANS, NoiseComponents, whitener_of
from calib.gap.inference.repeatability import MAX_REPLICATES, PRIOR_SPREADS, SCALE_BOUNDS
from calib.types import FloatArray

#: steps from the scales of replicates to the most likely ones
_MAX_STEPS: Final = 30
_RIDGE: Final = 1e-2
#: cost of noise estimated too small by 1.4 in one channel of a hundred runs: 30 degrees of freedom err by no more
NOISE_WINDOW: Final = 14.0
#: of variances: channels exactly alike stay factorable
_ROUNDING: Final = 1e-9


class ScaleEvidence:
    """Likelihood of the noise's scales under a model by all units.

    `system`: whitened by the estimated noise.
    """

    def __init__(self, system: LinearSystem) -> None:
        noise, shapes = system.noise, NoiseComponents.about(system.path)
        both = shapes.usable[:, :, None] & shapes.usable[:, None, :]
        white = noise.whitener
        self._active = shapes.active
        self._kernels, fixed = (
            np.where(both, white @ np.where(both, part, 0.0) @ white.transpose(0, 2, 1), 0.0)
            / noise.weight[:, None, None]
            for part in (shapes.kernels, shapes.fixed)
        )
        index = np.arange(N_CHANNELS)
        fixed[:, index, index] += np.where(shapes.usable, _ROUNDING, 1.0)
        self._fixed, self._blocks = fixed, system.blocks
        self._estimated = np.log([noise.scales.get(name, median) for name, median, _ in COMPONENTS])
        self._gap = self._by_unit(system.gap[:, None])[:, :, 0]

    @staticmethod
    def is_open(system: LinearSystem) -> bool:
        """Return whether so few units leave the scales open; more tell them to a few per cent."""
        return len(system.path.s) <= MAX_REPLICATES

    def _by_unit(self, columns: FloatArray) -> FloatArray:
        spread = np.zeros((len(self._fixed), N_CHANNELS, columns.shape[1]))
        spread[self._blocks.unit, self._blocks.channel] = columns
        return spread

    def _whitened_at(self, log_scale: FloatArray) -> tuple[FloatArray, FloatArray]:
        variance = np.asarray(np.exp(2 * log_scale) * self._active)
        return variance, whitener_of(np.tensordot(variance, self._kernels, axes=1) + self._fixed)

    def _cost(self, log_scale: FloatArray, columns: FloatArray) -> tuple[float, FloatArray, float, float]:
        """Return minus the log likelihood with prior, its gradient, the gap's square and log |C|.

        `columns`: (n_units, 6, q), of model and nuisances, to unit prior variance.
        """
        variance, factor = self._whitened_at(log_scale)
        own, gap = factor @ columns, (factor @ self._gap[:, :, None])[:, :, 0]
        flat = own.reshape(-1, own.shape[2])
        lower = np.linalg.cholesky(np.eye(flat.shape[1]) + flat.T @ flat)
        own = own @ np.linalg.inv(lower).T
        along = own.reshape(flat.shape).T @ gap.ravel()
        square = float((gap**2).sum() - along @ along)
        diagonals = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(), np.log(np.diag(lower)).sum()
        log_det = 2 * float(diagonals[1] - diagonals[0])
        turned = factor.transpose(0, 2, 1)
        alpha = (turned @ (gap - own @ along)[:, :, None])[:, :, 0]
        kept = np.eye(N_CHANNELS) - own @ own.transpose(0, 2, 1)
        inner = turned @ kept @ factor - alpha[:, :, None] * alpha[:, None, :]
        away = (log_scale - np.log(PRIOR_MEDIANS)) / PRIOR_SPREADS * self._active
        gradient = np.tensordot(self._kernels, inner, axes=([1, 2, 3], [0, 1, 2])) * variance + away / PRIOR_SPREADS
        return 0.5 * (log_det + square + float(away @ away)), gradient, square, log_det

    def _information(self, log_scale: FloatArray) -> FloatArray:
        variance, factor = self._whitened_at(log_scale)
        parts = (factor @ self._kernels[self._active] @ factor.transpose(0, 2, 1)).reshape(int(self._active.sum()), -1)
        parts *= variance[self._active][:, None]
        return np.asarray(2 * parts @ parts.T + np.diag(1.0 / PRIOR_SPREADS[self._active] ** 2))

    def gain(self, columns: FloatArray) -> float:
        """Return the log evidence over all scales less that at the estimated ones.

        `columns`: (n_rows, q), whitened, of the model and what it may leave, to unit prior variance.
        """
        from scipy.optimize import minimize

        spread = self._by_unit(columns)
        _, _, square, log_det = self._cost(self._estimated, spread)
        best = minimize(
            lambda log_scale: self._cost(log_scale, spread)[:2],
            self._estimated,
            jac=True,
            method="L-BFGS-B",
            bounds=SCALE_BOUNDS,
            options={"maxiter": _MAX_STEPS, "ftol": 1e-7},
        )
        over_all = -float(best.fun) - 0.5 * float(np.linalg.slogdet(self._information(best.x))[1])
        return over_all - float(log_marginal(square, log_det, len(self._blocks.unit)))


def scale_gains(
    local: LocalSearch, weight: FloatArray, likely: Iterable[int], models: list[Model], window: float
) -> FloatArray:
    """Return the change of the log weights by the integral over the noise's scales, in the shape of `weight`.

    Parameters
    ----------
    local, models
    weight : shape (n_scales, n_models)
        Log weights beside the noise as it was estimated.
    likely
        Models to integrate; the gain of the others is the least of theirs.
    window
        Weights this far below the best are not integrated; that of noise alone is by `NOISE_WINDOW`.
    """
    evidence, gains = ScaleEvidence(local.system), np.full(weight.shape, np.nan)
    for n in likely:
        if local.columns.layout.wide in models[n]:
            continue
        for scale in {0, int(np.argmax(weight[:, n]))}:
            # what differs between runs without repeats is no noise estimated too small
            alone = not models[n] and local.system.noise.supported
            if weight[scale, n] > weight.max() - (NOISE_WINDOW if alone else window):
                gains[scale, n] = evidence.gain(_columns(local, models[n], scale))
    if not np.isfinite(gains).any():
        return np.zeros(weight.shape)
    least = np.where(np.isfinite(gains), gains, np.inf).min(axis=0)
    return np.where(np.isfinite(gains), gains, np.where(np.isfinite(least), least, least.min()))


def held_gain(local: LocalSearch) -> float:
    """Return the same for noise alone, the calibration as believed."""
    return ScaleEvidence(local.system).gain(local.system.calibration[:, 3:])


def _columns(local: LocalSearch, model: Model, scale: int) -> FloatArray:
    system, sums = local.system, local.sums
    weighting = Weighting(system, int(sums.kind[scale]), float(sums.scale[scale]), local.deviations)
    parts = [system.calibration, weighting.common]
    if model:
        (place,), (owner,) = local.columns.index([model])
        sizes = ridge_solve(*sums.of_columns(scale, place), _RIDGE)
        most = prior_scale(sizes[None], owner[None], local.columns, place[None])[0]
        parts.append(np.concatenate([system.of(k) for k in model], axis=1) * most)
    for (_, places), own in zip(system.blocks.alike, weighting.own, strict=True):
        spread = np.zeros((len(system.gap), len(places), own.shape[2]))
        spread[places, np.arange(len(places))[:, None]] = own
        parts.append(spread.reshape(len(system.gap), -1))
    return np.concatenate(parts, axis=1)
