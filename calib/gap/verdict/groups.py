"""Which effects these runs cannot tell from the named ones."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.gap.effects.calibration import DIRECTIONS, NAMES
from calib.gap.evidence.marginal import Nuisance
from calib.gap.verdict.alternatives import NEAR, aliases_of
from calib.gap.verdict.evidence import Evidence

#: hypotheses whose weights differ by less (a factor of ten) are not told apart either
LIKELY_NATS: Final = 2.3
#: how free, in prior sizes, the other named effects are while one is asked for what could stand in for it
OTHERS_FREE: Final = 3.0
#: how free another calibration parameter is that is off by itself
CALIBRATION_FREE: Final = 0.03


def groups_of(evidence: Evidence) -> list[list[str]]:
    """Return, for each named effect, the group that these runs cannot tell it from (itself first)."""
    groups = _groups_of_effects(evidence)
    fitted, system, calibration = evidence.fitted, evidence.system, evidence.calibration
    beside = [system.calibration[:, 3:], *(OTHERS_FREE * system.columns(form) for form in fitted.forms)]
    if len(calibration) > 1:
        # one cause may look like two calibration parameters off at once (counts lost on one wheel)
        nuisance = Nuisance.of(np.concatenate(beside, axis=1))
        together = evidence.calibration_contribution(calibration)
        near = aliases_of(system, nuisance, together, evidence.search.forms, evidence.named)
        if near:
            return [*groups, [*calibration, *sorted(near, key=lambda name: near[name])]]
    own = {name: effect.forms(evidence.observations) for name, effect in evidence.effects.items() if effect.calibration}
    offered = evidence.search.forms | own
    for name in calibration:
        others = []
        for other, direction in zip(NAMES, DIRECTIONS, strict=True):
            if other != name:
                way = (evidence.per_unit @ direction)[:, None]
                # one that was not found to be off may be off by what would not have been found
                unseen = NEAR / max(float(np.sqrt((way**2).sum())), 1e-12)
                others.append(way * (CALIBRATION_FREE if other in calibration else unseen))
        nuisance = Nuisance.of(np.concatenate([*beside, *others], axis=1))
        near = aliases_of(system, nuisance, evidence.calibration_contribution([name]), offered, evidence.named)
        instead = [alias for alias in evidence.recalibration.instead.get(name, ()) if alias not in near]
        groups.append([name, *sorted(near, key=lambda alias: near[alias]), *instead])
    return groups


def _groups_of_effects(evidence: Evidence) -> list[list[str]]:
    """Return the group of each effect of the best hypothesis."""
    fitted, system = evidence.fitted, evidence.system
    groups = []
    for form, theta in zip(fitted.forms, fitted.theta, strict=True):
        rest = [system.calibration]
        rest += [OTHERS_FREE * system.columns(other) for other in fitted.forms if other is not form]
        nuisance = Nuisance.of(np.concatenate(rest, axis=1))
        contribution = evidence.contribution(form, theta)
        near = aliases_of(system, nuisance, contribution, evidence.search.forms, evidence.named)
        alike = _as_likely(evidence, form.effect)
        near.update({name: NEAR for name in alike if name not in near and name not in evidence.named})
        groups.append([form.effect, *sorted(near, key=lambda name: near[name])])
    return groups


def _as_likely(evidence: Evidence, effect: str) -> list[str]:
    """Return what, put in the place of one effect of the best hypothesis, is nearly as likely.

    These are other effects and, where the others do without it, parameters of the calibration that it would look like.
    """
    best, search = evidence.search.effects, evidence.search
    probability = dict(zip(search.models, search.probabilities, strict=True))
    others = {name for name in best if name != effect}
    least = probability.get(best, 0.0) * np.exp(-LIKELY_NATS)
    alike = []
    for model, p in probability.items():
        instead = set(model) - others
        # two effects that are as likely at work together do not stand in for one another
        together = probability.get(tuple(sorted({*best, *instead})), 0.0)
        if p > max(least, together) and len(model) == len(best) and others <= set(model) and effect not in model:
            alike += list(instead)
    if probability.get(tuple(sorted(others)), 0.0) > least:
        shifts = [name for name in evidence.effects[effect].shifts if name in evidence.effects]
        alike += [name for name in shifts if evidence.recalibration.probability(name) > least]
    return alike
