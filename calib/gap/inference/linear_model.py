"""The whitened linear model about one path: design matrix, and scalar products at each scale of the lack of fit."""

from collections.abc import Sequence
from copy import copy
from functools import cached_property
from typing import Final

import numpy as np

from calib.gap.effects import Form
from calib.gap.inference import fit as fitting
from calib.gap.inference.fit import CALIBRATION_SD, Fitted
from calib.gap.inference.lack_of_fit import LACK_OF_FIT_SCALES, Blocks, LackOfFit, lack_of_fit_components
from calib.gap.inference.noise import Noise
from calib.gap.inference.scalar_products import Layout, Reduced, Sums, above_rounding, scalar_products
from calib.gap.predict import Path, residuals
from calib.types import FloatArray

#: columns of a recalibration
N_CALIBRATION: Final = 4


class LinearSystem:
    """Gap, recalibration and signatures of forms about one path, whitened, ordered by condition.

    `fitted`: about whose path; `nominal`: the model alone; `forms`: on offer, those of `fitted` included.
    """

    def __init__(self, fitted: Fitted, nominal: Path, noise: Noise, forms: Sequence[Form]) -> None:
        path = fitted.path
        self.path, self.nominal, self.noise, self.fitted = path, nominal, noise, fitted
        self.forms = tuple(forms)
        self.blocks = Blocks(path.s)
        order = self.blocks.order
        self.kinds: list[LackOfFit] = lack_of_fit_components(path, noise, self.blocks)
        self.layout = Layout.of(self.forms)
        self.whole = np.empty((len(order), self._width))
        self.calibration[:] = fitting.whitened_rows(path, noise, fitting.recalibration_columns(path))[order]
        place = np.argsort(order)
        edges = np.concatenate(([0], np.cumsum(path.s.usable.sum(axis=1))))
        for number, units, some in fitting.signatures_by_part(path, self.forms):
            rows = place[edges[units.start] : edges[units.stop]]
            self.of(number)[rows] = fitting.whitened_rows(path, noise, some, units)
        self.left = fitting.whitened(path, noise, residuals(path, nominal))[order]
        gap = self.left + self.calibration @ (fitted.calibration / CALIBRATION_SD)
        for number, (form, theta, _) in zip(self.numbers(fitted.forms), fitted.each(), strict=True):
            gap = gap + self.of(number) @ (theta / form.typical)
        self.gap = self.whole[:, self._n_narrow] = gap
        for number, where in self._common.items():
            self.whole[:, where] = self.kinds[number].common

    @property
    def calibration(self) -> FloatArray:
        """The recalibration, to unit prior variance, shape (n_rows, 4)."""
        return self.whole[:, :N_CALIBRATION]

    @property
    def _n_narrow(self) -> int:
        return N_CALIBRATION + int(self.layout.counts.sum()) - self.layout.n_wide

    @property
    def _width(self) -> int:
        return max([self._n_narrow + 1 + self.layout.n_wide, *(int(where.stop) for where in self._common.values())])

    @property
    def _common(self) -> dict[int, slice]:
        return _common_places(self.kinds, self._n_narrow + 1 + self.layout.n_wide)

    @cached_property
    def _gram(self) -> FloatArray:
        return above_rounding(self.whole.T @ self.whole)

    def only(self, numbers: Sequence[int]) -> "LinearSystem":
        """Return the system with some of its forms, in the order given."""
        selected, gram = copy(self), self._gram
        selected.forms = tuple(self.forms[k] for k in numbers)
        selected.layout = Layout.of(selected.forms)
        index = np.empty(selected._width, dtype=np.int64)
        index[:N_CALIBRATION] = np.arange(N_CALIBRATION)
        for number, own in enumerate(numbers):
            index[selected._place(number)] = np.arange(self.whole.shape[1])[self._place(own)]
        index[selected._n_narrow] = self._n_narrow
        for number, where in selected._common.items():
            index[where] = np.arange(self._common[number].start, self._common[number].stop)
        selected.whole = self.whole.take(index, axis=1)
        vars(selected)["_gram"] = gram[index[:, None], index]
        return selected

    def _place(self, number: int) -> slice:
        first = N_CALIBRATION + int(self.layout.starts[number]) + (number == self.layout.wide)
        return slice(first, first + int(self.layout.counts[number]))

    def of(self, number: int) -> FloatArray:
        """Return the columns of a form, shape (n_rows, n_parameters)."""
        return self.whole[:, self._place(number)]

    def columns_of(self, model: Sequence[int]) -> FloatArray:
        """Return the columns of the recalibration and of some forms, shape (n_rows, 4 + n_parameters)."""
        return np.concatenate([self.calibration, *(self.of(k) for k in model)], axis=1)

    def numbers(self, forms: Sequence[Form]) -> list[int]:
        """Return the number of each of some forms."""
        return [next(k for k, own in enumerate(self.forms) if own is form) for form in forms]

    def sums(
        self, deviations: FloatArray, *, scales: Sequence[float] = LACK_OF_FIT_SCALES, interactions: bool = True
    ) -> Sums:
        """Return scalar products of forms and gap under each scale of the lack of fit, the recalibration free.

        `deviations`: (n_rows, k), of effects in each condition, to unit prior variance; `interactions`: also those of
        the surroundings.
        """
        kinds = [(k, kind) for k, kind in enumerate(self.kinds) if interactions or not kind.is_interaction]
        reduced = Reduced(self.whole, self._gram, deviations, self.blocks)
        sizes = N_CALIBRATION, self._n_narrow - N_CALIBRATION, self.layout.n_wide
        return scalar_products(reduced, kinds, self._common, sizes, scales)

    def sums_of(self, columns: FloatArray, nuisance: FloatArray, deviations: FloatArray) -> Sums:
        """Return those of other columns (n_rows, p) beside nuisances (n_rows, m) to unit prior variance."""
        m, p = nuisance.shape[1], columns.shape[1]
        first = self._n_narrow + 1 + self.layout.n_wide
        whole = np.concatenate([nuisance, columns, self.gap[:, None], self.whole[:, first:]], axis=1)
        own = whole[:, : m + p + 1].T @ whole
        gram = np.block([[own], [own[:, m + p + 1 :].T, self._gram[first:, first:]]])
        reduced = Reduced(whole, above_rounding(gram), deviations, self.blocks)
        kinds, common = list(enumerate(self.kinds)), _common_places(self.kinds, m + p + 1)
        return scalar_products(reduced, kinds, common, (m, p, 0), LACK_OF_FIT_SCALES)


def _common_places(kinds: Sequence[LackOfFit], first: int) -> dict[int, slice]:
    places = {}
    for number, kind in enumerate(kinds):
        if kind.common is not None:
            places[number] = slice(first, first + kind.common.shape[1])
            first = places[number].stop
    return places


class WhitenedSystem:
    """Whitened residual, recalibration and form columns about one path, made once each.

    `nominal`: the model alone; `offered`: forms to be asked for, made at once on a path in parts; `known`: a system of
    the same path and noise.
    """

    def __init__(
        self, path: Path, nominal: Path, noise: Noise, offered: Sequence[Form] = (), known: LinearSystem | None = None
    ) -> None:
        self.path, self.nominal, self.noise = path, nominal, noise
        self.gap = fitting.whitened(path, noise, residuals(path, nominal))
        self.calibration = fitting.whitened_rows(path, noise, fitting.recalibration_columns(path))
        self._offered = () if path.kept is not None else tuple(offered)
        self._columns: dict[int, tuple[Form, FloatArray]] = {}
        self._known, self._back = known, None if known is None else np.argsort(known.blocks.order)

    def repeated(self, times: FloatArray) -> "WhitenedSystem":
        """Return the system with each observation made so often, (n_obs,), or not at all."""
        weight = np.sqrt(times)[np.nonzero(self.path.s.usable)[0], None]
        rows, some = weight[:, 0] > 0.0, copy(self)

        def made(columns: FloatArray) -> FloatArray:
            return np.asarray(columns[rows] * weight[rows])

        some.calibration = made(self.calibration)
        vars(some)["columns"] = lambda form: made(self.columns(form))
        return some

    def columns(self, form: Form) -> FloatArray:
        """Return the whitened signatures of a form in typical sizes, shape (n_rows, n_parameters)."""
        if self._known is not None and any(form is own for own in self._known.forms):
            return self._known.of(*self._known.numbers([form]))[self._back]
        if id(form) not in self._columns:
            wanted = [form, *(other for other in self._offered if id(other) not in self._columns and other is not form)]
            self._offered = ()
            for other, columns in zip(wanted, fitting.signature_columns(self.path, wanted), strict=True):
                self._columns[id(other)] = other, fitting.whitened_rows(self.path, self.noise, columns)
        return self._columns[id(form)][1]
