"""Columns of forms, their priors, and their scalar products at each scale of the lack of fit.

A form of more columns than `WIDE_FORM` (a step of each radius in each session) is taken up only where asked for.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from math import comb, log
from typing import Final

import numpy as np

from calib.gap.effects import Form
from calib.gap.effects.library import effect_class
from calib.gap.inference.noise import Blocks, LackOfFit
from calib.types import BoolArray, FloatArray, IntArray

#: cost of choosing the prior's scale by the fitted size, in log-evidence units
SCALE_CHOICE_COST: Final = float(np.log(4.0))
#: prior odds of one more effect at work
FURTHER: Final = 0.5
#: prior odds of a lack of fit, which makes a third of the false alarms; two thirds at three times these
PRIOR_REST: Final = 0.05
#: a form of more columns stands apart
WIDE_FORM: Final = 24
#: of a sum of some thousand products in double precision, relative
_ROUNDING: Final = 1e-13


class Layout:
    """Where columns of forms stand: a wide one's last.

    `counts`: (n_forms,), of columns; `wide`: number of the wide form; -1: none.
    """

    def __init__(self, counts: IntArray, wide: int) -> None:
        self.counts, self.wide = counts, wide
        narrow = np.where(np.arange(len(counts)) == wide, 0, counts)
        self.starts = np.cumsum(narrow) - narrow  #: shape (n_forms,)
        if wide >= 0:
            self.starts[wide] = narrow.sum()

    @staticmethod
    def of(forms: Sequence[Form]) -> "Layout":
        """Arrange forms' columns: at most one form is wide, without signs."""
        counts = np.array([len(form.parameters) for form in forms], dtype=np.int64)
        wide = int(np.argmax(counts)) if len(counts) and counts.max() > WIDE_FORM else -1
        if wide >= 0 and any(parameter.sign for parameter in forms[wide].parameters):
            wide = -1
        return Layout(counts, wide)

    @property
    def n_wide(self) -> int:
        """Columns of the wide form."""
        return int(self.counts[self.wide]) if self.wide >= 0 else 0

    def of_form(self, number: int) -> IntArray:
        """Return where the columns of a form stand."""
        return np.arange(self.starts[number], self.starts[number] + self.counts[number])


@dataclass(frozen=True, slots=True, eq=False)
class FormPriors:
    """What weighing needs of forms and columns."""

    forms: tuple[Form, ...]
    layout: Layout
    most: FloatArray  #: shape (p,): largest prior scale of each column, in typical sizes
    sign: IntArray  #: shape (p,): 1 or -1 where sizes have that sign only, else 0
    own: FloatArray  #: shape (p,): 1; 0 for a shift of the zero point
    log_prior: FloatArray  #: shape (n_forms,): of each form of its effect
    by_count: FloatArray  #: shape (n_effects + 1,): log prior of a set of so many effects, laws of the load being one
    is_law: FloatArray  #: shape (n_forms,): 1 for laws of the load

    @staticmethod
    def from_forms(forms: Sequence[Form]) -> "FormPriors":
        """Make it of forms.

        One effect more is less likely by the same odds; of so many every set is as likely (Scott and Berger, Annals of
        Statistics 38 (2010) 2587).
        """
        n_effects = len({form.effect for form in forms})
        layout = Layout.of(forms)
        most, sign = np.zeros(int(layout.counts.sum())), np.zeros(int(layout.counts.sum()), dtype=np.int64)
        own = np.array([not p.shift for form in forms for p in form.parameters], dtype=np.float64)
        for number, form in enumerate(forms):
            most[layout.of_form(number)] = max([3.0, *(p.largest / p.typical for p in form.parameters)])
            sign[layout.of_form(number)] = [p.sign for p in form.parameters]
        # half of the prior lies on the impossible sign
        signed = np.array([sum(p.sign != 0 for p in form.parameters) for form in forms])
        log_prior = -np.log([form.tries for form in forms]) - SCALE_CHOICE_COST + np.log(2.0) * signed
        by_count = np.array([k * log(FURTHER) - log(comb(n_effects, k)) for k in range(n_effects + 1)])
        is_law = np.array([effect_class(form.effect).is_load_law for form in forms], dtype=np.float64)
        return FormPriors(tuple(forms), layout, most, sign, own, log_prior, by_count, is_law)

    def index(self, models: Sequence[tuple[int, ...]]) -> tuple[IntArray, IntArray]:
        """Return models' columns and forms, both (n_models, width), else -1."""
        form, row = _forms_of(models)
        counts = self.layout.counts[form]
        at, row, owner = (np.repeat(each, counts) for each in (self.layout.starts[form], row, form))
        at += _within(np.repeat(np.arange(len(form)), counts))
        place = _within(row)
        table = np.full((2, len(models), int(place.max(initial=-1)) + 1), -1)
        table[:, row, place] = at, owner
        return table[0], table[1]

    def widths(self, models: Sequence[tuple[int, ...]]) -> IntArray:
        """Return models' numbers of columns, (n_models,)."""
        form, row = _forms_of(models)
        return np.bincount(row, self.layout.counts[form], len(models)).astype(np.int64)

    def priors(self, models: Sequence[tuple[int, ...]]) -> FloatArray:
        """Return models' log priors, (n_models,)."""
        form, row = _forms_of(models)
        laws = np.bincount(row, self.is_law[form], len(models)).astype(np.int64)
        count = np.bincount(row, minlength=len(models)) - np.maximum(laws - 1, 0)
        return np.bincount(row, self.log_prior[form], len(models)) + self.by_count[count]


def _forms_of(models: Sequence[tuple[int, ...]]) -> tuple[IntArray, IntArray]:
    form = np.fromiter(chain.from_iterable(models), dtype=np.int64)
    return form, np.repeat(np.arange(len(models)), [len(model) for model in models])


def _within(row: IntArray) -> IntArray:
    return np.arange(len(row)) - np.searchsorted(row, row)


@dataclass(frozen=True, slots=True, eq=False)
class WideSums:
    """Scalar products of a wide form's columns, made where asked for."""

    #: number of a scale -> products (w, w), and with the rest (w, p + 1)
    make: Callable[[int], tuple[FloatArray, FloatArray]]
    numbers: IntArray  #: shape (n_scales,): each scale's number for `make`
    _known: dict[int, tuple[FloatArray, FloatArray]] = field(default_factory=dict)

    def at(self, scale: int) -> tuple[FloatArray, FloatArray]:
        """Return the products (w, w) and (w, p + 1) at a scale."""
        number = int(self.numbers[scale])
        if number not in self._known:
            self._known[number] = self.make(number)
        return self._known[number]


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """Scalar products of columns and gap at each scale of the lack of fit, nuisances taken out."""

    gram: FloatArray  #: shape (n_scales, p, p): of the columns but a wide form's
    right: FloatArray  #: shape (n_scales, p): of the columns with the gap
    square: FloatArray  #: shape (n_scales,): of the gap with itself
    log_det: FloatArray  #: shape (n_scales,): of the covariance, nuisances included
    log_prior: FloatArray  #: shape (n_scales,): of the scale; the first: no lack of fit
    kind: IntArray  #: shape (n_scales,): number of the lack-of-fit component; -1: none
    scale: FloatArray  #: shape (n_scales,): standard deviation of the lack of fit, in noise levels of one run
    n_rows: int
    wide: WideSums | None = None  #: of a wide form's columns, behind the others

    def pick(self, scales: BoolArray | slice) -> "Sums":
        """Return some scales only."""
        by_scale = ("gram", "right", "square", "log_det", "log_prior", "kind", "scale")
        wide = None if self.wide is None else replace(self.wide, numbers=self.wide.numbers[scales])
        return replace(self, **{name: getattr(self, name)[scales] for name in by_scale}, wide=wide)

    def of_columns(self, scale: int, index: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return products of columns (k,) at a scale, (k, k), and with the gap, (k,)."""
        if index.max(initial=-1) < self.right.shape[1]:
            return self.gram[scale][index[:, None], index], self.right[scale][index]
        assert self.wide is not None
        own, across = self.wide.at(scale)
        whole = np.block([[self.gram[scale], across[:, :-1].T], [across[:, :-1], own]])
        return whole[index[:, None], index], np.concatenate([self.right[scale], across[:, -1]])[index]


class Reduced:
    """Scalar products without what each block may have of its own.

    `whole`: (n_rows, width), whitened columns and gap; `gram`: their products, see `above_rounding`; `deviations`:
    (n_rows, k), each block's own, to unit prior variance.
    """

    def __init__(self, whole: FloatArray, gram: FloatArray, deviations: FloatArray, blocks: Blocks) -> None:
        self.gram, self.log_det, self.n_rows = gram, 0.0, len(whole)
        #: rows of blocks of each length, (n, length, width), and what takes out their own columns
        self.wholes = [blocks.alike_rows(whole, group) for group in range(len(blocks.alike))]
        self.factors: list[FloatArray] = []
        self.taken: list[FloatArray] = []
        if not deviations.shape[1]:
            return
        for group, of_blocks in enumerate(self.wholes):
            own = blocks.alike_rows(deviations, group)
            turned = own.transpose(0, 2, 1)
            lower = np.linalg.cholesky(np.eye(own.shape[2]) + above_rounding(turned @ own))
            self.log_det += 2 * float(np.log(np.diagonal(lower, axis1=1, axis2=2)).sum())
            self.factors.append(np.linalg.solve(lower, turned))
            self.taken.append(self.factors[-1] @ of_blocks)
        rows = np.concatenate([taken.reshape(-1, whole.shape[1]) for taken in self.taken])
        self.gram = self.gram - rows.T @ rows

    def turned(self, kind: LackOfFit, where: slice | None, columns: slice) -> tuple[FloatArray, FloatArray]:
        """Return eigenvalues (q,) of a lack of fit's products, and turned products (q, n) with some columns.

        `where`: columns common to all blocks; None: each has its own.
        """
        if where is not None:
            eigen, vectors = np.linalg.eigh(self.gram[where, where])
            return np.maximum(eigen, 0.0), vectors.T @ self.gram[where, columns]
        eigens, turned = [np.zeros(0)], [np.zeros((0, columns.stop - columns.start))]
        for stack in kind.stacks:
            part, across = stack.part, stack.part.transpose(0, 2, 1)
            own, cross = across @ part, across @ self.wholes[stack.group][:, :, columns][stack.same]
            if self.factors:
                with_part = self.factors[stack.group][stack.same] @ part
                own = own - with_part.transpose(0, 2, 1) @ with_part
                cross -= with_part.transpose(0, 2, 1) @ self.taken[stack.group][:, :, columns][stack.same]
            eigen, vectors = np.linalg.eigh(own)
            keep = eigen > 1e-9 * np.maximum(eigen[:, -1:], 1e-12)
            eigens.append(eigen[keep])
            turned.append((vectors.transpose(0, 2, 1) @ cross)[keep])
        return np.maximum(np.concatenate(eigens), 0.0), np.concatenate(turned)


def above_rounding(gram: FloatArray) -> FloatArray:
    """Return products (..., k, k) with slightly larger squares: no residual falls below zero."""
    return gram * (1.0 + _ROUNDING * np.eye(gram.shape[-1]))


def scalar_products(
    reduced: Reduced,
    kinds: Sequence[tuple[int, LackOfFit]],
    common: dict[int, slice],
    sizes: tuple[int, int, int],
    scales: Sequence[float],
) -> Sums:
    """Return the scalar products of columns and gap under each scale of the lack of fit.

    Parameters
    ----------
    reduced
        Nuisances, columns, gap, a wide form's columns, those common to all blocks.
    kinds
        Components of the lack of fit, each with its number.
    common
        Places of columns common to all blocks, by number.
    sizes
        Numbers of nuisances, columns and a wide form's columns.
    scales
        Of the lack of fit.
    """
    m, p, w = sizes
    core, apart = slice(0, m + p + 1), slice(m + p + 1, m + p + 1 + w)
    log_dets, labels, shrinking = [reduced.log_det], [(-1, 0.0)], [np.zeros(0)]
    gram = np.empty((1 + len(kinds) * len(scales), core.stop, core.stop))
    gram[0] = reduced.gram[core, core]
    turned_of: dict[int, FloatArray] = {}
    for number, kind in kinds:
        eigen, turned_of[number] = reduced.turned(kind, common.get(number), core)
        for scale in scales:
            shrinking.append(scale / np.sqrt(1.0 + scale**2 * eigen))
            shrunk = turned_of[number] * shrinking[-1][:, None]
            np.subtract(gram[0], shrunk.T @ shrunk, out=gram[len(labels)])
            log_dets.append(reduced.log_det + float(np.log1p(scale**2 * eigen).sum()))
            labels.append((number, scale))
    # nuisances at scale one: (I + N^T N) on a unit diagonal
    inner = gram[:, :m, :m] + np.eye(m)
    root = np.sqrt(np.diagonal(inner, axis1=1, axis2=2))
    lower = np.linalg.cholesky(inner / (root[:, :, None] * root[:, None, :]) + 1e-11 * np.eye(m))
    cross = np.linalg.solve(lower, gram[:, :m, m:] / root[:, :, None])
    left = gram[:, m:, m:]
    for of_scale, taken in zip(left, cross, strict=True):
        of_scale -= taken.T @ taken
    wide_of: dict[int, FloatArray] = {}

    def wide(place: int) -> tuple[FloatArray, FloatArray]:
        own, across = reduced.gram[apart, apart], reduced.gram[apart, core]
        number, shrink = labels[place][0], shrinking[place][:, None]
        if number >= 0:
            if number not in wide_of:
                wide_of[number] = reduced.turned(dict(kinds)[number], common.get(number), apart)[1]
            shrunk = wide_of[number] * shrink
            own, across = own - shrunk.T @ shrunk, across - shrunk.T @ (turned_of[number] * shrink)
        taken = np.linalg.solve(lower[place], across[:, :m].T / root[place][:, None])
        return own - taken.T @ taken, across[:, m:] - taken.T @ cross[place]

    return Sums(
        gram=left[:, :-1, :-1],
        right=left[:, :-1, -1],
        square=left[:, -1, -1],
        log_det=np.array(log_dets) + 2 * (np.log(np.diagonal(lower, axis1=1, axis2=2)) + np.log(root)).sum(axis=1),
        log_prior=_log_priors([kind for _, kind in kinds], scales),
        kind=np.array([number for number, _ in labels]),
        scale=np.array([scale for _, scale in labels]),
        n_rows=reduced.n_rows,
        wide=WideSums(wide, np.arange(len(labels))) if w else None,
    )


def _log_priors(kinds: Sequence[LackOfFit], scales: Sequence[float]) -> FloatArray:
    others = sum(not kind.is_scatter for kind in kinds)
    odds = [
        float(kind.is_plausible(scale)) if kind.is_scatter else PRIOR_REST / others
        for kind in kinds
        for scale in scales
    ]
    with np.errstate(divide="ignore"):
        return np.log([1.0, *np.array(odds) / len(scales)])
