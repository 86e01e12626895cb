"""Radii that follow the temperature are found within sessions, whatever the load does; others are left in peace."""

from __future__ import annotations

import numpy as np
import pytest

from calib.radius.checks import FAILED, OK, Check
from calib.radius.regression import fit_wheel
from calib.radius.temperature_check import against_temperature

#: scatter of a radius, and how far it follows the temperature
SCATTER_M, PER_K = 30e-6, 7e-6


def checked(
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
    found = against_temperature(fit, warmth, session).checks
    return found[-1] if found else None


def test_radii_that_follow_the_temperature_fail_and_the_slope_is_said() -> None:
    """Seven micrometres a kelvin over twelve, beside a scatter of thirty: five standard errors and more."""
    check = checked(np.random.default_rng(1), PER_K)
    assert check is not None
    assert check.level == FAILED
    said = float(check.sentence.partition("by ")[2].partition(" um/K")[0])
    # standard error: the scatter over the temperature's own, of forty runs
    assert said == pytest.approx(1e6 * PER_K, abs=4 * 1e6 * SCATTER_M / (12 / np.sqrt(12) * np.sqrt(40)))


def test_sound_radii_raise_a_remark_as_often_as_it_says() -> None:
    """At 1 % a test: of 400 campaigns 4 are expected, 11 lie four standard deviations above."""
    rng = np.random.default_rng(2)
    checks = [checked(rng, 0.0, with_load=0.005) for _ in range(400)]
    assert sum(check is not None and check.level != OK for check in checks) <= 11


def test_a_temperature_that_went_with_the_load_alone_is_not_judged() -> None:
    assert checked(np.random.default_rng(3), PER_K, span_K=0.0, with_load=0.01) is None


def test_what_differs_between_sessions_alone_is_left_to_the_sessions() -> None:
    assert checked(np.random.default_rng(4), PER_K, span_K=0.0, between_K=4.0) is None


@pytest.mark.parametrize(("unread", "made"), [(3, True), (40, False)])
def test_runs_whose_temperature_was_not_read_are_left_out(unread: int, made: bool) -> None:
    check = checked(np.random.default_rng(1), PER_K, unread=unread)
    assert (check is not None and check.level == FAILED) is made
