"""Each check reports the fault that it is for, and nothing on sound campaigns."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from statsmodels.regression.linear_model import OLS
from statsmodels.stats.anova import anova_lm
from statsmodels.stats.outliers_influence import OLSInfluence

from calib.radius.checks import with_checks
from calib.radius.fit import with_temperature_check
from calib.radius.regression import FAILED, NOTE, OK, Check, WheelFit, fit_wheel

LOADS = np.array([300.0, 500.0, 700.0, 900.0, 1100.0])
N = 60
#: scatter of a radius, and how far it follows the temperature
SCATTER_M, PER_K = 30e-6, 7e-6
#: campaigns, and the share of intervals that hold the truth: 95 % less three standard errors of such a share
HELD, LEAST_HELD = 300, 0.912


def wheel_of(
    seed: int = 1, *, crossed: bool = True, sessions: int = 5, bend_m: float = 0.0, growth: float = 1.0, **shift: float
) -> tuple[WheelFit, dict[str, Check]]:
    """Return a checked fit of 60 runs with the faults asked for."""
    rng = np.random.default_rng(seed)
    session = np.repeat(np.arange(sessions), N // sessions)
    load = np.tile(np.resize(LOADS, 12), 5) if crossed else np.repeat(LOADS, N // 5)
    z = (load - 700) / 400
    noise = rng.normal(0, 1.5e-5, N) * (1 + (growth - 1) * (z + 1) / 2)
    radius = 0.1 + 1.3e-6 * (load - 300) - bend_m * (1 - z**2) + noise
    radius = radius + rng.normal(0, shift.get("session", 0.0), sessions)[session]
    radius = radius + shift.get("back", 0.0) * (np.arange(N) % 2)
    radius[7] += shift.get("run", 0.0)
    names = np.array([f"s{one}" for one in session])
    direction = np.resize(["out", "back"], N)
    run_id = np.array([f"r{run:02d}" for run in range(N)])
    fit = with_checks(fit_wheel("left", load, radius, names, reference_load_N=300.0), names, direction, run_id)
    return fit, {check.name: check for check in fit.checks}


def test_sound_campaigns_seldom_alarm() -> None:
    """Seven tests at 1 % each; 40 campaigns give 2.8 notes on average, and more than 8 once in 400."""
    notes = sum(check.level != OK for seed in range(40) for check in wheel_of(seed)[0].checks)
    assert notes <= 8


def test_no_sound_campaign_fails() -> None:
    assert all(
        wheel_of(seed)[0].checks and all(check.passed for check in wheel_of(seed)[0].checks) for seed in range(20)
    )


@pytest.mark.parametrize(
    ("fault", "name", "level", "word"),
    [
        ({"bend_m": 1e-4}, "curvature", FAILED, "bends"),
        ({"bend_m": 1e-4}, "lack_of_fit", FAILED, "neighbouring"),
        ({"growth": 8.0}, "equal_scatter", NOTE, "HC3"),
        ({"run": 2e-4}, "influence", FAILED, "r07"),
        ({"session": 1e-4}, "session", NOTE, "look for the cause"),
        ({"back": 5e-5}, "direction", NOTE, "rangefinder"),
        ({"crossed": False}, "design", NOTE, "drive at least two loads in every session"),
        ({"sessions": 1}, "design", FAILED, "one session"),
    ],
)
def test_a_fault_is_reported_by_its_check(fault: dict[str, float], name: str, level: str, word: str) -> None:
    _, checks = wheel_of(**fault)  # type: ignore[arg-type]
    assert checks[name].level == level
    assert word in checks[name].sentence


@pytest.mark.parametrize("loads", [(300.0, 1100.0), (300.0, 300.0, 300.0, 1000.0, 1000.0, 1100.0)])
def test_what_one_direction_does_is_in_the_slope_where_one_load_is_driven_each_way(loads: tuple[float, ...]) -> None:
    """Unladen back, laden out: residuals of the law cannot differ by direction; each load both ways tells."""
    load, session = np.tile(loads, 60 // len(loads)), np.repeat(["a", "b"], 30)
    radius = 0.1 - 1.3e-6 * (load - 300.0) + np.random.default_rng(3).normal(0.0, 1e-5, 60)
    run_id = np.array([f"r{run:02d}" for run in range(60)])
    fit = fit_wheel("left", load, radius, session, reference_load_N=300.0)
    for direction, level in (
        (np.where(load > 600.0, "out", "back"), FAILED),
        (np.resize(["out", "back", "back"], 60), OK),
    ):
        (check,) = (one for one in with_checks(fit, session, direction, run_id).checks if one.name == "direction")
        assert check.level == level
        assert ("drive each load both ways" in check.sentence) == (level == FAILED)


@pytest.mark.parametrize("crossed", [True, False])
def test_drag_of_one_direction_fails_where_loads_go_with_it_and_cancels_where_not(crossed: bool) -> None:
    """Heavy out and light back, each of two loads: the slope takes up a part of it, as stated."""
    load, session = np.resize([300.0, 500.0, 900.0, 1100.0], 60), np.repeat(["a", "b", "c"], 20)
    direction = np.where(np.arange(60) // 4 % 2 > 0 if crossed else load > 600.0, "out", "back")
    run_id = np.array([f"r{run:02d}" for run in range(60)])
    slopes = []
    for drag in (0.0, 5e-5):
        radius = 0.1 - 1.3e-6 * (load - 300.0) + np.random.default_rng(3).normal(0.0, 1e-5, 60)
        fit = fit_wheel("left", load, radius + drag * (direction == "back"), session, reference_load_N=300.0)
        (check,) = (one for one in with_checks(fit, session, direction, run_id).checks if one.name == "direction")
        slopes.append(fit.law.slope_m_per_N)
        assert check.level == (OK if drag == 0.0 else NOTE if crossed else FAILED)
    assert ("cancel it" in check.sentence) == crossed
    if not crossed:
        moved = float(check.sentence.split("holds ")[1].split(" um/N")[0])
        assert moved == pytest.approx(1e6 * abs(slopes[1] - slopes[0]), rel=0.3)


def test_sessions_of_one_direction_each_tell_nothing_of_it() -> None:
    """What is left of the direction beside the sessions is rounding, and no finding."""
    session = np.repeat(["a", "b", "c"], [17, 19, 24])
    direction = np.repeat(["out", "back", "out"], [17, 19, 24])
    load, run_id = np.resize(LOADS, 60), np.array([f"r{run:02d}" for run in range(60)])
    for seed in range(20):
        radius = 0.1 + np.random.default_rng(seed).normal(0.0, 1e-5, 60)
        fit = fit_wheel("left", load, radius, session, reference_load_N=300.0)
        assert not any(one.name == "direction" for one in with_checks(fit, session, direction, run_id).checks)


def test_every_check_ends_in_a_sentence() -> None:
    for fault in ({}, {"crossed": False}, {"sessions": 1}, {"bend_m": 1e-4}, {"growth": 8.0}):
        for check in wheel_of(**fault)[0].checks:  # type: ignore[arg-type]
            assert check.sentence.endswith(".")
            assert check.sentence[0].isupper()


def test_lack_of_fit_is_the_analysis_of_variance_of_nested_models() -> None:
    fit, checks = wheel_of(3, sessions=1)
    line = np.column_stack((np.ones(N), fit.load_N))
    levels = (fit.load_N[:, None] == LOADS).astype(float)
    scaled = fit.radius_m * 1e6
    oracle = anova_lm(OLS(scaled, line).fit(), OLS(scaled, levels).fit())
    assert checks["lack_of_fit"].statistic == pytest.approx(oracle["F"].iloc[1], rel=1e-6)  # rounding of residuals
    assert checks["lack_of_fit"].p_value == pytest.approx(oracle["Pr(>F)"].iloc[1], rel=1e-6)


@pytest.mark.parametrize("parts", ["sessions", "halves"])
def test_a_law_that_differs_between_sessions_or_halves_is_the_analysis_of_variance_of_nested_models(parts: str) -> None:
    """Slopes of five sessions that differ by a tenth, or another wheel from the middle of the third session on."""
    rng, session = np.random.default_rng(4), np.repeat(np.arange(5), 12)
    load, late = np.tile(np.resize(LOADS, 12), 5), np.arange(N) >= N // 2
    slope = 1.3e-6 * (np.array([1.0, 1.1, 0.9, 1.05, 0.95])[session] if parts == "sessions" else 1.0)
    radius = 0.1 + slope * (load - 300) + (0.0 if parts == "sessions" else 1e-4) * late + rng.normal(0, 1.5e-5, N)
    names = session.astype(str)
    fit = with_checks(fit_wheel("left", load, radius, names, reference_load_N=300.0), names, names, names)
    check = next(check for check in fit.checks if check.name == "same_law")
    of_session = np.eye(5)[session]
    line = np.column_stack((of_session, load))
    more = load[:, None] * of_session if parts == "sessions" else np.column_stack((line, late, late * load))
    more = np.column_stack((of_session, more)) if parts == "sessions" else more
    oracle = anova_lm(OLS(radius * 1e6, line).fit(), OLS(radius * 1e6, more).fit())
    assert check.statistic == pytest.approx(oracle["F"].iloc[1], rel=1e-6)  # rounding of residuals
    # two tests, the smaller p-value counts
    assert check.p_value == pytest.approx(2.0 * oracle["Pr(>F)"].iloc[1], rel=1e-6)
    assert check.level == FAILED
    assert ("session to session" if parts == "sessions" else "the second, from 2 on") in check.sentence


def test_curvature_is_the_t_of_a_quadratic_term() -> None:
    fit, checks = wheel_of(3, sessions=1)
    z = (fit.load_N - 700) / 400
    oracle = OLS(fit.radius_m * 1e6, np.column_stack((np.ones(N), z, z**2))).fit()
    assert checks["curvature"].statistic == pytest.approx(oracle.tvalues[2], rel=1e-6)  # rounding of residuals
    assert checks["curvature"].p_value == pytest.approx(oracle.pvalues[2], rel=1e-6)


def test_the_bend_is_stated_in_micrometres() -> None:
    _, checks = wheel_of(4, bend_m=2e-4)
    bend_um = float(checks["curvature"].sentence.split("about ")[1].split(" um")[0])
    assert bend_um == pytest.approx(200, abs=20)  # noise of 60 runs: 15 um / sqrt(60) times about 3


def test_cook_and_leverage_are_those_of_statsmodels() -> None:
    fit, _ = wheel_of(5)
    oracle = OLSInfluence(OLS(fit.radius_m * 1e6, np.column_stack((np.ones(N), fit.load_N))).fit())
    np.testing.assert_allclose(fit.leverage, oracle.hat_matrix_diag, rtol=1e-9)  # rounding
    np.testing.assert_allclose(fit.cook, oracle.cooks_distance[0], rtol=1e-6)  # rounding of residuals


def test_session_statistic_is_the_analysis_of_variance_of_sessions_given_load() -> None:
    fit, checks = wheel_of(6, session=1e-5)
    names = np.repeat(np.arange(5), 12)
    dummies = (names[:, None] == np.arange(5)).astype(float)
    scaled = fit.radius_m * 1e6
    oracle = anova_lm(
        OLS(scaled, np.column_stack((np.ones(N), fit.load_N))).fit(),
        OLS(scaled, np.column_stack((dummies, fit.load_N))).fit(),
    )
    # the same where sessions have the same loads
    assert checks["session"].statistic == pytest.approx(oracle["F"].iloc[1], rel=1e-6)


def test_normality_is_shapiro_wilk() -> None:
    fit, checks = wheel_of(7, sessions=1)
    assert checks["normality"].p_value == pytest.approx(
        stats.shapiro(fit.residual_m * 1e6).pvalue, rel=1e-3
    )  # centring


def test_two_loads_are_fitted_and_straightness_is_not_tested() -> None:
    rng = np.random.default_rng(8)
    load = np.resize([300.0, 900.0], 20)
    names = np.full(20, "one")
    fit = fit_wheel("left", load, 0.1 + 1e-6 * load + rng.normal(0, 1e-5, 20), names, reference_load_N=300.0)
    fit = with_checks(fit, names, np.full(20, ""), np.array([str(run) for run in range(20)]))
    checks = {check.name: check for check in fit.checks}
    assert fit.model == "line"
    assert "two loads" in checks["lack_of_fit"].sentence
    assert "third load" in checks["lack_of_fit"].sentence


def test_one_load_asks_for_further_loads() -> None:
    rng = np.random.default_rng(9)
    names = np.full(20, "one")
    fit = fit_wheel("left", np.full(20, 300.0), 0.1 + rng.normal(0, 1e-5, 20), names, reference_load_N=300.0)
    fit = with_checks(fit, names, np.full(20, ""), np.array([str(run) for run in range(20)]))
    assert "drive two further loads" in {check.name: check for check in fit.checks}["design"].sentence


def test_reference_load_outside_the_measured_loads_is_extrapolation() -> None:
    fit, _ = wheel_of(10)
    names = np.full(N, "one")
    again = with_checks(
        fit_wheel("left", fit.load_N, fit.radius_m, names, reference_load_N=50.0),
        names,
        np.full(N, ""),
        np.array([str(run) for run in range(N)]),
    )
    assert "extrapolated" in {check.name: check for check in again.checks}["range"].sentence


def temperature_check(
    rng: np.random.Generator,
    per_K: float,
    span_K: float = 12.0,
    between_K: float = 0.0,
    with_load: float = 0.0,
    unread: int = 0,
) -> Check | None:
    """Return the check of forty runs in four sessions, the temperature of the first few not read."""
    session = np.repeat(["a", "b", "c", "d"], 10)
    load_N = rng.uniform(300.0, 1100.0, 40)
    warmth = 20.0 + span_K * rng.random(40) + between_K * np.repeat(np.arange(4), 10) + with_load * (load_N - 700.0)
    radius = 0.1 - 1e-9 * load_N + per_K * (warmth - 20.0) + SCATTER_M * rng.standard_normal(40)
    fit = fit_wheel("left", load_N, radius, session, reference_load_N=300.0)
    warmth[:unread] = np.nan
    checks = with_temperature_check(fit, warmth, session).checks
    return checks[-1] if checks else None


def test_radii_that_follow_the_temperature_fail_and_the_slope_is_stated() -> None:
    """Seven micrometres a kelvin over twelve, beside a scatter of thirty: five standard errors and more."""
    check = temperature_check(np.random.default_rng(1), PER_K)
    assert check is not None
    assert check.level == FAILED
    slope = float(check.sentence.partition("by ")[2].partition(" um/K")[0])
    # standard error: the scatter over the temperature's own, of forty runs
    assert slope == pytest.approx(1e6 * PER_K, abs=4 * 1e6 * SCATTER_M / (12 / np.sqrt(12) * np.sqrt(40)))


def test_sound_radii_give_a_note_as_often_as_stated() -> None:
    """At 1 % a test: of 400 campaigns 4 are expected, 11 lie four standard deviations above."""
    rng = np.random.default_rng(2)
    checks = [temperature_check(rng, 0.0, with_load=0.005) for _ in range(400)]
    assert sum(check is not None and check.level != OK for check in checks) <= 11


def test_a_temperature_that_follows_the_load_fails() -> None:
    """The slope takes up what the temperature does, however little else of it is left to test."""
    for span_K in (0.0, 1.0):
        check = temperature_check(np.random.default_rng(3), PER_K, span_K=span_K, with_load=0.01)
        assert check is not None and check.level == FAILED and "go together" in check.sentence


def test_a_warm_up_under_rising_loads_is_no_proof_that_nothing_follows_the_temperature() -> None:
    """Three loads in rising order over 3 K a session: 5 um/K is hidden; over half a kelvin it moves nothing."""
    load, session = np.tile(np.repeat([300.0, 700.0, 1100.0], 4), 3), np.repeat(["a", "b", "c"], 12)
    radius = 0.1 - 1.4e-6 * (load - 300.0) + np.random.default_rng(5).normal(0.0, 1.5e-5, 36)
    fit = fit_wheel("left", load, radius, session, reference_load_N=300.0)
    for span_K, level in ((3.0, FAILED), (1.1, OK)):
        check = with_temperature_check(fit, 18.0 + span_K * np.tile(np.arange(12) / 11.0, 3), session).checks[-1]
        assert (check.name, check.level) == ("temperature", level)
        assert "no more than" in check.sentence or "may not show" in check.sentence


@pytest.mark.parametrize(("order", "level"), [("rising", NOTE), ("mixed", OK), ("one load", OK)])
def test_loads_that_rise_in_every_session_leave_a_drift_open(order: str, level: str) -> None:
    load, session = np.tile(np.repeat([300.0, 700.0, 1100.0], 4), 3), np.repeat(["a", "b", "c"], 12)
    rng = np.random.default_rng(3)
    load = {"rising": load, "mixed": np.resize([300.0, 1100.0, 700.0], 36), "one load": 300.0 + 0.1 * rng.random(36)}[
        order
    ]
    fit = fit_wheel("left", load, 0.1 + rng.normal(0.0, 1e-5, 36), session, reference_load_N=300.0)
    (check,) = (one for one in with_checks(fit, session, session, session).checks if one.name == "order")
    assert check.level == level
    assert ("rise or fall" in check.sentence) == (level == NOTE)


def test_runs_of_one_load_fail_no_check_of_their_order() -> None:
    """Independent runs: a failure has a probability of 1e-4 a wheel, and one load follows no order."""
    rng, session = np.random.default_rng(4), np.repeat(["a", "b", "c"], 8)
    for _ in range(200):
        fit = fit_wheel("left", np.full(24, 300.0), 0.1 + rng.normal(0, 1e-5, 24), session, reference_load_N=300.0)
        (check,) = (one for one in with_checks(fit, session, session, session).checks if one.name == "order")
        assert check.level != FAILED
        assert "loads follow" not in check.sentence


@pytest.mark.parametrize(("share", "level"), [(4.5, NOTE), (30.0, FAILED)])
def test_an_outlier_fails_where_it_moves_the_law_out_of_its_interval(share: float, level: str) -> None:
    """Nine times the scatter in the middle of 60 runs moves the mean by 0.15 of it; the interval holds 0.26."""
    rng, session = np.random.default_rng(5), np.repeat(["a", "b", "c"], 20)
    load = np.resize(LOADS, 60)
    radius = 0.1 + 1e-6 * load + rng.normal(0.0, 1e-5, 60)
    radius[7] += 2e-5 * share
    fit = fit_wheel("left", load, radius, session, reference_load_N=300.0)
    run_id = np.arange(60).astype(str)
    (check,) = (one for one in with_checks(fit, session, session, run_id).checks if one.name == "influence")
    assert (check.level, "Run 7 lies" in check.sentence) == (level, True)


def test_temperatures_that_differ_between_sessions_alone_are_not_checked() -> None:
    assert temperature_check(np.random.default_rng(4), PER_K, span_K=0.0, between_K=4.0) is None


@pytest.mark.parametrize(("unread", "checked"), [(3, True), (40, False)])
def test_runs_whose_temperature_was_not_read_are_left_out(unread: int, checked: bool) -> None:
    check = temperature_check(np.random.default_rng(1), PER_K, unread=unread)
    assert (check is not None and check.level == FAILED) is checked


def test_one_load_on_another_day_is_a_remark_and_its_intervals_hold() -> None:
    """Sessions that shift the radius as much as runs scatter: 300 campaigns of a full day and a day of one load.

    The slope is that of the first day and no shift moves it; the radius is known to the shift of two days, k = 12.7.
    """
    rng, load = np.random.default_rng(3), np.append(np.resize(LOADS, 20), np.full(6, 300.0))
    names = np.repeat(["mon", "tue"], [20, 6])
    held = np.zeros(2)
    for _ in range(HELD):
        shift = rng.normal(0.0, SCATTER_M, 2)[np.repeat([0, 1], [20, 6])]
        radius = 0.1 + 1.3e-6 * (load - 300.0) + shift + rng.normal(0.0, SCATTER_M, 26)
        fit = fit_wheel("left", load, radius, names, reference_load_N=300.0)
        off = np.abs(np.array([fit.law.radius_ref_m - 0.1, fit.law.slope_m_per_N - 1.3e-6]))
        held += off <= fit.estimate.half_width(np.eye(2))
    assert (held / HELD >= LEAST_HELD).all()
    checked = with_checks(fit, names, np.resize(["out", "back"], 26), names)
    design = checked.checks[0]
    assert (design.name, design.level) == ("design", NOTE)
    assert "mon alone has more than one load" in design.sentence
    both = np.where(names == "tue", np.resize([300.0, 1100.0], 26), load)
    again = fit_wheel("left", both, radius, names, reference_load_N=300.0)
    assert with_checks(again, names, names, names).checks[0].level == OK


@pytest.mark.parametrize("whose", ["run", "session"])
def test_a_misreported_load_is_named_with_the_load_that_explains_it(whose: str) -> None:
    """Driven at 1100 N and noted as 800 N: the line through all others gives 1100 N, a load of theirs."""
    rng, session = np.random.default_rng(3), np.repeat(["a", "b", "c"], 20)
    load = np.tile(np.repeat(LOADS, 4), 3)
    radius = 0.1 - 1.3e-6 * (load - 300) + rng.normal(0, 3e-6, N)
    wrong = np.flatnonzero((load == 1100.0) & (session == "b"))[: 1 if whose == "run" else None]
    stated = np.where(np.isin(np.arange(N), wrong), 800.0, load)
    names = np.array([f"r{run:02d}" for run in range(N)])
    fit = with_checks(fit_wheel("left", stated, radius, session, reference_load_N=300.0), session, names, names)
    check = next(check for check in fit.checks if check.name == ("influence" if whose == "run" else "lack_of_fit"))
    assert check.level == FAILED
    explained = check.sentence.partition("is that at ")[2]
    assert float(explained.partition(" N")[0]) == pytest.approx(1100.0, abs=10.0)
    assert "a load of others, where 800 N are stated" in explained
    assert ("Run r36" if whose == "run" else "the 4 runs of session b from r36 on") in check.sentence
