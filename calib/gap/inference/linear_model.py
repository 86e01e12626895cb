"""The whitened linear model about one path: its design matrix, and scalar products at each scale of the lack of fit.

A hypothesis needs only scalar products of columns. They are sums over conditions, so lack of fit that each condition
has of its own is taken out condition by condition.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.gap.effects.effect import Form
from calib.gap.inference.fit import (
    CALIBRATION_SD,
    Fitted,
    recalibration_columns,
    signature_columns,
    whitened_rows,
)
from calib.gap.inference.lack_of_fit import (
    LACK_OF_FIT_SCALES,
    BlockColumns,
    Blocks,
    LackOfFit,
    lack_of_fit_components,
    row_blocks,
)
from calib.gap.inference.noise import Noise
from calib.gap.predict import Path, residuals
from calib.types import BoolArray, FloatArray, IntArray

#: of a sum of products over some thousand rows in double precision, relative to its largest part
_ROUNDING: Final = 1e-13


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """Scalar products of columns and of the gap, one set for each scale of the lack of fit; nuisances taken out.

    Parameters
    ----------
    gram : array of float, shape (n_scales, p, p)
        Of the columns.
    right : array of float, shape (n_scales, p)
        Of the columns with the gap.
    square : array of float, shape (n_scales,)
        Of the gap with itself.
    log_det : array of float, shape (n_scales,)
        Of the covariance, nuisances included.
    log_prior : array of float, shape (n_scales,)
        Of the scale; the first is no lack of fit at all.
    kind : array of int, shape (n_scales,)
        Number of the lack-of-fit component among the system's; -1 where there is none.
    scale : array of float, shape (n_scales,)
        Standard deviation of the lack of fit, in noise levels of one run.
    n_rows : int
        Length of the gap.
    """

    gram: FloatArray
    right: FloatArray
    square: FloatArray
    log_det: FloatArray
    log_prior: FloatArray
    kind: IntArray
    scale: FloatArray
    n_rows: int

    def pick(self, scales: BoolArray | slice) -> Sums:
        """Return some scales only."""
        return Sums(
            self.gram[scales],
            self.right[scales],
            self.square[scales],
            self.log_det[scales],
            self.log_prior[scales],
            self.kind[scales],
            self.scale[scales],
            self.n_rows,
        )


class LinearSystem:
    """Gap, recalibration and signatures of forms about one path, whitened, ordered by condition.

    Parameters
    ----------
    fitted : Fitted
        The hypothesis about whose path all is linear.
    nominal : Path
        The model alone.
    noise : Noise
        Covariance of each unit.
    forms : sequence of Form
        Forms to offer; those of `fitted` must be among them.
    """

    def __init__(self, fitted: Fitted, nominal: Path, noise: Noise, forms: Sequence[Form]) -> None:
        path = fitted.path
        self.path, self.nominal, self.noise, self.fitted = path, nominal, noise, fitted
        self.forms = tuple(forms)
        self.blocks: Blocks = row_blocks(path.s)
        order = self.blocks.order
        self.calibration = whitened_rows(path, noise, recalibration_columns(path))[order]
        self.cuts = np.cumsum([0, *(len(form.parameters) for form in self.forms)])
        self.columns = np.empty((len(order), int(self.cuts[-1])))
        for number, column in enumerate(signature_columns(path, self.forms)):
            self.columns[:, self.cuts[number] : self.cuts[number + 1]] = whitened_rows(path, noise, column)[order]
        gap = whitened_rows(path, noise, residuals(path, nominal)[:, :, None])[order, 0]
        self.left = gap
        gap = gap + self.calibration @ (fitted.calibration / CALIBRATION_SD)
        for form, theta in zip(fitted.forms, fitted.theta, strict=True):
            number = next(k for k, offered in enumerate(self.forms) if offered is form)
            gap = gap + self.of(number) @ (theta / form.typical)
        self.gap = gap
        self.kinds: list[LackOfFit] = lack_of_fit_components(path, noise, self.blocks)
        self._stacks = [self.blocks.stacked(kind.by_block) if kind.by_block is not None else [] for kind in self.kinds]

    def only(self, numbers: Sequence[int]) -> LinearSystem:
        """Return the system with some of its forms, in the order given."""
        selected = copy(self)
        selected.forms = tuple(self.forms[k] for k in numbers)
        parts = [self.of(k) for k in numbers]
        selected.cuts = np.cumsum([0, *(part.shape[1] for part in parts)])
        selected.columns = np.concatenate(parts, axis=1) if parts else np.zeros((len(self.gap), 0))
        return selected

    def of(self, number: int) -> FloatArray:
        """Return the columns of a form, shape (n_rows, n_parameters)."""
        return self.columns[:, self.cuts[number] : self.cuts[number + 1]]

    def sums(
        self,
        columns: FloatArray,
        nuisance: FloatArray,
        deviations: FloatArray,
        *,
        prior_rest: float,
        scales: Sequence[float] = LACK_OF_FIT_SCALES,
        interactions: bool = True,
    ) -> Sums:
        """Return scalar products of columns and gap under each scale of the lack of fit.

        Parameters
        ----------
        columns : array of float, shape (n_rows, p)
            Whitened columns of hypotheses.
        nuisance : array of float, shape (n_rows, m)
            Columns that are free beside each of them, scaled to unit prior variance.
        deviations : array of float, shape (n_rows, k)
            What each condition may have of its own, scaled to unit prior variance: an effect's deviation from its form.
        prior_rest : float
            Prior odds of a lack of fit.
        scales : sequence of float
            Of the lack of fit.
        interactions : bool
            Weigh interactions of the surroundings too.
        """
        kinds = [(k, kind) for k, kind in enumerate(self.kinds) if interactions or not kind.is_interaction]
        common = [kind.common for _, kind in kinds if kind.common is not None]
        whole = np.concatenate([nuisance, columns, self.gap[:, None], *common], axis=1)
        reduced = _Reduced(whole, deviations, self.blocks)
        m, p = nuisance.shape[1], columns.shape[1] + 1
        core = m + p
        log_dets, weights, labels = [reduced.log_det], [0.0], [(-1, 0.0)]
        gram = np.empty((1 + len(kinds) * len(scales), core, core))
        gram[0] = reduced.gram[:core, :core]
        share = np.log(prior_rest / max(len(kinds) * len(scales), 1))
        place = core
        for number, kind in kinds:
            if kind.by_block is not None:
                eigen, turned = reduced.of_blocks(self._stacks[number], core)
            else:
                assert kind.common is not None
                where = slice(place, place + kind.common.shape[1])
                place = where.stop
                eigen, vectors = np.linalg.eigh(reduced.gram[where, where])
                turned = vectors.T @ reduced.gram[where, :core]
            eigen = np.maximum(eigen, 0.0)
            for scale in scales:
                # a product of one matrix with itself is symmetric, and takes half the time
                shrunk = turned * (scale / np.sqrt(1.0 + scale**2 * eigen))[:, None]
                np.subtract(gram[0], shrunk.T @ shrunk, out=gram[len(labels)])
                log_dets.append(reduced.log_det + float(np.log1p(scale**2 * eigen).sum()))
                weights.append(float(share))
                labels.append((number, scale))
        log_det = np.array(log_dets)
        # the nuisances' own scale is one: (I + N^T N) on a unit diagonal
        inner = gram[:, :m, :m] + np.eye(m)
        root = np.sqrt(np.diagonal(inner, axis1=1, axis2=2))
        lower = np.linalg.cholesky(inner / (root[:, :, None] * root[:, None, :]) + 1e-11 * np.eye(m))
        cross = np.linalg.solve(lower, gram[:, :m, m:] / root[:, :, None])
        log_det = log_det + 2 * (np.log(np.diagonal(lower, axis1=1, axis2=2)) + np.log(root)).sum(axis=1)
        left = gram[:, m:, m:]
        for of_scale, taken in zip(left, cross, strict=True):
            of_scale -= taken.T @ taken
        return Sums(
            gram=left[:, :-1, :-1],
            right=left[:, :-1, -1],
            square=left[:, -1, -1],
            log_det=log_det,
            log_prior=np.array(weights),
            kind=np.array([number for number, _ in labels]),
            scale=np.array([scale for _, scale in labels]),
            n_rows=len(self.gap),
        )


class _Reduced:
    """Scalar products with what each block may have of its own taken out."""

    def __init__(self, whole: FloatArray, deviations: FloatArray, blocks: Blocks) -> None:
        self.gram = _above_rounding(whole.T @ whole)
        self.log_det = 0.0
        #: rows of the blocks of each length, shape (n, length, width), and what takes their own columns out of them
        self.wholes = [whole[places] for _, places in blocks.alike]
        self.factors: list[FloatArray] = []
        if deviations.shape[1]:
            for (_, places), of_blocks in zip(blocks.alike, self.wholes, strict=True):
                own = deviations[places]
                turned = own.transpose(0, 2, 1)
                lower = np.linalg.cholesky(np.eye(own.shape[2]) + _above_rounding(turned @ own))
                self.log_det += 2 * float(np.log(np.diagonal(lower, axis1=1, axis2=2)).sum())
                factor = np.linalg.solve(lower, turned)
                self.factors.append(factor)
                taken = (factor @ of_blocks).reshape(-1, whole.shape[1])
                self.gram = self.gram - taken.T @ taken

    def of_blocks(self, stacks: Sequence[BlockColumns], core: int) -> tuple[FloatArray, FloatArray]:
        """Return eigenvalues (q,) of the parts' scalar products and the turned products (q, core) with the columns."""
        eigens, turned = [np.zeros(0)], [np.zeros((0, core))]
        for stack in stacks:
            whole, part = self.wholes[stack.group][stack.same][:, :, :core], stack.part
            across = part.transpose(0, 2, 1)
            own, cross = across @ part, across @ whole
            if self.factors:
                factor = self.factors[stack.group][stack.same]
                with_part = factor @ part
                own = own - with_part.transpose(0, 2, 1) @ with_part
                cross = cross - with_part.transpose(0, 2, 1) @ (factor @ whole)
            eigen, vectors = np.linalg.eigh(own)
            keep = eigen > 1e-9 * np.maximum(eigen[:, -1:], 1e-12)
            eigens.append(eigen[keep])
            turned.append((vectors.transpose(0, 2, 1) @ cross)[keep])
        return np.concatenate(eigens), np.concatenate(turned)


def _above_rounding(gram: FloatArray) -> FloatArray:
    """Return scalar products (..., k, k) with squares a little larger: the residual of any is not below zero then."""
    return np.asarray(gram * (1.0 + _ROUNDING * np.eye(gram.shape[-1])))


class WhitenedSystem:
    """The whitened system about one path: residual, recalibration and form columns, made once each.

    Parameters
    ----------
    path : Path
        Where it is linear.
    nominal : Path
        The model alone.
    noise : Noise
        Covariance of each unit.
    offered : sequence of Form
        Forms that will be asked for: on a path that is worked through in parts, all at once.
    """

    def __init__(self, path: Path, nominal: Path, noise: Noise, offered: Sequence[Form] = ()) -> None:
        self.path, self.nominal, self.noise = path, nominal, noise
        self.gap = whitened_rows(path, noise, residuals(path, nominal)[:, :, None])[:, 0]
        self.calibration = whitened_rows(path, noise, recalibration_columns(path))
        usable = path.s.usable
        self.unit: IntArray = np.repeat(np.arange(len(path.s))[:, None], 6, axis=1)[usable]
        self.channel: IntArray = np.repeat(np.arange(6)[None, :], len(path.s), axis=0)[usable]
        self.condition: IntArray = path.s.condition[self.unit]
        self._offered = () if path.kept is not None else tuple(offered)
        self._columns: dict[int, tuple[Form, FloatArray]] = {}
        self._known: LinearSystem | None = None
        self._places: dict[int, int] = {}
        self._back: IntArray = np.zeros(0, dtype=np.int64)

    def know(self, system: LinearSystem) -> None:
        """Take columns from a system about the same path with the same floor, instead of making them once more."""
        self._known, self._back = system, np.argsort(system.blocks.order)
        self._places = {id(form): number for number, form in enumerate(system.forms)}

    def columns(self, form: Form) -> FloatArray:
        """Return the whitened signatures of a form in typical sizes, shape (n_rows, n_parameters)."""
        if self._known is not None and id(form) in self._places:
            return self._known.of(self._places[id(form)])[self._back]
        if id(form) not in self._columns:
            wanted = [form, *(other for other in self._offered if id(other) not in self._columns and other is not form)]
            self._offered = ()
            for other, columns in zip(wanted, signature_columns(self.path, wanted), strict=True):
                # the form is kept with its columns, so that its id stays its own
                self._columns[id(other)] = other, whitened_rows(self.path, self.noise, columns)
        return self._columns[id(form)][1]
