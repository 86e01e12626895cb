"""Probabilities behind a verdict: of a gap at all, of each effect, of a rest, and of sets of causes."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Final

from calib.gap.effects.calibration import NAMES
from calib.gap.evidence.subsets import ANY
from calib.gap.verdict.calibrated import calibrated
from calib.gap.verdict.evidence import Evidence

#: a credible set holds so much
CREDIBLE: Final = 0.95
#: a radius or track is mis-set so many times as often as any one effect that looks like it is at work
RARER: Final = 5.0
#: an effect more probable than this by the search was weighed together with the calibration there
WEIGHED: Final = 0.01
#: smallest probability that is listed
LISTED: Final = 1e-4


def gap_probability(evidence: Evidence) -> float:
    """Return the probability that anything at all is off: an effect, a calibration parameter, or a rest."""
    recalibration = evidence.recalibration
    for subset, probability in zip(recalibration.subsets, recalibration.probabilities, strict=True):
        if not subset:
            return 1.0 - evidence.search.nothing * float(probability)
    return 1.0


def effect_probabilities(evidence: Evidence, groups: Sequence[Sequence[str]]) -> dict[str, float]:
    """Return the probability of each effect being at work, and that of an unknown rest, largest first.

    The probability of a calibration parameter is divided with the effects that look like it by their prior odds, after
    what the model says of both together has been brought to how often such statements hold.
    """
    raw = {name: calibrated(p) for name, p in evidence.search.inclusion().items()}
    shared = _shared_with_aliases(evidence, groups)
    for name in NAMES:
        if name in evidence.effects:
            probability = calibrated(evidence.recalibration.probability(name))
            shares = shared.get(name, {})
            raw[name] = probability * (1.0 - sum(shares.values()))
            for alias, share in shares.items():
                # what speaks for the one speaks for the other, and what spoke for it beside, still does
                raw[alias] = max(raw.get(alias, 0.0), probability * share)
    raw |= {fault.effect.id: 1.0 for fault in evidence.faults}
    raw["unknown"] = evidence.search.rest
    ordered = sorted(raw.items(), key=lambda item: -item[1])
    return {name: value for name, value in ordered if value > LISTED or name == "unknown"}


def any_probability(evidence: Evidence, names: Collection[str]) -> float:
    """Return the probability that at least one of some causes is at work, calibration parameters among them."""
    search, recalibration = evidence.search, evidence.recalibration
    effects = sum(
        p for model, p in zip(search.models, search.probabilities, strict=True) if not set(names).isdisjoint(model)
    )
    subsets = zip(recalibration.subsets, recalibration.probabilities, strict=True)
    parameters = sum(q for subset, q in subsets if not set(names).isdisjoint(subset))
    return min(1.0, calibrated(float(effects)) + calibrated(float(parameters)))


def nothing_else_probability(evidence: Evidence, groups: Sequence[Sequence[str]]) -> float:
    """Return the probability that no further effect is at work beside what is named, or what stands in for it."""
    held = set(evidence.named).union(*groups)
    search = evidence.search
    return float(sum(p for model, p in zip(search.models, search.probabilities, strict=True) if held.issuperset(model)))


def _shared_with_aliases(evidence: Evidence, groups: Sequence[Sequence[str]]) -> dict[str, dict[str, float]]:
    """Return which shares of each calibration parameter's probability go to the effects that look like it.

    Of those that were not among what the search weighed together with the calibration, only prior odds speak.
    """
    prior = ANY / len(NAMES)
    weighed = {name for name, probability in evidence.search.inclusion().items() if probability > WEIGHED}
    shared: dict[str, dict[str, float]] = {}
    for group in groups:
        ours = [name for name in group if name in NAMES and name in evidence.calibration]
        if ours and group[0] in ours:
            odds = {
                name: prior / RARER * _most_likely_form(evidence, name)
                for name in group
                if name not in {*ours, *weighed}
            }
            total = prior + sum(odds.values())
            shared |= {name: {alias: each / total for alias, each in odds.items()} for name in ours}
    return shared


def _most_likely_form(evidence: Evidence, name: str) -> float:
    """Return the largest share of an effect's prior that one of its forms has."""
    return max((1.0 / form.tries for form in evidence.search.forms.get(name, ())), default=1.0)


def credible_sets(evidence: Evidence, groups: Sequence[Sequence[str]]) -> tuple[tuple[str, ...], ...]:
    """Return the most probable sets of causes that together hold 95 %, and what could stand in for the best."""
    weights: dict[tuple[str, ...], float] = {}
    gross = tuple(fault.effect.id for fault in evidence.faults)
    recalibration, search = evidence.recalibration, evidence.search
    for effects, p in zip(search.models, search.probabilities, strict=True):
        for subset, q in zip(recalibration.subsets, recalibration.probabilities, strict=True):
            known = tuple(name for name in subset if name in evidence.effects)
            unknown = ("unknown",) if len(known) < len(subset) else ()
            key = (*gross, *effects, *known, *unknown)
            weights[key] = weights.get(key, 0.0) + float(p * q)
    sets, total = [], 0.0
    for key, weight in sorted(weights.items(), key=lambda item: -item[1]):
        sets.append(key)
        total += weight
        if total >= CREDIBLE:
            break
    for group in groups:
        held = [name for name in group if name in sets[0]]
        for other in group:
            instead = tuple(sorted({other, *(name for name in sets[0] if name not in held)}))
            if other not in sets[0] and instead not in sets:
                sets.append(instead)
    return tuple(sets)
