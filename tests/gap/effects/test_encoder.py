"""Encoder blunders: each that is planted is named with what corrects it; sound campaigns have none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.gap.effects.encoder import Blunder, corrected, find_blunder
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict, residuals
from tests.gap.effects.making import Motion, Run, campaign, rich_runs
from tests.gap.observations.test_one_counter import car

Change = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def planted(change: Change, made: Campaign) -> Campaign:
    """The campaign with its left and right counts changed, in the table and in the logs."""
    numbers, columns = dict(made.runs.numbers), dict(made.logs.columns)
    for table in (numbers, columns):
        table["counts_left"], table["counts_right"] = change(table["counts_left"], table["counts_right"])
    return replace(made, runs=replace(made.runs, numbers=numbers), logs=replace(made.logs, columns=columns))


@cache
def rich() -> Campaign:
    """Return rich runs without an effect, made once; nobody changes them."""
    return campaign(rich_runs())


@cache
def sample_of(root: Path, name: str) -> Campaign:
    """Return a sample campaign, read once; nobody changes it."""
    return read_campaign(root / "sample_runs" / name)


def found(change: Change, made: Campaign | None = None) -> Blunder | None:
    s = observations_of(planted(change, made or rich()))
    return find_blunder(s, predict(s))


@pytest.mark.parametrize("factor", [2.0, 4.0, np.pi, 0.5, 0.25, 1 / np.pi, 10.0, -1.0])
@pytest.mark.parametrize("side", ["left", "right", "both"])
def test_a_factor_planted_is_named_with_its_inverse(factor: float, side: str) -> None:
    """Counts multiplied by a factor are to be multiplied by its inverse, on the wheel struck and no other."""
    a, b = (1.0 if side == "right" else factor), (1.0 if side == "left" else factor)
    fault = found(lambda left, right: (left * a, right * b))
    assert fault is not None
    assert not fault.swapped
    assert (fault.left, fault.right) == pytest.approx((1 / a, 1 / b))
    assert ("backwards" in fault.label) == (factor < 0)
    assert side in fault.label


@pytest.mark.parametrize("factor", [0.25, 0.5, 2.0, 4.0])
@pytest.mark.parametrize("sample", ["corridor", "corridor_crossed", "yard"])
def test_counts_per_revolution_taken_for_another_are_named_whatever_the_loads(
    sample: str, factor: float, project_root: Path
) -> None:
    """Of 40 m under unequal loads the end lies metres aside and a quarter radian turned with the right counts, too."""
    fault = found(lambda left, right: (left * factor, right * factor), sample_of(project_root, sample))
    assert fault is not None
    assert (fault.left, fault.right) == pytest.approx((1 / factor, 1 / factor))


@pytest.mark.parametrize("sample", ["corridor", "corridor_crossed", "yard"])
def test_samples_with_the_right_counts_have_no_fault(sample: str, project_root: Path) -> None:
    assert found(lambda left, right: (left, right), sample_of(project_root, sample)) is None


def test_swapped_wheels_are_named() -> None:
    fault = found(lambda left, right: (right, left))
    assert fault is not None
    assert fault.swapped
    assert (fault.left, fault.right) == (1.0, 1.0)


def test_swapped_wheels_that_count_backwards_are_named() -> None:
    fault = found(lambda left, right: (-right, -left))
    assert fault is not None
    assert fault.swapped
    assert (fault.left, fault.right) == (-1.0, -1.0)


@pytest.mark.parametrize("drive", ["tricycle", "ackermann"])
def test_a_steering_angle_of_the_other_sign_is_named_and_corrected(drive: str) -> None:
    """Turned back, nothing is left of it: readings, steering and all are those of the campaign as it was driven."""
    right = car(drive, (0.0, 0.0), (0.0, 0.0))
    columns = {**right.logs.columns, "steer_rad": -right.logs.columns["steer_rad"]}
    s = observations_of(replace(right, logs=replace(right.logs, columns=columns)))
    fault = find_blunder(s, predict(s))
    assert fault is not None
    assert "steering angle has the other sign" in fault.label
    assert Blunder.from_factors(fault.label, fault.factors) == fault
    driven, back = observations_of(right), corrected(s, fault)
    assert find_blunder(driven, predict(driven)) is None
    np.testing.assert_array_equal(back.steer_rad, driven.steer_rad)
    # the same sums, of wheels exchanged
    np.testing.assert_allclose(predict(back).reading, predict(driven).reading, rtol=0.0, atol=1e-12)


def test_counts_put_right_leave_no_gap() -> None:
    """Swapped and halved counts, corrected, predict what was measured."""
    s = observations_of(planted(lambda left, right: (right * 0.5, left * 0.5), rich()))
    right = predict(corrected(s, Blunder("", 2.0, 2.0, swapped=True)))
    # exact arcs within steps of 2 cm on routes of kinked curvature
    np.testing.assert_allclose(residuals(right, right)[:, :4], 0.0, atol=2e-3)


@pytest.mark.parametrize(
    "factors", [(1.0, 1.0), (1.03, 1.03), (1.02, 0.98), (0.99, 1.0)], ids=["sound", "radii", "unequal", "one"]
)
def test_small_errors_are_not_gross(factors: tuple[float, float]) -> None:
    """A radius wrong by some per cent is for the finer search."""
    assert found(lambda left, right: (left * factors[0], right * factors[1])) is None


def test_a_gross_gap_that_no_fault_closes_is_not_given_a_name() -> None:
    """A factor of 1.37 is none of those that encoders make."""
    assert found(lambda left, right: (left * 1.37, right * 1.37)) is None


def test_a_large_effect_is_not_taken_for_a_fault() -> None:
    """A track five per cent off turns tight routes by much, and is still no matter of counts."""

    def truth(run: Run, now: Motion) -> None:
        now.track = 0.05

    assert found(lambda left, right: (left, right), campaign(rich_runs(), truth=truth)) is None


def test_an_outside_simulator_has_no_counts_to_put_right() -> None:
    """Where the gap is another simulator's, factors of the counts do not enter it."""
    from tests.gap.effects.making import with_outside_simulator

    assert found(lambda left, right: (left * 2, right * 2), with_outside_simulator(rich())) is None
