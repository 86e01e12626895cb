"""Marginal likelihood of Gaussian hypotheses: sets of forms by scalar products alone, and over the noise's scales.

All runs tell the scales under each model, component by component: the integral is taken about the most likely ones
(Laplace; Tierney and Kadane, JASA 81 (1986) 82).
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from calib.gap.effects import Form
from calib.gap.inference.least_squares import LinearSystem
from calib.gap.inference.noise_components import COMPONENTS, N_CHANNELS, PRIOR_MEDIANS, NoiseComponents, whitener_of
from calib.gap.inference.repeatability import MAX_REPLICATES, PRIOR_SPREADS, SCALE_BOUNDS
from calib.gap.inference.scalar_products import FormPriors, Sums
from calib.types import BoolArray, FloatArray, IntArray

#: degrees of freedom of the noise level before the gap is looked at
FLOOR_DOF: Final = 20.0
_BATCH_SIZE: Final = 400
#: entries of scalar products at a time: 1 MB stays in the cache
_BATCH_ENTRIES: Final = 2**17
#: classes of width, in columns
_WIDTH_CLASSES: Final = (0, 1, 2, 3, 4, 6, 8, 12, 20, 40, 80)
#: smallest prior scale of a column, in typical sizes, and ridge of the sizes that choose it
_LEAST_SCALE: Final = 0.1
_RIDGE: Final = 1e-2
#: probability of a scale that adds nothing to an average
_NO_WEIGHT: Final = 1e-15
#: of a unit-diagonal matrix: smaller is rounding
_LEAST_PIVOT: Final = 1e-12
#: log-evidence window of the best, beyond which wide forms are not weighed
_NEGLIGIBLE: Final = 60.0
#: steps from the scales of replicates to the most likely ones
_MAX_STEPS: Final = 30
#: of variances: channels exactly alike stay factorable
_ROUNDING: Final = 1e-9


class Nuisance:
    """What is not judged: a recalibration, and deviations of known effects.

    `columns`: (n_rows, k), whitened, to unit prior variance.
    """

    def __init__(self, columns: FloatArray) -> None:
        self.columns = columns
        gram = np.eye(columns.shape[1]) + columns.T @ columns
        root = np.sqrt(np.diag(gram))
        lower = np.linalg.cholesky(gram / np.outer(root, root) + 1e-11 * np.eye(len(gram)))
        #: shape (k, k): inverse Cholesky factor of I + X^T X; log |I + X X^T|
        self.factor = np.linalg.solve(lower, np.diag(1.0 / root))
        self.log_det = float(2 * (np.log(np.diag(lower)) + np.log(root)).sum())

    def scalar(self, left: FloatArray, right: FloatArray) -> FloatArray:
        """Return left^T (I + X X^T)^-1 right of columns (n_rows, p) and (n_rows, q), (p, q)."""
        a, b = self.factor @ (self.columns.T @ left), self.factor @ (self.columns.T @ right)
        products: FloatArray = left.T @ right - a.T @ b
        return products


def log_marginal(square: float | FloatArray, log_det: float | FloatArray, n_rows: int) -> FloatArray:
    """Return the log evidence of a Gaussian hypothesis whose noise level is known up to a common factor.

    With the factor integrated out. `square`: y^T C^-1 y, C in units of the noise level; `log_det`: log |C|, same
    shape; `n_rows`: length of y.
    """
    spread = -0.5 * (FLOOR_DOF + n_rows) * np.log1p(np.asarray(square) / FLOOR_DOF)
    return spread - 0.5 * np.asarray(log_det)


def project(nuisance: Nuisance, columns: FloatArray) -> FloatArray:
    """Return columns projected by about (I + X X^T)^(-1/2): their residual beside a broad nuisance."""
    weights = nuisance.factor.T @ (nuisance.factor @ (nuisance.columns.T @ columns))
    products: FloatArray = columns - nuisance.columns @ weights
    return products


def ridge_solve(gram: FloatArray, right: FloatArray, ridge: float) -> FloatArray:
    """Solve (G + ridge I) x = g on a unit diagonal: columns alike do no harm.

    `gram`: (..., p, p), scalar products of the columns; `right`: (..., p), with the residual. Returns shape (..., p).
    """
    size = np.sqrt(np.diagonal(gram, axis1=-2, axis2=-1) + ridge)
    scaled = _with_diagonal(gram / (size[..., :, None] * size[..., None, :]), 1.0 + 1e-10)
    if gram.ndim == 2:
        return np.linalg.solve(scaled, right / size) / size
    pivots, rows = _eliminated(scaled, (right / size)[..., None])
    sizes = rows[:, -1] / pivots
    for j in range(len(rows) - 2, -1, -1):
        sizes[j] -= (rows[j, j + 1 : -1] * sizes[j + 1 :]).sum(axis=0) / pivots[j]
    return np.moveaxis(sizes, 0, -1) / size


def _with_diagonal(matrix: FloatArray, value: float) -> FloatArray:
    place = np.arange(matrix.shape[-1])
    matrix[..., place, place] = value
    return matrix


def log_weights(sums: Sums, columns: FormPriors, models: Sequence[tuple[int, ...]]) -> FloatArray:
    """Return log evidence plus log prior of each model at each scale of the lack of fit, (n_scales, n_models).

    -inf where a wide form cannot come near the best.
    """
    value = np.full((len(sums.square), len(models)), -np.inf)
    wide = np.array([columns.layout.wide in model for model in models], dtype=bool)
    prior, widths = columns.priors(models), columns.widths(models)
    # padding would cost the cube of the widest
    group = np.where(wide, -1, np.searchsorted(_WIDTH_CLASSES, widths))
    for number in np.unique(group[~wide]):
        places = np.flatnonzero(group == number)
        index, owner = columns.index([models[k] for k in places.tolist()])
        entries = max(index.shape[1], 1) ** 2
        size = int(np.clip(_BATCH_ENTRIES // (len(value) * entries), 1, _BATCH_SIZE))
        n_scales = max(_BATCH_ENTRIES // (size * entries), 1)
        for first in range(0, len(places), size):
            batch = slice(first, first + size)
            for low in range(0, len(value), n_scales):
                scales = slice(low, low + n_scales)
                value[scales, places[batch]] = _batch(sums.pick(scales), columns, index[batch], owner[batch])
    value += sums.log_prior[:, None] + prior
    if wide.any():
        with_wide = [model for model, is_wide in zip(models, wide, strict=True) if is_wide]
        value[:, wide] = _beside_wide(sums, columns, with_wide, float(value[:, ~wide].max(initial=-np.inf)))
    return value


def _batch(sums: Sums, columns: FormPriors, index: IntArray, owner: IntArray) -> FloatArray:
    if index.shape[1] == 0:
        return log_marginal(sums.square, sums.log_det, sums.n_rows)[:, None]
    present = index >= 0
    places = index.T
    gram = np.moveaxis(sums.gram[:, places[:, None], places[None]], 3, 1)
    gram, right = _padded(gram, np.swapaxes(sums.right[:, places], 1, 2), present)
    variance = _variance(ridge_solve(gram, right, _RIDGE), owner, columns, index)
    sign, square, log_det = np.where(present, columns.sign[index], 0), sums.square[:, None], sums.log_det[:, None]
    return _log_evidence(gram, right, variance, sign, square, log_det, sums.n_rows)


def _padded(gram: FloatArray, right: FloatArray, present: BoolArray) -> tuple[FloatArray, FloatArray]:
    if not present.all():
        gram = gram * (present[:, :, None] & present[:, None, :])
        gram += np.eye(present.shape[1]) * np.where(present, 0.0, 1.0)[:, None, :]
        right = right * present
    return gram, right


def _variance(sizes: FloatArray, owner: IntArray, columns: FormPriors, index: IntArray) -> FloatArray:
    return np.where(owner >= 0, prior_scale(sizes, owner, columns, index) ** 2, 1e-12)


def _log_evidence(
    gram: FloatArray,
    right: FloatArray,
    variance: FloatArray,
    sign: IntArray,
    square: FloatArray,
    log_det: FloatArray,
    n_rows: int,
) -> FloatArray:
    bayes, gain = log_evidence_parts(gram, right, variance)
    value = log_marginal(np.maximum(square - gain, 1e-9), log_det + bayes, n_rows)
    signed = sign.any(axis=1)
    if signed.any():
        value[:, signed] += log_sign_probability(gram[:, signed], right[:, signed], variance[:, signed], sign[signed])
    return value


def _beside_wide(sums: Sums, priors: FormPriors, models: Sequence[tuple[int, ...]], best: float) -> FloatArray:
    value, wide = np.full((len(sums.square), len(models)), -np.inf), priors.layout.wide
    index, owner = priors.index([tuple(form for form in model if form != wide) for model in models])
    prior, columns = priors.priors(models), np.unique(index[index >= 0])
    left: dict[int, float] = {}
    assert sums.wide is not None
    for n in np.lexsort((-sums.scale, sums.kind)).tolist():
        kind, top = int(sums.kind[n]), float(sums.log_prior[n] + prior.max()) + _NEGLIGIBLE
        if kind in left and top + log_marginal(left[kind], sums.log_det[n], sums.n_rows) < best:
            continue
        own = sums.wide.at(n)[0]
        left[kind] = _least_left(sums, n, columns, 1.0 / float(priors.most.max()) ** 2)
        log_det = sums.log_det[n] + np.linalg.slogdet(np.eye(len(own)) + _LEAST_SCALE**2 * own)[1]
        if top + log_marginal(left[kind], log_det, sums.n_rows) < best:
            continue
        value[n] = sums.log_prior[n] + prior + _wide_at(sums, n, priors, index, owner)
        best = max(best, float(value[n].max()))
    return value


def _least_left(sums: Sums, n: int, columns: IntArray, ridge: float) -> float:
    assert sums.wide is not None
    own, across = sums.wide.at(n)
    half = np.linalg.solve(np.linalg.cholesky(own + ridge * np.eye(len(own))), across[:, [*columns, -1]])
    products = half.T @ half
    gram = sums.gram[n][columns[:, None], columns] - products[:-1, :-1]
    right = sums.right[n][columns] - products[:-1, -1]
    return float(max(sums.square[n] - products[-1, -1] - right @ ridge_solve(gram, right, ridge), 1e-9))


def _wide_at(sums: Sums, n: int, priors: FormPriors, index: IntArray, owner: IntArray) -> FloatArray:
    assert sums.wide is not None
    own, across = sums.wide.at(n)
    eigen, axes = np.linalg.eigh(own)
    eigen, turned, present = np.maximum(eigen, 0.0), axes.T @ across, index >= 0
    gram, right = sums.gram[n][index[:, :, None], index[:, None, :]], sums.right[n][index]
    beside, gap = turned[:, index].transpose(1, 0, 2), turned[:, -1]

    def reduced(share: FloatArray) -> tuple[FloatArray, FloatArray]:
        less = beside.transpose(0, 2, 1) * share[:, None, :]
        return _padded(gram - less @ beside, right - less @ gap, present)

    share = np.broadcast_to(1.0 / (eigen + _RIDGE), (len(index), len(eigen)))
    sizes = ridge_solve(*reduced(share), _RIDGE)
    own_sizes = share * (gap - (beside @ (sizes * present)[:, :, None])[:, :, 0])
    most = float(priors.most[priors.layout.starts[priors.layout.wide]])
    scale = np.clip(np.sqrt((own_sizes**2).mean(axis=1)), _LEAST_SCALE, most)[:, None]
    share = 1.0 / (eigen + scale**-2)
    square = sums.square[n] - share @ gap**2
    log_det = sums.log_det[n] + np.log1p(scale**2 * eigen).sum(axis=1)
    variance, sign = _variance(sizes, owner, priors, index), np.where(present, priors.sign[index], 0)
    gram, right = reduced(share)
    value = _log_evidence(gram[None], right[None], variance[None], sign, square, log_det, sums.n_rows)
    return np.asarray(value[0])


def prior_scale(sizes: FloatArray, owner: IntArray, columns: FormPriors, index: IntArray) -> FloatArray:
    """Return each column's prior scale: its form's rms size, from a tenth to what is plausible."""
    most = columns.most[index]
    alike = (owner[:, :, None] == owner[:, None, :]) * columns.own[index][:, None, :]
    alike /= np.maximum(alike.sum(axis=2, keepdims=True), 1.0)
    mean_square = np.moveaxis(np.einsum("mab,...mb->a...m", alike, sizes**2), 0, -1)
    return np.asarray(np.clip(np.sqrt(mean_square), _LEAST_SCALE, most))


def effect_scale(sizes: FloatArray, form: Form) -> float:
    """Return the prior scale of a form in typical sizes; see `prior_scale`."""
    own = [not p.shift for p in form.parameters]
    size = float(np.sqrt(np.mean(sizes[own] ** 2))) if len(sizes) else 1.0
    most = max([3.0, *(p.largest / p.typical for p in form.parameters)])
    return float(np.clip(size, 0.1, most))


def log_evidence_parts(gram: FloatArray, right: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return log |I + S G| and g^T (S^-1 + G)^-1 g, each shape (...)."""
    root = np.sqrt(variance)
    inner, size = _inner(gram, root)
    pivots, rows = _eliminated(inner, (root * right / size)[..., None])
    log_det = np.log(pivots).sum(axis=0) + 2.0 * np.log(size).sum(axis=-1)
    return log_det, (rows[:, -1] ** 2 / pivots).sum(axis=0)


def log_sign_probability(gram: FloatArray, right: FloatArray, variance: FloatArray, sign: IntArray) -> FloatArray:
    """Return the log probability that sizes have their only possible sign, (...), each as if independent.

    `gram`: (..., k, k); `right`, `variance`, `sign`: (..., k), sign 0 for either.
    """
    from scipy.special import log_ndtr

    root = np.sqrt(variance)
    inner, size = _inner(gram, root)
    signed = np.flatnonzero((sign != 0).reshape(-1, sign.shape[-1]).any(axis=0))
    sides = np.empty((*inner.shape[:-1], 1 + len(signed)))
    sides[..., 0], sides[..., 1:] = root * right / size, np.eye(sign.shape[-1])[:, signed]
    pivots, rows = _eliminated(inner, sides)
    right, own = rows[:, len(pivots), None], rows[:, len(pivots) + 1 :]
    share = own / pivots[:, None]
    mean, spread = (np.moveaxis((share * of).sum(axis=0), 0, -1) for of in (right, own))
    spread = np.sqrt(spread)
    held = sign[..., signed]
    return np.asarray(np.where(held != 0, log_ndtr(held * mean / spread), 0.0).sum(axis=-1))


def _eliminated(matrix: FloatArray, sides: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eliminate symmetric matrices of unit diagonal (..., k, k) beside right sides (..., k, q), all at once.

    Returns pivots (k, ...), whose product is the determinant, and rows (k, k + q, ...); a^T matrix^-1 b of two sides is
    the sum of a b / pivot.
    """
    k, lead = matrix.shape[-1], matrix.shape[:-2]
    rows = np.empty((k, k + sides.shape[-1], *lead))
    turned = np.moveaxis(rows, (0, 1), (-2, -1))
    turned[..., :k], turned[..., k:] = matrix, sides
    for j in range(k):
        rows[j, j] = np.maximum(rows[j, j], _LEAST_PIVOT)
        rows[j + 1 :, j + 1 :] -= (rows[j, j + 1 : k] / rows[j, j])[:, None] * rows[j, j + 1 :]
    return np.moveaxis(np.diagonal(rows), -1, 0), rows


def _inner(gram: FloatArray, root: FloatArray) -> tuple[FloatArray, FloatArray]:
    size = np.sqrt(root**2 * np.diagonal(gram, axis1=-2, axis2=-1) + 1.0)
    ratio = root / size
    return _with_diagonal(gram * (ratio[..., :, None] * ratio[..., None, :]), 1.0 + 1e-11), size


def model_sizes(sums: Sums, columns: FormPriors, model: tuple[int, ...], weight: FloatArray) -> FloatArray:
    """Return a model's sizes in typical sizes, (k,), averaged over scales of probability `weight` (n_scales,)."""
    if not model:
        return np.zeros(0)
    (place,), _ = columns.index([model])
    sizes = np.zeros(len(place))
    for n in np.flatnonzero(weight > _NO_WEIGHT):
        sizes += weight[n] * ridge_solve(*sums.of_columns(int(n), place), _RIDGE)
    return sizes


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
        return 2 * parts @ parts.T + np.diag(1.0 / PRIOR_SPREADS[self._active] ** 2)

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
