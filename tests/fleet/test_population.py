"""Mean and spread over vehicles hold the truth as often as they say; what is named is named rightly."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import numpy as np
import pytest
from scipy.special import stdtr

from calib.fleet import (
    Outlier,
    difference_of,
    false_discovery,
    familywise,
    moderated,
    outlying,
    population,
    quantities_of,
    shown_quantity,
)

#: 400 fleets: the standard error of a share of 95 % is 1.1 %; three of them either way
CAMPAIGNS = 400
LOWEST_COVERAGE, HIGHEST_COVERAGE = 0.917, 0.983
#: where nothing is to be found, the false discovery rate is the chance of any: 1 %, and three standard errors
MOST_FALSE_FLEETS = 0.025


@pytest.fixture(autouse=True)
def _nothing_old_to_collect() -> Iterator[None]:
    """Statsmodels collects garbage at each correction: of all that the session holds, 60 ms a call."""
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.mark.parametrize("spread", [0.3, 1.0, 4.0])
def test_the_intervals_of_mean_and_spread_hold_the_truth(spread: float) -> None:
    """In 95 % of fleets, whether the spread is below or above what each vehicle is uncertain by."""
    rng = np.random.default_rng(5)
    mean_held = spread_held = 0
    for _ in range(CAMPAIGNS):
        std = rng.uniform(0.5, 1.5, 40)
        found = population(rng.normal(7.0, spread, 40) + rng.normal(0.0, std), std)
        assert found is not None
        mean_held += found.mean_ci95[0] <= 7.0 <= found.mean_ci95[1]
        spread_held += found.spread_ci95[0] <= spread <= found.spread_ci95[1]
    for held in (mean_held, spread_held):
        assert LOWEST_COVERAGE <= held / CAMPAIGNS <= HIGHEST_COVERAGE


def test_a_fleet_without_spread_has_none() -> None:
    """Vehicles that differ by less than they are uncertain by: the spread is zero, and its interval begins there."""
    found = population(np.array([1.0, 1.1, 0.9, 1.0]), np.full(4, 1.0))
    assert found is not None
    assert found.spread == 0.0
    assert found.spread_ci95[0] == 0.0


def test_the_spread_solves_its_equation() -> None:
    """Paule and Mandel: at the between variance Cochran's Q is its expectation, the number of vehicles less one."""
    rng = np.random.default_rng(8)
    std = rng.uniform(1e-7, 3e-6, 60)
    values = 0.1 + rng.uniform(-4e-5, 4e-5, 60)
    fleet = population(values, std)
    assert fleet is not None
    weight = 1.0 / (fleet.spread**2 + std**2)
    assert float(weight @ (values - fleet.mean) ** 2) == pytest.approx(59.0, rel=1e-9)


def test_a_shared_difference_is_that_of_welch() -> None:
    """Interval and p-value by the Welch-Satterthwaite formula, where no value lies so far out that it is drawn in."""
    from scipy.special import stdtr, stdtrit

    values = 0.1 + np.random.default_rng(8).uniform(-4e-5, 4e-5, 60)
    inside = np.arange(60) < 20
    parts = values[inside], values[~inside]
    terms = np.array([part.var(ddof=1) / len(part) for part in parts])
    dof = terms.sum() ** 2 / np.sum(terms**2 / (np.array([20, 40]) - 1))
    size, half = parts[0].mean() - parts[1].mean(), stdtrit(dof, 0.975) * np.sqrt(terms.sum())
    difference = difference_of(values, inside)
    assert difference.ci95 == pytest.approx((size - half, size + half), rel=1e-9)
    assert difference.p_value == pytest.approx(2 * stdtr(dof, -abs(size) / np.sqrt(terms.sum())), rel=1e-9)


@pytest.mark.parametrize(("spread", "least"), [(0.0, 0.9), (0.3, 0.85)])
def test_drift_is_known_beside_the_scatter_of_the_whole_fleet(spread: float, least: float) -> None:
    """Five sessions leave three degrees of freedom; by them alone one drift in ten stands.

    The two wheels of a vehicle share half of their sessions' scatter, whose size varies between vehicles.
    """
    rng = np.random.default_rng(6)
    day = np.arange(5.0) - 2.0
    found = false = 0
    for _ in range(200):
        size = np.exp(spread * rng.standard_normal((50, 1, 1)))
        level = size * (rng.standard_normal((50, 1, 5)) + rng.standard_normal((50, 2, 5)))
        level[:3] += 6.0 * day
        level = (level - level.mean(axis=2, keepdims=True)).reshape(100, 5)
        rate = level @ day / 10.0
        own = np.sum((level - np.outer(rate, day)) ** 2, axis=1) / 3.0
        variance, dof = moderated(own, np.full(100, 3.0))
        assert (variance >= own).all()
        stands = familywise(2.0 * stdtr(dof, -np.abs(rate) / np.sqrt(variance / 10.0))).reshape(50, 2).any(axis=1)
        found, false = found + stands[:3].sum(), false + stands[3:].any()
    assert found / 600 > least
    assert false / 200 <= MOST_FALSE_FLEETS


def test_equal_vehicles_differ_in_nothing() -> None:
    """Copies of one vehicle: no variance, no p-value, no finding, no warning."""
    difference = difference_of(np.full(12, 0.1), np.arange(12) < 6)
    assert not familywise(np.array([difference.p_value])).any()


def test_far_vehicles_do_not_hide_themselves() -> None:
    """A fifth of the fleet ten spreads off: the others' distances stay those of a normal, theirs are far beyond."""
    rng = np.random.default_rng(2)
    values = rng.normal(0.0, 1.0, 200)
    values[:40] += 10.0
    z, p_value = outlying(values, np.full(200, 0.1))
    assert np.abs(z[:40]).min() > 4.0
    assert false_discovery(p_value)[:40].all()
    assert not false_discovery(p_value)[40:].any()


def test_a_sound_fleet_has_no_vehicle_apart() -> None:
    """Normal vehicles, sixty of them: in few fleets any is named, four quantities or one."""
    rng = np.random.default_rng(4)
    named = [false_discovery(outlying(rng.normal(0.0, 1.0, 60), np.full(60, 0.1))[1]).any() for _ in range(CAMPAIGNS)]
    assert np.mean(named) < MOST_FALSE_FLEETS


def test_the_share_of_false_findings_is_controlled() -> None:
    """Benjamini and Hochberg: of those named, at most a hundredth is false on average."""
    rng = np.random.default_rng(3)
    shares = []
    for _ in range(200):
        p = rng.random(400)
        p[:20] = 1e-9
        named = false_discovery(p)
        shares.append(named[20:].sum() / max(named.sum(), 1))
        assert named[:20].all()
    assert np.mean(shares) < 0.02


def test_findings_stand_by_the_definitions_of_both_procedures() -> None:
    """Benjamini-Hochberg: the largest k with p(k) <= share k / n; Holm: while p(k) <= chance / (n - k + 1)."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        p = rng.random(50) ** 3
        ranked = np.sort(p)
        below = np.flatnonzero(ranked <= 0.01 * np.arange(1, 51) / 50)
        limit = ranked[below[-1]] if len(below) else -1.0
        assert np.array_equal(false_discovery(p, 0.01), p <= limit)
        steps = int(np.argmin(np.append(ranked <= 0.01 / np.arange(50, 0, -1), False)))
        assert np.array_equal(np.sort(p)[:steps], np.sort(p[familywise(p, 0.01)]))


def test_the_between_variance_is_that_of_statsmodels() -> None:
    from statsmodels.stats.meta_analysis import _fit_tau_iterative

    rng = np.random.default_rng(1)
    values, std = rng.normal(1.0, 2.0, 30), rng.uniform(0.5, 1.5, 30)
    fleet = population(values, std)
    assert fleet is not None
    variance, converged = _fit_tau_iterative(values, std**2)
    assert converged
    # statsmodels stops at 1e-5 of the estimating equation, which has the size of n - 1
    assert fleet.spread**2 == pytest.approx(variance, rel=1e-6)


def test_an_outlier_is_as_far_from_the_fleet_as_from_the_mean_that_is_shown() -> None:
    """A skewed fleet, whose median is no mean, with a label's share taken off."""
    values = {"radius_left_ref_m": 0.1 + 1e-6 * np.array([*(np.arange(12.0) ** 2), 2000.0])}
    names = [f"v{number:02d}" for number in range(13)]
    found = quantities_of(names, values, {"radius_left_ref_m": np.full(13, 1e-6)}, {})
    (apart,) = found.outliers
    assert apart.vehicle == "v12"
    away = apart.value - found.populations["radius_left_ref_m"].mean
    assert abs(away - (apart.value - float(np.median(values["radius_left_ref_m"])))) > 1e-6
    assert f"{1e3 * away:+.3g} mm from the fleet's mean" in apart.why
    # a quantity without a unit has none, and no blank in its place
    assert Outlier("v", "gyro_scale", 1.5, 1.0, 9.0).why.startswith("gyro scale: 1.5, +0.5 from")


def test_a_hall_that_is_off_makes_no_other_hall_off() -> None:
    """Beside hall B, whose radii are larger, halls A and C lie below the mean of the others; they share nothing."""
    rng, n = np.random.default_rng(3), 160
    halls = np.array(["A"] * 60 + ["B"] * 40 + ["C"] * 60)
    names = [f"v{number:03d}" for number in range(n)]
    radii = 0.1 + 5e-5 * rng.standard_normal(n) + 1.2e-4 * (halls == "B")
    labels = {"hall": dict(zip(names, halls.tolist(), strict=True))}
    found = quantities_of(names, {"radius_right_ref_m": radii}, {"radius_right_ref_m": np.full(n, 1e-6)}, labels)
    (common,) = found.common
    assert (common.value, common.n_vehicles) == ("B", 40)
    low, high = common.difference.ci95
    assert low < 1.2e-4 < high
    low, high = found.populations["radius_right_ref_m"].mean_ci95
    assert low < 0.1 < high


@pytest.mark.parametrize(
    ("quantity", "shown"),
    [
        ("track_m", ("track", 1e3, "mm")),
        ("slope_left_m_per_N", ("slope left", 1e6, "µm/N")),
        ("side_slip_s2_per_m", ("side slip", 1.0, "s²/m")),
        ("understeer_s2_per_m2", ("understeer", 1.0, "s²/m²")),
    ],
)
def test_a_quantity_is_shown_in_the_unit_of_its_name(quantity: str, shown: tuple[str, float, str]) -> None:
    """A size of slip per acceleration is no length in millimetres."""
    assert shown_quantity(quantity) == shown
