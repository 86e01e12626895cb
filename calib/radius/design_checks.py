"""What the plan of a campaign can and cannot tell: sessions, loads, range; each check ends in a sentence."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.radius.checks import NOTE, OK, Check
from calib.radius.regression import WheelFit, distinct_loads
from calib.radius.sessions import Groups

UM: Final = 1e6
NOTE_BELOW: Final = 0.01
#: the reference load may lie this share of the load range outside it before that is worth a word
EDGE: Final = 0.02


def design_check(fit: WheelFit, groups: Groups) -> Check:
    """Say what the plan of loads and sessions allows."""
    loads = distinct_loads(fit.load_N)
    few = " There are only two loads: whether the law is straight stays unknown." if loads == 2 else ""
    level = NOTE
    if fit.model == "constant":
        few = ""
        sentence = (
            f"All runs have one load ({fit.law.reference_load_N:.0f} N): a constant radius is given, for that load "
            "only, and no slope; drive two further loads at least."
        )
    elif len(groups) == 1:
        sentence = (
            "All runs are of one session: what shifts from session to session is not in the intervals; repeat some "
            "loads on another day."
        )
    elif len(groups) == len(fit.load_N):
        level, sentence = NOTE if few else OK, "Every run is a session of its own: the runs are independent."
    elif fit.design == "confounded" and fit.estimate.design != "confounded":
        sentence = (
            f"Each session has a load of its own and there are only {len(groups)} sessions: the scatter of sessions "
            "cannot be estimated, so the intervals count every run as independent and are too narrow; drive every load "
            "in every session."
        )
    elif fit.design == "confounded":
        sentence = (
            f"Each session has a load of its own: a drift from session to session looks like load. The intervals rest "
            f"on the {len(groups)} session means ({fit.law.dof:.3g} degrees of freedom) and hold if sessions scatter "
            "at random; to split the two, drive at least two loads in every session."
        )
    else:
        crossed = "crossed" if fit.design == "crossed" else "partly crossed"
        level = NOTE if few else OK
        sentence = f"The loads are {crossed} with the sessions: load and drift between sessions are told apart."
    return Check("design", level, sentence + few)


def range_check(fit: WheelFit) -> Check:
    """Say where the law holds, and whether the reference load lies there."""
    law = fit.law
    slack = EDGE * (law.load_max_N - law.load_min_N)
    inside = law.load_min_N - slack <= law.reference_load_N <= law.load_max_N + slack
    span = f"{law.load_min_N:.0f} to {law.load_max_N:.0f} N"
    if inside:
        return Check("range", OK, f"The law holds for {span} a wheel and was not measured outside.")
    sentence = (
        f"The reference load {law.reference_load_N:.0f} N lies outside the measured {span}: the radius there is "
        "extrapolated; measure near it, or set reference_load_N in campaign.toml."
    )
    return Check("range", NOTE, sentence)


def session_check(fit: WheelFit, groups: Groups) -> Check | None:
    """Say whether sessions scatter beyond their runs, and what counting runs as independent would have claimed."""
    estimate = fit.estimate
    if len(groups) < 2 or len(groups) == len(fit.load_N) or estimate.session_f is None or estimate.dof_between < 1:
        return None
    from scipy.special import fdtrc

    p_value = float(fdtrc(estimate.dof_between, estimate.dof_within, max(estimate.session_f, 0.0)))
    name = f"F({estimate.dof_between:.0f}, {estimate.dof_within:.0f})"
    compared = _against_naive(fit)
    what = "Session means leave the line" if estimate.design == "confounded" else "Sessions differ"
    if p_value >= NOTE_BELOW:
        sentence = f"{what} no more than their runs explain; the intervals allow for sessions all the same.{compared}"
        return Check("session", OK, sentence, estimate.session_f, name, p_value)
    cause = (
        "a bend of the law, or a shift from session to session, which these runs cannot tell apart"
        if estimate.design == "confounded"
        else "temperature, a remounted rangefinder, wear"
    )
    sentence = (
        f"{what} by {UM * fit.session_std_m:.2g} um more than their runs explain ({cause}); the intervals allow for "
        f"it, but look for the cause.{compared}"
    )
    return Check("session", NOTE, sentence, estimate.session_f, name, p_value)


def _against_naive(fit: WheelFit) -> str:
    if fit.naive is None or fit.slope_ci95_m_per_N is None:
        return ""
    honest = fit.slope_ci95_m_per_N[1] - fit.slope_ci95_m_per_N[0]
    naive = fit.naive.slope_ci95_m_per_N[1] - fit.naive.slope_ci95_m_per_N[0]
    if naive <= 0 or honest <= 0:
        return ""
    return f" Counting every run as independent would give a slope interval {naive / honest:.2g} times as wide."


def session_influence_check(fit: WheelFit, groups: Groups) -> Check | None:
    """Say how far the slope moves when one session is left out."""
    if len(groups) < 3 or len(groups) > 100 or fit.slope_ci95_m_per_N is None:
        return None
    n = groups.sizes
    x, y = fit.load_N - fit.load_N.mean(), fit.residual_m
    moments = [np.bincount(groups.index, weights=w, minlength=len(groups)) for w in (x, y, x * x, x * y)]
    sx, sy, sxx, sxy = (total.sum() - total for total in moments)
    left = n.sum() - n
    spread = sxx - sx**2 / left
    usable = spread > 1e-6 * float(x @ x)
    if not usable.any():
        return None
    moved = np.where(usable, (sxy - sx * sy / left) / np.where(usable, spread, 1.0), 0.0)
    worst = int(np.argmax(np.abs(moved)))
    half = 0.5 * (fit.slope_ci95_m_per_N[1] - fit.slope_ci95_m_per_N[0])
    ratio = abs(float(moved[worst])) / half if half > 0 else 0.0
    change = (
        f"changes the slope by {100 * moved[worst] / fit.law.slope_m_per_N:+.2g} %" if fit.law.slope_m_per_N else ""
    )
    if ratio <= 1:
        sentence = (
            f"No session carries the slope alone: leaving out {groups.names[worst]} {change}, within its interval."
        )
        return Check("session_influence", OK, sentence, ratio, "change over half interval")
    sentence = (
        f"The slope leans on session {groups.names[worst]}: leaving it out {change}, more than the interval's half "
        "width; repeat its loads."
    )
    return Check("session_influence", NOTE, sentence, ratio, "change over half interval")
