"""Probabilities behind a verdict: of a gap at all, of each effect, of an unknown cause, and of sets of causes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from calib.gap.effects.calibration import NAMES
from calib.gap.evidence.recalibration import PRIOR
from calib.gap.verdict.evidence import Evidence

__all__ = ["credible_sets", "effect_probabilities", "gap_probability", "imitation", "rest_left"]

#: a cause named beside an unknown rest may be what the rest looks like: by so much its probability is cut
DOUBT: Final = 0.6
#: closure from which on a gap counts as explained; below, a rest is left
EXPLAINS: Final = 0.9
#: probability of an unknown cause, at least, where the named ones leave such a rest
REST: Final = 0.5
#: how probable it is that what so many named causes (a calibration parameter counts half) explain together is one cause
#: outside the library, which they imitate; from cases whose true effect was deleted from the library
IMITATION: Final = ((0.0, 1.0, 2.0, 2.5), (0.0, 0.08, 0.12, 0.9))
#: a credible set holds so much
CREDIBLE: Final = 0.95
#: smallest probability that is listed
LISTED: Final = 1e-4


def imitation(n_effects: int, n_calibration: int) -> float:
    """Return the probability that so many named causes together imitate one outside the library."""
    return float(np.interp(n_effects + 0.5 * n_calibration, *IMITATION))


def rest_left(fraction: float | None) -> bool:
    """Return whether a closure leaves more of the gap, on runs left out, than an explanation may."""
    return fraction is not None and fraction < EXPLAINS


def gap_probability(evidence: Evidence) -> float:
    """Return the probability that anything at all is off."""
    nothing = evidence.probability(lambda hypothesis: not hypothesis.effects and not hypothesis.unknown)
    recalibration = evidence.recalibration
    for subset, probability in zip(recalibration.subsets, recalibration.probabilities, strict=True):
        if not subset:
            return 1.0 - nothing * float(probability)
    return 1.0


def effect_probabilities(evidence: Evidence, groups: Sequence[Sequence[str]]) -> dict[str, float]:
    """Return the probability of each effect being at work, and that of an unknown cause, largest first."""
    raw: dict[str, float] = {"unknown": evidence.probability(lambda hypothesis: hypothesis.unknown)}
    for hypothesis, probability in zip(evidence.search.hypotheses, evidence.probabilities, strict=True):
        for name in hypothesis.effects:
            raw[name] = raw.get(name, 0.0) + float(probability)
    kept = _kept_beside_aliases(evidence, groups)
    for name in NAMES:
        if name in evidence.effects:
            raw[name] = evidence.recalibration.probability(name) * kept.get(name, 1.0)
    unknown = raw.pop("unknown")
    if evidence.best.effects and rest_left(evidence.held_out.fraction):
        unknown = max(unknown, REST)
    sure = 1.0 - imitation(len(evidence.best.effects), len(evidence.calibration))
    cut = {name: value * (1.0 - DOUBT * unknown) * sure for name, value in raw.items()}
    cut["unknown"] = 1.0 - (1.0 - unknown) * sure
    if evidence.fault is not None:
        cut[evidence.fault.effect.id] = 1.0
    ordered = sorted(cut.items(), key=lambda item: -item[1])
    return {name: value for name, value in ordered if value > LISTED or name == "unknown"}


def _kept_beside_aliases(evidence: Evidence, groups: Sequence[Sequence[str]]) -> dict[str, float]:
    """Return what each calibration parameter keeps of its probability beside the effects that look like it.

    Those effects were projected out of the search, so that only their prior odds speak for them.
    """
    kept: dict[str, float] = {}
    for group in groups:
        ours = [name for name in group if name in NAMES and name in evidence.calibration]
        if ours and group[0] in ours:
            others = len(group) - len(ours)
            kept.update(dict.fromkeys(ours, PRIOR / (PRIOR + evidence.settings.prior_effect * others)))
    return kept


def credible_sets(evidence: Evidence, groups: Sequence[Sequence[str]]) -> tuple[tuple[str, ...], ...]:
    """Return the most probable sets of causes that together hold 95 %, and what could stand in for the best."""
    weights: dict[tuple[str, ...], float] = {}
    gross = () if evidence.fault is None else (evidence.fault.effect.id,)
    recalibration = evidence.recalibration
    for hypothesis, p in zip(evidence.search.hypotheses, evidence.probabilities, strict=True):
        for subset, q in zip(recalibration.subsets, recalibration.probabilities, strict=True):
            known = tuple(name for name in subset if name in evidence.effects)
            unknown = hypothesis.unknown or len(known) < len(subset)
            key = (*gross, *hypothesis.effects, *known, *(("unknown",) if unknown else ()))
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
