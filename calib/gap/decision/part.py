"""The fix of the sure causes, where that of all is not recommended."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from typing import Final

import numpy as np

from calib.gap.decision import Trial, confounding, most_square, trials
from calib.gap.decision import fix as rule
from calib.gap.decision.causes import Finding
from calib.gap.decision.constancy import half_of_steps
from calib.gap.decision.diagnosis import Cause, Evidence, Fix, Quantity
from calib.gap.decision.held_out import Improvement, improvement_of, left_with_others
from calib.gap.effects import Family
from calib.gap.effects.library import effect_class
from calib.gap.effects.quantities import session_steps
from calib.gap.effects.radii import DIRECTIONS, NAMES, OF_WHEELS
from calib.gap.inference import CERTAIN_PROBABILITY, EVEN_PROBABILITY, HALF_CLOSURE
from calib.gap.inference.fit import Fitted, fit
from calib.gap.inference.least_squares import HeldOutFit
from calib.gap.predict import residuals
from calib.types import FloatArray, few_digits

#: relative change of a calibration that is none
ROUNDING: Final = 1e-12


def sure_part(evidence: Evidence, finding: Finding, whole: Fix) -> Fix:
    """Return the fix of the sure causes where recommended, else the whole one with its reasons.

    `whole`: the fix of all causes, blunders apart, not recommended.
    """
    causes, unexplained = finding.causes, finding.unexplained
    if not evidence.situation.faults and confounding.gap_probability(evidence) < CERTAIN_PROBABILITY:
        return whole
    kept, dropped, by_odds = _parted(finding)
    if len(kept) > 1:
        dropped |= _unclear(evidence, replace(finding, causes=kept), whole)
        kept = [cause for cause in kept if cause.effect not in dropped]
    names = {cause.effect for cause in kept}
    families = {evidence.effects[cause.effect].family for cause in causes if cause.effect in evidence.effects}
    steps = {name for name in dropped if name in evidence.named and evidence.effects[name].per_session}
    if Family.SIMULATOR in families and dropped.keys() - steps:
        # a simulator's parameters are set together
        return whole
    # a recalibration that is rather at work than not cannot be taken off
    likely = {cause.effect for cause in causes if finding.probability(cause) >= EVEN_PROBABILITY}
    if not (names or evidence.situation.faults) or any(name in NAMES and name in likely for name in dropped):
        return whole
    # the closure is that of all: what dropped causes explain is left by design
    if causes and (_is_whole(evidence, names) or any(True for _ in rule.remaining(whole.held_out, unexplained))):
        return whole
    sure = replace(finding, causes=kept, tied=[group for group in finding.tied if names.intersection(group)])
    # a radius is the mean of the sessions: held out with their steps they say if it helps
    alike = names.union(*sure.tied)
    beside = {name for name in steps if alike.isdisjoint(evidence.effects[name].shifts)}
    apart_m = confounding.agreement_m(evidence, sure.tied)
    others = rule.elsewhere(names, rule.alternatives(evidence, sure))
    apart = rule.disagreement(apart_m, whole.agreement_on, evidence.held_out.closure, sure.tied)
    beyond = [*apart, *others, *rule.unsized(evidence, sure), *_odd(evidence, kept, beside)]
    # what helps only with the calibration that a dropped cause looks like is not the fix of these
    left_out, improvement, transfer, worse = _on_held_out(evidence, names, beside)
    left = () if dropped else rule.remaining(improvement, unexplained)
    odds = rule.needed(improvement) if by_odds else ()
    helpful = [*rule.unhelpful(improvement), *rule.oversized(kept, improvement)]
    why = [*helpful, *worse, *left, *odds, *rule.harm(transfer), *beyond]
    if why and steps:
        return replace(whole, why=(*whole.why, *(f"beside {', '.join(sorted(steps))}: {text}" for text in why)))
    if why:
        return whole if causes else replace(whole, held_out=improvement, transfer=transfer, why=tuple(why))
    return replace(
        whole,
        recommended=True,
        agreement_m=apart_m,
        transfer=transfer,
        held_out=improvement,
        why=(),
        corrects=tuple(sorted(names, key=[cause.effect for cause in causes].index)),
        leaves=tuple(dropped.values()),
        fitted=left_out.fitted,
    )


def _odd(evidence: Evidence, kept: Sequence[Cause], beside: Collection[str]) -> list[str]:
    drifts = {evidence.effects[name].family for name in beside}
    known = [cause for cause in kept if cause.effect in evidence.effects and cause.remark]
    odd = [f"{cause.effect}: {cause.remark}" for cause in known if evidence.effects[cause.effect].family in drifts]
    return [*rule.without_length(cause.effect for cause in kept), *odd]


def _unclear(evidence: Evidence, finding: Finding, whole: Fix) -> dict[str, str]:
    unclear: dict[str, str] = {}
    for group in finding.tied:
        apart_m = confounding.agreement_m(evidence, [group])
        texts = [
            *rule.disagreement(apart_m, whole.agreement_on, evidence.held_out.closure, [group]),
            *rule.elsewhere((), rule.alternatives(evidence, replace(finding, tied=[group]))),
        ]
        named = [cause.effect for cause in finding.causes if cause.effect in group]
        unclear |= {name: f"{name}: {text}" for text in texts for name in named}
    return unclear


def as_delivered(evidence: Evidence, finding: Finding, fix: Fix) -> Fix:
    """Return a recommended fix as written, without what is fitted and not named, judged anew.

    The others' sizes change with it; radii and track only where named, or for another zero of a named effect.
    """
    names = {cause.effect for cause in finding.causes}
    if not fix.recommended or fix.corrects is not None or _is_whole(evidence, names):
        return fix
    left_out, improvement, transfer, worse = _on_held_out(evidence, names, ())
    unnamed = ", ".join(sorted(set(evidence.search.effects) - names))
    beside = unnamed or "other radii or another track"
    acts = bool(unnamed) or not _others_at_zero(evidence, names)
    reason = f"the rest is what {beside} would take"
    left = (
        (*rule.remaining(improvement, finding.unexplained, reason), *_resized(evidence, left_out.fitted))
        if acts
        else ()
    )
    why = (*rule.unhelpful(improvement), *left, *worse, *rule.harm(transfer))
    if why:
        lead = f"without {unnamed}, which is not named" if unnamed else "with no other change of radii and track"
        return replace(fix, recommended=False, why=tuple(f"{lead}: {text}" for text in why))
    corrects = tuple(cause.effect for cause in finding.causes)
    closing = evidence.held_out.closing
    closure = closing and closing(*left_with_others(left_out, sessions=_by_session(evidence, names)))
    return replace(
        fix, corrects=corrects, fitted=left_out.fitted, held_out=improvement, transfer=transfer, closure=closure
    )


def _resized(evidence: Evidence, fitted: Fitted) -> Iterator[str]:
    whole = {form.effect: theta for form, theta, _ in evidence.fitted.each()}
    for form, theta, _ in fitted.each():
        columns = evidence.system.columns(form) / form.typical
        off, size = (float(np.linalg.norm(columns @ part)) for part in (theta - whole[form.effect], theta))
        # by what half of a gap's squares closes
        if off > np.sqrt(1.0 - HALF_CLOSURE) * size:
            yield f"{100 * off / size:.0f} % of what it does by {form.effect} would be theirs, not its own; {rule.PLAN}"


def _others_at_zero(evidence: Evidence, names: Collection[str]) -> bool:
    # whether the 95 % region of their sizes holds zero
    from scipy.special import fdtri

    values, covariance = _relative(evidence.fitted)
    moved = _moved_by(evidence, names)
    held = [k for k, name in enumerate(NAMES) if name not in moved]
    square = float(values[held] @ np.linalg.solve(covariance[np.ix_(held, held)], values[held]))
    return square <= len(held) * float(fdtri(len(held), max(evidence.noise.dof, 3.0), 0.95))


def _relative(fitted: Fitted) -> tuple[FloatArray, FloatArray]:
    return OF_WHEELS @ fitted.calibration[:3], OF_WHEELS @ fitted.covariance[:3, :3] @ OF_WHEELS.T


def _is_whole(evidence: Evidence, names: Collection[str]) -> bool:
    return set(evidence.search.effects).issubset(names) and len(_along(evidence, names)) == len(DIRECTIONS)


def _along(evidence: Evidence, names: Collection[str]) -> FloatArray:
    moved = _moved_by(evidence, names)
    return DIRECTIONS[[name in moved for name in NAMES]]


def _moved_by(evidence: Evidence, names: Collection[str]) -> set[str]:
    known = [evidence.effects[name] for name in evidence.effects.keys() & names]
    # a line and its bend are a new law: where the old one crosses it, nothing tells
    new_law = sum(effect.is_load_law for effect in known) > 1
    shifts = (effect.shifts if new_law and effect.is_load_law else effect.own_shifts for effect in known)
    return {*names, *chain.from_iterable(shifts)}


def _on_held_out(
    evidence: Evidence, names: Collection[str], stepping: Collection[str]
) -> tuple[HeldOutFit, Improvement, tuple[Trial, ...], tuple[str, ...]]:
    forms = [form for form in evidence.fitted.forms if form.effect in names or form.effect in stepping]
    along = _along(evidence, names)
    fitted = fit(evidence.nominal, evidence.noise, forms, along=along, start=evidence.fitted)
    left_out = HeldOutFit(fitted, evidence.nominal, evidence.noise, evidence.search.weighting, along)
    before, as_counted = residuals(evidence.nominal, evidence.nominal), evidence.situation.as_counted
    steps = left_out.contribution(stepping)
    stated = (before if as_counted is None else as_counted) - steps
    sessions = _by_session(evidence, (*names, *stepping))
    after, _ = left_with_others(left_out, sessions=sessions)
    worse = _worse_sessions(evidence, left_out, before, fitted.left + steps)[:1] if stepping else ()
    worse = (*worse, *rule.opened(evidence.observations.usable, evidence.noise, stated, after))
    return left_out, improvement_of(left_out, stated, after), trials(left_out, before - steps), worse


def _by_session(evidence: Evidence, names: Iterable[str]) -> bool:
    return not any(evidence.effects[name].per_session for name in names)


def _worse_sessions(evidence: Evidence, left_out: HeldOutFit, before: FloatArray, alone: FloatArray) -> list[str]:
    observations, worse = evidence.observations, []
    squares = [left_out.squares(gap) for gap in (before, alone)]
    for session in np.unique(observations.labels["session"]):
        units = observations.labels["session"] == session
        as_is, left = (float(part[units].sum()) for part in squares)
        if left > max(as_is, most_square(int(observations.usable[units].sum()), evidence.noise.dof)):
            worse.append((np.sqrt(left / max(as_is, ROUNDING)), session))
    return [
        f"alone it makes session {session} worse ({few_digits(ratio, 2)} times the gap): its size is the mean of "
        "unlike ones"
        for ratio, session in sorted(worse, reverse=True)
    ]


def moved(evidence: Evidence, fix: Fix, causes: Sequence[Cause]) -> dict[str, Quantity]:
    """Return what the fix changes of radii and track unnamed, by effect; nothing without a cause."""
    from scipy.special import stdtrit

    values, covariance = _relative((fix.fitted or evidence.fitted).at_end())
    free = np.flatnonzero(np.abs(values) > ROUNDING)
    if not causes or not len(free):
        return {}
    inverse = np.linalg.inv(covariance)
    sd = np.sqrt(np.diag(np.linalg.inv(inverse[np.ix_(free, free)])))
    half_steps = half_of_steps(causes, [name for name, _ in session_steps(evidence.observations)])
    steps = [half_steps.get(NAMES[k], 0.0) for k in free]
    half = np.hypot(float(stdtrit(max(evidence.noise.dof, 3.0), 0.975)) * sd, steps)
    named = {cause.effect for cause in causes}
    sizes = {NAMES[k]: (float(values[k]), float(h)) for k, h in zip(free, half, strict=True) if NAMES[k] not in named}
    return {name: Quantity(value, (value - h, value + h), "1") for name, (value, h) in sizes.items()}


def is_named_beside(cause: Cause, fix: Fix, finding: Finding) -> bool:
    """Return whether a cause stays named beside a part's fix; `Fix.leaves` tells what doubtful ones are."""
    kept = fix.corrects is None or cause.effect in fix.corrects or effect_class(cause.effect).per_session
    return kept or finding.probability(cause) >= CERTAIN_PROBABILITY


def _parted(finding: Finding) -> tuple[list[Cause], dict[str, str], bool]:
    causes = finding.causes
    dropped = {cause.effect: text for cause in causes for text in rule.doubts(cause, finding)}
    # a session's own step says nothing of the next
    kinds = [kind for kind in (effect_class(cause.effect) for cause in causes) if kind.per_session]
    dropped |= {kind.id: f"{kind.id}: {kind.not_transferable}" for kind in kinds}
    for cause, other in finding.parts():
        text = f"{cause.effect} has a signal of {cause.signal:.0f} beside {other.effect} with {other.signal:.0f}"
        dropped.setdefault(cause.effect, f"{text}, whose size differs between runs: it may be a part of that")
    kept = [cause for cause in causes if cause.effect not in dropped]
    n_probable = len(kept)
    while (least := rule.improbable(kept, finding)) is not None:
        kept.remove(least)
        dropped[least.effect] = f"{least.effect} is at work with a probability of {finding.probability(least):.2f}"
    return kept, dropped, len(kept) < n_probable
