"""Turns and stops: sizes and errors of the regression are those of independent software and of closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from statsmodels.regression.linear_model import OLS

from calib.arrays import FloatArray
from calib.gap.data.channels import Channel
from calib.gap.where.traces import Trace
from calib.gap.where.windows import _slope, compare_windows

#: two ways to the same double: matrix products in another order
ROUNDING = 1e-9


def drawn(n_runs: int, seed: int = 0) -> tuple[FloatArray, FloatArray, np.ndarray]:
    rng = np.random.default_rng(seed)
    design = np.stack([rng.uniform(0.5, 1.5, 12 * n_runs), rng.normal(size=12 * n_runs)], axis=1)
    run = np.repeat(np.arange(n_runs), 12)
    gap = design @ [0.02, -0.5] + 0.1 * rng.normal(size=n_runs)[run] + 0.05 * rng.normal(size=len(run))
    return design, gap, run


def test_few_runs_have_the_errors_of_ordinary_least_squares() -> None:
    """Statsmodels' OLS on the same rows gives the same slope, error and degrees of freedom."""
    design, gap, run = drawn(5)
    expected = OLS(gap, design).fit()
    size, error, dof = _slope(design, gap, run)
    assert size == pytest.approx(expected.params[1], rel=ROUNDING)
    assert error == pytest.approx(expected.bse[1], rel=ROUNDING)
    assert dof == expected.df_resid


def test_many_runs_have_errors_clustered_by_run() -> None:
    """Statsmodels' clustered covariance without its own small-sample factor, times runs over runs less two."""
    design, gap, run = drawn(12)
    expected = OLS(gap, design).fit(cov_type="cluster", cov_kwds={"groups": run, "use_correction": False})
    size, error, dof = _slope(design, gap, run)
    assert size == pytest.approx(expected.params[1], rel=ROUNDING)
    assert error == pytest.approx(expected.bse[1] * np.sqrt(12 / 10), rel=ROUNDING)
    assert dof == 10


def trace(run: int, per_rad: float, rng: np.random.Generator, *, ranged: bool = False) -> Trace:
    """A run of 40 m that turns by a radian in every other metre and gains heading with the turn."""
    way = np.linspace(0.0, 40.0, 401)
    turn = np.concatenate(([0.0], np.cumsum(np.where(np.floor(way[:-1]) % 2 == 1, 0.1, 0.0))))
    heading = per_rad * turn + np.concatenate(([0.0], np.cumsum(rng.normal(0, 1e-4, 400))))
    nothing = np.zeros_like(way)
    unknown = np.full_like(way, np.nan)
    return Trace(f"r{run}", "route", False, way, turn, way, nothing, nothing, unknown if ranged else heading, nothing)


def test_a_gap_that_grows_with_the_turn_is_found_with_its_size() -> None:
    """Heading of 0.01 rad gained per radian, walk of 1 mrad a run beside it: the interval holds the truth."""
    rng = np.random.default_rng(1)
    lines = compare_windows([trace(run, 0.01, rng) for run in range(10)])
    heading = next(line for line in lines if line.channel is Channel.HEADING and line.where == "turns")
    assert heading.ci95[0] <= 0.01 <= heading.ci95[1]
    assert heading.size == pytest.approx(0.01, rel=0.05)
    assert heading.p_value < 1e-6
    assert heading.unit == "rad/rad"
    assert heading.n_runs == 10


def test_runs_without_a_heading_are_not_asked_for_it() -> None:
    """A rangefinder alone: no line on the heading, and none of its NaN anywhere."""
    rng = np.random.default_rng(2)
    lines = compare_windows([trace(run, 0.01, rng, ranged=True) for run in range(10)])
    assert {line.channel for line in lines} == {Channel.ALONG}
    assert all(np.isfinite([line.size, *line.ci95, line.p_value]).all() for line in lines)
