"""Gauss-Newton fit of a recalibration and effects on the re-simulated path."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

import numpy as np

from calib.gap import Perturbation, joined_perturbation, total_perturbation
from calib.gap.effects import Form, Parameter
from calib.gap.inference.noise import Noise
from calib.gap.observations import Observations
from calib.gap.predict import Path, predict, residuals, signature
from calib.types import BoolArray, FloatArray

#: prior standard deviation of sizes, in typical ones: keeps the solution finite
SIZE_SD = 30.0
#: prior standard deviation of a recalibration, relative: left, right radius, track, front radius; the last is held: its
#: error is a gap to be named
CALIBRATION_SD: Final = np.array([0.03, 0.03, 0.1, 1e-6])
#: halvings of a step that raises the misfit: to a thousandth
_MAX_HALVINGS: Final = 10
#: squares closer than this share are equal in double precision
_ROUNDING: Final = 1e-9
#: a step of a hundredth of every standard uncertainty ends the fit
_SMALL_STEP: Final = 0.01
#: standard uncertainties of a far step: it moves effects by a third of one
_FAR_STEP: Final = 10.0
#: chance that noise alone passes for a recalibration
BY_CHANCE: Final = 0.001


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A fitted hypothesis."""

    forms: tuple[Form, ...]
    theta: tuple[FloatArray, ...]  #: each shape (n_parameters,), in the parameters' units
    calibration: FloatArray  #: shape (4,): relative, of left radius, right radius, track, front radius
    covariance: FloatArray  #: shape (4 + n_parameters, 4 + n_parameters): of (calibration, all theta), given the noise
    path: Path
    chi_square: float  #: whitened sum of squares of the residual
    left: FloatArray  #: shape (n_units, 6): residuals, not whitened

    def each(self) -> Iterator[tuple[Form, FloatArray, slice]]:
        """Yield each form, its sizes, and where they stand in the covariance."""
        first = len(self.calibration)
        for form, theta in zip(self.forms, self.theta, strict=True):
            yield form, theta, slice(first, first + len(theta))
            first += len(theta)

    def sizes_of(self, forms: Sequence[Form]) -> list[FloatArray]:
        """Return the sizes of some forms, zero of those that it lacks."""
        known = {id(form): theta for form, theta, _ in self.each()}
        return [known.get(id(form), np.zeros(len(form.parameters))) for form in forms]

    def at_end(self) -> "Fitted":
        """Return the fit as a file holds it: what counts on is zero at the campaign's end."""
        turned = np.eye(len(self.covariance))
        for form, _, place in self.each():
            if form.end is not None and form.centre is not None:
                # of each wheel; zero points of other effects come after
                turned[[0, 1], [place.start, place.start + 1]] = form.end.mean - form.centre.mean
        calibration = turned[:4] @ np.concatenate([self.calibration, *self.theta])
        forms = tuple(form.centred_at(form.end) for form in self.forms)
        theta = tuple(size.copy() for size in self.theta)
        for form, size in zip(self.forms, theta, strict=True):
            if form.end is not None:
                size[:2] /= 1.0 + calibration[:2]
        covariance = turned @ self.covariance @ turned.T
        return replace(self, forms=forms, theta=theta, calibration=calibration, covariance=covariance)

    @property
    def parameters(self) -> FloatArray:
        """All theta end to end, in typical sizes, shape (n_parameters,)."""
        return np.concatenate([np.zeros(0), *(theta / form.typical for form, theta, _ in self.each())])


def calibration_pushes(s: Observations, calibration: FloatArray, path: Path | None) -> list[Perturbation]:
    """Return the perturbations of a relative recalibration (left, right, track, front), (4,)."""
    ones = np.ones(len(s))
    perturbations = [Perturbation(left=ones * calibration[0], right=ones * calibration[1], track=ones * calibration[2])]
    if calibration[3] != 0 and path is not None:
        perturbations.append(Perturbation(reading=path.calibration[:, :, 3] * calibration[3]))
    return perturbations


def hypothesis_path(
    s: Observations, calibration: FloatArray, forms: Sequence[Form], theta: Sequence[FloatArray], about: Path
) -> Path:
    """Re-simulate under a hypothesis whose perturbations are taken about a path.

    Parameters
    ----------
    s, forms, about
    calibration : shape (4,)
        Relative change of left radius, right radius, track, front radius.
    theta : each shape (n_parameters,)
        Sizes of each form, in its parameters' units.
    """
    pushes = calibration_pushes(s, calibration, about)
    acting = [(form, sizes) for form, sizes in zip(forms, theta, strict=True) if np.any(sizes != 0)]
    whole = [None if form.by_parts else form.perturbations(about) for form, _ in acting]

    def total(units: slice, part: Path) -> Perturbation:
        added = [push.part(units, s) for push in pushes]
        for (form, sizes), known in zip(acting, whole, strict=True):
            own = form.perturbations(part) if known is None else [push.part(units, s) for push in known]
            added += [push.scaled(float(size)) for push, size in zip(own, sizes, strict=True)]
        return total_perturbation(part.s, added)

    parts = about.parts() if None in whole else [(slice(0, len(s)), about)]
    return predict(s, [joined_perturbation(s, ((units, total(units, part)) for units, part in parts))])


def path_after(
    step_sd: float, about: Path, calibration: FloatArray, forms: Sequence[Form], theta: Sequence[FloatArray]
) -> Path:
    """Re-simulate after a step of so many standard uncertainties, a far one about its own path; see `hypothesis_path`.

    Effects act along that: about the path before, the step seems to fit too well.
    """
    path = hypothesis_path(about.s, calibration, forms, theta, about)
    return hypothesis_path(about.s, calibration, forms, theta, path) if forms and step_sd > _FAR_STEP else path


def recalibration_columns(path: Path) -> FloatArray:
    """Return the derivative by a recalibration of unit prior variance, (n_units, 6, 4)."""
    return path.calibration * (0.0 if path.s.calibration_held else CALIBRATION_SD)


def hypothesis_columns(path: Path, forms: Sequence[Form]) -> FloatArray:
    """Return those and the forms' signatures times typical sizes, (n_units, 6, 4 + n_parameters)."""
    return np.concatenate([recalibration_columns(path), *signature_columns(path, forms)], axis=2)


def by_form(forms: Sequence[Form], values: FloatArray) -> list[FloatArray]:
    """Divide values of a calibration and of forms, (4 + n_parameters,), among the forms."""
    return np.split(values, np.cumsum([4, *(len(form.parameters) for form in forms)]))[1:-1]


def calibration_basis(along: FloatArray, n_others: int) -> FloatArray:
    """Return a basis (4 + n_others, k + n_others), to unit prior variance, of directions (k, 4) and other sizes."""
    whole = np.zeros((4 + n_others, len(along) + n_others))
    scaled = (along / CALIBRATION_SD).T
    whole[:4, : len(along)] = scaled / np.linalg.norm(scaled, axis=0)
    whole[4:, len(along) :] = np.eye(n_others)
    return whole


@dataclass(frozen=True, slots=True, eq=False)
class _Misfit:
    nominal: Path
    noise: Noise
    forms: Sequence[Form]
    freedom: BoolArray  #: shape (4,): which of the calibration may change
    prior_sd: FloatArray  #: shape (n_parameters,): of each scaled parameter
    along: FloatArray | None  #: shape (k, 4): directions of the calibration; None: all

    def sizes(self, scaled: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        theta = [own * form.typical for form, own in zip(self.forms, by_form(self.forms, scaled), strict=True)]
        return np.where(self.freedom, scaled[:4] * CALIBRATION_SD, 0.0), theta

    def cost(self, path: Path, scaled: FloatArray) -> float:
        white = whitened(path, self.noise, residuals(path, self.nominal))
        return float(white @ white + np.sum((scaled / self.prior_sd) ** 2))

    def gauss_newton(self, path: Path, scaled: FloatArray) -> tuple[FloatArray, FloatArray]:
        gap = residuals(path, self.nominal)[:, :, None]
        whole = whitened_rows(path, self.noise, np.append(hypothesis_columns(path, self.forms), gap, axis=2))
        a, r = whole[:, :-1], whole[:, -1]
        precision = self.prior_sd**-2.0
        normal = a.T @ a + np.diag(precision)
        normal += 1e-11 * np.diag(np.diag(normal))
        right = a.T @ r - precision * scaled
        if self.along is None:
            return normal, np.asarray(np.linalg.solve(normal, right), dtype=np.float64)
        basis = calibration_basis(self.along, len(scaled) - 4)
        return normal, np.asarray(basis @ np.linalg.solve(basis.T @ normal @ basis, basis.T @ right), dtype=np.float64)


def fit(
    nominal: Path,
    noise: Noise,
    forms: Sequence[Form] = (),
    *,
    along: FloatArray | None = None,
    start: Fitted | None = None,
    steps: int = 10,
) -> Fitted:
    """Fit a recalibration and effects by Gauss-Newton on the re-simulated path.

    Parameters
    ----------
    nominal, noise, forms
    along : shape (k, 4)
        Directions in which left radius, right radius, track and front radius may change; all by default.
    start
        Where to begin (its calibration; its parameters where the forms are the same).
    steps
        At most; a step below a hundredth of the standard uncertainty is the last. 0: stay at the start.
    """
    s = nominal.s
    freedom = np.array([True, True, True, bool(s.usable[:, 4:].any())]) & (not s.calibration_held)
    sizes_sd = np.full(sum(len(form.parameters) for form in forms), SIZE_SD)
    prior_sd = np.concatenate([np.where(freedom, 1.0, 1e-6), sizes_sd])
    misfit = _Misfit(nominal, noise, forms, freedom, prior_sd, along)
    calibration = np.zeros(4) if start is None or along is not None else np.where(freedom, start.calibration, 0.0)
    theta = [np.zeros(len(form.parameters)) for form in forms] if start is None else start.sizes_of(forms)
    if start is None:
        path = nominal
    elif np.array_equal(calibration, start.calibration) and {id(f) for f in start.forms} <= {id(f) for f in forms}:
        path = start.path
    else:
        path = hypothesis_path(s, calibration, forms, theta, nominal)
    now = np.concatenate([calibration / CALIBRATION_SD, *(t / f.typical for t, f in zip(theta, forms, strict=True))])
    reached, normal = misfit.cost(path, now), np.eye(len(now))
    for _ in range(max(steps, 1)):
        normal, step = misfit.gauss_newton(path, now)
        if not steps:
            break
        largest = float((np.abs(step) * np.sqrt(np.diag(normal))).max())
        for _ in range(_MAX_HALVINGS):
            calibration, theta = misfit.sizes(now + step)
            trial = path_after(largest, path, calibration, forms, theta)
            lower = misfit.cost(trial, now + step)
            if lower <= reached * (1.0 + _ROUNDING):
                break
            step = 0.5 * step
        else:
            break
        path, now, reached = trial, now + step, lower
        if largest < _SMALL_STEP:
            break
    calibration, theta = misfit.sizes(now)
    left = residuals(path, nominal)
    square = float((whitened(path, noise, left) ** 2).sum())
    units = np.concatenate([CALIBRATION_SD, *(form.typical for form in forms)])
    covariance = np.asarray(np.linalg.inv(normal) * np.outer(units, units), dtype=np.float64)
    return Fitted(tuple(forms), tuple(theta), calibration, covariance, path, square, left)


def recalibrate(nominal: Path, noise: Noise, start: Fitted | None = None) -> Fitted:
    """Return the recalibration alone; none where the model's own leaves no more than noise may.

    Where routes hardly tell a direction (loops of one sense) the best is far off.
    """
    alone, fitted = fit(nominal, noise, steps=0), fit(nominal, noise, start=start)
    return fitted if is_gain(alone.chi_square - fitted.chi_square, alone) else alone


def is_gain(squares: float, fitted: Fitted) -> bool:
    """Return whether a recalibration takes more squares away than noise may."""
    from scipy.special import chdtri

    channels = fitted.path.s.usable[:, 4:].any()
    return squares > float(chdtri(4 if channels else 3, BY_CHANCE))


def linear_rest(fitted: Fitted, noise: Noise) -> float:
    """Return the squares that a linear fit about a hypothesis would leave."""
    columns = np.append(hypothesis_columns(fitted.path, fitted.forms), fitted.left[:, :, None], axis=2)
    whole = whitened_rows(fitted.path, noise, columns)
    gram = whole.T @ whole
    normal = gram[:-1, :-1] + np.diag(1e-11 * np.diag(gram)[:-1] + 1e-11)
    return float(gram[-1, -1] - gram[-1, :-1] @ np.linalg.solve(normal, gram[:-1, -1]))


def whitened_rows(path: Path, noise: Noise, columns: FloatArray, units: slice = slice(None)) -> FloatArray:
    """Whiten columns (n_units, 6, k); usable rows end to end, (n_rows, k)."""
    usable = path.s.usable[units]
    whitened: FloatArray = (noise.whitener[units] @ np.where(usable[:, :, None], columns, 0.0))[usable]
    return whitened


def whitened(path: Path, noise: Noise, left: FloatArray) -> FloatArray:
    """Whiten residuals (n_units, 6); usable rows end to end, (n_rows,)."""
    return whitened_rows(path, noise, left[:, :, None])[:, 0]


def squares_by_unit(path: Path, noise: Noise, left: FloatArray) -> FloatArray:
    """Return the whitened squares of residuals (n_units, 6), shape (n_units,)."""
    unit, _ = np.nonzero(path.s.usable)
    return np.bincount(unit, whitened(path, noise, left) ** 2, len(path.s)).astype(np.float64)


def signature_columns(path: Path, forms: Sequence[Form]) -> list[FloatArray]:
    """Return each form's signatures times typical sizes, each (n_units, 6, n_parameters)."""
    columns = [np.zeros((len(path.s), path.s.usable.shape[1], len(form.parameters))) for form in forms]
    for number, units, signatures in signatures_by_part(path, forms):
        columns[number][units] = signatures
    return columns


def signatures_by_part(path: Path, forms: Sequence[Form]) -> Iterator[tuple[int, slice, FloatArray]]:
    """Yield form number, observations and their signatures times typical sizes, (n, 6, n_parameters)."""

    def columns(part: Path, form: Form, pushes: Sequence[Perturbation]) -> FloatArray:
        signatures = [signature(part, push) * size for push, size in zip(pushes, form.typical, strict=True)]
        return np.stack(signatures, axis=2)

    along_path: list[tuple[int, Form, Sequence[Perturbation]]] = []
    for number, form in enumerate(forms):
        pushes = () if form.by_parts else form.perturbations(path)
        if form.by_parts or not all(push.is_of_observations(path.s) for push in pushes):
            along_path.append((number, form, pushes))
        else:
            # what all steps of an observation share needs none of them
            yield number, slice(0, len(path.s)), columns(path, form, pushes)
    for units, part in path.parts() if along_path else ():
        for number, form, pushes in along_path:
            changes = form.perturbations(part) if form.by_parts else [push.part(units, path.s) for push in pushes]
            yield number, units, columns(part, form, changes)


def undetermined(parameters: Sequence[Parameter], sizes: FloatArray, half_width: FloatArray) -> tuple[str, ...]:
    """Return the parameters whose interval holds zero and reaches beyond the plausible on both sides.

    `parameters`: of one effect; `sizes`, `half_width`: (n_parameters,), of the intervals.
    """
    return tuple(
        parameter.name
        for parameter, size, half in zip(parameters, sizes, half_width, strict=True)
        if half - abs(size) > parameter.largest
    )


def identifiability_message(
    parameters: Sequence[Parameter], sizes: FloatArray, covariance: FloatArray, coverage: float
) -> str:
    """Say which of an effect's parameters the runs leave open or determine only together; else empty.

    `coverage`: half an interval over its standard uncertainty.
    """
    spread = np.sqrt(np.diag(covariance))
    open_ones = undetermined(parameters, sizes, coverage * spread)
    if not open_ones:
        return ""
    together = []
    for (a, p), (b, q) in combinations(enumerate(parameters), 2):
        if {p.name, q.name} <= set(open_ones) and p.unit == q.unit:
            mean = 0.5 * (sizes[a] + sizes[b])
            half = coverage * 0.5 * float(np.sqrt(max(covariance[np.ix_([a, b], [a, b])].sum(), 0.0)))
            if half < min(p.largest, q.largest):
                unit = "" if p.unit == "1" else f" {p.unit}"
                together.append(f"only the mean of {p.name} and {q.name}, {mean:.4g} +- {half:.2g}{unit}")
    alone = f"these runs do not determine {' and '.join(open_ones)}"
    return f"{alone}, {'; '.join(together)}" if together else alone
