"""Search over sets of effects, linearised again about each better one until converged."""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from calib.gap.effects import Effect, Form
from calib.gap.inference import REPORTED_GAP_PROBABILITY
from calib.gap.inference.fit import Fitted, fit, linear_rest
from calib.gap.inference.least_squares import LinearSystem, prior_precision
from calib.gap.inference.local_search import MOST_EFFECTS, NOISE_WINDOW, LocalSearch, Model, SearchResult
from calib.gap.inference.marginal_likelihood import ScaleEvidence
from calib.gap.inference.noise import Noise
from calib.gap.inference.recalibration import SUBSETS, free_estimates, weigh_subsets
from calib.gap.predict import Path
from calib.types import BoolArray, FloatArray

#: passes: linearise, search, fit
_MAX_PASSES: Final = 7
#: a step below this share of the standard uncertainty is the last
_CONVERGED_STEP: Final = 0.2
#: most probable causes that are fitted alone, to begin with the best
_SINGLE_STARTS: Final = 3
#: models weighed with the calibration: at most, within this window of the best
_MAX_LIKELY_MODELS: Final = 12
_LIKELY_WINDOW: Final = 7.0
#: sets taken as current, one after the other
_MAX_SET_CHANGES: Final = 5
_MAX_FORM_CHANGES: Final = 3
#: log evidence gained about the own path that another's does not do for
_NONLINEAR: Final = 1.0
#: beside a larger lack of fit the search begins anew
_SMALL_LACK_OF_FIT: Final = 1.0
#: rms residual, in noise levels, beyond which no search begins: the largest scale of lack of fit but one
_FAR_RMS: Final = 30.0
#: Gauss-Newton steps of each trial from far away
_TRIAL_STEPS: Final = 4
#: of these, before trials are dropped that leave so many times the squares of the best
_FIRST_STEPS: Final = 2
_HOPELESS: Final = 100.0
#: and those whose linear fit leaves so many times what the best has left
_OUTDONE: Final = 2.0
#: share of the promise within which no further step is taken
_SETTLED_SHARE: Final = 0.02
#: most of the squares that a cause of a large gap may leave
_MAX_RESIDUAL_SHARE: Final = 0.5
#: and its linear fit: four steps of a tenth leave 0.66
_MAX_LINEAR_SHARE: Final = 0.9
#: a linearisation, and what was fitted about it
_Settled = tuple[LocalSearch, Fitted]


def search(
    nominal: Path,
    noise: Noise,
    base: Fitted,
    effects: Sequence[Effect],
    start: SearchResult | None = None,
    passed: Callable[[], None] | None = None,
) -> SearchResult:
    """Search the library.

    Parameters
    ----------
    nominal, noise
    base
        The recalibration alone.
    effects
        The library; the calibration's own three are left to the recalibration.
    start
        Where to begin, beside another noise level; the recalibration alone by default.
    passed
        Called before each pass.
    """
    shifts = {effect.id: effect.own_shifts for effect in effects}
    own = {effect.id: effect.forms(nominal.s) for effect in effects if start is None and not effect.calibration}
    forms = {name: offered for name, offered in own.items() if offered} if start is None else start.forms
    all_forms = [form for offered in forms.values() for form in offered]
    alone = LinearSystem(base, nominal, noise, all_forms)
    initial = LocalSearch(alone)
    converge = partial(_converge, all_forms=all_forms, passed=passed)
    begin = _begin_at(start, initial)
    local, fitted = converge(
        copy(initial) if begin is base else LocalSearch(LinearSystem(begin, nominal, noise, all_forms))
    )
    if begin is base and _near((local, fitted), base) is None:
        local, fitted = copy(initial), base
    if local.weighting().scale > _SMALL_LACK_OF_FIT and initial.offered:
        settled, settled_fitted = _begun_anew(initial, converge)
        if settled.evidence() > local.evidence():
            local, fitted = settled, settled_fitted
    at_base = _weighed(initial, shifts)

    def settle(other: LocalSearch, left: Fitted) -> _Settled | None:
        if other.current or initial.with_current(()).weighting().scale:
            return _near(converge(other, greedy=False), left)
        return copy(initial), base

    gap_certain = at_base.nothing * at_base.as_believed < 1.0 - REPORTED_GAP_PROBABILITY
    weigh = partial(_weighed, shifts=shifts)
    most_probable = _most_probable(local, fitted, gap_certain, settle, weigh)
    local, fitted, weighed = _best_alternative(most_probable, settle, weigh)
    by_model = weighed.probability.sum(axis=0)
    by_set = local.by_effects(weighed.models, by_model)
    order = sorted(by_set, key=lambda key: -by_set[key])
    return SearchResult(
        fitted=fitted,
        base=base,
        alone=alone,
        system=local.system,
        forms=forms,
        models=tuple(order),
        probabilities=np.array([by_set[key] for key in order]),
        alternatives=local.alternatives(weighed.models, by_model),
        rest=float(weighed.probability[~local.is_noise].sum()),
        weighting=local.weighting(),
        nothing=at_base.nothing,
        beside_nothing=at_base.beside_nothing,
        gains=weighed.gains,
    )


def _begun_anew(initial: LocalSearch, converge: Callable[..., _Settled]) -> _Settled:
    starts = [initial.with_current(model) for model in initial.best_single_effects(_SINGLE_STARTS)]
    starts = [converge(start, greedy=False)[0] for start in starts]
    best = max(starts, key=lambda start: np.nan_to_num(start.evidence(), nan=-np.inf))
    ended = converge(copy(initial), largest_scale=_SMALL_LACK_OF_FIT), converge(best)
    return max(ended, key=lambda end: end[0].evidence())


def _begin_at(start: SearchResult | None, initial: LocalSearch) -> Fitted:
    if start is not None:
        return start.fitted
    system = initial.system
    if system.path.s.calibration_held and is_far(system.fitted):
        # two parameters far off: neither leads near alone
        forms = initial.forms_of(copy(initial).greedy_search())
        fitted = fit(system.nominal, system.noise, forms, start=system.fitted, steps=_TRIAL_STEPS)
        if not is_far(fitted):
            return fitted
    return continuation_start(system)


def is_far(fitted: Fitted) -> bool:
    """Return whether too much is left for the linear model about this path."""
    return fitted.chi_square > int(fitted.path.s.usable.sum()) * _FAR_RMS**2


def continuation_start(system: LinearSystem) -> Fitted:
    """Return a hypothesis near which the gap is linear: the system's, effects added one by one as they fit.

    `system`: about the path of the recalibration alone, with the forms on offer; its own where it is not far off.
    """
    fitted, nominal, noise = system.fitted, system.nominal, system.noise

    def further(trial: Fitted, steps: int) -> Fitted:
        return fit(nominal, noise, trial.forms, start=trial, steps=steps)

    while is_far(fitted) and len(fitted.forms) < MOST_EFFECTS:
        if system.fitted is not fitted:
            system = LinearSystem(fitted, nominal, noise, system.forms)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            candidates = _worth_trying(system)
            first = [fit(nominal, noise, (*fitted.forms, form), start=fitted, steps=1) for form, _ in candidates]
            second = [
                one if _settled(one.chi_square, promised) else further(one, _FIRST_STEPS - 1)
                for one, (_, promised) in zip(first, candidates, strict=True)
            ]
            least = min((trial.chi_square for trial in second), default=0.0)
            trials: list[Fitted] = []
            for one, two in sorted(zip(first, second, strict=True), key=lambda pair: pair[1].chi_square):
                if two.chi_square <= _HOPELESS * least:
                    ended = _settled(two.chi_square, one.chi_square) or (
                        bool(trials) and linear_rest(two, noise) > _OUTDONE * trials[0].chi_square
                    )
                    trials.append(two if ended else further(two, _TRIAL_STEPS - _FIRST_STEPS))
        trials = [trial for trial in trials if trial.chi_square <= _MAX_RESIDUAL_SHARE * fitted.chi_square]
        if not trials:
            break
        fitted = min(trials, key=lambda trial: trial.chi_square)
    return fitted


def _settled(squares: float, before: float) -> bool:
    return abs(squares - before) <= _SETTLED_SHARE * squares


def _worth_trying(system: LinearSystem) -> list[tuple[Form, float]]:
    fitted = system.fitted
    effects = {form.effect for form in fitted.forms}
    beside = system.columns_of(system.numbers(fitted.forms))
    candidates = []
    for number, form in enumerate(system.forms):
        if form.effect in effects:
            continue
        columns = np.concatenate([beside, system.of(number)], axis=1)
        normal, right = columns.T @ columns + np.diag(prior_precision(columns.shape[1])), columns.T @ system.gap
        root = np.sqrt(np.diag(normal))
        solved = np.linalg.solve(normal / np.outer(root, root) + 1e-11 * np.eye(len(root)), right / root)
        left = float(system.gap @ system.gap - solved @ (right / root))
        if left <= _MAX_LINEAR_SHARE * fitted.chi_square:
            candidates.append((form, left))
    return candidates


@dataclass(frozen=True, slots=True, eq=False)
class _WeighedModels:
    models: list[Model]
    probability: FloatArray  #: shape (n_scales, n_models)
    is_noise: BoolArray  #: shape (n_scales,): scales without a lack of fit
    beside_nothing: FloatArray  #: see `SearchResult`
    current_weight: float
    gains: FloatArray  #: see `weigh_subsets`

    @property
    def as_believed(self) -> float:
        return float(self.beside_nothing[SUBSETS.index(())])

    @property
    def nothing(self) -> float:
        return float(self.probability[self.is_noise, self.models.index(())].sum())


def _weighed(local: LocalSearch, shifts: Mapping[str, tuple[str, ...]]) -> _WeighedModels:
    models, weight = local.posterior()
    total = np.logaddexp.reduce(weight, axis=0)
    likely = [int(n) for n in np.argsort(-total)[:_MAX_LIKELY_MODELS] if total[n] > total.max() - _LIKELY_WINDOW]
    none, is_noise = models.index(()), local.is_noise
    gains = np.zeros((2, len(weight)))
    near = none in likely or weight[is_noise, none].max() > total.max() - NOISE_WINDOW
    if near and ScaleEvidence.is_open(local.system):
        integrated = {*likely, none, models.index(local.current)}
        gain = local.scale_gains(weight, integrated, models, _LIKELY_WINDOW)
        gained = weight + gain
        if none in likely or gained[is_noise, none].max() > gained.max() - _LIKELY_WINDOW:
            gains = np.stack([gain[:, none]] * 2)
            gains[0, 0] = ScaleEvidence(local.system).gain(local.system.calibration[:, 3:])
            weight = gained
    weighting, over_free = local.weighting(), dict[int, float]()
    beside_nothing: FloatArray = np.eye(len(SUBSETS))[SUBSETS.index(())]
    if local.system.path.s.calibration_held:
        likely, over_free = [], dict.fromkeys(range(len(models)), 0.0)
    for n in {*likely, models.index(local.current)} - over_free.keys():
        free = free_estimates(local.system, models[n], weighting)
        subsets = weigh_subsets(local.system, models[n], *free, shifts, gains)
        over_free[n] = subsets.over_free
        if not models[n]:
            beside_nothing = subsets.probabilities
    weight = weight + np.array([over_free.get(n, min(over_free.values())) for n in range(len(models))])
    probability = np.exp(weight - weight.max())
    current_weight = float(np.logaddexp.reduce(weight[:, models.index(local.current)]))
    probability /= probability.sum()
    return _WeighedModels(models, probability, local.is_noise, beside_nothing, current_weight, gains)


def _near(moved: _Settled, left: Fitted) -> _Settled | None:
    local, fitted = moved
    most = _OUTDONE * max(left.chi_square, float(len(local.system.gap)))
    own = {id(form) for form in fitted.forms}
    if own.issuperset(id(form) for form in left.forms) and not local.weighting().scale:
        most = left.chi_square * (1.0 + _SETTLED_SHARE)
    return moved if fitted.chi_square <= most else None


#: a set fitted from another's fit, None where that runs away; models weighed; a set with these
_Settle = Callable[[LocalSearch, Fitted], _Settled | None]
_Weigh = Callable[[LocalSearch], _WeighedModels]
_Found = tuple[LocalSearch, Fitted, _WeighedModels]


def _most_probable(local: LocalSearch, fitted: Fitted, gap_certain: bool, settle: _Settle, weigh: _Weigh) -> _Found:
    visited: dict[tuple[str, ...], _Found] = {}
    for _ in range(_MAX_SET_CHANGES):
        weighed = weigh(local)
        by_set, own = local.by_effects(weighed.models, weighed.probability.sum(axis=0)), local.current_effects
        if gap_certain:
            by_set[()] -= weighed.nothing * weighed.as_believed
        visited[own] = local, fitted, weighed
        most_probable = max(by_set, key=lambda key: by_set[key])
        if most_probable in visited:
            turns = list(visited)[list(visited).index(most_probable) :]
            return visited[min(turns, key=lambda name: (len(name), -visited[name][2].current_weight))]
        moved = settle(local.with_current(local.best_form(most_probable, weighed.models, weighed.probability)), fitted)
        if moved is None:
            return visited[own]
        local, fitted = moved
    return list(visited.values())[-1]


def _converge(
    local: LocalSearch,
    *,
    all_forms: Sequence[Form],
    passed: Callable[[], None] | None,
    largest_scale: float = np.inf,
    greedy: bool = True,
) -> _Settled:
    for number in range(_MAX_PASSES):
        if passed is not None:
            passed()
        # the last passes keep the set: two alike must not alternate
        if greedy and number < _MAX_PASSES - 2:
            local.largest_scale = largest_scale
            local.greedy_search()
            local.largest_scale = np.inf
        before, fitted = local.system.fitted, local.fitted()
        if _step(before, fitted) < _CONVERGED_STEP:
            break
        if number < _MAX_PASSES - 1:
            nominal, noise = local.system.nominal, local.system.noise
            del before, local
            local = LocalSearch(LinearSystem(fitted, nominal, noise, all_forms))
    return local, fitted


def _step(before: Fitted, after: Fitted) -> float:
    if [id(form) for form in before.forms] != [id(form) for form in after.forms]:
        return np.inf
    new, old = (np.concatenate([fitted.calibration, *fitted.theta]) for fitted in (after, before))
    return float(np.abs((new - old) / np.sqrt(np.diag(after.covariance))).max())


def _best_alternative(start: _Found, settle: _Settle, weigh: _Weigh) -> _Found:
    """Return the best of a set and of likely ones with one effect replaced, each about its own path.

    In a large gap linearising about another's path errs by more than evidence weighs.
    """
    best, (local, fitted, weighed) = start, start
    own, total = set(local.current_effects), weighed.probability.sum(axis=0)
    least = total[weighed.models.index(local.current)] * np.exp(-_LIKELY_WINDOW)
    likely = [weighed.models[int(n)] for n in np.argsort(-total) if total[n] > least]
    named = [{form.effect for form in local.forms_of(model)} for model in likely]
    others = [
        model for model, names in zip(likely, named, strict=True) if len(names) == len(own) == len(own & names) + 1
    ]
    for other in others[:_SINGLE_STARTS]:
        system = local.with_current(other)
        linear, moved = system.evidence(), settle(system, fitted)
        for _ in range(_MAX_FORM_CHANGES):
            if moved is None:
                break
            about, names = weigh(moved[0]), moved[0].current_effects
            by_set = moved[0].by_effects(about.models, about.probability.sum(axis=0))
            likeliest = by_set[names] == max(by_set.values()) and about.current_weight > best[2].current_weight
            if likeliest and moved[0].evidence() > linear + _NONLINEAR:
                best = (*moved, about)
            form = moved[0].best_form(names, about.models, about.probability)
            if form == moved[0].current:
                break
            moved = settle(moved[0].with_current(form), fitted)
    return best
