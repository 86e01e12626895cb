"""Fits on the re-simulated path, their start from far away, and which parameters the runs determine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.gap.effects import Form, Parameter
from calib.gap.effects.library import library
from calib.gap.effects.load import LoadRadius
from calib.gap.effects.radii import SpeedRadius
from calib.gap.inference.fit import (
    Fitted,
    fit,
    hypothesis_path,
    identifiability_message,
    undetermined,
)
from calib.gap.inference.least_squares import LinearSystem
from calib.gap.inference.local_search import LocalSearch
from calib.gap.inference.model_search import continuation_start, is_far
from calib.gap.inference.noise import Noise, estimate_noise
from calib.gap.observations import Observations
from calib.gap.observations.from_campaign import observations_of
from calib.gap.plan import noise_at
from calib.gap.predict import Path, predict, residuals
from calib.plant.design import good_design
from calib.plant.effects import find
from calib.plant.make import make_campaign
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
    held = fit(nominal, noise, along=np.eye(4)[:2])
    assert held.calibration[2] == held.calibration[3] == 0.0
    assert np.abs(held.calibration[:2]).min() > 0
    nothing = fit(nominal, noise, along=np.zeros((0, 4)))
    np.testing.assert_array_equal(nothing.calibration, 0.0)
    np.testing.assert_allclose(nothing.left, gap, atol=1e-12)


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


#: relative error of a radius; ten times that of a tyre taken for another
OFF = 0.5


def _loaded(times: float) -> tuple[Observations, Path, Noise, Fitted]:
    """Radii that follow the load, so many times as strongly as is typical of a rubber wheel."""
    rng = np.random.default_rng(4)
    form = find("load_radius", "")
    campaign = make_campaign(good_design(rng, needs=form.needs), {"load_radius": times * form.typical}, rng)
    observations = observations_of(campaign)
    nominal = predict(observations)
    noise = estimate_noise(nominal, residuals(nominal, nominal))
    return observations, nominal, noise, fit(nominal, noise)


def _forms(observations: Observations, *names: str) -> list[Form]:
    return [form for e in library(observations) if e.id in names for form in e.forms(observations)[:2]]


def test_of_effects_that_bend_alike_the_one_whose_own_path_fits_is_begun_with() -> None:
    observations, nominal, noise, base = _loaded(3.0)
    forms = _forms(observations, "floor_slope", "curve_scrub", "load_radius", "temperature_radius")
    assert is_far(base)
    near = continuation_start(LinearSystem(base, nominal, noise, forms))
    assert [form.effect for form in near.forms] == ["load_radius"]
    assert not is_far(near)


def test_where_little_is_left_the_search_begins_at_the_calibration() -> None:
    observations, nominal, noise, base = _loaded(0.02)
    assert continuation_start(LinearSystem(base, nominal, noise, _forms(observations, "load_radius"))) is base


def test_what_takes_less_than_half_away_is_not_begun_with() -> None:
    observations, nominal, noise, base = _loaded(3.0)
    assert continuation_start(LinearSystem(base, nominal, noise, _forms(observations, "rangefinder_offset"))) is base


def test_a_wrong_effect_about_a_path_far_off_turns_no_wheel_inside_out() -> None:
    """Fitted and linearised again and again, the calibration beside it stays one that a vehicle could have."""
    observations, nominal, noise, fitted = _loaded(3.0)
    forms = _forms(observations, "wheel_eccentricity")[:1]
    for _ in range(4):
        greedy_search = LocalSearch(LinearSystem(fitted, nominal, noise, forms))
        fitted = greedy_search.with_current((0,)).fitted()
        assert np.all(np.abs(fitted.calibration[:2]) < OFF)


LEFT = Parameter("slope_left", "m/N", typical=1e-6, largest=6e-6)
RIGHT = Parameter("slope_right", "m/N", typical=1e-6, largest=6e-6)


def test_an_interval_beyond_what_is_plausible_on_both_sides_says_nothing() -> None:
    """+-4 m on a track is omitted; an implausible value that is well known, or a plausible one, is not."""
    widening = Parameter("widening", "m", typical=0.01, largest=0.1)
    for size, half, left_out in ((0.02, 4.0, True), (4.0, 0.1, False), (0.02, 0.05, False), (0.2, 0.25, False)):
        assert bool(undetermined([widening], np.array([size]), np.array([half]))) == left_out


def test_what_is_known_together_only_is_said_together() -> None:
    """Two slopes of which only the sum shows: each is unknown to 1e-4, their mean to 1e-7."""
    sum_sd, difference_sd = 2e-7, 2e-4
    turn = np.array([[0.5, 0.5], [0.5, -0.5]])
    covariance = turn @ np.diag([sum_sd**2, difference_sd**2]) @ turn.T
    words = identifiability_message([LEFT, RIGHT], np.array([3e-5, -2.7e-5]), covariance, 2.0)
    assert words.startswith("these runs do not determine slope_left and slope_right, only the mean of")
    # the mean's standard uncertainty is half that of the sum; its value half the sum's
    assert "1.5e-06 +- 2e-07 m/N" in words


def test_what_is_determined_needs_no_words() -> None:
    assert identifiability_message([LEFT, RIGHT], np.array([1e-6, 1e-6]), np.diag([1e-14, 1e-14]), 2.0) == ""
