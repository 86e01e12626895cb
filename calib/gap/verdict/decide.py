"""From evidence to a verdict: which of the verdicts it is, what it names, and whether its fix is recommended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from calib.gap.verdict.causes import causes_of
from calib.gap.verdict.closure import closure_of
from calib.gap.verdict.evidence import Evidence
from calib.gap.verdict.gross import gross_cause
from calib.gap.verdict.groups import groups_of
from calib.gap.verdict.odds import credible_sets, effect_probabilities, gap_probability, imitation, rest_left
from calib.gap.verdict.result import SURE, Cause, Closure, Fix, Group, NoiseSummary, Verdict, VerdictKind
from calib.gap.verdict.sentence import sentence

__all__ = ["Balance", "decide", "kind_of", "recommended"]

#: a gap is said to exist where the probability that anything is off reaches this
DETECTION: Final = 0.7
#: an unknown cause alone is called one where its probability reaches this
UNKNOWN: Final = 0.85
#: closure on held-out runs below which a fix is not recommended, and an explanation not believed
CLOSES: Final = 0.7
#: closure below which nothing is explained, not even in part
HELPS: Final = 0.3
#: named causes that imitate one outside the library with this probability do not explain the gap
IMITATES: Final = 0.5


@dataclass(frozen=True, slots=True)
class Balance:
    """What tips the verdict one way or the other, a gross fault left aside.

    Parameters
    ----------
    gap : float
        Probability that anything is off.
    unknown : float
        Probability of a cause outside the library.
    n_effects, n_calibration : int
        Effects and calibration parameters that would be named.
    rest : bool
        Whether the best hypothesis has a rest of unknown cause.
    denied : bool
        Whether a calibration parameter is off that the library was denied.
    tied : bool
        Whether a named effect has one that these runs cannot tell it from.
    fraction : float or None
        Closure on runs left out.
    ci95 : tuple of float or None
        Its interval.
    """

    gap: float
    unknown: float
    n_effects: int
    n_calibration: int = 0
    rest: bool = False
    denied: bool = False
    tied: bool = False
    fraction: float | None = None
    ci95: tuple[float, float] | None = None


def kind_of(balance: Balance) -> VerdictKind:
    """Return which verdict it is."""
    if balance.gap < DETECTION:
        return VerdictKind.NO_GAP
    if balance.n_effects + balance.n_calibration == 0:
        sure = balance.denied or balance.unknown >= UNKNOWN
        return VerdictKind.UNKNOWN if sure else VerdictKind.NO_GAP
    rest = balance.rest or balance.denied
    if rest and (balance.fraction is None or balance.fraction < HELPS):
        return VerdictKind.UNKNOWN
    if balance.ci95 is not None and balance.ci95[1] < CLOSES:
        return VerdictKind.PARTLY_EXPLAINED if balance.ci95[0] > HELPS else VerdictKind.UNKNOWN
    imitated = imitation(balance.n_effects, balance.n_calibration) >= IMITATES
    if rest or imitated or rest_left(balance.fraction):
        return VerdictKind.PARTLY_EXPLAINED
    return VerdictKind.AMBIGUOUS if balance.tied else VerdictKind.EXPLAINED


def recommended(kind: VerdictKind, causes: Sequence[Cause], closure: Closure) -> bool:
    """Return whether the fix is for a gap whose cause is known, and holds on runs left out.

    Where a rest is left, the rest may be what the fix imitates.
    """
    return (
        kind is VerdictKind.EXPLAINED
        and all(cause.probability >= SURE for cause in causes)
        and closure.fraction is not None
        and closure.fraction >= CLOSES
        and closure.ci95 is not None
        and closure.ci95[0] > 0.5 * CLOSES
    )


def decide(evidence: Evidence) -> Verdict:
    """Return the verdict, its sentence included; runs to drive next are not sought here.

    Parameters
    ----------
    evidence : Evidence
        What the stages before have measured.
    """
    groups = groups_of(evidence)
    kind = kind_of(_balance(evidence, groups)) if evidence.noise.supported else VerdictKind.UNDECIDED
    nothing_named = kind in {VerdictKind.NO_GAP, VerdictKind.UNKNOWN, VerdictKind.UNDECIDED}
    probabilities = effect_probabilities(evidence, groups)
    causes = [] if nothing_named else causes_of(evidence, probabilities)
    if evidence.fault is not None:
        # where the rest is no gap or unknown, the fault alone is named
        causes = [gross_cause(evidence.fault), *causes]
        kind = {
            VerdictKind.NO_GAP: VerdictKind.EXPLAINED,
            VerdictKind.UNKNOWN: VerdictKind.PARTLY_EXPLAINED,
            VerdictKind.UNDECIDED: VerdictKind.PARTLY_EXPLAINED,
        }.get(kind, kind)
    closure = closure_of(evidence.held_out, evidence.observations)
    verdict = Verdict(
        kind=kind,
        sentence="",
        causes=tuple(causes),
        credible_sets=credible_sets(evidence, () if nothing_named else groups),
        groups=() if nothing_named else tuple(Group(tuple(group)) for group in groups if len(group) > 1),
        undetectable=evidence.undetectable,
        where=evidence.where,
        closure=closure,
        fix=Fix(recommended=recommended(kind, causes, closure)),
        notes=(*evidence.observations.notes, *evidence.notes),
        noise=NoiseSummary.about(evidence.noise),
        probabilities=probabilities,
        judged_against=evidence.judged_against,
        campaign=evidence.campaign,
        simulated=evidence.simulated,
    )
    return replace(verdict, sentence=sentence(verdict))


def _balance(evidence: Evidence, groups: Sequence[Sequence[str]]) -> Balance:
    return Balance(
        gap=gap_probability(evidence),
        unknown=evidence.probability(lambda hypothesis: hypothesis.unknown),
        n_effects=len(evidence.best.effects),
        n_calibration=len(evidence.calibration),
        rest=evidence.best.unknown,
        denied=evidence.denied,
        tied=any(len(group) > 1 for group in groups),
        fraction=evidence.held_out.fraction,
        ci95=evidence.held_out.ci95,
    )
