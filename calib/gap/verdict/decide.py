"""From evidence to a verdict: which of the verdicts it is, what it names, and whether its fix is recommended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import Final

import numpy as np

from calib.gap.effects.encoder_gross import GROSS, misfit
from calib.gap.evidence.search import GAP
from calib.gap.verdict.agreement import agreement_m
from calib.gap.verdict.causes import causes_of
from calib.gap.verdict.closure import closure_of
from calib.gap.verdict.evidence import Evidence
from calib.gap.verdict.gross import gross_cause
from calib.gap.verdict.groups import groups_of
from calib.gap.verdict.odds import (
    any_probability,
    credible_sets,
    effect_probabilities,
    gap_probability,
    nothing_else_probability,
)
from calib.gap.verdict.outcome import DRIVEN, JOURNEYS, Closure, Fix, Group, NoiseSummary, Rest
from calib.gap.verdict.rest import SMALL, explained_share, faint_beside, rest_of
from calib.gap.verdict.result import ALIKE, SURE, Cause, Verdict, VerdictKind
from calib.gap.verdict.sentence import TELLING, gross_sentence, sentence
from calib.gap.verdict.transfer import Trial

#: closure on held-out runs below which a fix is not recommended, and an explanation not believed
CLOSES: Final = 0.7
#: closure below which a rest hides whether anything is explained
HELPS: Final = 0.3
#: closure below which more of the gap is left than explained: where that is sure, the likeliest causes are what the
#: rest imitates (in 8 of 8 verdicts of opened sets, and in 2 of 3 on altered recordings)
HALF: Final = 0.5
#: closure from which on a gap counts as explained; below, a rest is left
EXPLAINS: Final = 0.9
#: what is less probable than this, with all that stands in for it, is not named
LEAST: Final = 0.1
#: where a rest hides whether a correction helps, nothing but its own probability speaks for a cause: so much at least
ALONE: Final = 0.8
#: beside a larger rest a fix needs causes that show so many times as strongly; half of a fainter one may be the rest
CLEAR: Final = 2.0


@dataclass(frozen=True, slots=True)
class Balance:
    """What tips the verdict one way or the other, a gross fault left aside.

    Parameters
    ----------
    gap : float
        Probability that anything is off.
    n_named : int
        Effects and calibration parameters that would be named.
    sure : bool
        Whether one of them is itself probable enough to be named beside any rest.
    rest : float or None
        Share of the gap that a rest carries; None where no rest is probable.
    denied : bool
        Whether a calibration parameter is off that the library was denied.
    tied : bool
        Whether a named effect that carries more than a small share has one of another family that these runs cannot
        tell it from.
    fraction : float or None
        Closure on runs left out.
    ci95 : tuple of float or None
        Its interval.
    carries : bool
        Whether the correction closes the gap on whatever was left out.
    supported : bool
        Whether the runs support a floor at all.
    off : float
        How far runs end off with what would be named, as a share of their length, on average.
    """

    gap: float
    n_named: int
    sure: bool = False
    rest: float | None = None
    denied: bool = False
    tied: bool = False
    fraction: float | None = None
    ci95: tuple[float, float] | None = None
    carries: bool = True
    supported: bool = True
    off: float = 0.0

    @property
    def beside_rest(self) -> bool:
        """Whether there is a rest, or what stands for one."""
        return self.rest is not None or self.denied

    @property
    def leaves_most(self) -> bool:
        """Whether, beside a rest, the correction surely leaves more of the gap than it closes on runs left out."""
        return self.beside_rest and self.ci95 is not None and self.ci95[1] < HALF

    @property
    def buried(self) -> bool:
        """Whether a rest hides what the correction closes on runs left out: each cause then stands for itself."""
        if self.beside_rest and (self.fraction is None or self.fraction < HELPS):
            return True
        return self.ci95 is not None and self.ci95[1] < CLOSES and self.ci95[0] <= HELPS


def kind_of(balance: Balance) -> VerdictKind:
    """Return which verdict it is."""
    if not balance.supported:
        return VerdictKind.UNDECIDED
    if balance.gap < GAP and balance.off < GROSS:
        return VerdictKind.NO_GAP
    if balance.n_named == 0 or balance.leaves_most or balance.off >= GROSS:
        return VerdictKind.UNKNOWN
    if balance.buried:
        return VerdictKind.PARTLY_EXPLAINED if balance.sure else VerdictKind.UNKNOWN
    if balance.ci95 is not None and balance.ci95[1] < CLOSES:
        return VerdictKind.PARTLY_EXPLAINED
    # a rest that these runs do not show is none
    left = balance.ci95 is not None and balance.ci95[1] < EXPLAINS
    if left or balance.denied or not balance.carries or (balance.rest is not None and balance.rest > SMALL):
        return VerdictKind.PARTLY_EXPLAINED
    return VerdictKind.AMBIGUOUS if balance.tied else VerdictKind.EXPLAINED


def recommended(
    causes: Sequence[Cause],
    certain: Sequence[float],
    closure: Closure,
    trials: Sequence[Trial] = (),
    agreement: float | None = None,
    rest: Rest | None = None,
    nothing_else: float = 1.0,
) -> bool:
    """Return whether what is named is likely at work and all there is, and the fix helps wherever it is tried.

    Parameters
    ----------
    causes : sequence of Cause
        What is named.
    certain : sequence of float
        Of each, the probability that it or one that stands in for it is at work.
    closure : Closure
        On runs left out.
    trials : sequence of Trial
        Kinds, speeds, loads, directions and sessions left out in turn.
    agreement : float or None
        How far the corrections of causes that cannot be told apart differ, in metres; None where nothing is tied.
    rest : Rest or None
        What no cause explains.
    nothing_else : float
        Probability that no further effect is at work.
    """
    if not causes or prod(certain) < SURE or nothing_else < SURE:
        return False
    beside = rest.signal if rest is not None and rest.share > SMALL else 0.0
    if any(cause.share > SMALL and cause.signal < CLEAR * beside for cause in causes):
        return False
    if closure.fraction is None or closure.fraction < CLOSES or closure.ci95 is None:
        return False
    if closure.ci95[0] <= 0.5 * CLOSES or any(trial.harms for trial in trials):
        return False
    if agreement is not None and agreement > ALIKE * (closure.floor_rms_m or 0.0):
        return False
    return not any(trial.fails for trial in trials)


def decide(evidence: Evidence) -> Verdict:
    """Return the verdict, its sentence included; runs to drive next are not sought here.

    Parameters
    ----------
    evidence : Evidence
        What the stages before have measured.
    """
    alike = groups_of(evidence)
    groups, forms_open = _by_family(evidence, alike)
    rest = rest_of(evidence)
    probabilities = effect_probabilities(evidence, alike)
    certain = {name: _certain(evidence, name, alike) for name in evidence.named}
    causes = faint_beside(rest, causes_of(evidence, probabilities, certain, forms_open))
    causes = [cause for cause in causes if certain[cause.effect] >= LEAST]
    probabilities = _stated(probabilities, causes)
    balance = _balance(evidence, groups, None if rest is None else rest.share, causes)
    kind = kind_of(balance)
    nothing_named = kind in {VerdictKind.NO_GAP, VerdictKind.UNKNOWN, VerdictKind.UNDECIDED}
    causes = [cause for cause in causes if not nothing_named and (not balance.buried or cause.probability >= ALONE)]
    names = {cause.effect for cause in causes}
    tied = [group for group in groups if len(group) > 1 and names.intersection(group)]
    closure = closure_of(evidence.held_out, evidence.observations)
    fix = _fix(evidence, alike, tied, causes, [certain[cause.effect] for cause in causes], closure, rest)
    if evidence.faults:
        # where the rest is no gap or unknown, the fault alone is named
        causes = [*map(gross_cause, evidence.faults), *causes]
        kind = {
            VerdictKind.NO_GAP: VerdictKind.EXPLAINED,
            VerdictKind.UNKNOWN: VerdictKind.PARTLY_EXPLAINED,
            VerdictKind.UNDECIDED: VerdictKind.PARTLY_EXPLAINED,
        }.get(kind, kind)
    verdict = Verdict(
        kind=kind,
        sentence="",
        causes=tuple(causes),
        credible_sets=credible_sets(evidence, () if nothing_named else alike),
        groups=tuple(Group(tuple(group)) for group in tied),
        undetectable=evidence.undetectable,
        where=evidence.where,
        closure=closure,
        rest=None if kind is VerdictKind.NO_GAP else rest,
        fix=fix,
        notes=(*evidence.observations.notes, *evidence.notes),
        noise=NoiseSummary.about(evidence.noise),
        probabilities=probabilities,
        judged_against=evidence.judged_against,
        campaign=evidence.campaign,
        simulated=evidence.simulated,
        gap_probability=1.0 if evidence.faults else balance.gap,
    )
    gross = kind is VerdictKind.UNKNOWN and balance.off >= GROSS
    return replace(verdict, sentence=gross_sentence(verdict, balance.off) if gross else sentence(verdict))


def _stated(probabilities: Mapping[str, float], causes: Sequence[Cause]) -> dict[str, float]:
    """Return the probabilities as the named causes have them, largest first."""
    stated = {**probabilities, **{cause.effect: cause.probability for cause in causes if cause.effect in probabilities}}
    return dict(sorted(stated.items(), key=lambda item: -item[1]))


def _fix(
    evidence: Evidence,
    alike: Sequence[Sequence[str]],
    tied: Sequence[Sequence[str]],
    causes: Sequence[Cause],
    certain: Sequence[float],
    closure: Closure,
    rest: Rest | None,
) -> Fix:
    """Return what the correction is worth; `certain` is that of each cause, as in `recommended`."""
    agreement, nothing_else = agreement_m(evidence, tied), nothing_else_probability(evidence, alike)
    concerned = {*evidence.named, *(name for group in tied for name in group)}
    explained, scatter = explained_share(evidence)
    # where all but a small share is surely explained, and by what nothing else stands in for, whatever else is at work
    # can carry no more than that share
    whole = not tied and explained - 2.0 * scatter >= 1.0 - SMALL
    return Fix(
        # the correction holds all that was fitted, and some of it may be none for the journeys to come
        recommended={cause.effect for cause in causes}.issuperset(evidence.named)
        and not any(evidence.effects[name].stays for name in concerned)
        # runs that tell nothing of a cause do not tell what it does elsewhere
        and not any(len(group) > TELLING for group in tied)
        and recommended(causes, certain, closure, evidence.trials, agreement, rest, 1.0 if whole else nothing_else),
        agreement_m=agreement,
        agreement_on=DRIVEN if evidence.journeys is None else JOURNEYS,
        nothing_else=nothing_else,
        transfer=tuple(trial.transfer for trial in evidence.trials) if causes else (),
    )


def _by_family(
    evidence: Evidence, alike: Sequence[Sequence[str]]
) -> tuple[list[list[str]], dict[str, tuple[str, ...]]]:
    """Return the groups without what is of the named effect's own family, and those forms that are open by effect."""
    groups, forms_open = [], {}
    for group in alike:
        named = [name for name in group if name in evidence.named]
        families = {evidence.effects[name].family for name in named}
        own = tuple(n for n in group if n not in named and evidence.effects[n].family in families)
        groups.append([name for name in group if name not in own])
        for name in named:
            forms_open[name] = own
    return groups, forms_open


def _certain(evidence: Evidence, effect: str, alike: Sequence[Sequence[str]]) -> float:
    """Return the probability that an effect or one that stands in for it is at work."""
    return any_probability(evidence, {effect}.union(*(group for group in alike if effect in group)))


def _balance(
    evidence: Evidence,
    groups: Sequence[Sequence[str]],
    rest: float | None,
    causes: Sequence[Cause],
) -> Balance:
    large = {cause.effect for cause in causes if cause.share > SMALL}
    return Balance(
        gap=gap_probability(evidence),
        n_named=len(causes),
        sure=any(cause.probability >= ALONE for cause in causes),
        rest=rest,
        denied=evidence.denied,
        tied=any(len(group) > 1 and large.intersection(group) for group in groups),
        fraction=evidence.held_out.fraction,
        ci95=evidence.held_out.ci95,
        carries=not any(trial.fails for trial in evidence.trials),
        supported=evidence.noise.supported,
        off=float(np.mean(misfit(evidence.fitted.path))),
    )
