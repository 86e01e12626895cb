"""The named causes with their sizes and shares, and the unexplained residual beside them."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Final

import numpy as np

from calib.gap.decision import most_square, reach_of_noise
from calib.gap.decision.constancy import SessionScatter, SizeDifference, beside_named_steps, session_scatter
from calib.gap.decision.diagnosis import Cause, Evidence, Fix, Quantity, Unexplained
from calib.gap.decision.kind import NEGLIGIBLE_SHARE, ON_FLOOR
from calib.gap.effects import Form
from calib.gap.effects.encoder import Blunder
from calib.gap.effects.mounting import Mounting, Restated
from calib.gap.effects.quantities import session_steps
from calib.gap.effects.radii import DIRECTIONS, NAMES
from calib.gap.inference import (
    CERTAIN_PROBABILITY,
    EVEN_PROBABILITY,
    FORM_ERROR,
    NOISE_LEVELS,
    PROBABILITY_CLASSES,
    SMALL_SHARE,
)
from calib.gap.inference.fit import CALIBRATION_SD, identifiability_message, undetermined
from calib.gap.inference.marginal_likelihood import FLOOR_DOF, Nuisance
from calib.gap.observations import Channel
from calib.types import FloatArray, few_digits

#: a cause below this signal and `FORM_ERROR` of a larger one's may be an error of that one's form; radii and track have
#: none
WEAK_SIGNAL: Final = 10.0
MOST_PLACES: Final = 3
MOST_COVARIATES: Final = 2


@dataclass(frozen=True, slots=True, eq=False)
class _Sized:
    form: Form
    theta: FloatArray
    covariance: FloatArray
    columns: FloatArray
    signal: float
    weights: FloatArray  #: (n_estimates, n_parameters): of the estimates, recalibration first

    @property
    def squares(self) -> tuple[float, float]:
        contribution = self.columns @ self.theta
        gram = self.columns.T @ self.columns
        spread = gram @ self.covariance
        along = gram @ self.theta
        variance = 4.0 * along @ self.covariance @ along + 2.0 * np.trace(spread @ spread)
        return float(contribution @ contribution), float(np.sqrt(variance))


def causes_of(
    evidence: Evidence,
    probabilities: Mapping[str, float],
    certain: Mapping[str, float],
    forms_open: Mapping[str, tuple[str, ...]],
) -> list[Cause]:
    """Return causes of the most probable hypothesis and the recalibration, most probable first.

    Ordered by `certain`, see `fix_of`: an alias costs no cause its place.
    """
    from scipy.special import stdtrit

    variance_factor = evidence.variance_factor
    coverage = float(stdtrit(max(evidence.noise.dof, 3.0), 0.975))
    every = _sized(evidence)
    scatter = session_scatter(evidence)
    causes = [
        replace(
            _cause(evidence, sized, variance_factor, scatter, probabilities.get(sized.form.effect, 0.0)),
            share=share,
            share_ci95=(max(share - half, 0.0), min(share + half, 1.0)),
            forms_open=forms_open.get(sized.form.effect, ()),
        )
        for sized, (share, half) in zip(every, _shares(evidence, every, variance_factor, coverage), strict=True)
    ]
    classes = {name: int(np.digitize(probability, PROBABILITY_CLASSES)) for name, probability in certain.items()}
    causes = list(beside_named_steps(causes, [name for name, _ in session_steps(evidence.observations)]))
    return sorted(causes, key=lambda cause: (-classes[cause.effect], -cause.signal))


def negligible(causes: Sequence[Cause], certain: Mapping[str, float]) -> tuple[str, ...]:
    """Return effects that are negligible beside a larger cause, or small and not nearly certain.

    Nearly certain is also a cause above even odds whose family is by `certain`.
    """
    largest = max((cause.share for cause in causes), default=0.0)
    strongest = max((cause.signal for cause in causes if cause.effect not in NAMES), default=0.0)

    def too_small(cause: Cause) -> bool:
        likeliest = max(cause.probability, certain.get(cause.effect, 0.0))
        is_certain = cause.probability > EVEN_PROBABILITY and likeliest >= CERTAIN_PROBABILITY
        doubtful = cause.share <= SMALL_SHARE * largest and not is_certain
        # what radii or track may be instead has a small signal beside them
        weak = cause.share <= SMALL_SHARE and cause.signal < min(WEAK_SIGNAL, FORM_ERROR * strongest)
        return cause.share < NEGLIGIBLE_SHARE * largest or doubtful or weak

    return tuple(cause.effect for cause in causes if too_small(cause))


def _shares(
    evidence: Evidence, every: Sequence[_Sized], variance_factor: float, coverage: float
) -> list[tuple[float, float]]:
    explained, explained_sd = evidence.explained_share
    squares, sd = np.array([sized.squares for sized in every]).reshape(-1, 2).T
    sd *= variance_factor
    total = max(float(squares.sum()), 1e-12)
    ratio = squares / total
    slopes = (np.eye(len(every)) - ratio[:, None]) / total
    half = coverage * np.sqrt(explained**2 * (slopes**2) @ sd**2 + (ratio * explained_sd) ** 2)
    return list(zip((explained * ratio).tolist(), half.tolist(), strict=True))


def _sized(evidence: Evidence) -> list[_Sized]:
    system, fitted, recalibration = evidence.system, evidence.fitted, evidence.recalibration
    nuisance = Nuisance(system.calibration)
    sized, own = [], np.eye(4 + len(fitted.parameters))
    for form, theta, place in fitted.each():
        columns = system.columns(form) / form.typical
        whitened = (columns @ theta)[:, None]
        signal = float(np.sqrt(nuisance.scalar(whitened, whitened)[0, 0]))
        sized.append(_Sized(form, theta, fitted.covariance[place, place], columns, signal, own[:, place]))
    for name in evidence.calibration:
        k = NAMES.index(name)
        form = evidence.effects[name].forms(evidence.observations)[0]
        columns = (evidence.per_unit @ DIRECTIONS[k])[:, None]
        covariance, signal = np.diag(recalibration.sd[[k]] ** 2), float(recalibration.signal[k])
        along = own[:, : len(DIRECTIONS[k])] @ (CALIBRATION_SD[: len(DIRECTIONS[k])] * DIRECTIONS[k])
        sized.append(_Sized(form, recalibration.values[[k]], covariance, columns, signal, along[:, None]))
    return sized


def _cause(
    evidence: Evidence, sized: _Sized, variance_factor: float, scatter: SessionScatter | None, probability: float
) -> Cause:
    from scipy.special import stdtrit

    form, effect = sized.form, evidence.effects[sized.form.effect]
    covariance, dof = variance_factor * sized.covariance, max(evidence.noise.dof, 3.0)
    coverage = float(stdtrit(dof, 0.975))
    if scatter is not None:
        widening = scatter.widening(sized.weights, dof)
        covariance = covariance * np.outer(widening, widening)
    spread = np.sqrt(np.diag(covariance))
    quantities, times = {}, 0.0
    for parameter, value, sd in zip(form.parameters, sized.theta.tolist(), spread.tolist(), strict=True):
        interval = (value - coverage * sd, value + coverage * sd)
        quantities[parameter.name] = Quantity(value, interval, parameter.unit, parameter.shift)
        times = max(times, (abs(value) - 2 * sd) / parameter.largest)
    means = _means(form, sized.theta, covariance, coverage)
    beyond = f"{few_digits(times, 2)} times what is physically plausible: suspect {effect.implausible}"
    remark = beyond if times > 1.0 else ""
    unknown = undetermined(form.parameters, sized.theta, coverage * spread)
    if unknown:
        remark = identifiability_message(form.parameters, sized.theta, covariance, coverage) or remark
    return Cause(
        effect=effect.id,
        title=effect.title,
        form=form.label,
        probability=probability,
        share=0.0,
        signal=sized.signal,
        parameters=quantities | means,
        plausible=times <= 1.0 and bool(means or len(unknown) < len(form.parameters)),
        remark=remark,
        times=times,
        undetermined=unknown,
        settings=form.settings,
        family=effect.family.value,
    )


def _means(form: Form, theta: FloatArray, covariance: FloatArray, coverage: float) -> dict[str, Quantity]:
    means = {}
    for (a, left), (b, right) in combinations(enumerate(form.parameters), 2):
        pair = covariance[np.ix_([a, b], [a, b])]
        mean, half = float(0.5 * (theta[a] + theta[b])), 0.5 * coverage * float(np.sqrt(max(pair.sum(), 0.0)))
        alone = bool((np.abs(theta[[a, b]]) > coverage * np.sqrt(np.diag(pair))).any())
        if left.name.replace("left", "right") == right.name and not alone and abs(mean) > half:
            means[left.name.replace("left", "mean")] = Quantity(mean, (mean - half, mean + half), left.unit)
    return means


def as_corrected(evidence: Evidence, causes: Sequence[Cause], fix: Fix) -> Sequence[Cause]:
    """Return causes with the sizes of a recommended fix of them all: beside what is not named they would be parts."""
    fitted, others = fix.fitted, {cause.effect for cause in causes}.difference(fix.corrects or ())
    if not fix.recommended or fitted is None or others:
        return causes
    own, scatter = np.eye(4 + len(evidence.fitted.parameters)), session_scatter(evidence)
    places = {form.effect: place for form, _, place in evidence.fitted.each()}
    sized = [
        _Sized(form, theta, fitted.covariance[place, place], np.zeros((0, 0)), 0.0, own[:, places[form.effect]])
        for form, theta, place in fitted.each()
    ]
    again = {each.form.effect: _cause(evidence, each, evidence.variance_factor, scatter, 0.0) for each in sized}
    kept = ("probability", "share", "share_ci95", "signal", "forms_open")
    return [
        replace(again[cause.effect], **{name: getattr(cause, name) for name in kept})
        if cause.effect in again
        else cause
        for cause in causes
    ]


def blunder_cause(fault: Blunder | Mounting) -> Cause:
    """Return a blunder corrected before the search as a cause: certain, the whole gap."""
    return Cause(
        effect=fault.effect.id,
        title=fault.effect.title,
        form=fault.label,
        probability=fault.probability,
        share=1.0,
        signal=float(np.linalg.norm(fault.size / fault.sd)) if isinstance(fault, Restated) else float("inf"),
        parameters={name: Quantity(*size) for name, size in fault.sizes.items()},
        remark=fault.remark,
        family=fault.effect.family.value,
    )


def unexplained_of(evidence: Evidence) -> Unexplained | None:
    """Return the unexplained residual; None where none is probable, nor more left than noise leaves."""
    n_rows, square, noise = int(evidence.observations.usable.sum()), evidence.fitted.chi_square, evidence.noise
    beyond = noise.supported and square > most_square(n_rows, noise.dof)
    if (evidence.search.rest < EVEN_PROBABILITY and not beyond) or square <= n_rows:
        return None
    return Unexplained(1.0 - evidence.explained_share[0], float(np.sqrt(square - n_rows)), _places(evidence), beyond)


def left_held_out(evidence: Evidence) -> Unexplained | None:
    """Return what the causes leave of the gap on held-out runs, as an unexplained residual; None where within noise."""
    held_out, usable = evidence.held_out, evidence.observations.usable
    if held_out.closure.largest_residual <= NOISE_LEVELS:
        return None
    scaled = (np.nan_to_num(each[usable] / held_out.floor[usable]) for each in (held_out.before, held_out.after))
    before, after = (max(float(each @ each) - len(each), 1.0) for each in scaled)
    return Unexplained(min(after / before, 1.0), float(np.sqrt(after)))


def places_as_unexplained(
    evidence: Evidence, causes: Sequence[Cause], unexplained: Unexplained | None
) -> tuple[list[Cause], Unexplained | None]:
    """Return places that other causes outweigh, and the unexplained residual with these."""
    total = sum(cause.share for cause in causes)
    placed = [cause for cause in causes if evidence.effects[cause.effect].by_place and cause.share <= 0.5 * total]
    if not placed:
        return [], unexplained
    left = unexplained or Unexplained(0.0, 0.0)
    where = (*(f"{ON_FLOOR}, {cause.form}" for cause in placed), *left.where)
    signal = float(np.linalg.norm([left.signal, *(cause.signal for cause in placed)]))
    share = min(left.share + sum(cause.share for cause in placed), 1.0)
    return placed, replace(left, share=share, signal=signal, where=where)


def limited_beside(causes: Sequence[Cause], *left: Unexplained | None) -> list[Cause]:
    """Return the causes; those of a weaker signal than an unexplained residual at even odds at most.

    Where that is beyond noise, all but the strongest may share it.
    """
    limited = [*causes]
    for unexplained in left:
        if unexplained is not None and unexplained.share > SMALL_SHARE:
            limit = max([unexplained.signal, *(cause.signal for cause in causes if unexplained.beyond_noise)])
            limited = limited_to_even(limited, {cause.effect for cause in causes if cause.signal < limit})
    return limited


def limited_to_even(causes: Sequence[Cause], doubtful: Collection[str]) -> list[Cause]:
    """Return the causes, doubtful effects at even odds at most."""
    return [
        replace(cause, probability=min(cause.probability, EVEN_PROBABILITY)) if cause.effect in doubtful else cause
        for cause in causes
    ]


def _places(evidence: Evidence) -> tuple[str, ...]:
    observations, residual = evidence.observations, evidence.fitted.left
    kinds = observations.labels["kind"]
    means = []
    for kind in np.unique(kinds):
        for channel in Channel:
            on = (kinds == kind) & observations.usable[:, channel]
            if on.sum() > 1:
                scaled = residual[on, channel] / evidence.noise.floor[on, channel]
                mean_sd = abs(float(scaled.mean() * np.sqrt(on.sum())))
                means.append((mean_sd, f"kind {kind}, {channel.label}" if kind else channel.label))
    reach = reach_of_noise(evidence.noise.dof or FLOOR_DOF, len(means))
    places = [words for mean_sd, words in sorted(means, reverse=True)[:MOST_PLACES] if mean_sd > reach]
    where = evidence.where.rest
    if where is not None:
        places += [line.name.replace("_", " ") for line in where.significant[:MOST_COVARIATES]]
    return tuple(dict.fromkeys(places))


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """What is named, how sure, and what stands beside it."""

    causes: Sequence[Cause]
    #: probability of each effect or one that it is confounded with
    certain: Mapping[str, float]
    unexplained: Unexplained | None = None
    #: causes whose sizes differ between groups
    differing: Mapping[str, SizeDifference] = field(default_factory=dict)
    #: confounded effects of the named ones outside their families
    tied: Sequence[Sequence[str]] = ()
    #: causes that no reading checks, and why
    unchecked: Mapping[str, str] = field(default_factory=dict)

    def probability(self, cause: Cause) -> float:
        """Return the probability of a cause or an effect that it is confounded with."""
        return self.certain.get(cause.effect, cause.probability)

    def parts(self) -> Iterator[tuple[Cause, Cause]]:
        """Yield causes that may be a part of a stronger one, whose size differs between runs, and that one.

        It acts as something else, of which radii that are nearly certain are no part.
        """
        odd = [cause for cause in self.causes if cause.effect in self.differing]
        strongest = max(odd, key=lambda cause: cause.signal, default=None)
        for cause in self.causes:
            sure = cause.effect in NAMES and self.probability(cause) >= CERTAIN_PROBABILITY
            if strongest is not None and not sure and cause.signal < strongest.signal:
                yield cause, strongest

    @property
    def leaves_part(self) -> bool:
        """Whether more than a small share is unexplained."""
        return self.unexplained is not None and self.unexplained.share > SMALL_SHARE
