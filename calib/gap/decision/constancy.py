"""Whether a cause has one size on all runs, and how much wider it is known where radii step between sessions.

Steps too small to name are a variance component (Searle, Casella, McCulloch, Variance Components, 1992), known by
Satterthwaite's degrees of freedom.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.campaign.wheels import turn_between_samples_rad
from calib.gap.decision import ORDER, chance_of_order, groupings
from calib.gap.decision.diagnosis import Cause, Evidence
from calib.gap.decision.held_out import MOST_SESSION_FOLDS, improvement_of, left_with_others
from calib.gap.effects import Family
from calib.gap.effects.radii import DIRECTIONS, NAMES, RadiusScale, SessionStep, UnequalRadii
from calib.gap.inference import (
    ADEQUATE_CLOSURE,
    FALSE_REJECTION,
    FORM_ERROR,
    HALF_CLOSURE,
    LOG_EVIDENCE_WINDOW,
    NOISE_LEVELS,
    SMALL_SHARE,
)
from calib.gap.inference.fit import CALIBRATION_SD, SIZE_SD, fit, whitened_rows
from calib.gap.inference.least_squares import HeldOutFit
from calib.gap.inference.noise_components import COMPONENTS, kernels
from calib.gap.localise import ON_THE_FLOOR
from calib.gap.observations import Channel
from calib.gap.predict import residuals
from calib.types import FloatArray, IntArray, StrArray

#: relative step of a radius: unit of the scatter
_STEP: Final = 5e-4
#: prior precision of a step, in its unit: a thousand, left to the data
_STEP_PRECISION: Final = 1e-6
#: log variances searched, in squares of the unit: steps of 1e-6 to 1e-2
_LOG_VARIANCES: Final = (-12.4, 6.0)
_SIDES: Final = ("left", "right")
#: families of causes that follow what may go together with the sessions
SET_WITH_SESSIONS: Final = (Family.DRIFT, Family.LOAD, Family.SPEED)

#: place of the walk of the heading among the noise components
_HEADING_WALK: Final = [name for name, *_ in COMPONENTS].index("heading_walk")
#: prior precision of a size's difference between groups: left to the data
DIFFERENCE_PRECISION: Final = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class SessionScatter:
    """Covariance of the estimates, recalibration first, without and beside steps; `dof` of the steps' variance."""

    without: FloatArray  #: shape (p, p)
    beside: FloatArray  #: shape (p, p)
    dof: float

    def widening(self, weights: FloatArray, dof: float) -> FloatArray:
        """Return by how much intervals of combinations (p, k) are wider, (k,); `dof`: of the noise."""
        from scipy.special import stdtrit

        run = np.einsum("pk,pq,qk->k", weights, self.without, weights)
        session = np.maximum(np.einsum("pk,pq,qk->k", weights, self.beside, weights) - run, 0.0)
        joint = (run + session) ** 2 / (run**2 / dof + session**2 / self.dof)
        widening: FloatArray = stdtrit(joint, 0.975) / stdtrit(dof, 0.975) * np.sqrt(1.0 + session / run)
        return np.maximum(widening, 1.0)


def session_scatter(evidence: Evidence) -> SessionScatter | None:
    """Return what the radii's steps add to sizes; None without sessions or scatter, or with steps named."""
    fitted, fit = evidence.fitted, evidence.left_out
    blocks = fit.weighting.system.blocks
    labels, session = np.unique(evidence.observations.labels["session"][blocks.unit], return_inverse=True)
    if len(labels) < 2 or any(form.effect == SessionStep.id for form in fitted.forms):
        return None
    radii = whitened_rows(fitted.path, evidence.noise, fitted.path.calibration[:, :, :2])[blocks.order] * _STEP
    inside = session[:, None] == np.arange(len(labels))
    steps = (radii[:, :, None] * inside[:, None, :]).reshape(len(radii), -1)
    columns, p = np.concatenate([fit.columns, steps], axis=1), fit.columns.shape[1]

    def solved(precision: float) -> tuple[FloatArray, FloatArray]:
        return fit.weighting.solve(columns, np.concatenate([fit.precision, np.full(steps.shape[1], precision)]))

    estimates, covariance = solved(_STEP_PRECISION)
    variance, dof = variance_component(estimates[p:], covariance[p:, p:])
    if not variance:
        return None
    # of unknown steps their number; a variance near zero is small, not unknown
    dof = max(dof, len(labels) - 1.0)
    without = fit.weighting.solve(fit.columns, fit.precision)[1]
    return SessionScatter(without, solved(1.0 / variance)[1][:p, :p], dof)


def variance_component(estimates: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """Return the variance beyond covariance (m, m) that estimates (m,) of mean zero scatter by, and its dof.

    0.0 where none is likelier; dof by the variance's Fisher information.
    """
    from scipy.optimize import minimize_scalar

    variances, axes = np.linalg.eigh(covariance)
    squares = (axes.T @ estimates) ** 2

    def misfit(log_variance: float) -> float:
        whole = np.abs(variances) + np.exp(log_variance)
        return float(np.sum(np.log(whole) + squares / whole))

    best = minimize_scalar(misfit, bounds=_LOG_VARIANCES, method="bounded", options={"xatol": 1e-6})
    if best.fun >= misfit(_LOG_VARIANCES[0]):
        return 0.0, 0.0
    variance = float(np.exp(best.x))
    return variance, float(np.sum((variance / (variances + variance)) ** 2))


def without_refuted(evidence: Evidence, groups: Sequence[Sequence[str]]) -> list[list[str]]:
    """Return groups of confounded effects, the named one first, without session steps that its predictions refute."""
    kept = []
    for named, *others in groups:
        lasting = [name for name in others if not (name in evidence.effects and evidence.effects[name].per_session)]
        kept.append([named, *(lasting if lasting != others and _is_predicted(evidence, named) else others)])
    return kept


def _is_predicted(evidence: Evidence, effect: str) -> bool:
    """Return whether a cause closes whole sessions held out, paired with the fit of the others alone.

    By F: few sessions may agree by chance. Not of what may have been set with the session, or follows their order.
    """
    from scipy.special import fdtrc

    improvement, family = evidence.held_out.improvement, evidence.effects[effect].family
    if family in SET_WITH_SESSIONS or improvement is None or improvement.closed_ci95[0] < ADEQUATE_CLOSURE:
        return False
    forms = [form for form in evidence.fitted.forms if form.effect != effect]
    along = DIRECTIONS[[name != effect for name in NAMES]]
    others = fit(evidence.nominal, evidence.noise, forms, along=along, start=evidence.fitted)
    without = HeldOutFit(others, evidence.nominal, evidence.noise, evidence.search.weighting, along)
    left, by = left_with_others(without, sessions=True)
    with_it, _ = left_with_others(evidence.left_out, sessions=True)
    closed = improvement_of(evidence.left_out, left, with_it).closed_ci95[0]
    k = len(evidence.fitted.parameters) - sum(len(form.parameters) for form in forms) or 1
    free = min(len(np.unique(evidence.observations.labels["session"])), MOST_SESSION_FOLDS) - 1 - k
    ratio = max(closed, 0.0) / max(1.0 - closed, 1e-9) * free / k
    return by == evidence.held_out.closure.held_out == "session" and float(fdtrc(k, free, ratio)) < FALSE_REJECTION


def beside_named_steps(causes: Sequence[Cause], later: Sequence[str]) -> Iterator[Cause]:
    """Yield causes; radii beside session steps with an interval that holds their scatter.

    They are means of the sessions driven. `later`: names of all but the first.
    """
    half_steps = half_of_steps(causes, later)
    for cause in causes:
        if cause.effect in half_steps:
            (name, size) = next(iter(cause.parameters.items()))
            half = float(np.hypot(half_steps[cause.effect], 0.5 * (size.ci95[1] - size.ci95[0])))
            whole = replace(size, ci95=(size.value - half, size.value + half))
            text = f"the mean of {len(later) + 1} sessions, and the interval holds their steps"
            cause = replace(cause, parameters={name: whole}, remark=cause.remark or text)
        yield cause


def half_of_steps(causes: Sequence[Cause], later: Sequence[str]) -> dict[str, float]:
    """Return half the 95 % interval that named session steps leave of mean radii, by effect; none without steps."""
    step = next((cause for cause in causes if cause.effect == SessionStep.id and cause.parameters), None)
    if step is None:
        return {}
    steps = step.parameters.items()
    by_session = [[0.0, *(size.value for name, size in steps if name.startswith(side))] for side in _SIDES]
    if step.form:
        before = 1 + later.index(next(iter(step.parameters)).partition("_")[2])
        by_session = [[0.0] * before + [own[-1]] * (len(later) + 1 - before) for own in by_session]
    directions = {name: DIRECTIONS[NAMES.index(name), : len(_SIDES)] for name in SessionStep.shifts}
    return {name: half_of_mean(along @ np.array(by_session) / (along @ along)) for name, along in directions.items()}


def half_of_mean(results: FloatArray) -> float:
    """Return half the 95 % interval of the mean of independent results (n,), Student's t."""
    from scipy.special import stdtrit

    n = len(results)
    return float(stdtrit(n - 1, 0.975) * np.std(results, ddof=1) / np.sqrt(n))


@dataclass(frozen=True, slots=True)
class SizeDifference:
    """A cause whose size differs between groups of runs beyond noise and deviations of its form."""

    effect: str
    by: str  #: what the runs are grouped by, see `groupings`
    value: str  #: the group that differs most significantly
    reference: str  #: the group that determines the size best
    ratio: float  #: size on the one over the size on the other
    ratio_sd: float
    p_value: float  #: of equal sizes on all groups, corrected for the number of tests

    @property
    def sentence(self) -> str:
        """What differs, with figures and what to do."""
        if self.by == ORDER:
            return (
                f"the size of {self.effect} drifts with the order driven (p = {self.p_value:.1g}): what warms up or "
                "wears is no constant"
            )
        return (
            f"the size of {self.effect} differs by {self.by}: on {self.value} it is {self.ratio:.2g} +- "
            f"{2.0 * self.ratio_sd:.1g} times that on {self.reference} (p = {self.p_value:.1g}): another effect "
            "may act instead; 'calib plan' names the runs that tell"
        )


def size_differences(evidence: Evidence, effects: Collection[str]) -> dict[str, SizeDifference]:
    """Return, by effect, those whose sizes differ between groups of runs.

    A cause's contribution is given a further factor on each group, beside recalibration and fitted effects (Chow,
    Econometrica 28, 1960). The covariance holds the lack of fit and deviations from the
    form. The statistic follows F; levels are divided by the number of tests. None is what an effect beside accounts
    for, by a test of its own, the only one.
    """
    names = {name for name in effects if not evidence.effects[name].per_session}
    groups = groupings(evidence.observations, by_balance=True)
    contributions = _contributions(evidence, names)

    def difference(effect: str, by: str, beside: FloatArray | None = None) -> SizeDifference | None:
        by_groups = _difference(evidence.left_out, effect, contributions[effect], by, groups[by], beside)
        if by_groups is None or by != ORDER or abs(by_groups.ratio - 1.0) <= FORM_ERROR:
            return by_groups
        if not (evidence.observations.windowed and evidence.search.weighting.name):
            return by_groups
        # what follows the order driven is no scatter
        return replace(by_groups, p_value=_chance_of_drift(evidence, contributions[effect], beside))

    pairs = ((effect, by) for effect in contributions for by in groups)
    tested = [test for effect, by in pairs if (test := difference(effect, by)) is not None]
    differing: dict[str, SizeDifference] = {}
    for each in sorted(tested, key=lambda each: each.p_value):
        if (p_value := len(tested) * each.p_value) >= FALSE_REJECTION:
            break
        others = (difference(each.effect, each.by, beside) for beside in _beside(evidence))
        if each.effect not in differing and all(other and other.p_value < FALSE_REJECTION for other in others):
            differing[each.effect] = replace(each, p_value=p_value)
    return differing


def _beside(evidence: Evidence) -> Iterator[FloatArray]:
    search, order = evidence.search, evidence.left_out.weighting.system.blocks.order
    probability = dict(zip(search.models, search.probabilities, strict=True))
    least = probability.get(search.effects, 0.0) * np.exp(-LOG_EVIDENCE_WINDOW)
    for name, forms in search.forms.items():
        if name not in search.effects and probability.get(tuple(sorted([*search.effects, name])), 0.0) >= least:
            yield from (evidence.system.columns(form)[order] for form in forms)


def _contributions(evidence: Evidence, names: Collection[str]) -> dict[str, FloatArray]:
    fit = evidence.left_out
    contributions = {
        form.effect: fit.columns[:, place] @ (theta / form.typical) for form, theta, place in evidence.fitted.each()
    }
    per_unit = fit.weighting.system.calibration / CALIBRATION_SD
    for number, name in enumerate(NAMES):
        if name in evidence.calibration:
            contributions[name] = per_unit @ DIRECTIONS[number] * evidence.recalibration.values[number]
    return {name: contribution for name, contribution in contributions.items() if name in names}


def _difference(
    fit: HeldOutFit, effect: str, contribution: FloatArray, by: str, labels: StrArray, beside: FloatArray | None = None
) -> SizeDifference | None:
    from scipy.special import fdtrc

    on_rows = labels[fit.weighting.system.blocks.unit]
    squares = {str(value): float((contribution[on_rows == value] ** 2).sum()) for value in np.unique(labels)}
    reference, *others = sorted((v for v in squares if squares[v] > NOISE_LEVELS**2), key=lambda v: -squares[v]) or [""]
    if not others:
        return None
    change, covariance = _changes(fit, contribution, on_rows, others, beside)
    sd = np.sqrt(np.diag(covariance))
    covariance = covariance + FORM_ERROR**2 * (np.eye(len(others)) + 1.0)
    largest = int(np.argmax(np.abs(change) / sd))
    statistic = float(change @ np.linalg.solve(covariance, change)) / len(others)
    p_value = float(fdtrc(len(others), max(fit.noise.dof, 3.0), statistic))
    ratio = 1.0 + float(change[largest])
    return SizeDifference(effect, by, others[largest], reference, ratio, float(sd[largest]), p_value)


def _changes(
    fit: HeldOutFit,
    contribution: FloatArray,
    on_rows: StrArray | IntArray,
    values: Sequence[str | int],
    beside: FloatArray | None,
) -> tuple[FloatArray, FloatArray]:
    # relative changes of a contribution's size on groups of rows, and their covariance
    nuisance, n = fit.columns[:, :0] if beside is None else beside, len(values)
    further = np.column_stack([nuisance, *(np.where(on_rows == value, contribution, 0.0) for value in values)])
    own = np.concatenate([fit.precision, np.full(nuisance.shape[1], 1.0 / SIZE_SD**2)])
    precision = np.concatenate([own, np.full(n, DIFFERENCE_PRECISION)])
    estimates, covariance = fit.weighting.solve(np.concatenate([fit.columns, further], axis=1), precision)
    return estimates[-n:], covariance[-n:, -n:]


def _chance_of_drift(evidence: Evidence, contribution: FloatArray, beside: FloatArray | None) -> float:
    # that sizes of recordings follow the order driven so closely
    fit, run = evidence.left_out, evidence.observations.run[evidence.left_out.weighting.system.blocks.unit]
    strong = np.flatnonzero(np.bincount(run, contribution**2) > NOISE_LEVELS**2)
    changes, _ = _changes(fit, contribution, run, strong[1:].tolist(), beside)
    return chance_of_order(np.append(0.0, changes))[0]


def unchecked(evidence: Evidence, causes: Sequence[Cause]) -> dict[str, str]:
    """Return the causes whose sizes no reading checks, and why.

    What one does on other runs is to be known to what these show of it.
    """
    hints: dict[str, str] = {}
    for cause in causes:
        if (effect := evidence.effects.get(cause.effect)) is not None:
            times, where = effect.elsewhere(evidence.observations)
            if times > NOISE_LEVELS and cause.signal < NOISE_LEVELS * times:
                shown = f"{cause.effect} has a signal of {cause.signal:.0f} in these runs"
                hints[cause.effect] = f"{shown}, and does {times:.0f} times as much {where}"
    names = {cause.effect for cause in causes}
    return _saturated(evidence, names) | hints | _at_a_place(evidence, names) | _between_samples(evidence, names)


def _between_samples(evidence: Evidence, names: Collection[str]) -> dict[str, str]:
    seen, blocks = evidence.observations, evidence.left_out.weighting.system.blocks
    if not seen.by_front:
        return {}
    turn = turn_between_samples_rad(evidence.situation.campaign.included())[seen.run]
    turn /= np.sqrt(np.bincount(seen.run)[seen.run])
    wander = np.diagonal(kernels(evidence.nominal)[_HEADING_WALK], axis1=1, axis2=2)
    reach = turn[:, None] ** 2 * wander / np.maximum(wander[:, 3:4], 1e-300) / evidence.noise.floor**2
    text = f"is within what the steering may do between two samples ({1e3 * turn.mean():.2g} mrad); log it more often"
    hidden = {}
    for name, acts in _contributions(evidence, names).items():
        square = acts**2
        if np.minimum(square, reach[blocks.unit, blocks.channel]).sum() > HALF_CLOSURE * square.sum():
            hidden[name] = f"{name} {text}"
    return hidden


def _at_a_place(evidence: Evidence, names: Collection[str]) -> dict[str, str]:
    """Return radii, which act along the whole way, where a route's gap opens at one place, out and back."""
    seen, gap = evidence.observations, residuals(evidence.nominal, evidence.nominal)
    located: dict[str, str] = {}
    for place in evidence.where.places:
        name = {Channel.ALONG: RadiusScale.id, Channel.HEADING: UnequalRadii.id}.get(place.channel, "")
        on = (seen.labels["kind"] == place.route) & seen.usable[:, place.channel]
        if not place.place or place.coordinate != ON_THE_FLOOR or name not in names or not on.any():
            continue
        if abs(place.size) > HALF_CLOSURE * float(np.abs(gap[on, place.channel]).mean()):
            first, last = place.place
            opens = f"the gap of {place.route} in {place.channel.label} opens from {first:.2f} to {last:.2f} m"
            located[name] = f"{name} acts along the whole way, and {opens}: look at the floor there"
    return located


def _saturated(evidence: Evidence, names: Collection[str]) -> dict[str, str]:
    """Return causes that act alike in every run of a route, where not half of the readings are left to check them.

    A reading is a route's mean in a channel: of thousands of sets some fit what places on each route do.
    """
    seen, blocks = evidence.observations, evidence.left_out.weighting.system.blocks
    placed = {name for name in names if name in evidence.effects and evidence.effects[name].by_place}
    contributions = _contributions(evidence, set(names) - placed)
    pair = np.stack([seen.kind[blocks.unit], blocks.channel])
    kinds, reading, n = np.unique(pair, axis=1, return_inverse=True, return_counts=True)
    means = {name: np.bincount(reading, acts) / n for name, acts in contributions.items()}
    spread = {name: ((acts - means[name][reading]) ** 2).sum() for name, acts in contributions.items()}
    alike = [name for name, acts in contributions.items() if spread[name] <= SMALL_SHARE * (acts**2).sum()]
    size = sum(len(form.parameters) for form in evidence.fitted.forms if form.effect in alike)
    size += sum(name in NAMES for name in alike)
    shown = np.abs(sum((means[name] for name in alike), np.zeros(len(n)))) * np.sqrt(n) > NOISE_LEVELS
    if seen.windowed or size < 2 or shown.sum() >= 2 * size or set(alike).issubset(NAMES):
        return {}
    routes = len(np.unique(kinds[0, shown]))
    text = (
        f"{' and '.join(alike)}: {size} sizes rest on {shown.sum()} mean readings of {routes} "
        f"{'route' if routes == 1 else 'routes'} and nothing checks them, since offsets of the routes' own would look "
        "the same; drive another route with turns"
    )
    return dict.fromkeys(alike, text)
