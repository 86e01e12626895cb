"""Closure: a full fix is 1, no fix about 0, no gap none; held-out runs are never fitted on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.gap.decision.held_out import HeldOut, _fraction, _interval, folds, measure_closure
from calib.gap.effects.radii import TemperatureRadius
from calib.gap.inference.fit import fit
from calib.gap.inference.least_squares import HeldOutFit
from calib.gap.observations import Channel, Observations
from calib.gap.plan import noise_at
from calib.gap.predict import predict
from tests.gap.effects.making import Motion, Run, rich_runs, situation


def noisy(truth: Callable[[Run, Motion], None], seed: int = 1) -> Observations:
    """Rich runs with instruments that scatter as stated."""
    rng = np.random.default_rng(seed)

    def with_noise(run: Run, now: Motion) -> None:
        truth(run, now)
        now.laser_m, now.end_x_m, now.end_y_m = rng.normal(0, [0.0015, 0.002, 0.002])
        now.end_rad = rng.normal(0, 0.0008)

    runs = [replace(run, front=False) for run in rich_runs()]
    for number, run in enumerate(runs):
        # a sign that alternates within sessions, loads and routes
        run.numbers["sign"] = float((-1) ** (number * 5 // 7))
    return situation(runs, truth=with_noise)


def held_out(s: Observations, *, temperature: bool = False) -> HeldOut:
    nominal = predict(s)
    noise = noise_at(nominal, {})
    fitted = fit(nominal, noise, TemperatureRadius().forms(s) if temperature else [])
    return measure_closure(HeldOutFit(fitted, nominal, noise), np.random.default_rng(0))


def warm(run: Run, now: Motion) -> None:
    now.left = now.right = 3e-4 * (run.numbers["temperature_C"] - 20.0)


def test_a_full_fix_closes_the_gap() -> None:
    """The very law that is at work, fitted on other sessions, leaves the noise alone."""
    result = held_out(noisy(warm), temperature=True)
    closure = result.closure
    assert closure.held_out == "session"
    assert closure.fraction == pytest.approx(1.0, abs=0.02)
    assert closure.ci95 is not None
    assert closure.ci95[0] > 0.9
    assert closure.ci95[0] <= closure.fraction <= closure.ci95[1]
    distance = {line.channel: line.fraction for line in closure.channels}[Channel.DISTANCE]
    assert distance is not None
    assert distance > 0.95
    assert np.abs(result.after[:, 0]).max() < np.abs(result.before[:, 0]).max()


def test_a_fix_that_has_nothing_to_do_with_the_cause_closes_nothing() -> None:
    """Radii that change sign at random: neither a recalibration nor the temperature predicts a run not seen."""

    def random(run: Run, now: Motion) -> None:
        now.left = now.right = 3e-3 * run.numbers["sign"]

    fraction = held_out(noisy(random), temperature=True).closure.fraction
    assert fraction is not None
    # what is fitted by chance on two thirds of 24 runs harms as often as it helps
    assert abs(fraction) < 0.25


def test_no_gap_has_no_closure() -> None:
    """Where the excess is below half the noise level, a fraction of it would be a fraction of noise."""
    closure = held_out(noisy(lambda run, now: None)).closure
    assert closure.fraction is None
    assert closure.ci95 is None


def test_sessions_are_held_out_whole_where_there_are_three() -> None:
    s = noisy(warm)
    fold, kind = folds(s)
    assert kind == "session"
    for name in np.unique(s.labels["session"]):
        assert len(np.unique(fold[s.labels["session"] == name])) == 1
    assert len(np.unique(fold)) == 3


def test_conditions_are_held_out_whole_where_sessions_are_the_cause() -> None:
    s = noisy(warm)
    fold, kind = folds(s, sessions=False)
    assert kind == "condition"
    for number in np.unique(s.condition):
        assert len(np.unique(fold[s.condition == number])) == 1
    assert 2 <= len(np.unique(fold)) <= 6


def test_neighbours_in_time_are_held_out_together_where_sessions_are_few() -> None:
    s = noisy(warm)
    two = replace(s, labels={**s.labels, "session": np.where(s.labels["session"] == "s3", "s2", s.labels["session"])})
    fold, kind = folds(two)
    assert kind == "run"
    assert np.all(np.diff(fold) >= 0)
    assert len(np.unique(fold)) == 6


#: the other runs' estimates are of first order about a fit on all runs, the spoilt ones among them: what that fit moves
#: by, 1e-3 relative, times itself over 10 m
SECOND_ORDER_M = 1e-5


def test_what_a_session_measured_does_not_enter_its_own_prediction() -> None:
    """A session whose measurements are spoilt keeps the prediction that the others gave it."""
    s = noisy(warm)
    mine = s.labels["session"] == "s2"
    spoilt = s.measured.copy()
    spoilt[mine, 0] += 0.01
    nominal, other = predict(s), predict(replace(s, measured=spoilt))
    noise = noise_at(nominal, {})
    a, b = (
        measure_closure(
            HeldOutFit(fit(one, noise, TemperatureRadius().forms(one.s)), one, noise), np.random.default_rng(0)
        )
        for one in (nominal, other)
    )
    np.testing.assert_allclose((b.after - a.after)[mine & s.usable[:, 0], 0], 0.01, atol=SECOND_ORDER_M)


def test_the_only_corridor_beside_closed_loops_says_nothing_against_a_correction() -> None:
    """Squares do not tell the mean radius: without the one corridor its distance would be predicted by chance."""
    numbers = {"load_left_N": 300.0, "load_right_N": 300.0}
    square = [piece for _ in range(4) for piece in ((3.0, 0.0), (np.pi / 2, 1.0))]
    back = [(length, -kappa) for length, kappa in square]
    runs = [Run([square, back][n % 2], session="s", kind="ab"[n % 2], front=False, **numbers) for n in range(18)]
    runs.append(Run([(20.0, 0.0)], session="s", kind="corridor", front=False, **numbers))
    rng = np.random.default_rng(3)

    def unequal(_: Run, now: Motion) -> None:
        now.left, now.right = 1e-3, -1e-3
        now.laser_m, now.end_x_m, now.end_y_m = rng.normal(0, [0.0015, 0.002, 0.002])
        now.end_rad = rng.normal(0, 0.0008)

    closure = held_out(situation(runs, truth=unequal)).closure
    assert closure.fraction is not None and closure.fraction > 0.9
    # each square is predicted by the others, the corridor's distance by itself
    assert all(line.after_rms < 2.0 * line.floor_rms for line in closure.channels)


def test_a_channel_that_gets_more_than_twice_as_bad_says_by_how_much() -> None:
    """Squares above the noise of 1 that become 3.2 times as many: -220 %, and no limit at -100 %."""
    before, after, noise = 1.0 + 1.0, 1.0 + 3.2, 1.0
    closed = _fraction(np.array([[before, after]] * 10), np.full(10, noise))
    assert closed == pytest.approx(1.0 - 3.2, rel=1e-12)
    low, high = _interval(np.array([[before, after]] * 10), np.full(10, noise), np.arange(10), np.random.default_rng(0))
    assert low == pytest.approx(-2.2, rel=1e-9) and high == pytest.approx(-2.2, rel=1e-9)
