"""The paper's headline beside a campaign's own: what the load correction is worth at the end of a route."""

from __future__ import annotations

from typing import Any, Final

from calib.gap.verdict import Verdict

__all__ = ["LOAD_EFFECTS", "PAPER_AFTER_M", "PAPER_BEFORE_M", "headline"]

#: end error along the route without and with the load correction, as the paper states them (Sect. 7.3)
PAPER_BEFORE_M: Final = 1.1
PAPER_AFTER_M: Final = 0.06
LOAD_EFFECTS: Final = frozenset({"load_radius", "load_radius_nonlinear"})


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
        ``sentence`` for people. The campaign's are root mean squares over runs left out of the fit.
    """
    cause = next((one.effect for one in verdict.causes if one.effect in LOAD_EFFECTS), None)
    before, after = (verdict.closure.get(f"{name}_rms_m") for name in ("before", "after"))
    if cause is None or before is None or after is None:
        return None
    sole = not any(cause in group for group in verdict.indistinguishable)
    ratio = before / after if after > 0.0 else None
    here = f"this campaign: {_metres(before)} m to {_metres(after)} m"
    here += "" if ratio is None else f", {ratio:.3g} times smaller"
    paper_ratio = PAPER_BEFORE_M / PAPER_AFTER_M
    paper = f"{PAPER_BEFORE_M:g} m to {PAPER_AFTER_M:g} m, about {paper_ratio:.0f} times smaller"
    caveat = "" if sole else ", if the load is the cause"
    said = (
        f"Correction for the load; the paper: {paper}; {here}{caveat}. The figures are end errors, each on its own "
        "route and loads."
    )
    return {
        "effect": cause,
        "sole_candidate": sole,
        "paper": {"before_m": PAPER_BEFORE_M, "after_m": PAPER_AFTER_M, "ratio": paper_ratio},
        "campaign": {"before_m": float(before), "after_m": float(after), "ratio": ratio},
        "sentence": said,
    }


def _metres(value: float) -> str:
    """Return a length with two significant digits or more, without an exponent."""
    return f"{value:.2f}" if value >= 0.995 else f"{value:.2g}"
