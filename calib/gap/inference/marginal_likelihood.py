"""Marginal likelihood of Gaussian hypotheses: sets of forms, weighed by scalar products alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb, log
from typing import Final

import numpy as np

from calib.gap.effects.effect import Form
from calib.gap.inference.linear_model import Sums
from calib.types import FloatArray, IntArray

#: degrees of freedom by which the noise level as a whole is known before the gap is looked at; the remainder of what is
#: known of it comes from the same runs
FLOOR_DOF: Final = 20.0
#: what choosing the prior's scale by the fitted size costs, in log-evidence units
SCALE_CHOICE_COST: Final = float(np.log(4.0))
#: hypotheses weighed at a time
_BATCH_SIZE: Final = 400
#: numbers of all their scalar products at a time: 1 MB, for with what is worked out of them they stay in the cache
_BATCH_ENTRIES: Final = 2**19
#: hypotheses of more columns are weighed one by one: half the products save more than a call a matrix costs
_WIDE: Final = 80
#: classes of width, in columns
_WIDTH_CLASSES: Final = (0, 1, 2, 3, 4, 6, 8, 12, 20, 40, _WIDE)


@dataclass(frozen=True, slots=True, eq=False)
class Nuisance:
    """Residuals out of the judgement: a recalibration, and deviations of known effects.

    Parameters
    ----------
    columns : array of float, shape (n_rows, k)
        Whitened, each scaled to unit prior variance.
    factor : array of float, shape (k, k)
        Inverse Cholesky factor of I + X^T X.
    log_det : float
        log |I + X X^T|.
    """

    columns: FloatArray
    factor: FloatArray
    log_det: float

    @staticmethod
    def of(columns: FloatArray) -> Nuisance:
        """Make it of whitened columns scaled to unit prior variance, shape (n_rows, k)."""
        gram = np.eye(columns.shape[1]) + columns.T @ columns
        # scaled to a unit diagonal: columns of very different size, or exactly alike, stay factorable
        root = np.sqrt(np.diag(gram))
        lower = np.linalg.cholesky(gram / np.outer(root, root) + 1e-11 * np.eye(len(gram)))
        inverse = np.linalg.solve(lower, np.diag(1.0 / root))
        return Nuisance(columns, inverse, float(2 * (np.log(np.diag(lower)) + np.log(root)).sum()))

    def scalar(self, left: FloatArray, right: FloatArray) -> FloatArray:
        """Return left^T (I + X X^T)^-1 right for columns (n_rows, p) and (n_rows, q), shape (p, q)."""
        a, b = self.factor @ (self.columns.T @ left), self.factor @ (self.columns.T @ right)
        products: FloatArray = left.T @ right - a.T @ b
        return products


def log_marginal(square: float | FloatArray, log_det: float | FloatArray, n_rows: int) -> FloatArray:
    """Return the log evidence of a Gaussian hypothesis whose noise level is known up to a common factor.

    The factor is integrated out, so that a noise level too small by a quarter, or tails heavier than normal, do not
    pass for a cause: Student's t in place of the normal density, without its constant.

    Parameters
    ----------
    square : float or array of float
        y^T C^-1 y of the hypothesis' covariance C in units of the noise level.
    log_det : float or array of float
        log |C|, same shape.
    n_rows : int
        Length of y.
    """
    spread = -0.5 * (FLOOR_DOF + n_rows) * np.log1p(np.asarray(square) / FLOOR_DOF)
    return np.asarray(spread - 0.5 * np.asarray(log_det))


def project(nuisance: Nuisance, columns: FloatArray) -> FloatArray:
    """Return (I + X X^T)^(-1/2)-like projected columns: the residual of them once the nuisance took its share.

    The result P has P^T P equal to the scalar product of `Nuisance.scalar` in the limit of a broad nuisance.
    """
    weights = nuisance.factor.T @ (nuisance.factor @ (nuisance.columns.T @ columns))
    products: FloatArray = columns - nuisance.columns @ weights
    return products


def ridge_solve(gram: FloatArray, right: FloatArray, ridge: float) -> FloatArray:
    """Solve (G + ridge I) x = g, scaled to a unit diagonal so that columns exactly alike do no harm.

    Parameters
    ----------
    gram : array of float, shape (..., p, p)
        Scalar products of the columns.
    right : array of float, shape (..., p)
        Their scalar products with the residual.
    ridge : float
        Added to the diagonal.

    Returns
    -------
    array of float, shape (..., p)
    """
    size = np.sqrt(np.diagonal(gram, axis1=-2, axis2=-1) + ridge)
    scaled = _with_diagonal(gram / (size[..., :, None] * size[..., None, :]), 1.0 + 1e-10)
    return np.asarray(np.linalg.solve(scaled, (right / size)[..., None])[..., 0] / size)


def _with_diagonal(matrix: FloatArray, value: float) -> FloatArray:
    """Set the diagonal of matrices (..., p, p), in place, and return them."""
    place = np.arange(matrix.shape[-1])
    matrix[..., place, place] = value
    return matrix


@dataclass(frozen=True, slots=True, eq=False)
class FormPriors:
    """What the weighing has to know of each form and column.

    Parameters
    ----------
    forms : tuple of Form
        Forms on offer.
    cuts : array of int, shape (n_forms + 1,)
        Columns of form f stand at ``cuts[f]:cuts[f + 1]``.
    most : array of float, shape (p,)
        Largest prior scale of each column, in typical sizes.
    sign : array of int, shape (p,)
        1 or -1 where only sizes of that sign have a meaning, else 0.
    log_prior : array of float, shape (n_forms,)
        Of each form of its effect, the search over forms and scales paid for.
    by_count : array of float, shape (n_effects + 1,)
        Log prior of a set of so many effects.
    """

    forms: tuple[Form, ...]
    cuts: IntArray
    most: FloatArray
    sign: IntArray
    log_prior: FloatArray
    by_count: FloatArray

    @staticmethod
    def from_forms(forms: Sequence[Form], further: float) -> FormPriors:
        """Make it of forms and the prior odds of one effect more at work.

        Every number of effects is less likely than one fewer by the same odds, and of so many effects every set is as
        likely: the more the library offers, the less speaks for any one, and what else is at work speaks for neither.
        Scott, Berger: Bayes and empirical-Bayes multiplicity adjustment, Annals of Statistics 38 (2010), 2587-2619.
        """
        n_effects = len({form.effect for form in forms})
        sizes = [len(form.parameters) for form in forms]
        most = [max([3.0, *(p.largest / p.typical for p in form.parameters)]) for form in forms]
        sign = [p.sign for form in forms for p in form.parameters]
        # half of the prior lies on the sign that a parameter cannot have
        log_prior = [
            -np.log(form.tries) - SCALE_CHOICE_COST + np.log(2.0) * sum(p.sign != 0 for p in form.parameters)
            for form in forms
        ]
        return FormPriors(
            tuple(forms),
            np.cumsum([0, *sizes]),
            np.repeat(most, sizes) if forms else np.zeros(0),
            np.array(sign, dtype=np.int64),
            np.array(log_prior),
            np.array([k * log(further) - log(comb(n_effects, k)) for k in range(n_effects + 1)]),
        )

    def index(self, models: Sequence[tuple[int, ...]]) -> tuple[IntArray, IntArray]:
        """Return the columns of each model and the form of each, both (n_models, width), -1 where there is none."""
        width = max((int(sum(self.cuts[f + 1] - self.cuts[f] for f in model)) for model in models), default=0)
        columns = np.full((len(models), width), -1)
        owner = np.full((len(models), width), -1)
        for row, model in enumerate(models):
            at = 0
            for form in model:
                count = int(self.cuts[form + 1] - self.cuts[form])
                columns[row, at : at + count] = np.arange(self.cuts[form], self.cuts[form + 1])
                owner[row, at : at + count] = form
                at += count
        return columns, owner


def log_weights(sums: Sums, columns: FormPriors, models: Sequence[tuple[int, ...]]) -> FloatArray:
    """Return log evidence plus log prior of each model at each scale of the lack of fit, shape (n_scales, n_models)."""
    value = np.full((len(sums.square), len(models)), -np.inf)
    widths = np.array([int(sum(columns.cuts[f + 1] - columns.cuts[f] for f in model)) for model in models])
    # models of like width together: padding a narrow one to the widest would cost the cube of it
    group = np.searchsorted(_WIDTH_CLASSES, widths)
    for number in np.unique(group):
        places = np.flatnonzero(group == number)
        entries = max(int(widths[places].max()), 1) ** 2
        size = int(np.clip(_BATCH_ENTRIES // (len(value) * entries), 1, _BATCH_SIZE))
        n_scales = max(_BATCH_ENTRIES // (size * entries), 1)
        if number == len(_WIDTH_CLASSES):
            # an effect of every session has hundreds of columns
            for place in places.tolist():
                value[:, place] = [_wide(sums.pick(slice(n, n + 1)), columns, models[place]) for n in range(len(value))]
            continue
        for first in range(0, len(places), size):
            some = places[first : first + size]
            for low in range(0, len(value), n_scales):
                scales = slice(low, low + n_scales)
                value[scales, some] = _batch(sums.pick(scales), columns, [models[k] for k in some])
    return value


def _wide(sums: Sums, columns: FormPriors, model: tuple[int, ...]) -> float:
    """Return what `_batch` does of a model of many columns at one scale, in place, each triangle factored once."""
    from scipy.linalg.lapack import dposv, dpotrf, dtrtrs
    from scipy.special import log_ndtr

    (index,), _ = columns.index([model])
    gram, right = sums.gram[0][index[:, None], index], sums.right[0][index][:, None]
    diagonal = np.diag(gram).copy()
    # a little added, so that columns exactly alike do no harm
    np.fill_diagonal(gram, (diagonal + 1e-2) * (1.0 + 1e-10))
    # a symmetric matrix is its own transpose, which stands as LAPACK has it
    _, sizes, failed = dposv(gram.T, right, lower=1, overwrite_a=1)
    count = [int(columns.cuts[form + 1] - columns.cuts[form]) for form in model]
    mean_square = np.add.reduceat(sizes[:, 0] ** 2, np.cumsum([0, *count[:-1]])) / count
    variance = np.clip(np.sqrt(np.repeat(mean_square, count)), 0.1, columns.most[index]) ** 2
    np.fill_diagonal(gram, (diagonal + 1.0 / variance) * (1.0 + 1e-11))
    upper, failed_too = dpotrf(gram.T, lower=0, clean=0, overwrite_a=1)
    if failed or failed_too:
        return float(_batch(sums, columns, [model])[0, 0])
    signed = np.flatnonzero(columns.sign[index])
    half = dtrtrs(upper, np.concatenate([right, np.eye(len(index))[:, signed]], axis=1), lower=0, trans=1)[0]
    square = np.maximum(sums.square - half[:, 0] @ half[:, 0], 1e-9)
    log_det = sums.log_det + 2 * np.log(np.diag(upper)).sum() + np.log(variance).sum()
    away = half[:, 1:].T @ half[:, 0] / np.sqrt((half[:, 1:] ** 2).sum(axis=0))
    held = log_ndtr(columns.sign[index][signed] * away).sum()
    prior = sums.log_prior[0] + columns.log_prior[list(model)].sum() + columns.by_count[len(model)]
    return float(prior + log_marginal(square, log_det, sums.n_rows)[0] + held)


def _batch(sums: Sums, columns: FormPriors, models: Sequence[tuple[int, ...]]) -> FloatArray:
    index, owner = columns.index(models)
    prior = np.array([columns.log_prior[list(model)].sum() + columns.by_count[len(model)] for model in models])
    base = sums.log_prior[:, None] + prior[None, :]
    if index.shape[1] == 0:
        empty: FloatArray = base + log_marginal(sums.square, sums.log_det, sums.n_rows)[:, None]
        return empty
    there = index >= 0
    gram, right = sums.gram[:, index[:, :, None], index[:, None, :]], sums.right[:, index]
    if not there.all():
        gram *= there[:, :, None] & there[:, None, :]
        gram += np.eye(index.shape[1]) * np.where(there, 0.0, 1.0)[:, None, :]
        right *= there
    sizes = ridge_solve(gram, right, 1e-2)
    variance = np.where(there, prior_scale(sizes, owner, columns.most[index]) ** 2, 1e-12)
    sign = np.where(there, columns.sign[index], 0)
    bayes, gain = log_evidence_parts(gram, right, variance)
    square = np.maximum(sums.square[:, None] - gain, 1e-9)
    value = log_marginal(square, sums.log_det[:, None] + bayes, sums.n_rows)
    signed = sign.any(axis=1)
    if signed.any():
        value[:, signed] += log_sign_probability(gram[:, signed], right[:, signed], variance[:, signed], sign[signed])
    return np.asarray(base + value)


def prior_scale(sizes: FloatArray, owner: IntArray, most: FloatArray) -> FloatArray:
    """Return the prior scale of each column: its form's root mean square size, from a tenth to what is plausible."""
    alike = (owner[:, :, None] == owner[:, None, :]).astype(np.float64)
    alike /= alike.sum(axis=2, keepdims=True)
    mean_square = np.einsum("mab,...mb->...ma", alike, sizes**2)
    return np.asarray(np.clip(np.sqrt(mean_square), 0.1, most))


def effect_scale(sizes: FloatArray, form: Form) -> float:
    """Return the prior scale of a form in typical sizes: its fitted size, from a tenth to what is plausible at most."""
    size = float(np.sqrt(np.mean(sizes**2))) if len(sizes) else 1.0
    most = max([3.0, *(p.largest / p.typical for p in form.parameters)])
    return float(np.clip(size, 0.1, most))


def log_evidence_parts(gram: FloatArray, right: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return log |I + S G| and g^T (S^-1 + G)^-1 g, each shape (...)."""
    root = np.sqrt(variance)
    inner, size = _inner(gram, root)
    k = inner.shape[-1]
    # one factor gives both: below it the products stand as a further row, which becomes the solution. Its own square
    # has to exceed that of the solution, and does, for I + S G is no less than the identity
    below = np.zeros((*inner.shape[:-2], k + 1, k + 1))
    below[..., :k, :k], below[..., k, :k] = inner, root * right / size
    below[..., k, k] = 1.0 + ((root * right) ** 2).sum(axis=-1)
    lower = np.linalg.cholesky(below)
    log_det = 2 * (np.log(np.diagonal(lower, axis1=-2, axis2=-1)[..., :k]) + np.log(size)).sum(axis=-1)
    return log_det, (lower[..., k, :k] ** 2).sum(axis=-1)


def log_sign_probability(gram: FloatArray, right: FloatArray, variance: FloatArray, sign: IntArray) -> FloatArray:
    """Return the log probability that sizes have the sign they can only have, both being as likely before, shape (...).

    Of several parameters each by itself, as if their estimates were independent. Scalar products (..., k, k) and
    (..., k), prior variances (..., k) and signs (..., k), 0 where either may be.
    """
    from scipy.special import log_ndtr

    root = np.sqrt(variance)
    inner, size = _inner(gram, root)
    signed = np.flatnonzero((sign != 0).reshape(-1, sign.shape[-1]).any(axis=0))
    inverse = np.linalg.solve(inner, np.eye(sign.shape[-1])[:, signed])
    # both times the prior scale over the scaling
    mean = np.einsum("...kc,...k->...c", inverse, root * right / size)
    spread = np.sqrt(inverse[..., signed, np.arange(len(signed))])
    held = sign[..., signed]
    return np.asarray(np.where(held != 0, log_ndtr(held * mean / spread), 0.0).sum(axis=-1))


def _inner(gram: FloatArray, root: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return I + S G scaled to a unit diagonal, so that columns exactly alike do no harm, and the scaling (..., k)."""
    size = np.sqrt(root**2 * np.diagonal(gram, axis1=-2, axis2=-1) + 1.0)
    ratio = root / size
    return _with_diagonal(gram * (ratio[..., :, None] * ratio[..., None, :]), 1.0 + 1e-11), size


def model_sizes(sums: Sums, columns: FormPriors, model: tuple[int, ...], weight: FloatArray) -> FloatArray:
    """Return the sizes of a model's columns in typical sizes, averaged over the scales of the lack of fit, shape (k,).

    Parameters
    ----------
    sums : Sums
        Scalar products.
    columns : Columns
        Of the forms.
    model : tuple of int
        Its forms.
    weight : array of float, shape (n_scales,)
        Probability of each scale.
    """
    if not model:
        return np.zeros(0)
    index, _ = columns.index([model])
    place = index[0]
    gram = sums.gram[:, place[:, None], place[None, :]]
    sizes: FloatArray = np.einsum("s,sk->k", weight, ridge_solve(gram, sums.right[:, place], 1e-2))
    return sizes
