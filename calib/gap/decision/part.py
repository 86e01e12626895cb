"""A fix of the sure causes alone, where the fix of all named ones is held back by some that are not sure.

A cause that is doubtful, whose size may be zero or that may be a part of the unexplained residual is no part of it. The
others are fitted anew without these, and held against held-out runs by the same conditions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.gap.decision import confounding
from calib.gap.decision.diagnosis import Cause, Fix, Unexplained
from calib.gap.decision.evidence import Evidence
from calib.gap.decision.fix import disagreement, doubts, elsewhere, harm, remaining, unhelpful
from calib.gap.decision.held_out import improvement_of
from calib.gap.decision.trials import trials
from calib.gap.effects.calibration import NAMES
from calib.gap.effects.effect import Family
from calib.gap.inference.fit import fit
from calib.gap.inference.least_squares import HeldOutFit
from calib.gap.inference.local_search import EVEN_PROBABILITY
from calib.gap.predict import residuals


def sure_part(
    evidence: Evidence,
    tied: Sequence[Sequence[str]],
    causes: Sequence[Cause],
    certain: Mapping[str, float],
    unexplained: Unexplained | None,
    whole: Fix,
) -> Fix:
    """Return the fix of the sure causes where that is recommended, else the whole one with its reasons.

    Parameters
    ----------
    evidence : Evidence
        What was measured.
    tied : sequence of sequence of str
        Confounded effects among which a named cause is.
    causes : sequence of Cause
        What is named, blunders apart.
    certain : mapping of str to float
        Of each effect, the probability that it or an effect that it is confounded with is at work.
    unexplained : Unexplained or None
        The unexplained residual.
    whole : Fix
        The fix of all causes, which is not recommended.
    """
    kept, dropped = _parted(causes, certain, unexplained)
    names = {cause.effect for cause in kept}
    if any(
        evidence.effects[cause.effect].family is Family.SIMULATOR
        for cause in causes
        if cause.effect in evidence.effects
    ):
        # parameters of a simulator are set together, and judged by running it again
        return whole
    # a recalibration is part of every fit: what is not sure of it cannot be taken off
    if not (names or evidence.situation.faults) or any(name in NAMES for name in dropped):
        return whole
    if causes and not dropped and set(evidence.search.effects) <= names:
        return whole
    # what the dropped causes explain is left by design: the closure is that of all of them
    if causes and any(True for _ in remaining(whole.held_out, None)):
        return whole
    forms = [form for form in evidence.fitted.forms if form.effect in names]
    fitted = fit(evidence.nominal, evidence.noise, forms, start=evidence.fitted)
    left_out = HeldOutFit(fitted, evidence.nominal, evidence.noise, evidence.search.weighting)
    sessions = not any(evidence.effects[name].per_session for name in names)
    improvement = improvement_of(left_out, sessions=sessions, as_counted=evidence.situation.as_counted)
    before = residuals(evidence.nominal, evidence.nominal)
    tried = trials(left_out, before, evidence.noise.dof)
    concerned = [group for group in tied if names.intersection(group)]
    apart_m = confounding.agreement_m(evidence, concerned)
    why = [
        *unhelpful(improvement),
        *harm(tried),
        *disagreement(apart_m, whole.agreement_on, evidence.held_out.closure, concerned),
        *elsewhere(names, concerned),
    ]
    if why:
        # without a cause beside a blunder there are no reasons yet
        return whole if causes else replace(whole, held_out=improvement, transfer=tried, why=tuple(why))
    return replace(
        whole,
        recommended=True,
        agreement_m=apart_m,
        transfer=tried,
        held_out=improvement,
        why=(),
        corrects=tuple(sorted(names, key=[cause.effect for cause in causes].index)),
        leaves=tuple(dropped.values()),
        fitted=fitted,
    )


def is_named_beside(cause: Cause, fix: Fix, certain: Mapping[str, float]) -> bool:
    """Return whether a cause stays named beside the fix of a part: one that is rather not at work does not."""
    if fix.corrects is None or cause.effect in fix.corrects:
        return True
    return certain.get(cause.effect, cause.probability) >= EVEN_PROBABILITY


def _parted(
    causes: Sequence[Cause], certain: Mapping[str, float], unexplained: Unexplained | None
) -> tuple[list[Cause], dict[str, str]]:
    """Return the causes that are sure, and of the others by name why they are not."""
    dropped = {cause.effect: text for cause in causes for text in doubts(cause, unexplained)}
    kept = [cause for cause in causes if cause.effect not in dropped]
    for cause in sorted(kept, key=lambda each: certain.get(each.effect, each.probability)):
        probability = certain.get(cause.effect, cause.probability)
        if float(np.prod([certain.get(each.effect, each.probability) for each in kept])) >= EVEN_PROBABILITY:
            break
        kept.remove(cause)
        dropped[cause.effect] = f"{cause.effect} is at work with a probability of {probability:.2f}"
    return kept, dropped
