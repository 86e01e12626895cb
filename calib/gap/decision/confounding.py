"""Confounded effects, how far their corrections differ, and the probability of each effect."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from calib.gap.decision.diagnosis import Evidence
from calib.gap.effects import Family, Form
from calib.gap.effects.library import applied_perturbations, section_of
from calib.gap.effects.radii import DIRECTIONS, NAMES, RadiusScale, SpeedRadius, TrackWidth
from calib.gap.effects.reference import ReferenceScale
from calib.gap.inference import CONFIDENCE, LOG_EVIDENCE_WINDOW
from calib.gap.inference.fit import CALIBRATION_SD, Fitted, calibration_pushes, hypothesis_path
from calib.gap.inference.least_squares import LinearSystem, Weighting, prior_precision
from calib.gap.inference.marginal_likelihood import Nuisance
from calib.gap.inference.noise import Noise
from calib.gap.inference.recalibration import MIN_EFFECT_SD, PRIOR_SHIFT_ODDS, SUBSETS
from calib.gap.observations import POSE
from calib.gap.plan import SEPARATION_SD, aliases_of, sizes_on
from calib.gap.predict import Path, predict
from calib.types import FloatArray

#: off by the same share: radii and track, and what does the same
SCALED: Final = (RadiusScale.id, TrackWidth.id, ReferenceScale.id)
#: a radius or track is wrong so many times as often as an effect like it
CALIBRATION_ODDS: Final = 5.0
#: above this the search weighed an effect with the calibration
WEIGHED_PROBABILITY: Final = 0.01
#: named causes, and how far from them each effect is
Distances = tuple[tuple[str, ...], dict[str, float]]
#: smallest probability that is listed
LISTED_PROBABILITY: Final = 1e-4
#: probability by the model, and the share of such statements that held, by
#: `tests/challenge/learn_map.py`, learnt on named causes of 152 development cases, none scored
TABLE: Final = (
    (0.0, 0.50, 0.65, 0.75, 0.85, 0.95, 0.99, 0.995, 1.0),
    (0.0, 0.37, 0.40, 0.58, 0.65, 0.83, 0.93, 0.95, 0.96),
)


def calibrated(probability: float) -> float:
    """Return how often a cause of this probability by the model was at work."""
    return float(np.interp(probability, *TABLE))


def groups_of(evidence: Evidence) -> list[list[str]]:
    """Return the group that each named effect is confounded with (itself first, then the nearest)."""
    groups = []
    for named, near in distances_of(evidence):
        likely = evidence.recalibration.instead.get(named[0], ()) if len(named) == 1 else ()
        if named[0] in evidence.search.effects:
            every = (*_as_likely(evidence, named[0]), *_other_laws(evidence, named[0]))
            likely = tuple(name for name in every if name not in evidence.named)
        near |= {name: SEPARATION_SD for name in likely if name not in near}
        groups.append([*named, *sorted(near, key=near.__getitem__)])
    return groups


def distances_of(evidence: Evidence, within: float = SEPARATION_SD) -> list[Distances]:
    """Return the effects `within` so many standard deviations of each named one; of radii and track together first.

    Confounded together, each for itself is not asked for.
    """
    fitted, system, off = evidence.fitted, evidence.system, evidence.calibration
    distances = [_of_effect(evidence, number, within) for number in range(len(fitted.forms))]
    forms = evidence.search.forms
    free = [system.calibration[:, 3:], *(MIN_EFFECT_SD * system.columns(form) for form in fitted.forms)]

    def near(
        names: Sequence[str], others: Sequence[FloatArray], forms: Mapping[str, Sequence[Form]], by: float = 1.0
    ) -> dict[str, float]:
        numbers, nuisance = [NAMES.index(name) for name in names], Nuisance(np.concatenate([*free, *others], axis=1))
        does = evidence.per_unit @ DIRECTIONS[numbers].T @ evidence.recalibration.values[numbers] / by
        return aliases_of(system, nuisance, does, forms, evidence.named, within)

    if evidence.unaided_scale and set(off).issuperset(SCALED[:2]):
        ratio = [evidence.per_unit @ DIRECTIONS[[NAMES.index(name)]].T for name in off if name not in SCALED]
        others, by = [CALIBRATION_SD[0] * column for column in ratio], float(np.sqrt(evidence.variance_factor))
        alike = near(SCALED[:2], others, forms | evidence.unaided_scale, by)
        if alike.pop(ReferenceScale.id, np.inf) < SEPARATION_SD:
            distances.append((SCALED, alike))
            off = tuple(name for name in off if name not in SCALED)
    if len(off) > 1:
        # counts lost on one wheel look like two parameters off
        together = near(off, [], forms)
        if min(together.values(), default=np.inf) < SEPARATION_SD:
            return [*distances, (off, together)]
        distances += [(off, together)] * bool(together)
    for name in off:
        others = [_undetected(evidence, off)[:, [other != name for other in NAMES]]]
        own = {other: each for other, each in evidence.own_forms.items() if other in NAMES}
        # a track that is off by itself takes up what a scale does not turn
        own |= evidence.unaided_scale if name == RadiusScale.id and TrackWidth.id in off else {}
        distances.append(((name,), near([name], others, forms | own)))
    return distances


def _of_effect(evidence: Evidence, number: int, within: float) -> Distances:
    fitted, system = evidence.fitted, evidence.system
    form, theta = fitted.forms[number], fitted.theta[number]
    others = [MIN_EFFECT_SD * system.columns(other) for other in fitted.forms if other is not form]
    contribution = np.asarray(system.columns(form) @ (theta / form.typical))
    near = _absorbing(evidence, contribution, within)
    own = min(near.values(), default=np.inf) < SEPARATION_SD or evidence.effects[form.effect].needs_calibration
    for held in (False, True):
        calibration = [_undetected(evidence, evidence.calibration), system.calibration[:, 3:]]
        calibration = calibration if held else [system.calibration]
        compared = {
            name: forms
            for name, forms in evidence.search.forms.items()
            if held == (own or evidence.effects[name].needs_calibration)
        }
        nuisance = Nuisance(np.concatenate([*calibration, *others], axis=1))
        if SpeedRadius.id in compared and evidence.effects[form.effect].family is Family.DIRECTION:
            compared[SpeedRadius.id] = evidence.own_forms[SpeedRadius.id]
        near |= aliases_of(system, nuisance, contribution, compared, evidence.named, within)
    return (form.effect,), near


def apart_on(
    evidence: Evidence, path: Path, noise: Noise, among: Collection[str]
) -> Callable[[FloatArray], list[Distances]]:
    """Return how far some effects are from the named ones if each of other runs is made so often, (n_obs,)."""
    wanted = {*among, *evidence.named, *NAMES}
    effects = {name: effect for name, effect in evidence.effects.items() if name in wanted}
    forms = {name: effect.forms(path.s) for name, effect in effects.items() if not effect.calibration}
    acting, sizes = list(zip(*sizes_on(forms, evidence.fitted), strict=True)) or ((), ())
    fitted = replace(evidence.fitted, path=path, forms=acting, theta=sizes)
    search = replace(evidence.search, fitted=fitted, forms=forms)
    planned = replace(evidence, nominal=path, noise=noise, effects=effects, search=search)
    whole = planned.system

    def distances(times: FloatArray) -> list[Distances]:
        vars(planned).pop("per_unit", None)
        vars(planned)["system"] = whole.repeated(times)
        return distances_of(planned, np.inf)

    return distances


def _absorbing(evidence: Evidence, contribution: FloatArray, within: float) -> dict[str, float]:
    left = Nuisance(evidence.system.calibration).scalar(contribution[:, None], contribution[:, None])[0, 0]
    if not (left < within**2 and contribution @ contribution > SEPARATION_SD**2):
        return {}
    columns = evidence.per_unit @ DIRECTIONS.T
    sizes = np.linalg.lstsq(columns, contribution)[0] * np.linalg.norm(columns, axis=0)
    left_sd = float(np.sqrt(left)) if left > SEPARATION_SD**2 else 0.0
    return {name: left_sd for name, size in zip(NAMES, sizes.tolist(), strict=True) if abs(size) > SEPARATION_SD}


def _undetected(evidence: Evidence, off: Collection[str]) -> FloatArray:
    columns = evidence.per_unit @ DIRECTIONS.T
    limits = SEPARATION_SD / np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
    return np.asarray(columns * np.where([name in off for name in NAMES], CALIBRATION_SD[0], limits))


def _as_likely(evidence: Evidence, effect: str) -> list[str]:
    best, search = evidence.search.effects, evidence.search
    probability = dict(zip(search.models, search.probabilities, strict=True))
    others = {name for name in best if name != effect}
    least = probability.get(best, 0.0) * np.exp(-LOG_EVIDENCE_WINDOW)
    alternatives: list[str] = []
    for model, p in probability.items():
        instead = set(model) - others
        together = probability.get(tuple(sorted({*best, *instead})), 0.0)
        if p > max(least, together) and len(model) == len(best) and others <= set(model) and effect not in model:
            alternatives += instead
    if probability.get(tuple(sorted(others)), 0.0) > least:
        shifts = [name for name in evidence.effects[effect].shifts if name in evidence.effects]
        alternatives += [name for name in shifts if evidence.recalibration.probability(name) > least]
    return alternatives


def _other_laws(evidence: Evidence, effect: str) -> list[str]:
    if not evidence.effects[effect].is_load_law:
        return []
    inclusion = evidence.search.inclusion()
    least = inclusion.get(effect, 0.0) * np.exp(-LOG_EVIDENCE_WINDOW)
    return [name for name, other in evidence.effects.items() if other.is_load_law and inclusion.get(name, 0.0) > least]


def as_probable(evidence: Evidence, groups: Sequence[Sequence[str]]) -> set[str]:
    """Return effects at least a tenth as probable as the named one of their group.

    A form of many parameters (a floor zone, steps between sessions) follows nearly every weak cause: beside the named
    one it is no alternative to it.
    """
    models, probable = [*zip(evidence.search.models, evidence.search.probabilities, strict=True)], set[str]()

    def probability(name: str, named: set[str]) -> float:
        apart = sum(p for model, p in models if name in model and (name in named or named.isdisjoint(model)))
        return float(max(apart, evidence.recalibration.probability(name) if name in NAMES else 0.0))

    for group in groups:
        named = set(evidence.named).intersection(group)
        least = np.exp(-LOG_EVIDENCE_WINDOW) * max((probability(name, named) for name in named), default=0.0)
        probable.update(name for name in group if probability(name, named) >= least)
    return probable


def _ends(evidence: Evidence, fitted: Fitted) -> FloatArray:
    journeys, about = evidence.journeys, fitted.path
    if journeys is None:
        path = hypothesis_path(about.s, fitted.calibration, fitted.forms, fitted.theta, about)
        return path.reading[:, POSE] if about.s.calibration_held else path.end[:, :2]
    sections = [section_of(form, sizes) for form, sizes, _ in fitted.each()]
    declared = evidence.situation.campaign.extra.get("effects", ())
    perturbations, _ = applied_perturbations(journeys, sections, declared=declared)
    path = predict(journeys, [*calibration_pushes(journeys, fitted.calibration, None), *perturbations])
    return path.end[~np.isin(journeys.labels["run_id"], evidence.observations.labels["run_id"]), :2]


def agreement_m(evidence: Evidence, groups: Sequence[Sequence[str]]) -> float | None:
    """Return the largest root mean square distance of ends under confounded effects; None without any.

    Ends of the journeys to come where given, else of the runs driven. An instrument's error moves no vehicle.

    `groups`: the named effect first.
    """
    distances = []
    for group in groups:
        named = [name for name in group if name in evidence.named]
        exchanged = [_exchanged(evidence, named, other) for other in group if other not in named]
        for alternative in filter(None, exchanged):
            apart = _ends(evidence, alternative) - _ends(evidence, evidence.fitted)
            distances.append(float(np.sqrt(np.mean((apart**2).sum(axis=1)))))
    return max(distances, default=None)


def is_recalibrated(evidence: Evidence, name: str) -> bool:
    """Return whether an effect is a calibration parameter."""
    return name in evidence.effects and evidence.effects[name].calibration


def _exchanged(evidence: Evidence, named: Sequence[str], other: str) -> Fitted | None:
    kept = [form for form in evidence.fitted.forms if form.effect not in named]
    offered = (evidence.search.forms | evidence.unaided_scale).get(other, ())
    candidates = [kept] if is_recalibrated(evidence, other) else [[*kept, form] for form in offered]
    fixed = [NAMES.index(name) for name in named if is_recalibrated(evidence, name)]
    refits = [refitted(evidence, forms, fixed) for forms in candidates]
    return min(refits, key=lambda each: each[0])[1] if refits else None


def refitted(evidence: Evidence, forms: Sequence[Form], fixed: Sequence[int]) -> tuple[float, Fitted]:
    """Return the whitened square that some forms leave, calibration parameters but `fixed` free, and them so fitted."""
    fitted = evidence.fitted
    every = [*fitted.forms, *(form for form in forms if all(form is not own for own in fitted.forms))]
    system = LinearSystem(fitted, evidence.nominal, evidence.noise, every)
    numbers = system.numbers(forms)
    free = [k for k in range(len(NAMES)) if k not in fixed]
    directions = DIRECTIONS[free].T
    calibration = (system.calibration / CALIBRATION_SD) @ directions * CALIBRATION_SD[0]
    columns = np.concatenate([calibration, *(system.of(k) for k in numbers)], axis=1)
    precision = np.concatenate([np.ones(len(free)), prior_precision(4 + columns.shape[1] - len(free))[4:]])
    sizes, _ = Weighting(system).solve(columns, precision)
    residual = system.gap - columns @ sizes
    change = directions @ sizes[: len(free)] * CALIBRATION_SD[0]
    parts = np.split(sizes, np.cumsum([len(free), *(len(form.parameters) for form in forms)])[:-1])[1:]
    theta = tuple(part * form.typical for part, form in zip(parts, forms, strict=True))
    return float(residual @ residual), replace(fitted, calibration=change, forms=tuple(forms), theta=theta)


def gap_probability(evidence: Evidence) -> float:
    """Return the probability of any gap: an effect, a calibration parameter, an unexplained residual."""
    return 1.0 - evidence.search.nothing * float(evidence.search.beside_nothing[SUBSETS.index(())])


def effect_probabilities(evidence: Evidence, groups: Sequence[Sequence[str]]) -> dict[str, float]:
    """Return the probability of each effect and of an ``unknown`` residual, largest first.

    A calibration parameter's, `calibrated` with its aliases', is divided between them by prior odds.
    """
    listed = {name: calibrated(p) for name, p in evidence.search.inclusion().items()}
    shared = _shared_with_aliases(evidence, groups)
    for name in (name for name in NAMES if is_recalibrated(evidence, name)):
        probability = calibrated(evidence.recalibration.probability(name))
        shares = shared.get(name, {})
        listed[name] = probability * (1.0 - sum(shares.values()))
        for alias, share in shares.items():
            # support of the parameter is its alias'
            listed[alias] = max(listed.get(alias, 0.0), probability * share)
    listed |= {fault.effect.id: fault.probability for fault in evidence.situation.faults}
    listed["unknown"] = evidence.search.rest
    ordered = sorted(listed.items(), key=lambda item: -item[1])
    return {name: value for name, value in ordered if value > LISTED_PROBABILITY or name == "unknown"}


def any_probability(evidence: Evidence, names: Collection[str]) -> float:
    """Return the probability that any of some causes is at work, calibration parameters among them."""
    search, recalibration = evidence.search, evidence.recalibration
    weighed = [(search.models, search.probabilities), (recalibration.subsets, recalibration.probabilities)]
    # a parameter and what looks like it share one probability
    sums = [sum(p for s, p in zip(*sets, strict=True) if not set(names).isdisjoint(s)) for sets in weighed]
    return calibrated(min(1.0, float(sum(sums))))


def with_alternatives(evidence: Evidence, groups: Sequence[Sequence[str]]) -> dict[str, float]:
    """Return each named effect's probability together with those that it is confounded with."""
    alternatives = {name: {name}.union(*(group for group in groups if name in group)) for name in evidence.named}
    return {name: any_probability(evidence, names) for name, names in alternatives.items()}


def nothing_else_probability(evidence: Evidence, groups: Sequence[Sequence[str]]) -> float:
    """Return the probability of no further effect beside the named ones and their aliases."""
    named = set(evidence.named).union(*groups)
    weighed = zip(evidence.search.models, evidence.search.probabilities.tolist(), strict=True)
    return float(sum(p for model, p in weighed if named.issuperset(model)))


def _shared_with_aliases(evidence: Evidence, groups: Sequence[Sequence[str]]) -> dict[str, dict[str, float]]:
    prior = PRIOR_SHIFT_ODDS / len(NAMES)
    weighed = {name for name, probability in evidence.search.inclusion().items() if probability > WEIGHED_PROBABILITY}
    shared: dict[str, dict[str, float]] = {}
    for group in groups:
        own = [name for name in group if name in NAMES and name in evidence.calibration]
        if own and group[0] in own:
            forms = {name: evidence.search.forms.get(name, ()) for name in group if name not in {*own, *weighed}}
            # of an effect's prior, its likeliest form; radii and track off alike are rare
            odds = {
                name: prior / CALIBRATION_ODDS * max((1.0 / form.tries for form in offered), default=1.0)
                for name, offered in forms.items()
            }
            odds |= {name: prior for name in evidence.unaided_scale if name in odds}
            total = prior + sum(odds.values())
            shared |= {name: {alias: each / total for alias, each in odds.items()} for name in own}
    return shared


def credible_sets(evidence: Evidence, groups: Sequence[Sequence[str]]) -> tuple[tuple[str, ...], ...]:
    """Return the most probable sets of causes that hold 95 %, and alternatives to the first."""
    weights: dict[tuple[str, ...], float] = {}
    faults = tuple(fault.effect.id for fault in evidence.situation.faults)
    recalibration, search = evidence.recalibration, evidence.search
    beside_nothing = [tuple(NAMES[k] for k in subset) for subset in SUBSETS], search.beside_nothing
    for effects, p in zip(search.models, search.probabilities, strict=True):
        beside = (recalibration.subsets, recalibration.probabilities) if effects else beside_nothing
        for subset, q in zip(*beside, strict=True):
            known = tuple(name for name in subset if name in evidence.effects)
            unknown = ("unknown",) if len(known) < len(subset) else ()
            key = (*faults, *effects, *known, *unknown)
            weights[key] = weights.get(key, 0.0) + float(p * q)
    sets, total = [], 0.0
    for key, weight in sorted(weights.items(), key=lambda item: -item[1]):
        sets.append(key)
        total += weight
        if total >= CONFIDENCE:
            break
    for group in groups:
        replaced = [name for name in group if name in sets[0]]
        for other in group:
            instead = tuple(sorted({other, *(name for name in sets[0] if name not in replaced)}))
            if other not in sets[0] and instead not in sets:
                sets.append(instead)
    return tuple(sets)
