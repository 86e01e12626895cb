"""What the plan of loads and sessions, and the order driven, allow a wheel's fit to say."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.radius.law import COVERAGE
from calib.radius.regression import FAILED, NOTE, OK, Check, WheelFit, distinct_loads
from calib.radius.sessions import Groups

#: p-values below which a check gives a note, and below which the law should not be used as it is. With some nine checks
#: a wheel the usual 5 % would give a false note in every third campaign.
NOTE_BELOW: Final = 0.01
FAIL_BELOW: Final = 1e-4
UM: Final = 1e6
#: a slope's interval that is so many times as wide by autocorrelation rests on a roughly known correlation:
#: with 0.8, loads ascending, it holds the truth in 84 to 89 % instead of 95 %
MAX_SLOPE_WIDENING: Final = 1.25
#: sessions beyond which no single one is omitted: too many to carry the slope alone
MAX_INFLUENCE_SESSIONS: Final = 100


def tested(
    name: str, statistic: float, statistic_name: str, p_value: float, sentences: tuple[str, str], *, fails: bool = False
) -> Check:
    """Return the check of a test.

    Parameters
    ----------
    name, statistic_name
        Of the check and of its statistic.
    statistic, p_value
        Result of the test.
    sentences
        Without and with a finding.
    fails
        Whether a clear finding forbids the law; False where the intervals allow for it.
    """
    level = FAILED if fails and p_value < FAIL_BELOW else NOTE if p_value < NOTE_BELOW else OK
    return Check(name, level, sentences[p_value < NOTE_BELOW], float(statistic), statistic_name, p_value)


def p_of_f(statistic: float, dof_first: float, dof_second: float) -> float:
    """Return the probability of a larger F."""
    from scipy.special import fdtrc

    return float(fdtrc(dof_first, dof_second, max(statistic, 0.0)))


def p_of_t(statistic: float, dof: float) -> float:
    """Return the two-sided probability of a Student's t."""
    from scipy.special import stdtr

    return float(2 * stdtr(dof, -abs(statistic)))


def design_check(fit: WheelFit, groups: Groups) -> Check:
    """Say what the plan of loads and sessions allows."""
    loads = distinct_loads(fit.load_N)
    few = " There are only two loads: whether the law is straight stays unknown." if loads == 2 else ""
    level = NOTE
    blank = int(groups.sizes[groups.names == ""].sum())
    if len(groups) > 1 and blank:
        level = FAILED
        sentence = f"{blank} runs have no session and count as one: fill in the column session of runs.csv."
    elif fit.model == "constant":
        few = ""
        sentence = (
            f"All runs have one load ({fit.law.reference_load_N:.0f} N): a constant radius is given, for that load "
            "only, and no slope; drive two further loads at least."
        )
    elif len(groups) == 1:
        sentence = ""
    elif len(groups) == len(fit.load_N):
        level, sentence = NOTE if few else OK, "Every run is a session of its own: the runs are independent."
    elif fit.design == "confounded" and fit.estimate.design != "confounded":
        level = FAILED
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
    if len(groups) == 1:
        level = FAILED
        one_session = (
            "All runs are of one session: what shifts from session to session is not in the intervals (where sessions "
            "scatter as much as runs they hold the truth in 60 % instead of 95 %); repeat some loads on another day."
        )
        sentence = f"{sentence} {one_session}".strip()
    return Check("design", level, sentence + few)


def order_check(fit: WheelFit) -> Check | None:
    """Say whether runs that follow each other scatter alike, and whether the slope rests on how much."""
    found = fit.autocorrelation
    if found is None or found.p_value == 1.0:
        return None
    common = f"Runs that follow each other scatter alike (correlation about {found.rho:.2g})"
    name = "lag-one autocorrelation"
    if found.slope_ratio > MAX_SLOPE_WIDENING and found.p_value < NOTE_BELOW:
        sentence = (
            f"{common}, and the loads follow the order driven: what lasts from run to run looks like load. The "
            f"intervals are {found.slope_ratio:.2g} times as wide for it, which is known roughly only; drive the loads "
            "in random order."
        )
        return Check("order", FAILED, sentence, found.lag_one, name, found.p_value)
    sentences = (
        "Runs that follow each other scatter independently.",
        f"{common}: the intervals allow for it; let the wheels warm up, and drive the loads in random order.",
    )
    return tested("order", found.lag_one, name, found.p_value, sentences)


def session_check(fit: WheelFit, groups: Groups) -> Check | None:
    """Say whether sessions scatter beyond their runs, and what counting runs as independent would have claimed."""
    estimate = fit.estimate
    if len(groups) < 2 or len(groups) == len(fit.load_N) or estimate.session_f is None or estimate.dof_between < 1:
        return None
    confounded = estimate.design == "confounded"
    p_value = p_of_f(estimate.session_f, estimate.dof_between, estimate.dof_within)
    width_ratio = _against_naive(fit)
    subject = "Session means leave the line" if confounded else "Sessions differ"
    cause = (
        "a bend of the law, or a shift from session to session, which these runs cannot tell apart"
        if confounded
        else "temperature, a remounted rangefinder, wear"
    )
    sentences = (
        f"{subject} no more than their runs explain; the intervals allow for sessions all the same.{width_ratio}",
        f"{subject} by {UM * fit.session_std_m:.2g} um more than their runs explain ({cause}); the intervals allow for "
        f"it, but look for the cause.{width_ratio}",
    )
    name = f"F({estimate.dof_between:.0f}, {estimate.dof_within:.0f})"
    return tested("session", estimate.session_f, name, p_value, sentences)


def _against_naive(fit: WheelFit) -> str:
    if fit.naive is None:
        return ""
    slope = (0.0, 1.0)
    aware, naive = (float(estimate.half_width(slope, COVERAGE)) for estimate in (fit.estimate, fit.naive))
    if naive <= 0 or aware <= 0:
        return ""
    return f" Counting every run as independent would give a slope interval {naive / aware:.2g} times as wide."


def session_influence_check(fit: WheelFit, groups: Groups) -> Check | None:
    """Say how far the slope moves when one session is omitted."""
    if not 3 <= len(groups) <= MAX_INFLUENCE_SESSIONS:
        return None
    n = groups.sizes
    x, y = fit.load_N - fit.load_N.mean(), fit.residual_m
    moments = [np.bincount(groups.index, weights=w, minlength=len(groups)) for w in (x, y, x * x, x * y)]
    sx, sy, sxx, sxy = (total.sum() - total for total in moments)
    kept = n.sum() - n
    spread = sxx - sx**2 / kept
    usable = spread > 1e-6 * float(x @ x)
    if not usable.any():
        return None
    change = np.where(usable, (sxy - sx * sy / kept) / np.where(usable, spread, 1.0), 0.0)
    worst = int(np.argmax(np.abs(change)))
    half = float(fit.estimate.half_width((0.0, 1.0), COVERAGE))
    ratio = abs(float(change[worst])) / half if half > 0 else 0.0
    slope, name = fit.law.slope_m_per_N, groups.names[worst]
    words = f"changes the slope by {100 * change[worst] / slope:+.2g} %" if slope else ""
    level, sentence = OK, f"No session carries the slope alone: leaving out {name} {words}, within its interval."
    if ratio > 1:
        level = NOTE
        sentence = (
            f"The slope depends on session {name}: leaving it out {words}, more than the interval's half width; "
            "repeat its loads."
        )
    return Check("session_influence", level, sentence, ratio, "change over half interval")
