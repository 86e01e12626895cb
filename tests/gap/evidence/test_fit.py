"""Fits: strong effects come back to their truth by re-simulating, where one linear step does not reach it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.gap.data.observations import Observations
from calib.gap.effects.load_radius import LoadRadius
from calib.gap.effects.speed_radius import SpeedRadius
from calib.gap.evidence.fit import fit, hypothesis_path
from calib.gap.plan.separability import noise_at
from calib.gap.predict.path import Path, predict
from calib.gap.predict.residuals import residuals
from tests.gap.effects.making import MODEL, RADIUS_M, ROUTE, TRACK_M, Motion, Run, situation

LONG_M = 40.0
TRACK_TRUTH = 0.01


def long_runs() -> list[Run]:
    """Long straights and routes under uneven loads."""
    loads = [(300.0, 300.0), (600.0, 300.0), (300.0, 700.0), (800.0, 500.0)]
    runs = []
    for number in range(16):
        left, right = loads[number % 4]
        straight = number % 8 < 4
        pieces = [(LONG_M, 0.0)] if straight else [(length * 2, kappa / 2) for length, kappa in ROUTE]
        kind = "corridor" if straight else "route_left"
        speed = 0.4 + 0.2 * (number // 8)
        runs.append(Run(pieces, steps=300, kind=kind, load_left_N=left, load_right_N=right, speed_mps=speed))
    return runs


def seen(truth: Callable[[Run, Motion], None]) -> Observations:
    return situation([replace(run, front=False) for run in long_runs()], truth=truth)


SLOPES = np.array([1.1e-6, 0.8e-6])  # m/N


def loaded(run: Run, now: Motion) -> None:
    now.left = SLOPES[0] * (run.load_left_N - MODEL.reference_load_N) / RADIUS_M
    now.right = SLOPES[1] * (run.load_right_N - MODEL.reference_load_N) / RADIUS_M
    now.track = TRACK_TRUTH


def unequal(run: Run, now: Motion) -> None:
    now.left, now.right = -0.003, 0.003


def started(s: Observations) -> tuple[Path, np.ndarray]:
    nominal = predict(s)
    return nominal, residuals(nominal, nominal)


def test_strong_load_slopes_come_back_where_one_linear_step_misses_them() -> None:
    """Headings off by more than 0.1 rad over 40 m: re-simulated, slopes and track are found; linear, they are not."""
    nominal, gap = started(seen(loaded))
    assert np.abs(gap[:, 3]).max() > 0.1
    noise = noise_at(nominal, {})
    forms = LoadRadius().forms(nominal.s)
    settled, linear = fit(nominal, noise, forms, steps=8), fit(nominal, noise, forms, steps=1)
    sd = np.sqrt(np.diag(settled.covariance))
    truth = np.concatenate([[0.0, 0.0, TRACK_TRUTH], SLOPES])
    found, once = (np.concatenate([f.calibration[:3], f.theta[0]]) for f in (settled, linear))
    sd = sd[[0, 1, 2, 4, 5]]
    # a fit ends within a hundredth of its uncertainty; its prior of 30 typical sizes draws by less than that
    np.testing.assert_allclose((found - truth) / sd, 0.0, atol=0.2)
    assert (np.abs(once - truth) / sd).max() > 3
    assert np.abs(settled.left[:, :4]).max() < 1e-3 < np.abs(linear.left[:, :4]).max()


def test_a_calibration_far_off_comes_back() -> None:
    """Radii six thousandths apart turn 40 m by 0.34 rad."""
    nominal, gap = started(seen(unequal))
    assert np.abs(gap[:, 3]).max() > 0.3
    fitted = fit(nominal, noise_at(nominal, {}), steps=8)
    sd = np.sqrt(np.diag(fitted.covariance))[:3]
    # a fit ends within a hundredth of its uncertainty; its prior and the steps of a route draw by less than 0.2
    np.testing.assert_allclose((fitted.calibration[:3] - [-0.003, 0.003, 0.0]) / sd, 0.0, atol=0.2)


def test_what_is_not_free_stays_and_what_is_follows() -> None:
    """With the track held, only the radii move; with nothing free, nothing does and the gap stays whole."""
    nominal, gap = started(seen(loaded))
    noise = noise_at(nominal, {})
    held = fit(nominal, noise, free=(True, True, False, False))
    assert held.calibration[2] == held.calibration[3] == 0.0
    assert np.abs(held.calibration[:2]).min() > 0
    nothing = fit(nominal, noise, free=(False,) * 4)
    np.testing.assert_array_equal(nothing.calibration, 0.0)
    np.testing.assert_allclose(nothing.left, gap, atol=1e-12)


def test_runs_left_out_do_not_count() -> None:
    """Whatever is measured in a run that is not used, the fit is the same."""
    s = seen(loaded)
    nominal = predict(s)
    use = np.arange(len(s)) >= 2
    wild = s.measured.copy()
    wild[:2, 0] += 1.0
    forms = LoadRadius().forms(s)
    noise = noise_at(nominal, {})
    fits = [fit(predict(one), noise, forms, use=use) for one in (s, replace(s, measured=wild))]
    np.testing.assert_array_equal(fits[0].theta[0], fits[1].theta[0])
    assert fits[0].chi_square == fits[1].chi_square


def test_the_stated_covariance_is_that_of_repeated_noise() -> None:
    """Over campaigns with fresh Gaussian noise the estimates scatter by the uncertainty that each states."""
    s = seen(unequal)
    nominal = predict(s)
    noise = noise_at(nominal, {})
    rng = np.random.default_rng(4)
    forms = SpeedRadius().forms(s)[:1]
    lower = np.linalg.cholesky(noise.covariance)
    away = []
    for _ in range(60):
        shaken = (lower @ rng.normal(size=(len(s), 6, 1)))[:, :, 0]
        c, sn = np.cos(nominal.frame), np.sin(nominal.frame)
        x, y = shaken[:, 1].copy(), shaken[:, 2].copy()
        shaken[:, 1], shaken[:, 2] = c * x - sn * y, sn * x + c * y
        fitted = fit(predict(replace(s, measured=s.measured + shaken)), noise, forms, steps=3)
        found = np.concatenate([fitted.calibration[:3], *fitted.theta])
        keep = [0, 1, 2, *range(4, 4 + len(fitted.parameters))]
        away.append(
            (found - [-0.003, 0.003, 0.0, *np.zeros(len(found) - 3)]) / np.sqrt(np.diag(fitted.covariance))[keep]
        )
    spread = np.sqrt(np.mean(np.square(away), axis=0))
    # a root mean square of 60 draws scatters by 1 / sqrt(120) = 9 %; four of these
    np.testing.assert_allclose(spread, 1.0, atol=0.37)


def test_a_hypothesis_of_nothing_is_the_model_alone() -> None:
    s = seen(loaded)
    nominal = predict(s)
    same = hypothesis_path(s, np.zeros(4), LoadRadius().forms(s), [np.zeros(2)], nominal)
    np.testing.assert_array_equal(same.reading, nominal.reading)
    assert pytest.approx(TRACK_M) == s.model.track_m
