"""Runs that follow each other and scatter alike: the intervals are widened for it, or the law is doubtful."""

from __future__ import annotations

import re

import numpy as np
import pytest

from calib.radius import groups_of, stratified_line, widened
from calib.radius.checks import with_checks
from calib.radius.order import step_check
from calib.radius.regression import FAILED, NOTE, OK, Check, WheelFit, fit_wheel
from calib.types import BoolArray, FloatArray

RADIUS_M, SLOPE_M_PER_N, REFERENCE_N, SCATTER_M = 0.1, 1.3e-6, 300.0, 1.6e-5
LOADS_N = np.array([300.0, 500.0, 700.0, 900.0, 1100.0])
RHO = 0.8


def series(rng: np.random.Generator, n: int, rho: float) -> FloatArray:
    """Return a stationary first-order autoregression of unit variance, written out run by run."""
    values = [rng.normal()]
    while len(values) < n:
        values.append(rho * values[-1] + np.sqrt(1 - rho**2) * rng.normal())
    return np.array(values)


def ascending(rng: np.random.Generator, rho: float, n_sessions: int = 3) -> WheelFit:
    """Return the fit of sessions in each of which the loads ascend."""
    load = np.tile(np.repeat(LOADS_N, 2), n_sessions)
    session = np.repeat([f"s{one}" for one in range(n_sessions)], 10)
    scatter = np.concatenate([series(rng, 10, rho) for _ in range(n_sessions)])
    radius = RADIUS_M + SLOPE_M_PER_N * (load - REFERENCE_N) + SCATTER_M * scatter
    fit = fit_wheel("left", load, radius, session, reference_load_N=REFERENCE_N)
    return with_checks(fit, session, np.full(len(load), ""), np.arange(len(load)).astype(str))


def holds(fit: WheelFit) -> bool:
    interval = fit.slope_ci95_m_per_N
    assert interval is not None
    return interval[0] <= SLOPE_M_PER_N <= interval[1]


def test_slopes_of_ascending_loads_hold_the_truth_or_are_doubtful() -> None:
    """Independent intervals hold it in 80 %; widened or marked 95 % within the scatter of 150 wheels (1.8 %)."""
    rng = np.random.default_rng(1)
    fits = [ascending(rng, RHO) for _ in range(150)]
    naive = [
        fit.naive is not None
        and abs(fit.naive.coefficients[1] - SLOPE_M_PER_N) < 2.05 * np.sqrt(fit.naive.covariance[1, 1])
        for fit in fits
    ]
    marked = [any(check.name == "order" and check.level == FAILED for check in fit.checks) for fit in fits]
    assert np.mean(naive) < 0.88
    assert np.mean([a or b for a, b in zip(map(holds, fits), marked, strict=True)]) > 0.95 - 2 * 0.018


def test_independent_runs_are_left_as_they_are() -> None:
    """The test of size 5 % widens one wheel in twenty, and marks fewer than one in fifty."""
    rng = np.random.default_rng(2)
    fits = [ascending(rng, 0.0) for _ in range(150)]
    found = [fit.autocorrelation for fit in fits]
    assert all(one is not None for one in found)
    # binomial, 150 of 5 %: 7.5 +- 2.7
    assert sum(one.rho > 0.0 for one in found if one is not None) <= 7.5 + 2.5 * 2.7
    assert sum(any(check.name == "order" and check.level == FAILED for check in fit.checks) for fit in fits) <= 5


@pytest.mark.parametrize("rho", [0.5, 0.8])
def test_the_variance_under_autocorrelation_is_that_of_the_closed_form(rho: float) -> None:
    """The slope's variance is x'Rx over the square of x'x, R written out in full; ``rho`` as it was estimated."""
    rng = np.random.default_rng(3)
    load = np.tile(np.repeat(LOADS_N, 8), 2)
    groups = groups_of(np.repeat(["a", "b"], 40))
    scatter = np.concatenate([series(rng, 40, rho) for _ in range(2)])
    radius = RADIUS_M + SLOPE_M_PER_N * (load - REFERENCE_N) + SCATTER_M * scatter
    x = load - REFERENCE_N
    plain = stratified_line(x, radius, groups)
    assert plain is not None
    wide, found = widened(plain, x, radius, groups)
    assert found.rho > 0.0
    n = len(load)
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    correlation = np.where(np.equal.outer(groups.index, groups.index), found.rho**apart, 0.0)
    x_within = groups.within(x)
    project = np.eye(n) - np.column_stack((np.eye(2)[groups.index], x)) @ np.linalg.pinv(
        np.column_stack((np.eye(2)[groups.index], x))
    )
    residual = project @ radius
    variance = residual @ residual / np.trace(project @ correlation)
    wanted = variance * (x_within @ correlation @ x_within) / (x_within @ x_within) ** 2
    assert wide.cov_within[1, 1] == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize(
    ("first", "low_m", "level"), [("light", 4e-5, FAILED), ("any", 4e-5, NOTE), ("light", 0.0, OK), ("any", 0.0, OK)]
)
def test_first_runs_that_lie_low_are_said_and_fail_where_they_move_the_slope(
    first: str, low_m: float, level: str
) -> None:
    """Cold wheels roll smaller; three light runs before each session tilt the line, three of any load do not.

    The slope without them, by least squares over the runs that are left, is the one they move it from.
    """
    rng, n, early = np.random.default_rng(8), 15, np.tile(np.arange(15) < 3, 5)
    ahead = np.full(3, LOADS_N[0]) if first == "light" else LOADS_N[[0, 2, 4]]
    load = np.concatenate([np.concatenate((ahead, rng.permutation(np.resize(LOADS_N, n - 3)))) for _ in range(5)])
    session = np.repeat(list("abcde"), n)
    radius = RADIUS_M + SLOPE_M_PER_N * (load - REFERENCE_N) + 1.2e-5 * rng.normal(size=5 * n) - low_m * early
    fit = fit_wheel("left", load, radius, session, reference_load_N=REFERENCE_N)
    (check,) = (one for one in with_checks(fit, session, np.full(5 * n, ""), session).checks if one.name == "order")
    assert check.level == level
    assert ("first runs of the sessions" in check.sentence) == (low_m > 0.0)
    assert "allow for it" not in check.sentence
    alone = np.polyfit(load[~early], radius[~early], 1)[0]
    assert (abs(alone - fit.law.slope_m_per_N) > fit.estimate.half_width((0.0, 1.0))) == (level == FAILED)


def test_loads_that_follow_the_order_are_in_no_interval_however_alike_runs_scatter() -> None:
    """What drifts along rising loads is their slope: wider intervals are no remedy."""
    fits = [ascending(np.random.default_rng(seed), 0.5) for seed in range(20)]
    said = [check.sentence for fit in fits for check in fit.checks if check.name == "order" and check.level == NOTE]
    assert any("scatter alike" in text for text in said)
    assert all("looks like load" in text and "allow for it" not in text for text in said)


@pytest.mark.parametrize(("labelled", "load"), [(True, "crossed"), (False, "crossed"), (True, "one")])
def test_a_wheel_that_was_changed_is_named_with_sessions_and_size(labelled: bool, load: str) -> None:
    """The size is that of the runs after less those before, written out; neither half has a step."""
    rng, n_sessions, n = np.random.default_rng(5), 6, 10
    loads = np.concatenate([rng.permutation(np.repeat(LOADS_N, 2)) for _ in range(n_sessions)])
    loads = loads if load == "crossed" else np.full(loads.shape, 300.0)
    session = np.repeat([f"s{one}" for one in range(n_sessions)], n) if labelled else np.full(n_sessions * n, "")
    run_id, after = np.arange(len(loads)).astype(str), np.arange(len(loads)) >= 3 * n
    level = RADIUS_M + SLOPE_M_PER_N * (loads - REFERENCE_N) + SCATTER_M * rng.normal(size=len(loads))

    def steps(chosen: BoolArray, radius: FloatArray) -> list[Check]:
        fit = fit_wheel("left", loads[chosen], radius[chosen], session[chosen], reference_load_N=REFERENCE_N)
        checks = with_checks(fit, session[chosen], np.full(int(chosen.sum()), ""), run_id[chosen]).checks
        return [one for one in checks if one.name == "step"]

    (check,) = steps(after | True, level + 4e-4 * after)
    assert check.level == FAILED
    assert ("between s2 and s3" if labelled else "between 29 and 30") in check.sentence
    assert (
        abs(float(re.findall(r"steps by (\S+) um", check.sentence)[0]) - 400.0)
        < 3.0 * 1e6 * SCATTER_M * (2 / 30) ** 0.5
    )
    assert not [*steps(after | True, level), *steps(after, level + 4e-4 * after), *steps(~after, level)]


def test_sessions_that_scatter_at_random_have_no_step() -> None:
    """Chance is two in a hundred at most, of steps and drifts: 200 wheels, 3 standard deviations above."""
    rng, said = np.random.default_rng(6), 0
    labels = np.repeat(np.arange(6), 5).astype(str)
    for _ in range(200):
        radius = RADIUS_M + SLOPE_M_PER_N * np.tile(LOADS_N - REFERENCE_N, 6) + SCATTER_M * rng.normal(size=30)
        radius += 5e-5 * np.repeat(rng.normal(size=6), 5)
        fit = fit_wheel("left", np.tile(LOADS_N, 6), radius, labels, reference_load_N=REFERENCE_N)
        check = step_check(fit, labels, labels)
        assert check is None or check.level == NOTE
        said += check is not None
    assert said <= 200 * (0.02 + 3 * (0.02 * 0.98 / 200) ** 0.5)


def test_steady_wear_is_a_drift_of_its_size_and_no_step() -> None:
    """The size is the slope of the session means over all sessions, by least squares."""
    rng, labels = np.random.default_rng(7), np.repeat(np.arange(6), 5).astype(str)
    for wear_m in (2e-4, -3e-4):
        radius = RADIUS_M + SLOPE_M_PER_N * np.tile(LOADS_N - REFERENCE_N, 6) + SCATTER_M * rng.normal(size=30)
        radius += wear_m * np.repeat(np.arange(6), 5) / 5.0
        fit = fit_wheel("left", np.tile(LOADS_N, 6), radius, labels, reference_load_N=REFERENCE_N)
        check = step_check(fit, labels, labels)
        assert check is not None and check.level == FAILED
        slope = np.polyfit(np.arange(6), fit.residual_m.reshape(6, 5).mean(axis=1), 1)[0]
        assert f"drifts by {5e6 * slope:+.3g} um" in check.sentence and "from 0 to 5" in check.sentence
