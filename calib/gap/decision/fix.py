"""Whether to apply a fix: it helps on held-out runs, harms nowhere beyond noise, and is determined."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from math import inf, prod, sqrt
from typing import Final

import numpy as np

from calib.gap.decision import Trial, confounding, most_square
from calib.gap.decision.causes import Finding
from calib.gap.decision.constancy import SET_WITH_SESSIONS
from calib.gap.decision.diagnosis import DRIVEN, JOURNEYS, Cause, Evidence, Fix, Unexplained
from calib.gap.decision.held_out import Closure, Improvement
from calib.gap.decision.kind import fails
from calib.gap.effects import Family
from calib.gap.effects.library import effect_class
from calib.gap.effects.reference import BeamMisalignment, RangefinderScale, ReferenceScale
from calib.gap.inference import (
    CERTAIN_PROBABILITY,
    EVEN_PROBABILITY,
    FALSE_ALARM,
    FIX_PROBABILITY,
    FURTHER_PROBABILITY,
    HALF_CLOSURE,
    NOISE_LEVELS,
    SMALL_SHARE,
)
from calib.gap.inference.noise import Noise
from calib.gap.observations import Channel
from calib.types import BoolArray, FloatArray, few_digits

#: more confounded effects do not identify the cause: no more are listed
LARGEST_GROUP: Final = 6
#: what settles most doubts
PLAN: str = "'calib plan' names the runs that tell"
#: and a reference's scale without another measure of length
TAPE: Final = "the length of one run by tape or laser (distance_m) tells"
REPEAT: str = "drive one route several times under the same conditions"
#: family of a cause -> those of causes that follow something else, which may have gone together with it
PARTING: Final = {
    Family.DRIFT: SET_WITH_SESSIONS,
    Family.DIRECTION: (Family.SPEED,),
}
#: bounds of plausible sizes are known to half an order of magnitude
PLAUSIBLE_FACTOR: Final = sqrt(10.0)


def fix_of(evidence: Evidence, finding: Finding, confounded: Sequence[Sequence[str]], small: Sequence[str] = ()) -> Fix:
    """Return what the correction is worth, and why not to apply it.

    `confounded`: groups of all effects fitted; `small`: fitted ones that are negligible.
    """
    apart_m = confounding.agreement_m(evidence, finding.tied)
    on = DRIVEN if evidence.journeys is None else JOURNEYS
    nothing_else = confounding.nothing_else_probability(evidence, confounded)
    fix = Fix(agreement_m=apart_m, agreement_on=on, nothing_else=nothing_else)
    if not finding.causes:
        return fix
    fitted, gap = [name for name in evidence.named if name not in small], confounding.gap_probability(evidence)
    unnamed = [name for name in fitted if name not in {cause.effect for cause in finding.causes}]
    held_out, improvement = evidence.held_out, evidence.held_out.improvement
    why = (
        *reasons(finding, improvement, evidence.trials, held_out.closure),
        *opened(evidence.observations.usable, evidence.noise, held_out.before, held_out.after),
        *disagreement(apart_m, on, held_out.closure, finding.tied),
        *(f"it rests on {name} too, which is not sure enough to be named; {PLAN}" for name in unnamed),
        *elsewhere(fitted, alternatives(evidence, finding)),
        *unsized(evidence, finding),
        # noise like a cause is like its improvement, too
        *([] if gap >= CERTAIN_PROBABILITY else [f"the probability that there is a gap at all is {gap:.2f}; {REPEAT}"]),
        # what is shown beyond too high a level holds at any lower one
        *([] if noise_bounded(evidence) else [f"the noise level rests on {evidence.noise.support}; {REPEAT}"]),
    )
    return replace(fix, recommended=not why, transfer=evidence.trials, held_out=improvement, why=why)


def noise_bounded(evidence: Evidence) -> bool:
    """Return whether noise is at most its level: a supported one, or that of runs that may differ in more."""
    return evidence.noise.supported or (evidence.noise.dof > 0.0 and not evidence.observations.windowed)


def reasons(
    finding: Finding, improvement: Improvement | None, trials: Sequence[Trial] = (), closure: Closure | None = None
) -> list[str]:
    """Return what keeps a fix of some causes back, with figures and what settles it.

    `improvement`, `closure`: on held-out runs; `trials`: on each value of what varies, held out.
    """
    single = dict.fromkeys(text for cause in finding.causes for text in doubts(cause, finding))
    left = any(map(fails, trials)) or (closure is not None and closure.leaves_part)
    helpful = [
        *unhelpful(improvement),
        *remaining(improvement, finding.unexplained, left=left),
        *oversized(finding.causes, improvement),
    ]
    measured = without_length(cause.effect for cause in finding.causes)
    return [*_doubtful(finding), *helpful, *single, *measured, *harm(trials)]


def without_length(names: Iterable[str]) -> list[str]:
    """Return that nothing measures a length where reference and rangefinder are both said to be off."""
    named = {*names}
    if ReferenceScale.id not in named or named.isdisjoint({RangefinderScale.id, BeamMisalignment.id}):
        return []
    return [
        "reference and rangefinder would both read lengths wrong, and nothing is left that measures one: tape one run"
    ]


def doubts(cause: Cause, finding: Finding) -> Iterator[str]:
    """Yield why a cause is no part of a fix.

    Its size may be zero or differ between groups of runs, or be a part of the unexplained residual.
    """
    yield from beyond_vehicles(cause)
    if holds_zero(cause):
        sizes = ", ".join(
            f"{name} {quantity.ci95[0]:.2g} to {quantity.ci95[1]:.2g} {quantity.unit.removeprefix('1')}".rstrip()
            for name, quantity in cause.parameters.items()
        )
        yield f"the interval of {cause.effect} holds zero ({sizes}); {PLAN}"
    if cause.effect in finding.differing:
        yield finding.differing[cause.effect].sentence
    if cause.effect in finding.unchecked:
        yield finding.unchecked[cause.effect]
    unexplained = finding.unexplained if finding.leaves_part and cause.share > SMALL_SHARE else None
    shared = unexplained is not None and unexplained.beyond_noise and cause.probability <= EVEN_PROBABILITY
    if unexplained is not None and (shared or cause.signal < NOISE_LEVELS * unexplained.signal):
        yield (
            f"{cause.effect} has a signal of {cause.signal:.0f} beside an unexplained residual of "
            f"{unexplained.signal:.0f}, of which it may be a part; add columns of suspected quantities to runs.csv"
        )


def beyond_vehicles(cause: Cause) -> Iterator[str]:
    """Yield that a length is beyond any vehicle's, by the bounds of `calib geometry`."""
    largest = effect_class(cause.effect).wrong_beyond
    if not cause.plausible and any(abs(quantity.value) > largest for quantity in cause.parameters.values()):
        sizes = ", ".join(f"{100 * quantity.value:+.3g} %" for quantity in cause.parameters.values())
        yield (
            f"{cause.effect} of {sizes} is beyond any vehicle's ({100 * largest:.0f} %): check the units of the "
            "reference, counts_per_rev, the gear ratio and the nominal lengths, then diagnose again"
        )


def improbable(causes: Sequence[Cause], finding: Finding) -> Cause | None:
    """Return the least probable cause where it or all together are less probable than a fix asks, else None."""
    least = min(sorted(causes, key=lambda cause: -cause.share)[1:], key=finding.probability, default=None)
    if least is not None and finding.probability(least) < FURTHER_PROBABILITY:
        return least
    return min(causes, key=finding.probability) if prod(map(finding.probability, causes)) < FIX_PROBABILITY else None


def _doubtful(finding: Finding) -> Iterator[str]:
    causes, probability = finding.causes, finding.probability
    if improbable(causes, finding) is not None:
        listed = ", ".join(
            f"{cause.effect}{'' if cause.probability >= 0.9 * probability(cause) else ' or what looks like it'} "
            f"{probability(cause):.2f}"
            for cause in causes
        )
        together = prod(map(probability, causes))
        yield f"the probability that all of its causes are at work is {together:.2f} ({listed}); {PLAN}"


def unsized(evidence: Evidence, finding: Finding) -> Iterator[str]:
    """Yield that an unexplained residual without a size is probable, where a cause is not strong beside it.

    Two standard deviations of chi square hide a signal of (8 n)^(1/4) in n readings.
    """
    if finding.unexplained is not None or evidence.search.rest < EVEN_PROBABILITY:
        return
    hidden = (8.0 * float(evidence.observations.usable.sum())) ** 0.25
    weak = [c for c in finding.causes if c.share > SMALL_SHARE and c.signal < NOISE_LEVELS * hidden]
    if weak or not finding.causes:
        yield (
            f"the probability of an unexplained residual is {evidence.search.rest:.2f}, though it is too small to be "
            f"located (a signal below {hidden:.0f}); repeat the routes with the largest gap"
        )


def unhelpful(improvement: Improvement | None) -> Iterator[str]:
    """Yield where a correction is not shown to help on held-out runs."""
    if improvement is None:
        yield "no run could be held out; drive each route twice at least"
        return
    low, high = improvement.improvement_ci95
    if low <= 0.0:
        yield (
            f"on held-out runs the error goes from {_errors(improvement)}, an improvement of {low:+.2g} to "
            f"{high:+.2g}: not shown to help; repeat the routes with the largest gap"
        )


def shown_by_many(fix: Fix, closure: Closure) -> Fix:
    """Return a fix, not recommended where it rests on few of the conditions driven: without them others get worse."""
    if not (fix.recommended and closure.rests_on_few and closure.ci95):
        return fix
    low, high = (100 * share for share in closure.ci95)
    why = f"drawn anew from these conditions it closes {low:.0f} to {high:.0f} %: too few show it; {PLAN}"
    return replace(fix, recommended=False, why=(why,))


def oversized(causes: Iterable[Cause], improvement: Improvement | None) -> Iterator[str]:
    """Yield causes beyond what is plausible that are not shown to close the gap: what imitates leaves a part of it.

    The squares left are to be below half of those of the largest size that may be, and the cause rather at work than
    not. Radii and track: `beyond_vehicles`.
    """
    if improvement is None:
        return
    low, high = (100 * share for share in improvement.closed_ci95)
    for cause in causes:
        beyond = max(cause.times / PLAUSIBLE_FACTOR, 1.0)
        wanted, bounded = 100 * (1 - (1 - HALF_CLOSURE) / beyond**2), effect_class(cause.effect).wrong_beyond < inf
        if cause.plausible or cause.undetermined or bounded:
            continue
        if cause.probability < EVEN_PROBABILITY:
            yield f"the size of {cause.effect} is {cause.remark}, and its probability {cause.probability:.2f}; {PLAN}"
        elif low <= wanted:
            yield (
                f"the size of {cause.effect} is {cause.remark}, and on held-out runs it closes {low:.0f} to {high:.0f} "
                f"% of the gap, where {wanted:.0f} % are to be certain; {PLAN}"
            )


#: what a fix leaves
REST: Final = "the rest has a cause of its own; look where the residual lies"


def remaining(
    improvement: Improvement | None, unexplained: Unexplained | None, reason: str = REST, *, left: bool = False
) -> Iterator[str]:
    """Yield where part of the gap, `reason`, is certainly left, and where too little of it closes; `left`: it shows."""
    if improvement is None or improvement.improvement_ci95[0] <= 0.0:
        return
    part = improvement.leaves_some or unexplained is not None or left
    if part and improvement.closed_ci95[0] <= HALF_CLOSURE:
        low, high = (100 * share for share in improvement.closed_ci95)
        yield (
            f"on held-out runs it closes {low:.0f} to {high:.0f} % of the gap, where {100 * HALF_CLOSURE:.0f} % are to "
            f"be certain ({_errors(improvement)}): {reason}"
        )


def needed(improvement: Improvement | None) -> Iterator[str]:
    """Yield where a cause dropped for its odds was needed: others certainly leave part of the gap."""
    if improvement is not None and improvement.leaves_some:
        low, high = (100 * share for share in improvement.closed_ci95)
        yield f"its probable causes alone close {low:.0f} to {high:.0f} % of the gap on held-out runs; {PLAN}"


def _errors(improvement: Improvement) -> str:
    return f"{improvement.before_rms:.3g} to {improvement.after_rms:.3g} times the noise"


def holds_zero(cause: Cause) -> bool:
    """Return whether all intervals of a cause hold zero, a shift of its zero point aside."""
    own = [quantity.ci95 for quantity in cause.parameters.values() if not quantity.shift]
    return bool(own) and all(low <= 0.0 <= high for low, high in own)


def ranked(causes: Iterable[Cause]) -> list[Cause]:
    """Return causes by whole percents of probability; equally probable ones as given, last any that may be zero."""
    rounded = [replace(cause, probability=round(cause.probability, 2)) for cause in causes]
    return sorted(rounded, key=lambda cause: (-cause.probability, holds_zero(cause)))


def harm(trials: Sequence[Trial]) -> Iterator[str]:
    """Yield where a correction harms beyond noise when held out."""
    for trial in harmed(trials):
        sizes = ""
        if trial.before_rms_m is not None and trial.after_rms_m is not None and trial.after_rms_m > trial.before_rms_m:
            sizes = f" from {few_digits(1e3 * trial.before_rms_m)} to {few_digits(1e3 * trial.after_rms_m)} mm"
        yield (
            f"held out, {trial.left_out} {trial.value} gets worse{sizes}, {trial.growth_sd:.1f} standard deviations "
            "beyond noise; drive it again, once slower and once loaded otherwise"
        )


def opened(usable: BoolArray, noise: Noise, before: FloatArray, after: FloatArray) -> Iterator[str]:
    """Yield channels whose squares grow by more than they were and more than noise leaves: a condition like a load.

    Less is what errors of two causes may cancel. `before`, `after`: (n_units, n_channels), without and with a
    correction fitted on others, as are `usable`.
    """
    for channel in Channel:
        on = usable[:, channel]
        rms = [float(np.sqrt(np.mean(values[on, channel] ** 2))) for values in (before, after, noise.floor) if on.any()]
        scaled = [np.sum((values[on, channel] / noise.floor[on, channel]) ** 2) for values in (before, after)]
        if scaled[1] - scaled[0] > max(scaled[0], most_square(int(on.sum()), noise.dof)):
            sizes = [few_digits(1e3 * value) for value in rms]
            yield (
                f"held out, {channel.label} gets worse from {sizes[0]} to {sizes[1]} m{channel.unit} "
                f"(noise {sizes[2]} m{channel.unit}): {REST}"
            )


def harmed(trials: Sequence[Trial]) -> list[Trial]:
    """Return where the gap grew beyond noise when held out, by chance in one of a hundred campaigns."""
    from scipy.special import ndtri

    limit = float(ndtri(1.0 - FALSE_ALARM / max(len(trials), 1)))
    return [trial for trial in trials if trial.growth_sd > limit]


def elsewhere(fitted: Iterable[str], alternatives: Iterable[str]) -> list[str]:
    """Return why a correction does not hold for journeys to come: by its causes, or what they may be instead."""
    return sorted({text for name in {*fitted, *alternatives} if (text := effect_class(name).not_transferable)})


def alternatives(evidence: Evidence, finding: Finding) -> set[str]:
    """Return what the causes may be instead: the probable ones where they explain all, else every one.

    Odds do not hold beside an unexplained residual or a size that differs between runs. Session steps always count
    where held-out sessions do not refute them.
    """
    every = {name for group in finding.tied for name in group}
    if finding.differing or finding.leaves_part:
        return every
    stepping = {name for name in every if name in evidence.effects and evidence.effects[name].per_session}
    return confounding.as_probable(evidence, finding.tied) | stepping


def parting(group: Sequence[str]) -> list[str]:
    """Return the first effect of a group and those that follow something else, one with it on the runs driven alone."""
    follows = PARTING.get(effect_class(group[0]).family, ())
    parted = [name for name in group[1:] if effect_class(name).family in follows]
    return [group[0], *parted] if parted else []


def _either(group: Sequence[str]) -> str:
    listed = group if len(group) <= LARGEST_GROUP else (group[0], f"{len(group) - 1} other effects")
    return " or ".join(listed)


def disagreement(apart_m: float | None, on: str, closure: Closure, tied: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield where corrections of confounded effects differ.

    What drifted alike here need not in sessions to come.
    """
    for parted in filter(None, map(parting, tied if on == DRIVEN else ())):
        yield (
            f"these runs cannot tell {_either(parted)}: what they follow went together, and where it does not their "
            f"corrections part; {PLAN}"
        )
    by_tape = any(confounding.SCALED[2] in group for group in tied if group[0] == confounding.SCALED[0])
    # a scale grows with the way: on longer runs they differ
    scaled = any(tuple(group[:3]) == confounding.SCALED for group in tied)
    noise_m = closure.floor_rms_m or 0.0
    if apart_m is None or (apart_m <= noise_m and not scaled):
        return
    groups = "; ".join(map(_either, tied))
    yield (
        f"these runs cannot tell {groups}, and their corrections differ by {few_digits(1e3 * apart_m)} mm at the end "
        f"of the {on} (noise {few_digits(1e3 * noise_m)} mm); {TAPE if by_tape else PLAN}"
    )
