"""Checks of what shows in no cell: headings off by whole turns."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.check import check_campaign
from calib.campaign.checks.counts import turn_direction
from calib.campaign.checks.settings import (
    FAR_FROM_NOMINAL,
    counts_per_revolution,
    heading_turns,
    implausible_senses,
    odd_runs,
)
from calib.campaign.model import Campaign
from tests.campaign.making import with_numbers
from tests.kinematics.campaigns import Truth, campaign, square
from tests.radius.campaigns import straight

#: runs of 4 rad to either side, and squares of whole turns
ROUTES = [
    (name, legs) for name, sense in (("left", 1), ("right", -1)) for legs in ([(3.0, 4.0 * sense)], square(2.0, sense))
]
SESSIONS = np.repeat(["day1", "day2", "day3"], 8)


def _driven() -> Campaign:
    made = campaign(ROUTES * 6, Truth(), np.random.default_rng(1), walk=1e-3)
    made.runs.labels["session"] = SESSIONS  # type: ignore[index]
    return made


@pytest.mark.parametrize("apart", [0.0, 0.003, 0.005, 0.01, 0.02])
@pytest.mark.parametrize(("off", "named"), [(0.04, True), (0.025, True), (-0.025, True), (0.0, False), (0.08, False)])
def test_both_radii_off_to_one_side_are_a_setting_whatever_they_differ_by(
    apart: float, off: float, named: bool
) -> None:
    """Wear takes a wheel or two off nominal; a wrong count takes both, and nothing is said of a radius assumed.

    Counts that one encoder loses, or has other ones a turn, take its wheel far off the other; so may unlike loads.
    """
    load = np.linspace(300.0, 900.0, 12)
    radius = 0.1 * (1.0 + off - 1e-5 * (load - 600.0))
    made = straight(radius * (1.0 + apart / 2), radius * (1.0 - apart / 2), load)
    found = [note.code for note in counts_per_revolution(made)]
    assert found == (["count_scale"] if named else ["unlike_wheels"] * (apart > FAR_FROM_NOMINAL))
    assert named or not list(counts_per_revolution(with_numbers(made, load_right_N=3.0 * load)))
    assert not list(counts_per_revolution(replace(made, assumed=("vehicle.wheel_radius_m",))))


def _wrapped(heading: np.ndarray) -> np.ndarray:
    return np.angle(np.exp(1j * heading))


def test_headings_that_their_instrument_wraps_are_no_fault() -> None:
    """A turn of 4 rad reads -2.28 rad there, and no wheels are swapped."""
    made = _driven()
    wrapped = with_numbers(made, ref_theta_rad=_wrapped(made.runs.number("ref_theta_rad")))
    assert np.abs(wrapped.runs.number("ref_theta_rad") - made.runs.number("ref_theta_rad")).max() > math.pi
    assert [note.code for note in check_campaign(wrapped).suspicious if "ref_theta_rad" in note.where] == []


def test_swapped_wheels_are_named_beside_wrapped_headings() -> None:
    """Turns of less than half a turn are not wrapped, and tell it."""
    routes = [("arc", [(3.0, sense * turn)]) for sense in (1, -1) for turn in (1.5, 2.3)]
    made = campaign(routes * 3, Truth(), np.random.default_rng(1), walk=1e-3)
    swapped = {"counts_left": made.runs.number("counts_right"), "counts_right": made.runs.number("counts_left")}
    (found,) = turn_direction(with_numbers(made, **swapped))
    assert "in 12 of 12 turning runs" in found.text


def test_one_heading_a_turn_off_is_a_wrong_cell() -> None:
    made = _driven()
    heading = made.runs.number("ref_theta_rad").copy()
    heading[5] += 2 * math.pi
    (found,) = heading_turns(with_numbers(made, ref_theta_rad=heading))
    assert found.run_id == "r005"


def test_a_session_of_another_unit_or_sign_is_no_wrong_cell() -> None:
    """In degrees, or with a wheel that counts backwards, some runs of a session are near whole turns by chance."""
    made, day = _driven(), SESSIONS == "day3"
    heading, left = made.runs.number("ref_theta_rad"), made.runs.number("counts_left")
    for spoilt in (
        {"ref_theta_rad": np.where(day, np.degrees(heading), heading)},
        {"counts_left": left * (1 - 2 * day)},
    ):
        assert list(heading_turns(with_numbers(made, **spoilt))) == []


@pytest.mark.parametrize("session", ["all runs", "day3"])
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda left, right, heading: (-left, right, heading), "negate counts_left"),
        (lambda left, right, heading: (left, -right, heading), "negate counts_right"),
        (lambda left, right, heading: (left, right, np.degrees(heading)), "name the column ref_theta_deg"),
    ],
)
def test_a_sense_or_unit_is_named_for_all_runs_or_a_session(
    session: str, change: Callable[..., tuple[np.ndarray, ...]], words: str
) -> None:
    made, names = _driven(), ("counts_left", "counts_right", "ref_theta_rad")
    spoilt = np.isin(SESSIONS, [session]) | (session == "all runs")
    columns = [made.runs.number(name) for name in names]
    numbers = {
        name: np.where(spoilt, new, old) for name, old, new in zip(names, columns, change(*columns), strict=True)
    }
    (found,) = implausible_senses(with_numbers(made, **numbers))
    assert found.level == "wrong"
    assert f"in {session} " in found.text
    assert found.text.endswith(words)


def test_headings_beside_wheels_that_hardly_turn_are_not_called_degrees() -> None:
    """Radians read as counts turn by a thousandth: any heading in degrees would agree with that."""
    made = _driven()
    counts = {name: made.runs.number(name) * 2e-3 for name in ("counts_left", "counts_right")}
    assert list(implausible_senses(with_numbers(made, **counts))) == []


def test_senses_that_agree_are_left_alone() -> None:
    """Headings wrapped or not, wheels of unequal radii and a wrong track."""
    made = _driven()
    assert list(implausible_senses(made)) == []
    assert list(implausible_senses(with_numbers(made, ref_theta_rad=_wrapped(made.runs.number("ref_theta_rad"))))) == []


def test_half_turns_that_their_instrument_wraps_are_left_alone() -> None:
    """A track 10 % too wide makes 2.8 rad of half a turn, and noise leaves either sign to the heading."""
    routes = [("u-turn", [(3.0, sense * math.pi)]) for sense in (1, -1)]
    made = campaign(routes * 6, Truth(track_m=0.4), np.random.default_rng(1), nominal=(0.05, 0.05, 0.445))
    made = with_numbers(made, ref_theta_rad=_wrapped(made.runs.number("ref_theta_rad")))
    assert (np.sign(made.runs.number("ref_theta_rad")) != np.tile([1, -1], 6)).any()
    assert list(turn_direction(made)) == []
    assert list(heading_turns(made)) == []


def _of_run(made: Campaign, run: int, **columns: Callable[[float], float]) -> Campaign:
    changed = {name: made.runs.number(name).copy() for name in columns}
    for name, change in columns.items():
        changed[name][run] = change(changed[name][run])
    return with_numbers(made, **changed)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"ref_theta_rad": math.degrees}, "if the headings are in degrees; correct the row"),
        ({"counts_right": lambda counts: -counts}, "if the right wheel counts backwards; correct the row"),
        ({"ref_x_m": lambda x: 1e3 * x, "ref_y_m": lambda y: 1e3 * y}, "m driven; is it in another unit"),
        ({}, ""),
    ],
)
def test_a_single_run_of_another_unit_or_sense_is_named(
    columns: dict[str, Callable[[float], float]], said: str
) -> None:
    """Beside sound ones, whose radii and track are off by some per cent."""
    made = _of_run(_driven(), 4, **columns)
    assert [note.run_id for note in odd_runs(made)] == ["r004"] * bool(said)
    assert all(said in note.text for note in odd_runs(made))
