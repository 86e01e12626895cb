"""Runs that stand out are named, also where they hide each other, and sound runs seldom are."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from calib.radius import deletion_effect, outliers
from calib.radius.checks import with_checks
from calib.radius.regression import FAILED, OK, fit_wheel

#: 54 values of Rosner (1983), as the NIST/SEMATECH e-Handbook prints them (1.3.5.17.3)
ROSNER = np.array([
    -0.25, 0.68, 0.94, 1.15, 1.20, 1.26, 1.26, 1.34, 1.38, 1.43, 1.49, 1.49, 1.55, 1.56, 1.58, 1.65, 1.69, 1.70,
    1.76, 1.77, 1.81, 1.91, 1.94, 1.96, 1.99, 2.06, 2.09, 2.10, 2.14, 2.15, 2.23, 2.24, 2.26, 2.35, 2.37, 2.40,
    2.47, 2.54, 2.62, 2.64, 2.90, 2.92, 2.92, 2.93, 3.21, 3.26, 3.30, 3.59, 3.68, 4.30, 4.64, 5.34, 5.42, 6.01,
])  # fmt: skip
#: the handbook's statistics, largest deviation in standard deviations, cut after three decimals
NIST_STATISTICS, PRINTED = [3.118, 2.942, 3.179, 2.810, 2.815, 2.848, 2.279, 2.310, 2.101, 2.067], 1e-3
#: its level, and the number of outliers that it finds
NIST_LEVEL, NIST_OUTLIERS = 0.05, 3
SCATTER_M = 1e-5


def test_the_published_example_gives_the_published_statistics_and_outliers() -> None:
    n = len(ROSNER)
    found = outliers(np.full((n, 1), n**-0.5), ROSNER - ROSNER.mean(), 10)
    left = n - np.arange(10)
    size = np.array([t for _, t, _ in found])
    # of the studentised residual: the deviation in standard deviations of all that are left
    deviation = size * (left - 1) / np.sqrt(left * (left - 2 + size**2))
    np.testing.assert_allclose(deviation, NIST_STATISTICS, atol=PRINTED)
    last = max(k for k, (*_, p) in enumerate(found) if p < NIST_LEVEL)
    assert [ROSNER[run] for run, *_ in found[: last + 1]] == [6.01, 5.42, 5.34]
    assert last + 1 == NIST_OUTLIERS
    assert found[0][2] > NIST_LEVEL


def campaign(seed: int, off_m: dict[int, float]) -> tuple[np.ndarray, ...]:
    """Return session, load and radius of 20 runs in two sessions, some off."""
    rng = np.random.default_rng(seed)
    load, session = np.resize([300.0, 500.0, 700.0, 900.0, 1100.0], 20), np.repeat(["a", "b"], 10)
    radius = 0.1 - 1e-6 * load + rng.normal(0.0, SCATTER_M, 20)
    for run, off in off_m.items():
        radius[run] += off
    return session, load, radius


@pytest.mark.parametrize("seed", range(5))
def test_outliers_that_hide_each_other_are_all_named(seed: int) -> None:
    """Three of twenty off alike by thirteen times the scatter: none lies four of all the runs' deviations off."""
    off_m = {4: 1.3e-4, 9: 1.3e-4, 14: 1.3e-4}
    session, load, radius = campaign(seed, off_m)
    run_id = np.array([f"r{run:02d}" for run in range(20)])
    fit = fit_wheel("left", load, radius, session, reference_load_N=300.0)
    (check,) = (one for one in with_checks(fit, session, session, run_id).checks if one.name == "influence")
    assert check.level == FAILED
    named, _, sizes = check.sentence.partition(" lie ")
    assert {*named.removeprefix("Runs ").split(", ")} == {f"r{run:02d}" for run in off_m}
    stated = np.array([float(size) for size in sizes.partition(" um")[0].split(", ")])
    # four standard deviations of a run and of the line through the others, 12 um at the ends
    np.testing.assert_allclose(stated, 130.0, atol=48.0)


def test_sound_runs_stand_out_as_seldom_as_stated() -> None:
    """200 campaigns at 1 %: two notes on average, and more than seven once in 900 by Poisson's law."""
    notes = 0
    for seed in range(200):
        session, load, radius = campaign(1000 + seed, {})
        fit = fit_wheel("left", load, radius, session, reference_load_N=300.0)
        notes += any(one.name == "influence" and one.level != OK for one in with_checks(fit, *[session] * 3).checks)
    assert notes <= 7


def test_a_single_run_moves_the_line_by_its_distance_of_cook() -> None:
    """Cook's distance is the change by one run, over the coefficients and the variance of all runs."""
    _, load, radius = campaign(3, {7: 1e-4})
    fit = fit_wheel("left", load, radius, np.full(20, ""), reference_load_N=300.0)
    line = np.column_stack((np.ones(20), load - load.mean()))
    off_m, moved, dof = deletion_effect(line, np.linalg.qr(line)[0], fit.residual_m, [7])
    others = np.delete(np.arange(20), 7)
    slope, at_zero = np.polyfit(load[others], radius[others], 1)
    left = radius[others] - at_zero - slope * load[others]
    assert off_m[0] == pytest.approx(radius[7] - at_zero - slope * load[7], rel=1e-6)
    assert dof == 17
    assert moved == pytest.approx(2 * fit.cook[7] * fit.residual_std_m**2 / (left @ left / dof), rel=1e-6)


def test_outliers_of_many_runs_take_memory_in_proportion_to_the_runs() -> None:
    """A matrix of 5,000 by 5,000 runs would take 200 MB, a hundred columns of them 4 MB."""
    n = 5000
    residual = np.random.default_rng(3).normal(0.0, SCATTER_M, n)
    line = np.column_stack((np.ones(n), np.linspace(-1.0, 1.0, n)))
    basis = np.linalg.qr(line)[0]
    tracemalloc.start()
    out = [run for run, *_ in outliers(basis, residual, 10)]
    deletion_effect(line, basis, residual, out)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100 * n * residual.itemsize
