"""The rule: which verdict the evidence supports. Whether its fix is recommended: `calib.gap.decision.fix`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from calib.gap.decision.diagnosis import Cause, VerdictKind
from calib.gap.decision.held_out import ADEQUATE_CLOSURE, Closure
from calib.gap.decision.trials import Trial
from calib.gap.effects.encoder import BLUNDER_MISFIT
from calib.gap.inference.model_search import REPORTED_GAP_PROBABILITY

#: closure below which an unexplained residual hides whether anything is explained: less than an adequate one leaves
HIDDEN_CLOSURE: Final = 1.0 - ADEQUATE_CLOSURE
#: closure below which more of the gap remains than is explained: where that is certain, the most probable causes
#: imitate the unexplained one (in 8 of 8 verdicts of opened sets, and in 2 of 3 on altered recordings)
HALF_CLOSURE: Final = 0.5
#: closure from which on a gap counts as explained; below, part of it is unexplained
FULL_CLOSURE: Final = 0.9
#: an unexplained residual, or confounded causes, with a larger share of the gap are part of the verdict
SMALL_SHARE: Final = 0.05
#: a cause with less than this share of what the largest one has is a hundredth of its size: no closer is the law of the
#: largest known, nor its size, and what they leave looks like a small cause of its own
NEGLIGIBLE_SHARE: Final = 1e-4
#: probability below which a cause, with all that it is confounded with, is not named
NAMED_PROBABILITY: Final = 0.1
#: where the unexplained residual hides whether a correction helps, only its own probability supports a cause
CERTAIN_PROBABILITY: Final = 0.8
#: beside a larger unexplained residual a cause of a fix needs so many times its signal: half of a weaker one may be it
SIGNAL_OVER_UNEXPLAINED: Final = 2.0
#: runs that confound more effects than this do not identify the cause: the verdict lists no more
LARGEST_GROUP: Final = 6


def fails(trial: Trial) -> bool:
    """Return whether there is a gap beyond chance where the correction was held out, and too much of it remains."""
    gap, residual = trial.before_square - trial.noise_square, trial.after_square - trial.noise_square
    beyond_chance = min(trial.before_square, trial.after_square) > trial.noise_limit
    return beyond_chance and residual > (1.0 - ADEQUATE_CLOSURE) * gap


def corrections_agree(agreement_m: float | None, closure: Closure) -> bool:
    """Return whether the corrections of confounded effects differ by no more than the noise level."""
    return agreement_m is not None and agreement_m <= (closure.floor_rms_m or 0.0)


def hides_causes(closure: Closure, unexplained_share: float | None) -> bool:
    """Return whether the closure cannot support the causes: each then needs a high probability of its own."""
    if unexplained_share is not None and (closure.fraction is None or closure.fraction < HIDDEN_CLOSURE):
        return True
    return closure.ci95 is not None and closure.ci95[1] < ADEQUATE_CLOSURE and closure.ci95[0] <= HIDDEN_CLOSURE


def kind_of(
    gap_probability: float,
    causes: Sequence[Cause],
    closure: Closure,
    *,
    trials: Sequence[Trial] = (),
    unexplained_share: float | None = None,
    tied: bool = False,
    supported: bool = True,
    misfit: float = 0.0,
) -> VerdictKind:
    """Return the verdict.

    Parameters
    ----------
    gap_probability : float
        Probability that there is a gap at all.
    causes : sequence of Cause
        What would be named.
    closure : Closure
        On held-out runs.
    trials : sequence of Trial
        Routes, speeds, loads, directions and sessions held out in turn.
    unexplained_share : float, optional
        Share of the gap that no cause of the library explains; none is probable by default.
    tied : bool
        Whether a cause of more than a small share is confounded with an effect of another family.
    supported : bool
        Whether the runs support a noise level.
    misfit : float
        How far runs end off with the causes corrected, as a share of their length, on average.
    """
    high = closure.ci95[1] if closure.ci95 else 1.0
    unexplained = unexplained_share is not None
    if not supported:
        return VerdictKind.UNDECIDED
    if gap_probability < REPORTED_GAP_PROBABILITY and misfit < BLUNDER_MISFIT:
        return VerdictKind.NO_GAP
    if not causes or misfit >= BLUNDER_MISFIT or (unexplained and high < HALF_CLOSURE):
        return VerdictKind.UNKNOWN
    if hides_causes(closure, unexplained_share):
        certain = any(cause.probability >= CERTAIN_PROBABILITY for cause in causes)
        return VerdictKind.PARTLY_EXPLAINED if certain else VerdictKind.UNKNOWN
    # an unexplained part that lies within the interval of the closure is not shown
    if high < FULL_CLOSURE or any(map(fails, trials)) or (unexplained_share or 0.0) > SMALL_SHARE:
        return VerdictKind.PARTLY_EXPLAINED
    return VerdictKind.AMBIGUOUS if tied else VerdictKind.EXPLAINED
