"""Checks of a wheel's fit; each says what it means and what to do."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.special import fdtrc, stdtrit

from calib.campaign.checks import direction_sign, partial_slope
from calib.radius import Groups, breusch_pagan, deletion_effect, groups_of, outliers, regression
from calib.radius.order import ROUNDING, aliasing_with_load, order_check, step_check
from calib.radius.regression import FAILED, NOTE, OK, UM, Check, WheelFit, distinct_loads, p_check, t_check
from calib.types import FloatArray, StrArray, few_digits, floats

#: with more sessions none can carry the slope alone
MAX_INFLUENCE_SESSIONS: Final = 100
#: most pairs of session and load tried as misreported; share of squares that they may leave
MAX_CELLS: Final = 200
MAX_SQUARES_LEFT: Final = 0.1
#: most runs tried as outliers, or a fifth of all: Rosner tested up to ten
MAX_OUTLIERS: Final = 10
#: share of the direction's variance that the load does not explain: below, its variance inflation is above ten (Kutner
#: et al., 10.5)
ALIASED: Final = 0.1
#: share of the load range by which the reference load may lie outside it
REFERENCE_MARGIN: Final = 0.02
#: numbers of runs for which the p-value of the test is valid
SHAPIRO_RUNS: Final = (8, 5000)


@dataclass(frozen=True, slots=True, eq=False)
class _Residuals:
    fit: WheelFit
    groups: Groups
    x: FloatArray
    residual_m: FloatArray
    dof: float
    session: StrArray
    direction: StrArray
    run_id: StrArray


def with_checks(fit: WheelFit, session: StrArray, direction: StrArray, run_id: StrArray) -> WheelFit:
    """Return `fit` with its checks; the labels are those of its runs, shape (n_runs,)."""
    groups, n = groups_of(session), len(fit.load_N)
    residual = groups.within(fit.residual_m) if 2 <= len(groups) < n else fit.residual_m - fit.residual_m.mean()
    dof = float(n - groups.indicators.shape[1] - (fit.model == "line" and fit.design != "confounded"))
    runs = _Residuals(fit, groups, fit.load_N - fit.load_N.mean(), residual, dof, session, direction, run_id)
    checks = [_design(fit, groups), _session(fit, groups), order_check(fit, session), step_check(fit, session, run_id)]
    if fit.model == "line":
        checks += [_range(fit), _same_law(runs), _lack_of_fit(runs), _curvature(runs), _equal_scatter(runs)]
    checks += [_session_influence(fit, groups), _influence(runs), _normality(runs), _direction(runs)]
    return replace(fit, checks=tuple(check for check in checks if check is not None))


def _squares(design: FloatArray, y: FloatArray) -> tuple[float, int]:
    coefficients, _, rank, _ = np.linalg.lstsq(design, y, rcond=1e-10)
    residual = y - design @ coefficients
    return float(residual @ residual), int(rank)


def _f_test(line: FloatArray, more: FloatArray, y: FloatArray) -> tuple[float, str, float] | None:
    (reduced, rank), (full, rank_full) = _squares(line, y), _squares(np.column_stack((line, more)), y)
    dof_more, dof = rank_full - rank, len(y) - rank_full
    if dof_more < 1 or dof < 3 or full <= 0.0:
        return None
    statistic = max((reduced - full) / dof_more / (full / dof), 0.0)
    return statistic, f"F({dof_more}, {dof})", float(fdtrc(dof_more, dof, statistic))


def _same_law(runs: _Residuals) -> Check | None:
    fit, late = runs.fit, floats(np.arange(len(runs.x)) >= len(runs.x) // 2)
    if fit.design == "confounded":
        return None
    line, y = fit.design_basis(runs.session), fit.residual_m * UM
    halves = f"between the first half of the runs and the second, from {runs.run_id[len(late) // 2]} on"
    ways = [
        (runs.x[:, None] * runs.groups.indicators, runs.groups.index, "from session to session"),
        (np.column_stack((late, runs.x * late)), late.astype(int), halves),
    ]
    tests = [(*test, of, words) for more, of, words in ways if (test := _f_test(line, more, y))]
    if not tests:
        return None
    statistic, name, p_value, of, words = min(tests, key=lambda test: test[2])
    x, y = runs.groups.within(runs.x), runs.groups.within(y)
    square = np.bincount(of, x**2)
    some = square > ALIASED * square.mean()
    slopes = UM * fit.law.slope_m_per_N + (np.bincount(of, x * y) / np.where(some, square, 1.0))[some]
    sentences = (
        "One law holds in all sessions, and in the second half of the runs as in the first.",
        f"The law differs {words} (slopes {slopes.min():.3g} to {slopes.max():.3g} um/N), more than runs explain, and "
        "no interval holds it: another wheel, or loads weighed or stated in another way; fit the parts apart.",
    )
    return p_check("same_law", statistic, name, min(len(tests) * p_value, 1.0), sentences, fails=True)


def _lack_of_fit(runs: _Residuals) -> Check | None:
    group = regression.load_groups(runs.fit.load_N)
    levels = int(group.max()) + 1
    if levels < 3:
        sentence = "With two loads any law runs through both: straightness cannot be tested; add a third load between."
        return Check("lack_of_fit", NOTE, sentence)
    if runs.fit.design == "confounded":
        return None
    test = _f_test(runs.fit.design_basis(runs.session), np.eye(levels)[group], runs.fit.residual_m * UM)
    if test is None:
        few = "Too few repeats at the same load to tell lack of fit from scatter; drive each load twice or more."
        return Check("lack_of_fit", NOTE, few)
    hint = _with_other_load(runs, several=True) if test[2] < regression.NOTE_BELOW else ""
    sentences = (
        "The straight line fits as well as the repeats at each load allow.",
        "The mean radii at the loads miss the straight line by more than repeats explain: use the law between "
        f"neighbouring measured loads only, or look for a load that is misreported.{hint}",
    )
    return p_check("lack_of_fit", *test, sentences, fails=True)


def _with_other_load(runs: _Residuals, *, several: bool) -> str:
    # the load at which the worst run, or `several` of one session and load, would lie on the law of all others
    fit, n = runs.fit, len(runs.x)
    if fit.design in {"constant", "confounded"}:
        return ""
    cells = runs.groups.index * n + regression.load_groups(fit.load_N)
    alone = np.arange(n) == np.argmax(np.abs(runs.residual_m))
    members = np.column_stack([alone, *(cells == cell for cell in np.unique(cells)[:MAX_CELLS])])
    line = np.column_stack((runs.x, runs.groups.indicators))
    basis = fit.design_basis(runs.session)
    own, residual = (part - basis @ (basis.T @ part) for part in (members, fit.residual_m))
    norm = np.maximum(np.sum(own**2, axis=0), 1e-9)
    gain, total = (residual @ own) ** 2 / norm, float(residual @ residual)
    of = members[:, int(np.argmax(gain))]
    if total - gain.max() > MAX_SQUARES_LEFT * total or n - line.shape[1] < 4 or (of.sum() > 1) != several:
        return ""
    slope, *_, moved = np.linalg.lstsq(np.column_stack((line, of)), fit.radius_m, rcond=None)[0]
    stated, largest = float(fit.load_N[of].mean()), float(fit.load_N.max())
    load = stated + moved / slope if slope else 0.0
    if np.min(np.abs(fit.load_N[~of] - load)) > regression.SAME_LOAD * largest:
        return ""
    session = runs.groups.names[runs.groups.index[of][0]]
    whose = f"the {of.sum()} runs of session {session} from {runs.run_id[of][0]} on" if several else "this run"
    return (
        f" By the line through all others, the radius of {whose} is that at {load:.0f} N, a load of others, where "
        f"{stated:.0f} N are stated: hold payload and loads against the notes of the day."
    )


def _curvature(runs: _Residuals) -> Check | None:
    z, y, base = runs.x / np.ptp(runs.x), runs.fit.residual_m * UM, runs.fit.design_basis(runs.session)
    square = z**2
    if runs.fit.design == "confounded":
        weight = np.sqrt(runs.groups.sizes)
        z, y = runs.groups.means(z), runs.groups.means(y) * weight
        base, square = np.column_stack((weight, z * weight)), z**2 * weight
    bend, sd, dof = partial_slope(y, square, base, 3e-5 * float(np.sqrt(np.mean(square**2))))
    if sd <= 0.0 or np.isinf(sd):
        return None
    # a parabola over the whole span departs from its chord by a quarter of its coefficient
    sag = few_digits(abs(bend) / 4, 2)
    sentences = (
        f"No curvature shows; a bend, if any, is about {sag} um in the middle of the load range.",
        f"The radius bends by about {sag} um in the middle of the load range: a straight law is that far off "
        "there; narrow the load range, or use a look-up table of measured loads.",
    )
    return t_check("curvature", bend, sd, dof, sentences, fails=True)


def _equal_scatter(runs: _Residuals) -> Check:
    statistic, p_value = breusch_pagan(runs.residual_m, runs.x)
    hold = "the slope's interval uses the heteroscedasticity-consistent covariance (HC3) and holds"
    if runs.fit.design == "confounded":
        hold = "the intervals rest on session means and hold"
    finding = f"The scatter changes with load; {hold}, the prediction band is too narrow at one end."
    return p_check("equal_scatter", statistic, "chi2(1)", p_value, ("The scatter is the same at every load.", finding))


def _influence(runs: _Residuals) -> Check | None:
    n, fit = len(runs.x), runs.fit
    if runs.dof < 3 or float(runs.residual_m @ runs.residual_m) <= 0:
        return None
    basis = fit.design_basis(runs.session)
    extremes = outliers(basis, fit.residual_m - basis @ (basis.T @ fit.residual_m), max(min(n // 5, MAX_OUTLIERS), 1))
    last = max((k for k, (*_, p) in enumerate(extremes) if p < regression.NOTE_BELOW), default=0)
    out, (_, size, p_value) = [run for run, *_ in extremes[: last + 1]], extremes[last]
    pulling = int(np.argmax(fit.cook))
    cook = float(fit.cook[pulling])
    if p_value >= regression.NOTE_BELOW and cook > 1:
        words = f"Run {runs.run_id[pulling]} alone moves the line by more than its uncertainty"
        sentence = f"{words} (Cook's distance {cook:.1f}): repeat its load."
        return Check("influence", NOTE, sentence, cook, "Cook's distance", None)
    line = np.column_stack([np.ones(n), *([runs.x] if fit.model == "line" else [])])
    off_m, moved, dof = deletion_effect(line, basis, fit.residual_m, out)
    off, times = ", ".join(f"{UM * one:+.0f}" for one in off_m), f"{size:.1f}" if size < 1000.0 else "over 1000"
    words, whose = f"Run {runs.run_id[out[0]]} lies {off} um off, {times}", "its"
    if last:
        words, whose = f"Runs {', '.join(runs.run_id[out])} lie {off} um off, {times} and more", "each one's"
    load = _with_other_load(runs, several=False) if p_value < regression.NOTE_BELOW and not last else ""
    sentences = (
        f"No single run stands out or carries the line (largest Cook's distance {cook:.2g}).",
        f"{words} standard deviations of the others: look at {whose} load, distance and counts, and correct it, "
        f"exclude it with a reason or repeat it.{load}",
    )
    # moved less, the law stays within the interval of the others'
    fails = moved > stdtrit(dof, 0.975) ** 2
    return p_check("influence", size, f"largest studentised residual of {n - last}", p_value, sentences, fails=fails)


def _normality(runs: _Residuals) -> Check | None:
    if not SHAPIRO_RUNS[0] <= len(runs.residual_m) <= SHAPIRO_RUNS[1] or float(runs.residual_m @ runs.residual_m) <= 0:
        return None
    from scipy.stats import shapiro

    statistic, p_value = map(float, shapiro(runs.residual_m))
    sentences = (
        "The residuals look normal, as the intervals assume.",
        "The residuals are not normal: the intervals of the coefficients still hold for means of many runs, the "
        "prediction band may not; look for outliers or two groups of runs.",
    )
    return p_check("normality", statistic, "Shapiro-Wilk W", p_value, sentences)


def _direction(runs: _Residuals) -> Check | None:
    side, fit = direction_sign(runs.direction), runs.fit
    loads = [fit.load_N[side == sign] for sign in (1.0, -1.0)]
    if min(map(len, loads)) < 3:
        return None
    known = np.isfinite(side)
    half, sd, dof = partial_slope(fit.residual_m[known], side[known], fit.design_basis(runs.session, known), ROUNDING)
    correlation, per_N = aliasing_with_load(fit, side, runs.session)
    of = f"Load and direction go together ({loads[0].mean():.0f} N out, {loads[1].mean():.0f} N back): the slope"
    if correlation**2 > 1.0 - ALIASED:
        return Check("direction", FAILED, f"{of} holds what one direction does; drive each load both ways.")
    if sd <= 0.0 or np.isinf(sd):
        return None
    moved, ends = abs(half * per_N), "As many runs out as back at each load cancel it, keep it so."
    if biased := fit.model == "line" and moved > float(fit.estimate.half_width((0.0, 1.0))):
        ends = f"{of} holds {UM * moved:.2g} um/N of it; drive each load both ways."
    sentences = (
        "Out and back give the same radius.",
        f"Radii driven out are {UM * 2.0 * half:+.1f} um from those driven back: a zero error of the rangefinder, "
        f"a sloping floor or drag in one direction. {ends}",
    )
    check = t_check("direction", half, sd, dof, sentences)
    return replace(check, level=FAILED) if biased and check.level == NOTE else check


def _range(fit: WheelFit) -> Check:
    law, margin = fit.law, REFERENCE_MARGIN * (fit.law.load_max_N - fit.law.load_min_N)
    span = f"{law.load_min_N:.0f} to {law.load_max_N:.0f} N"
    if law.load_min_N - margin <= law.reference_load_N <= law.load_max_N + margin:
        sentence = f"The law was measured for {span} a wheel; files of it hold 1 % of that span (at least 1 N) beyond."
        return Check("range", OK, sentence)
    words = f"The reference load {law.reference_load_N:.0f} N lies outside the measured {span}: the radius there is "
    return Check("range", NOTE, f"{words}extrapolated; measure near it, or set reference_load_N in campaign.toml.")


def _on_one_load(fit: WheelFit) -> str:
    words = f"All runs have one load ({fit.law.reference_load_N:.0f} N): a constant radius is given, for that load only"
    return f"{words}, and no slope; drive two further loads at least."


def without_loads(wheel: WheelFit) -> WheelFit:
    """Return the fit with the words of its checks where no load is given."""
    words = "No run's load is given: add load_left_N and load_right_N to runs.csv."

    def changed(check: Check) -> Check:
        if check.name == "design":
            return replace(check, sentence=check.sentence.replace(_on_one_load(wheel), words))
        if check.name == "scatter" and check.level != OK:
            return replace(check, level=FAILED, sentence=f"{words} Loads may differ. {check.sentence}")
        return check

    return replace(wheel, checks=tuple(map(changed, wheel.checks)))


def _design(fit: WheelFit, groups: Groups) -> Check:
    level, blank = NOTE, int(groups.sizes[groups.names == ""].sum())
    if len(groups) > 1 and blank:
        level = FAILED
        sentence = f"{blank} runs have no session and count as one: fill in the column session of runs.csv."
    elif fit.model == "constant":
        sentence = _on_one_load(fit)
    elif len(groups) == 1:
        sentence = ""
    elif len(groups) == len(fit.load_N):
        level, sentence = OK, "Every run is a session of its own: the runs are independent."
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
            f"on the {len(groups)} session means (degrees of freedom: {fit.law.dof:.3g}) and hold if sessions scatter "
            "at random; to split the two, drive at least two loads in every session."
        )
    else:
        several = [name for at, name in enumerate(groups.names) if distinct_loads(fit.load_N[groups.index == at]) > 1]
        crossed = "crossed" if fit.design == "crossed" and len(several) == len(groups) else "partly crossed"
        level = NOTE if len(several) == 1 else OK
        sentence = f"The loads are {crossed} with the sessions: load and drift between sessions are told apart."
        if len(several) == 1:
            words = f"Session {several[0]} alone has more than one load: the slope is that of this day"
            remedy = "drive two loads or more in another session"
            sentence = f"{words}, the others show how far the radius shifts only; {remedy}."
    if len(groups) == 1:
        level = FAILED
        one_session = (
            "All runs are of one session: what shifts from session to session is not in the intervals (where sessions "
            "scatter as much as runs they hold the truth in 60 % instead of 95 %); repeat some loads on another day."
        )
        sentence = f"{sentence} {one_session}".strip()
    return Check("design", level, sentence)


def _session(fit: WheelFit, groups: Groups) -> Check | None:
    estimate = fit.estimate
    if len(groups) < 2 or len(groups) == len(fit.load_N) or estimate.session_f is None or estimate.dof_between < 1:
        return None
    p_value, width_ratio = float(fdtrc(estimate.dof_between, estimate.dof_within, estimate.session_f)), ""
    aware, naive = (float(one.half_width((0.0, 1.0))) if one else 0.0 for one in (estimate, fit.naive))
    if naive > 0 and aware > 0:
        times = naive / aware
        wide = "as wide as this one" if abs(times - 1.0) < 0.05 else f"{few_digits(times, 2)} times as wide"
        width_ratio = f" Counting every run as independent would give a slope interval {wide}."
    subject, cause = "Sessions differ", "temperature, a remounted rangefinder, wear"
    if estimate.design == "confounded":
        subject = "Session means leave the line"
        cause = "a bend of the law, or a shift from session to session, which these runs cannot tell apart"
    sentences = (
        f"{subject} no more than their runs explain; the intervals allow for sessions all the same.{width_ratio}",
        f"{subject} by {UM * fit.session_std_m:.2g} um more than their runs explain ({cause}); the intervals allow for "
        f"it, but look for the cause.{width_ratio}",
    )
    name = f"F({estimate.dof_between:.0f}, {estimate.dof_within:.0f})"
    return p_check("session", estimate.session_f, name, p_value, sentences)


def _session_influence(fit: WheelFit, groups: Groups) -> Check | None:
    if fit.model != "line" or not 3 <= len(groups) <= MAX_INFLUENCE_SESSIONS:
        return None
    x, y = fit.load_N - fit.load_N.mean(), fit.residual_m
    change = np.zeros(len(groups))
    for session in range(len(groups)):
        others = groups.index != session
        if np.ptp(x[others]) > 1e-3 * np.ptp(x):
            change[session] = np.polyfit(x[others], y[others], 1)[0]
    if not change.any():
        return None
    worst, half = int(np.argmax(np.abs(change))), float(fit.estimate.half_width((0.0, 1.0)))
    ratio = abs(float(change[worst])) / half if half > 0 else 0.0
    slope, name = fit.law.slope_m_per_N, groups.names[worst]
    words = f"changes the slope by {100 * change[worst] / slope:+.2g} %" if slope else ""
    level, sentence = OK, f"No session carries the slope alone: leaving out {name} {words}, within its interval."
    if ratio > 1:
        level, subject = NOTE, f"The slope depends on session {name}: leaving it out {words}"
        sentence = f"{subject}, more than the interval's half width; repeat its loads."
    return Check("session_influence", level, sentence, ratio, "change over half interval")
