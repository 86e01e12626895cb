from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from calib.radius.law import critical_curve, critical_value, equivalent_dof, half_width
from tests.radius.coverage import DESIGNS, coverage


def test_pure_parts_are_students_t() -> None:
    critical = critical_value([0.0, 1.0], 4.0, 54.0)
    np.testing.assert_allclose(critical, stats.t.ppf(0.975, [54, 4]), rtol=1e-12)  # rounding


@pytest.mark.parametrize("share", [0.05, 0.2, 0.5, 0.8, 0.95])
def test_coverage_is_as_stated_for_every_true_share(share: float) -> None:
    """By Monte Carlo over the two chi-squared; the normal integral over the estimate is exact."""
    rng, n = np.random.default_rng(5), 100_000
    between = share * rng.chisquare(4, n) / 4
    within = (1 - share) * rng.chisquare(54, n) / 54
    critical = critical_value(between / (between + within), 4.0, 54.0)
    covered = np.mean(2 * stats.norm.cdf(critical * np.sqrt(between + within)) - 1)
    # solution of the integral equation to 0.15 %, Monte Carlo to 0.05 %
    assert covered == pytest.approx(0.95, abs=0.002)


def test_equivalent_dof_is_the_inverse_of_students_t() -> None:
    dof = np.array([1.0, 3.0, 4.86, 54.0, 300.0])
    np.testing.assert_allclose(equivalent_dof(stats.t.ppf(0.975, dof)), dof, rtol=1e-8)  # flat at many degrees


def test_the_curve_stays_between_the_pooled_and_the_wider_t() -> None:
    curve = critical_curve(4.0, 54.0)
    assert curve.min() >= stats.t.ppf(0.975, 58) - 1e-12
    assert curve.max() <= stats.t.ppf(0.975, 4) + 1e-12


def test_a_sum_of_two_cauchy_variates_is_one_with_the_sum_of_their_scales() -> None:
    """One degree of freedom each, the heaviest tails: the quantile is known in closed form; so it is of two normals."""
    for share in (1.0, 0.3, 0.01):
        scales = np.array([2.0, 2.0 * share])
        assert half_width(scales, [1.0, 1.0]) == pytest.approx(scales.sum() * stats.cauchy.ppf(0.975), rel=1e-7)
        assert half_width(scales[::-1], [1e9, 1e9]) == pytest.approx(
            np.hypot(*scales) * stats.norm.ppf(0.975), rel=1e-7
        )


@pytest.mark.parametrize("name", ["confounded+", "crossed"])
def test_intervals_of_whole_campaigns_hold_the_truth(name: str) -> None:
    """60 campaigns of two wheels; `python -m tests.radius.coverage` does 2,000, and the other designs."""
    shares = coverage(DESIGNS[name], 60, seed=7)
    # standard error 2 % of 120 intervals; three of them
    np.testing.assert_allclose(shares[:2], 0.95, atol=0.06)


def test_counting_runs_as_independent_claims_too_much_where_sessions_scatter() -> None:
    shares = coverage(DESIGNS["confounded+"], 40, seed=8)
    assert shares[2] < 0.75
