"""The paper's headline beside a campaign's own: what the load correction is worth at the end of a route."""

from __future__ import annotations

from typing import Any

from calib.gap.effects.library import effect_class
from calib.gap.verdict.result import Verdict
from calib.motion.studies.paper_headline import paper_headline

__all__ = ["headline"]


def headline(verdict: Verdict) -> dict[str, Any] | None:
    """Return what the load effect's correction achieves here and in the paper; None where load is not the cause.

    Parameters
    ----------
    verdict : Verdict
        Of a diagnosis.

    Returns
    -------
    dict or None
        ``paper`` and ``campaign``, each with ``before_m``, ``after_m`` and ``ratio`` (before over after; None where it
        cannot be told); ``effect``, the cause; ``sole_candidate``, False where these runs cannot tell it from others;
        ``sentence`` for people. The campaign's are root mean squares over runs left out of the fit; the paper's ratio
        is that of its own study before what it prints was rounded.
    """
    effect = next((cause.effect for cause in verdict.causes if _is_load_law(cause.effect)), None)
    before, after = verdict.closure.before_rms_m, verdict.closure.after_rms_m
    if effect is None or before is None or after is None:
        return None
    sole = not any(effect in group.effects for group in verdict.groups)
    ratio = before / after if after > 0.0 else None
    here = f"this campaign: {_metres(before)} m to {_metres(after)} m"
    here += "" if ratio is None else f", {ratio:.3g} times smaller"
    printed = paper_headline()
    paper = (
        f"{printed['before_m']:g} m to {printed['after_m']:g} m as printed, about {printed['ratio']:.0f} times smaller "
        "before rounding"
    )
    caveat = "" if sole else ", if the load is the cause"
    sentence = (
        f"Correction for the load; the paper: {paper}; {here}{caveat}. The figures are end errors, each on its own "
        "route and loads."
    )
    return {
        "effect": effect,
        "sole_candidate": sole,
        "paper": printed,
        "campaign": {"before_m": float(before), "after_m": float(after), "ratio": ratio},
        "sentence": sentence,
    }


def _is_load_law(effect: str) -> bool:
    kind = effect_class(effect)
    return kind is not None and kind.is_load_law


def _metres(value: float) -> str:
    """Return a length with two significant digits or more, without an exponent."""
    return f"{value:.2f}" if value >= 0.995 else f"{value:.2g}"
