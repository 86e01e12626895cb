"""The whitened linear model about one path, and least squares in it beside lack of fit; residuals of held-out runs."""

from collections.abc import Collection, Sequence
from copy import copy
from functools import cached_property
from typing import Final

import numpy as np

from calib.gap.effects import Form
from calib.gap.inference import fit as fitting
from calib.gap.inference.fit import CALIBRATION_SD, Fitted, by_form, whitened
from calib.gap.inference.noise import LACK_OF_FIT_SCALES, Blocks, LackOfFit, Noise, lack_of_fit_components
from calib.gap.inference.scalar_products import Layout, Reduced, Sums, above_rounding, scalar_products
from calib.gap.observations import Observations
from calib.gap.predict import Path, residuals
from calib.types import BoolArray, FloatArray

N_CALIBRATION: Final = 4
#: keeps a covariance positive definite, relative to its diagonal
_ROUNDING: Final = 1e-11
#: halvings of a step that runs away: to a sixty-fourth
_STEP_HALVINGS: Final = 6
#: what a step may leave, over what was left and what it was to leave
_MAX_MISFIT_RATIO: Final = 2.0
#: largest variance of a predicted correction, as a share of its square
MAX_PREDICTION_VARIANCE: Final = 0.1


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
        for number, units, signatures in fitting.signatures_by_part(path, self.forms):
            rows = place[edges[units.start] : edges[units.stop]]
            self.of(number)[rows] = fitting.whitened_rows(path, noise, signatures, units)
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
        rows, resampled = weight[:, 0] > 0.0, copy(self)

        def made(columns: FloatArray) -> FloatArray:
            return columns[rows] * weight[rows]

        resampled.calibration = made(self.calibration)
        vars(resampled)["columns"] = lambda form: made(self.columns(form))
        return resampled

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


def prior_precision(n_columns: int) -> FloatArray:
    """Return the prior precision of a recalibration and sizes after it, shape (n_columns,)."""
    return np.concatenate([np.ones(4), np.full(n_columns - 4, 1.0 / fitting.SIZE_SD**2)])


class Weighting:
    """Covariance of the whitened gap beside one scale of the lack of fit.

    `kind`: component of lack of fit (-1: none); `scale`: its standard deviation in noise levels of one run;
    `deviations`: each block's, (n_rows, k).
    """

    def __init__(
        self, system: LinearSystem, kind: int = -1, scale: float = 0.0, deviations: FloatArray | None = None
    ) -> None:
        lack, nothing = system.kinds[kind] if kind >= 0 else LackOfFit(""), np.zeros((len(system.gap), 0))
        self.system, self.name, self.scale = system, lack.name, scale
        #: shape (n, length, k): own columns of blocks of one length, to unit prior variance
        self.own: list[FloatArray] = []
        for group, (_, places) in enumerate(system.blocks.alike):
            stacks = [stack for stack in lack.stacks if stack.group == group]
            padded = np.zeros((*places.shape, max((stack.part.shape[2] for stack in stacks), default=0)))
            for stack in stacks:
                padded[stack.same, :, : stack.part.shape[2]] = scale * stack.part
            own = system.blocks.alike_rows(nothing if deviations is None else deviations, group)
            self.own.append(np.concatenate([own, padded], axis=2))
        #: shape (n_rows, q): columns common to all blocks, to unit prior variance
        self.common = nothing if lack.common is None else scale * lack.common

    def _noise(self, own: FloatArray) -> FloatArray:
        # own columns far beyond their size leave the noise below rounding
        return np.asarray(1.0 + _ROUNDING * (1.0 + (own**2).sum(axis=2)))

    def _products(self, columns: FloatArray, on: FloatArray | None = None) -> FloatArray:
        blocks, products = self.system.blocks, np.zeros((columns.shape[1],) * 2)
        for group, own in enumerate(self.own):
            part = blocks.alike_rows(columns, group)
            if on is not None:
                used = blocks.alike_rows(on[:, None], group)
                part, own = part * used, own * used
            deviation = np.sqrt(self._noise(own))[:, :, None]
            white, turned = part / deviation, (own / deviation).transpose(0, 2, 1)
            lower = np.linalg.cholesky(np.eye(own.shape[2]) + turned @ turned.transpose(0, 2, 1))
            for rows, sign in ((white, 1.0), (np.linalg.solve(lower, turned @ white), -1.0)):
                flat = rows.reshape(-1, len(products))
                products += sign * (flat.T @ flat)
        return products

    def solve(
        self, columns: FloatArray, precision: FloatArray, use: BoolArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return estimates (p,) and covariance (p, p) of whitened columns (n_rows, p).

        `precision`: (p,), of the prior; `use`: (n_units,), units to learn from, all by default.
        """
        system = self.system
        whole = np.concatenate([columns, self.common, system.gap[:, None]], axis=1)
        n = whole.shape[1] - 1
        normal = np.diag(np.concatenate([precision, np.ones(self.common.shape[1])]))
        weighed = self._products(whole, None if use is None else use[system.blocks.unit].astype(np.float64))
        normal += weighed[:n, :n]
        right = weighed[:n, n]
        # on a unit diagonal columns alike stay solvable
        root = np.sqrt(np.diag(normal))
        inverse = np.linalg.inv(normal / np.outer(root, root) + 1e-11 * np.eye(n)) / np.outer(root, root)
        p = columns.shape[1]
        return (inverse @ right)[:p], inverse[:p, :p]

    def square(self, gap: FloatArray) -> float:
        """Return y^T V^-1 y of a gap y, shape (n_rows,)."""
        inside = self._products(np.concatenate([gap[:, None], self.common], axis=1))
        common = inside[0, 1:] @ np.linalg.solve(np.eye(len(inside) - 1) + inside[1:, 1:], inside[1:, 0])
        return float(inside[0, 0] - common)

    def spread(self, change: FloatArray, units: BoolArray) -> float:
        """Return the gap's standard deviation along a change (n_rows,) of some units, sqrt(change^T V change)."""
        blocks, total = self.system.blocks, 0.0
        used = change * units[blocks.unit]
        for group, own in enumerate(self.own):
            part = blocks.alike_rows(used[:, None], group)
            total += float((self._noise(own)[:, :, None] * part**2).sum() + ((own * part).sum(axis=1) ** 2).sum())
        along = self.common.T @ used
        return float(np.sqrt(total + along @ along))


def controlled_step(system: LinearSystem, model: Sequence[int], weighting: Weighting) -> Fitted:
    """Return a hypothesis fitted in the linear model about a path, and re-simulated.

    `model`: numbers of forms; `weighting`: lack of fit, and what effects may deviate by; see `recalibrate`.
    """
    columns = system.columns_of(model)
    units = np.concatenate([CALIBRATION_SD, *(system.forms[k].typical for k in model)])
    sizes, covariance = weighting.solve(columns, prior_precision(columns.shape[1]))
    if not system.path.s.usable[:, 4:].any():
        sizes[3] = 0.0
    held = system.fitted.sizes_of([system.forms[k] for k in model])
    present, before = np.concatenate([system.fitted.calibration, *held]) / units, weighting.square(system.left)
    stays = [id(system.forms[k]) for k in model] == [id(form) for form in system.fitted.forms]
    if not (present[:4].any() or weighting.scale):
        stiff = np.where(np.arange(len(sizes)) < 4, 1e12, 1.0)
        alone, _ = weighting.solve(columns, prior_precision(columns.shape[1]) * stiff)
        gained = weighting.square(system.gap - columns @ alone) - weighting.square(system.gap - columns @ sizes)
        if not fitting.is_gain(gained, system.fitted):
            sizes = alone * (np.arange(len(sizes)) >= 4)
    if stays and np.array_equal(sizes, present):
        return system.fitted
    for halvings in range(_STEP_HALVINGS + 1):
        values = present + (sizes - present) / 2**halvings
        step_sd = float((np.abs(values - present) / np.sqrt(np.diag(covariance))).max())
        fitted, left = _simulated_at(system, model, values * units, covariance * np.outer(units, units), step_sd)
        most = before if stays else _MAX_MISFIT_RATIO * max(before, weighting.square(system.gap - columns @ values))
        if weighting.square(left) <= most:
            return fitted
    return system.fitted if stays else fitted


def _simulated_at(
    system: LinearSystem, model: Sequence[int], values: FloatArray, covariance: FloatArray, step_sd: float
) -> tuple[Fitted, FloatArray]:
    forms, calibration = tuple(system.forms[k] for k in model), values[:4]
    theta = tuple(by_form(forms, values))
    path = fitting.path_after(step_sd, system.path, calibration, forms, theta)
    left = residuals(path, system.nominal)
    white = whitened(path, system.noise, left)[system.blocks.order]
    return Fitted(forms, theta, calibration, covariance, path, float(white @ white), left), white


class HeldOutFit:
    """Holds runs out of a fit in turn.

    `fitted`: on all runs; `nominal`: the model alone; `weighting`: none by default; `along`: see `fit`.
    """

    def __init__(
        self,
        fitted: Fitted,
        nominal: Path,
        noise: Noise,
        weighting: Weighting | None = None,
        along: FloatArray | None = None,
    ) -> None:
        self.fitted, self.nominal, self.noise = fitted, nominal, noise
        if weighting is None:
            weighting = Weighting(LinearSystem(fitted, nominal, noise, fitted.forms))
        self.weighting = weighting
        columns = weighting.system.columns_of(weighting.system.numbers(fitted.forms))
        basis = np.eye(columns.shape[1]) if along is None else fitting.calibration_basis(along, columns.shape[1] - 4)
        self.columns, self.basis = columns @ basis, basis
        self.precision = np.square(basis).T @ prior_precision(len(basis))
        self._solved: dict[bytes, tuple[FloatArray, FloatArray]] = {}

    @property
    def observations(self) -> Observations:
        """Units and steps."""
        return self.fitted.path.s

    @cached_property
    def all_estimates(self) -> FloatArray:
        """Estimates on all runs, shape (p,)."""
        return self.weighting.solve(self.columns, self.precision)[0]

    @cached_property
    def derivative(self) -> FloatArray:
        """What each estimate does to the readings, shape (n_units, n_channels, p)."""
        columns = fitting.hypothesis_columns(self.fitted.path, self.fitted.forms)
        return np.where(self.observations.usable[:, :, None], columns @ self.basis, 0.0)

    def contribution(self, effects: Collection[str]) -> FloatArray:
        """Return what some effects do to the readings, shape (n_units, n_channels)."""
        wanted = [form.effect in effects for form in self.fitted.forms for _ in form.parameters]
        first = self.derivative.shape[2] - len(wanted)
        contributed: FloatArray = self.derivative[:, :, first:] @ (self.fitted.parameters * wanted)
        return contributed

    def after(self, out: BoolArray) -> FloatArray:
        """Return the residuals, (n_units, n_channels), of the fit without the units `out`."""
        if out.all():
            return self.fitted.left
        estimates = self._without(out)[0]
        left: FloatArray = self.fitted.left - self.derivative @ (estimates - self.all_estimates)
        return left

    def _without(self, out: BoolArray) -> tuple[FloatArray, FloatArray]:
        key = out.tobytes()
        if key not in self._solved:
            self._solved[key] = self.weighting.solve(self.columns, self.precision, use=~out)
        return self._solved[key]

    def is_predictive(self, out: BoolArray) -> bool:
        """Return whether the others determine the correction on the units `out` (a turn's effect needs turns)."""
        on = out[self.weighting.system.blocks.unit]
        correction = self.columns[on] @ self.all_estimates
        uncertain = self.prediction_variance(out)[0]
        return bool(uncertain < MAX_PREDICTION_VARIANCE * float(correction @ correction) + on.sum())

    def prediction_variance(self, out: BoolArray) -> tuple[float, float]:
        """Return the squares that errors of estimates without the units `out` add there, and half their variance."""
        columns = self.columns[out[self.weighting.system.blocks.unit]]
        spread = (columns.T @ columns) @ self._without(out)[1]
        return float(np.trace(spread)), float(np.trace(spread @ spread))

    def squares(self, residuals: FloatArray) -> FloatArray:
        """Return the whitened squares of each unit, shape (n_units,)."""
        return fitting.squares_by_unit(self.fitted.path, self.noise, residuals)

    def spread(self, change: FloatArray, units: BoolArray) -> float:
        """See `Weighting.spread`."""
        white = whitened(self.fitted.path, self.noise, change)
        return self.weighting.spread(white[self.weighting.system.blocks.order], units)
