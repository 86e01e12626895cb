from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from statsmodels.regression.linear_model import OLS

from calib.errors import RefusedError
from calib.radius import breusch_pagan
from calib.radius.regression import distinct_loads, fit_wheel, independent_line, least_squares, t_quantile

LOADS = np.array([300.0, 500.0, 700.0, 900.0, 1100.0])


def runs(crossed: bool, session_scatter: float = 5e-6, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return load, radius and session of 60 runs in five sessions."""
    rng = np.random.default_rng(seed)
    session = np.repeat(np.arange(5), 12)
    load = np.tile(np.tile(LOADS, 3)[:12], 5) if crossed else np.repeat(LOADS, 12)
    radius = 0.1 + 1.3e-6 * (load - 300) + rng.normal(0, session_scatter, 5)[session] + rng.normal(0, 1.5e-5, 60)
    return load, radius, np.array([f"s{one}" for one in session])


def test_naive_line_is_ordinary_least_squares() -> None:
    load, radius, session = runs(crossed=True)
    fit = fit_wheel("left", load, radius, session, reference_load_N=300.0)
    oracle = stats.linregress(load - 300, radius)
    assert fit.naive is not None
    half = stats.t.ppf(0.975, 58) * oracle.stderr
    # rounding
    assert fit.naive.coefficients[1] == pytest.approx(oracle.slope, rel=1e-10)
    assert fit.naive.coefficients[0] == pytest.approx(oracle.intercept, rel=1e-10)
    assert fit.naive.slope_ci95_m_per_N == pytest.approx((oracle.slope - half, oracle.slope + half), rel=1e-9)
    assert fit.r_squared == pytest.approx(oracle.rvalue**2, rel=1e-10)


def test_one_load_a_session_is_the_regression_on_session_means() -> None:
    """Exact t with three degrees of freedom, by scipy on the five means."""
    load, radius, session = runs(crossed=False)
    fit = fit_wheel("left", load, radius, session, reference_load_N=300.0)
    oracle = stats.linregress(LOADS - 300, radius.reshape(5, 12).mean(axis=1))
    t = stats.t.ppf(0.975, 3)
    assert fit.design == "confounded"
    assert fit.law.slope_m_per_N == pytest.approx(oracle.slope, rel=1e-10)  # rounding
    assert fit.slope_ci95_m_per_N == pytest.approx(
        (oracle.slope - t * oracle.stderr, oracle.slope + t * oracle.stderr), rel=1e-9
    )
    assert fit.radius_ref_ci95_m == pytest.approx(
        (oracle.intercept - t * oracle.intercept_stderr, oracle.intercept + t * oracle.intercept_stderr), rel=1e-9
    )
    assert (fit.dof_slope, fit.dof_radius_ref, fit.law.dof) == (3.0, 3.0, 3.0)


def test_crossed_loads_are_the_regression_with_a_constant_for_each_session() -> None:
    load, radius, session = runs(crossed=True, session_scatter=3e-5)
    fit = fit_wheel("left", load, radius, session, reference_load_N=300.0)
    design = np.column_stack((load - 300, session[:, None] == np.unique(session)))
    oracle = OLS(radius, design.astype(float)).fit()
    assert fit.design == "crossed"
    assert fit.law.slope_m_per_N == pytest.approx(oracle.params[0], rel=1e-9)  # rounding
    assert fit.slope_ci95_m_per_N == pytest.approx(tuple(oracle.conf_int()[0]), rel=1e-8)
    assert fit.dof_slope == 54


def test_variances_of_a_balanced_design_are_those_of_the_mixed_model() -> None:
    """REML of statsmodels' mixed model; balanced, so that its standard errors are ours where it finds a variance."""
    from statsmodels.regression.mixed_linear_model import MixedLM

    load, radius, session = runs(crossed=True, session_scatter=3e-5)
    fit = fit_wheel("left", load, radius, session, reference_load_N=300.0)
    design = np.column_stack((np.ones(60), (load - 300) / 400))
    oracle = MixedLM(radius * 1e5, design, groups=session).fit(reml=True)
    # its optimiser stops at some 1e-4 of the variance
    assert fit.session_std_m * 1e5 == pytest.approx(float(np.sqrt(oracle.cov_re[0, 0])), rel=5e-3)
    assert fit.run_std_m * 1e5 == pytest.approx(float(np.sqrt(oracle.scale)), rel=5e-3)
    assert np.sqrt(fit.law.covariance[0, 0]) * 1e5 == pytest.approx(oracle.bse_fe[0], rel=5e-3)
    assert np.sqrt(fit.law.covariance[1, 1]) * 4e7 == pytest.approx(oracle.bse_fe[1], rel=5e-3)


def test_one_session_is_ordinary_least_squares() -> None:
    load, radius, _ = runs(crossed=True)
    fit = fit_wheel("left", load, radius, np.full(60, ""), reference_load_N=300.0)
    assert fit.naive is not None
    assert fit.slope_ci95_m_per_N == pytest.approx(fit.naive.slope_ci95_m_per_N, rel=1e-12)  # rounding
    assert fit.law.dof == 58


@given(st.floats(-5e-6, 5e-6), st.floats(0.05, 0.3), st.booleans())
def test_an_exact_line_is_reproduced_for_slopes_of_both_signs(slope: float, radius: float, crossed: bool) -> None:
    load, _, session = runs(crossed)
    fit = fit_wheel("left", load, radius + slope * (load - 300), session, reference_load_N=300.0)
    # rounding of radii to 1e-17 m over loads of 800 N
    assert fit.law.slope_m_per_N == pytest.approx(slope, abs=1e-17)
    assert fit.law.radius_ref_m == pytest.approx(radius, rel=1e-13)


@given(st.floats(0.0, 2000.0))
def test_the_reference_load_moves_the_coefficients_along_the_same_line(reference: float) -> None:
    load, radius, session = runs(crossed=True)
    one = fit_wheel("left", load, radius, session, reference_load_N=300.0)
    other = fit_wheel("left", load, radius, session, reference_load_N=reference)
    at = np.array([200.0, 650.0, 1100.0])
    np.testing.assert_allclose(other.law.radius_m(at), one.law.radius_m(at), rtol=1e-12)  # rounding
    np.testing.assert_allclose(*(fit.band_m(at, single_run=False) for fit in (other, one)), rtol=1e-9)
    np.testing.assert_allclose(other.law.mean_std_m(at), one.law.mean_std_m(at), rtol=1e-6)


def test_bands_agree_with_the_textbook_where_runs_are_independent() -> None:
    load, radius, _ = runs(crossed=True)
    fit = fit_wheel("left", load, radius, np.full(60, "one"), reference_load_N=300.0)
    oracle = OLS(radius, np.column_stack((np.ones(60), load))).fit()
    at = np.array([250.0, 700.0, 1000.0])
    frame = oracle.get_prediction(np.column_stack((np.ones(3), at))).summary_frame(alpha=0.05)
    mean_m, prediction_m = (fit.band_m(at, single_run=single) for single in (False, True))
    np.testing.assert_allclose(mean_m, frame[["mean_ci_lower", "mean_ci_upper"]].T, rtol=1e-10)  # rounding
    np.testing.assert_allclose(prediction_m, frame[["obs_ci_lower", "obs_ci_upper"]].T, rtol=1e-10)


def test_the_prediction_band_of_sixty_runs_is_several_times_the_band_of_the_mean() -> None:
    load, radius, _ = runs(crossed=True)
    fit = fit_wheel("left", load, radius, np.full(60, "one"), reference_load_N=300.0)
    width = [np.diff(fit.band_m(650.0, single_run=single), axis=0)[0] for single in (False, True)]
    # sqrt(61) at the mean load, 4.6 on average over the range
    assert 4.6 < width[1] / width[0] < 8.0


@pytest.mark.parametrize("crossed", [True, False])
def test_the_band_at_a_load_is_students_t_times_the_standard_uncertainty_there(crossed: bool) -> None:
    """At the mean load of crossed sessions it is the interval of the session means, by hand."""
    load, radius, session = runs(crossed)
    fit = fit_wheel("left", load, radius, session, reference_load_N=300.0)
    mean_std_m = fit.law.mean_std_m(LOADS)
    for single, std_m in ((False, mean_std_m), (True, np.hypot(mean_std_m, fit.law.residual_std_m))):
        k = stats.t.ppf(0.975, fit.law.dof_of(fit.law.contrast(LOADS), single_run=single))
        # to the tolerance of the inverse of Student's t
        np.testing.assert_allclose(fit.law.half_width_m(LOADS, single_run=single), k * std_m, rtol=1e-7)
    at_reference = 0.5 * np.diff(fit.radius_ref_ci95_m)[0]
    np.testing.assert_allclose(fit.law.half_width_m(300.0), at_reference, rtol=1e-9)  # rounding
    means = [radius[session == one].mean() for one in np.unique(session)]
    if crossed:
        by_hand = stats.t.ppf(0.975, len(means) - 1) * stats.sem(means)
        np.testing.assert_allclose(fit.law.half_width_m(load.mean()), by_hand, rtol=1e-9)


def test_breusch_pagan_is_n_times_r_squared_of_the_squared_residuals() -> None:
    """Koenker's closed form for one regressor, and no statistic where there is no scatter."""
    rng = np.random.default_rng(2)
    x = rng.uniform(300, 1100, 60)
    residual = rng.normal(0, x)
    statistic = 60 * np.corrcoef(residual**2, x)[0, 1] ** 2
    assert breusch_pagan(residual, x) == pytest.approx((statistic, stats.chi2.sf(statistic, 1)), rel=1e-9)  # rounding
    assert breusch_pagan(np.zeros(60), x) == (0.0, 1.0)


def test_scatter_that_grows_with_load_selects_hc3() -> None:
    rng = np.random.default_rng(2)
    load = np.tile(LOADS, 12)
    radius = 0.1 + 1.3e-6 * load + rng.normal(0, 1e-5 * load / 300)
    fit = fit_wheel("left", load, radius, np.full(60, "one"), reference_load_N=300.0)
    oracle = OLS(radius, np.column_stack((np.ones(60), load - 300))).fit(cov_type="HC3")
    assert fit.estimate.hc3
    np.testing.assert_allclose(np.sqrt(np.diag(fit.law.covariance)), oracle.bse, rtol=1e-9)  # rounding


def test_one_load_gives_a_constant_and_no_slope() -> None:
    rng = np.random.default_rng(3)
    radius = 0.1 + rng.normal(0, 1e-5, 20)
    fit = fit_wheel("left", np.full(20, 700.0), radius, np.full(20, "one"), reference_load_N=300.0)
    assert fit.model == "constant"
    assert fit.slope_ci95_m_per_N is None
    assert fit.law.reference_load_N == 700.0
    low, high = stats.t.interval(0.95, 19, radius.mean(), radius.std(ddof=1) / np.sqrt(20))
    assert fit.radius_ref_ci95_m == pytest.approx((low, high), rel=1e-12)  # rounding


@pytest.mark.parametrize("n_runs", [3, 5, 60, 1000])
def test_naive_line_has_the_covariance_of_the_normal_equations(n_runs: int) -> None:
    """Coefficients and both covariances by their textbook formulas, with scatter that grows with the load."""
    rng = np.random.default_rng(n_runs)
    x = rng.uniform(0.0, 800.0, n_runs)
    y = 0.1 + 1.3e-6 * x + rng.normal(0.0, 1e-5, n_runs) * (1.0 + x / 400.0)
    ols, design = least_squares(x, y), np.column_stack((np.ones(n_runs), x))
    line, inverse = independent_line(ols), np.linalg.inv(design.T @ design)
    residual = y - design @ line.coefficients
    leverage = np.einsum("ij,jk,ik->i", design, inverse, design)
    weighted = design.T @ np.diag((residual / (1.0 - leverage)) ** 2) @ design
    np.testing.assert_allclose(line.coefficients, inverse @ design.T @ y, rtol=1e-9)  # the inverse loses digits
    np.testing.assert_allclose(line.covariance, inverse * (residual @ residual) / (n_runs - 2), rtol=1e-8)
    np.testing.assert_allclose(ols.cov_HC3, inverse @ weighted @ inverse, rtol=1e-6)  # leverages near one


def test_two_runs_are_refused() -> None:
    with pytest.raises(RefusedError, match="three or more"):
        fit_wheel("left", [300.0, 500.0], [0.1, 0.1], ["a", "a"], reference_load_N=300.0)


def test_loads_a_few_newtons_apart_count_as_one() -> None:
    assert distinct_loads(np.array([300.0, 303.0, 299.0, 700.0, 705.0])) == 2
    assert distinct_loads(np.array([300.0])) == 1


def test_t_quantile_is_that_of_student() -> None:
    assert float(t_quantile(3.0)) == pytest.approx(stats.t.ppf(0.975, 3), rel=1e-12)  # rounding
