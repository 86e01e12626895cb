"""The paper's headline beside a campaign's own: what the load correction is worth at the end of a route."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from calib.gap.effects.library import effect_class
from calib.gap.verdict.result import Verdict

if TYPE_CHECKING:
    from calib.motion.studies.paper_headline import Improvement


@dataclass(frozen=True, slots=True)
class PaperHeadline:
    """What the correction for the load achieves, here and in the paper.

    Parameters
    ----------
    effect : str
        The cause.
    sole_candidate : bool
        Whether these runs tell it from other causes.
    paper, campaign : Improvement
        The paper's figures, and root mean squares over runs of this campaign that were left out of the fit.
    sentence : str
        For people.
    """

    effect: str
    sole_candidate: bool
    paper: Improvement
    campaign: Improvement
    sentence: str


def headline(verdict: Verdict) -> PaperHeadline | None:
    """Return the paper's headline beside that of a diagnosis; None where load is not the cause."""
    effect = next((cause.effect for cause in verdict.causes if _is_load_law(cause.effect)), None)
    before, after = verdict.closure.before_rms_m, verdict.closure.after_rms_m
    if effect is None or before is None or after is None:
        return None
    from calib.motion.studies.paper_headline import Improvement, paper_headline

    sole = not any(effect in group.effects for group in verdict.groups)
    campaign = Improvement(float(before), float(after), before / after if after > 0.0 else None)
    here = f"this campaign: {_metres(before)} m to {_metres(after)} m"
    here += "" if campaign.ratio is None else f", {campaign.ratio:.3g} times smaller"
    printed = paper_headline()
    paper = (
        f"{printed.before_m:g} m to {printed.after_m:g} m as printed, about {printed.ratio:.0f} times smaller "
        "before rounding"
    )
    caveat = "" if sole else ", if the load is the cause"
    sentence = (
        f"Correction for the load; the paper: {paper}; {here}{caveat}. The figures are end errors, each on its own "
        "route and loads."
    )
    return PaperHeadline(effect, sole, printed, campaign, sentence)


def _is_load_law(effect: str) -> bool:
    kind = effect_class(effect)
    return kind is not None and kind.is_load_law


def _metres(value: float) -> str:
    """Return a length with two significant digits or more, without an exponent."""
    return f"{value:.2f}" if value >= 0.995 else f"{value:.2g}"
