"""The checks an expert would run on a wheel's fit, each ending in a sentence: what it means and what to do."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray, StrArray
from calib.radius.checks import FAILED, NOTE, OK, Check
from calib.radius.design_checks import design_check, range_check, session_check, session_influence_check
from calib.radius.regression import WheelFit, load_groups
from calib.radius.sessions import Groups, breusch_pagan, groups_of

#: p-values below which a check speaks up, and below which the law should not be used as it is. With some nine checks a
#: wheel the usual 5 % would cry wolf in every third campaign.
NOTE_BELOW: Final = 0.01
FAIL_BELOW: Final = 1e-4
UM: Final = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class _Runs:
    """What the checks share: loads, residuals about line and sessions, and labels."""

    fit: WheelFit
    groups: Groups
    x: FloatArray
    rest: FloatArray
    dof: float
    direction: StrArray
    run_id: StrArray
    by_session: bool


def checked(fit: WheelFit, session: StrArray, direction: StrArray, run_id: StrArray) -> WheelFit:
    """Return `fit` with its checks.

    `session`, `direction`, `run_id` (shape (n_runs,)): labels of the same runs. The same fit; nothing but ``checks``
    differs.
    """
    groups = groups_of(session)
    by_session = 2 <= len(groups) < len(fit.load_N)
    x = fit.load_N - fit.load_N.mean()
    rest = groups.within(fit.residual_m) if by_session else fit.residual_m - fit.residual_m.mean()
    sloped = fit.model == "line" and fit.design != "confounded"
    dof = len(x) - (len(groups) if by_session else 1) - (1 if sloped else 0)
    runs = _Runs(fit, groups, x, rest, float(dof), direction, run_id, by_session)
    checks = [design_check(fit, groups), session_check(fit, groups)]
    if fit.model == "line":
        checks += [
            range_check(fit),
            _lack_of_fit(runs),
            _curvature(runs),
            _equal_scatter(runs),
            session_influence_check(fit, groups),
        ]
    checks += [_influence(runs), _normality(runs), _direction(runs)]
    return replace(fit, checks=tuple(check for check in checks if check is not None))


def level(p_value: float) -> str:
    """Return the level of a check by its p-value."""
    return FAILED if p_value < FAIL_BELOW else NOTE if p_value < NOTE_BELOW else OK


def _p_f(statistic: float, dof_first: float, dof_second: float) -> float:
    from scipy.special import fdtrc

    return float(fdtrc(dof_first, dof_second, max(statistic, 0.0)))


def p_t(statistic: float, dof: float) -> float:
    """Return the probability of a Student's t at least as far from nought, either way."""
    from scipy.special import stdtr

    return float(2 * stdtr(dof, -abs(statistic)))


def _session_columns(runs: _Runs) -> FloatArray:
    n = len(runs.x)
    return np.eye(len(runs.groups))[runs.groups.index] if runs.by_session else np.ones((n, 1))


def _squares(design: FloatArray, y: FloatArray) -> tuple[float, int]:
    """Return the residual sum of squares and the rank of a design."""
    coefficients, _, rank, _ = np.linalg.lstsq(design, y, rcond=1e-10)
    rest = y - design @ coefficients
    return float(rest @ rest), int(rank)


def _lack_of_fit(runs: _Runs) -> Check | None:
    if runs.fit.design == "confounded":
        return None  # the session check says it: sessions and loads are one there
    cluster = load_groups(runs.fit.load_N)
    n, levels = len(runs.x), int(cluster.max()) + 1
    if levels < 3:
        return Check(
            "lack_of_fit",
            NOTE,
            "With two loads any law runs through both: straightness cannot be tested; add a third load in between.",
        )
    y = runs.fit.residual_m * UM
    reduced, rank_reduced = _squares(np.column_stack((_session_columns(runs), runs.x / np.ptp(runs.x))), y)
    full, rank_full = _squares(
        np.column_stack((_session_columns(runs), runs.x / np.ptp(runs.x), np.eye(levels)[cluster])), y
    )
    more, left = rank_full - rank_reduced, n - rank_full
    if more < 1 or left < 3 or full <= 0:
        return Check(
            "lack_of_fit",
            NOTE,
            "Too few repeats at the same load to tell lack of fit from scatter; drive each load twice or more.",
        )
    statistic = (reduced - full) / more / (full / left)
    p_value = _p_f(statistic, more, left)
    sentence = (
        "The straight line fits as well as the repeats at each load allow."
        if p_value >= NOTE_BELOW
        else "The mean radii at the loads miss the straight line by more than repeats explain: use the law between "
        "neighbouring measured loads only, or look for a load that is misreported."
    )
    return Check("lack_of_fit", level(p_value), sentence, statistic, f"F({more}, {left})", p_value)


def _curvature(runs: _Runs) -> Check | None:
    span = np.ptp(runs.x)
    z = runs.x / span
    y = runs.fit.residual_m * UM
    if runs.fit.design == "confounded":
        weight = np.sqrt(runs.groups.sizes)
        z, y = runs.groups.means(z) * 1.0, runs.groups.means(y)
        base = np.column_stack((np.ones_like(z), z)) * weight[:, None]
        square, y = z**2 * weight, y * weight
    else:
        base = np.column_stack((_session_columns(runs), z))
        square = z**2
    projected = square - base @ np.linalg.lstsq(base, square, rcond=1e-10)[0]
    norm = float(projected @ projected)
    full, rank = _squares(np.column_stack((base, square)), y)
    dof = len(y) - rank
    if norm <= 1e-9 * float(square @ square) or dof < 1 or full <= 0:
        return None
    bend = float(projected @ y) / norm
    statistic = bend / np.sqrt(full / dof / norm)
    p_value = p_t(statistic, dof)
    # a parabola over the whole span departs from its chord by a quarter of its coefficient in the middle
    sag = abs(bend) / 4
    sentence = (
        f"No curvature shows; a bend, if any, is about {sag:.2g} um in the middle of the load range."
        if p_value >= NOTE_BELOW
        else f"The radius bends by about {sag:.2g} um in the middle of the load range: a straight law is that far off "
        "there; narrow the load range, or use a look-up table of measured loads."
    )
    return Check("curvature", level(p_value), sentence, float(statistic), f"t({dof})", p_value)


def _equal_scatter(runs: _Runs) -> Check:
    statistic, p_value = breusch_pagan(runs.rest, runs.x)
    if p_value >= NOTE_BELOW:
        sentence = "The scatter is the same at every load."
    elif runs.fit.design == "confounded":
        sentence = (
            "The scatter of single runs changes with load; the intervals rest on session means and hold, the "
            "prediction band is too narrow at one end."
        )
    else:
        sentence = (
            "The scatter changes with load; the slope's interval uses the heteroscedasticity-consistent covariance "
            "(HC3) and holds, the prediction band is too narrow at one end."
        )
    # the interval allows for it, so it never forbids the law
    return Check("equal_scatter", OK if p_value >= NOTE_BELOW else NOTE, sentence, statistic, "chi2(1)", p_value)


def _times(ratio: float) -> str:
    """Return a ratio as people say it; beyond a thousand the digits mean nothing."""
    return f"{ratio:.1f}" if ratio < 1000.0 else "over 1000"


def _influence(runs: _Runs) -> Check | None:
    n, dof = len(runs.x), runs.dof
    total = float(runs.rest @ runs.rest)
    if dof < 3 or total <= 0:
        return None
    slack = np.full(n, dof / n)
    own = runs.rest**2 / slack
    # externally studentised: each run against the scatter of the others
    others = np.maximum(total - own, 1e-12 * total) / (dof - 1)
    studentised = np.abs(runs.rest) / np.sqrt(others * slack)
    worst = int(np.argmax(studentised))
    p_value = min(n * p_t(float(studentised[worst]), dof - 1), 1.0)
    cook = float(runs.fit.cook.max())
    label = f"largest studentised residual of {n}"
    if p_value < NOTE_BELOW:
        sentence = (
            f"Run {runs.run_id[worst]} lies {UM * runs.rest[worst]:+.0f} um off, {_times(studentised[worst])} standard "
            "deviations of the others: look at it with 'calib check', and exclude it with a reason or repeat it."
        )
    elif cook > 1:
        pulling = int(np.argmax(runs.fit.cook))
        sentence = (
            f"Run {runs.run_id[pulling]} alone moves the line by more than its uncertainty (Cook's distance "
            f"{cook:.1f}): repeat its load."
        )
        return Check("influence", NOTE, sentence, cook, "Cook's distance", None)
    else:
        sentence = f"No single run stands out or carries the line (largest Cook's distance {cook:.2g})."
    return Check("influence", level(p_value), sentence, float(studentised[worst]), label, p_value)


def _normality(runs: _Runs) -> Check | None:
    n = len(runs.rest)
    if not 8 <= n <= 5000 or float(runs.rest @ runs.rest) <= 0:
        return None
    from scipy.stats import shapiro

    statistic, p_value = (float(number) for number in shapiro(runs.rest))
    sentence = (
        "The residuals look normal, as the intervals assume."
        if p_value >= NOTE_BELOW
        else "The residuals are not normal: the intervals of the coefficients still hold for means of many runs, the "
        "prediction band may not; look for outliers or two groups of runs."
    )
    return Check("normality", OK if p_value >= NOTE_BELOW else NOTE, sentence, statistic, "Shapiro-Wilk W", p_value)


def _direction(runs: _Runs) -> Check | None:
    out: BoolArray = np.char.lower(runs.direction) == "out"
    back: BoolArray = np.char.lower(runs.direction) == "back"
    if out.sum() < 3 or back.sum() < 3:
        return None
    first, second = runs.rest[out], runs.rest[back]
    dof = runs.dof - 1
    if dof < 3:
        return None
    pooled = float(np.sum((first - first.mean()) ** 2) + np.sum((second - second.mean()) ** 2)) / dof
    if pooled <= 0:
        return None
    difference = float(first.mean() - second.mean())
    statistic = difference / np.sqrt(pooled * (1 / out.sum() + 1 / back.sum()))
    p_value = p_t(statistic, dof)
    sentence = (
        "Out and back give the same radius."
        if p_value >= NOTE_BELOW
        else f"Radii driven out are {UM * difference:+.1f} um from those driven back: a zero error of the rangefinder, "
        "a sloping floor or drag in one direction; as many runs out as back cancel it, keep it so."
    )
    return Check(
        "direction", OK if p_value >= NOTE_BELOW else NOTE, sentence, float(statistic), f"t({dof:.0f})", p_value
    )
