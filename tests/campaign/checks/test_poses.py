"""Poses of the reference in their unit."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.checks.counts import implausible_paths
from calib.campaign.checks.poses import implausible_poses, lost_reference
from calib.campaign.model import Campaign
from tests.campaign.making import with_numbers
from tests.kinematics.campaigns import Truth, campaign, square
from tests.kinematics.test_named_blunders import Columns, changed
from tests.radius.campaigns import straight

POSE = ("ref_x_m", "ref_y_m", "ref_theta_rad")


@pytest.mark.parametrize("wrapped", [False, True])
@pytest.mark.parametrize("degrees", [False, True])
def test_headings_along_the_path_in_degrees_are_wrong(degrees: bool, wrapped: bool) -> None:
    """Also where they wrap, at 360 or at two pi; radians are no fault."""
    made = campaign([("s", square(2.0, s)) for s in (1, -1) * 2], Truth(), np.random.default_rng(1), along=True)

    def turned(log: Columns) -> Columns:
        turn, heading = (360.0 if degrees else 2.0 * np.pi), log["ref_theta_rad"] * (180.0 / np.pi if degrees else 1.0)
        return log | {"ref_theta_rad": heading % turn if wrapped else heading}

    notes = [note for note in implausible_poses(changed(made, turned)) if "along the path" in note.text]
    assert [note.level for note in notes] == ["wrong"] * degrees


def _along_a_line(seed: int, *, by: float = 1.0, noise: float = 8e-4) -> Campaign:
    """Nearly straight runs whose end headings are given in units of `by`, of wheels that loads tell apart."""
    rng = np.random.default_rng(seed)
    load, other, length = rng.uniform(300.0, 1100.0, (3, 30))
    turned, length = 2e-2 * rng.standard_normal(30), 25.0 + length / 80.0
    made = straight(0.1 - 1e-6 * load, 0.1 - 1e-6 * other, load)
    columns = {"ref_theta_rad": by * (turned + noise * rng.standard_normal(30)), "distance_m": length}
    for side, sense in (("left", -1.0), ("right", 1.0)):
        rolled = (length + sense * 0.35 * turned) * (1.0 + 1e-4 * rng.standard_normal(30))
        columns[f"counts_{side}"] = made.runs.number(f"counts_{side}") / 40.0 * rolled
    return with_numbers(made, load_right_N=other, **columns)


def test_headings_of_straight_runs_in_degrees_are_named_where_counts_follow_them() -> None:
    """A 57th as far; nothing of headings in rad, coarse ones, or wheels that show nothing of them."""
    for seed in range(10):
        (note,) = implausible_poses(_along_a_line(seed, by=180.0 / np.pi))
        assert "ref_theta_deg" in note.text
        assert not list(implausible_poses(_along_a_line(seed)))
        assert not list(implausible_poses(_along_a_line(seed, noise=0.05)))


@pytest.mark.parametrize(("factor", "level"), [(1.0, []), (180.0 / np.pi, ["wrong"])])
def test_end_headings_of_loops_within_half_a_turn_are_no_fault(factor: float, level: list[str]) -> None:
    """A table of ends has how far a square is off a whole turn, 5 degrees here; in degrees it is a fault."""
    senses = np.array((1, -1) * 4)
    made = campaign([("s", square(2.0, sense)) for sense in senses], Truth(), np.random.default_rng(3))
    off_rad = factor * (made.runs.number("ref_theta_rad") - (2.0 * np.pi + 0.087) * senses)
    runs = replace(made.runs, numbers={**made.runs.numbers, "ref_theta_rad": off_rad})
    assert [note.level for note in implausible_poses(replace(made, runs=runs))] == level


def _driven(change: Callable[[Columns], Columns], *runs: int) -> Campaign:
    """Squares of 2 m each way under a noisy reference, some of them changed."""
    rng, number = np.random.default_rng(2), iter(range(8))
    made = campaign([("square", square(2.0, sense)) for sense in (1, -1) * 4], Truth(), rng, along=True, samples=1000)
    return changed(made, lambda log: change(log) if next(number) in runs else log)


def _at(log: Columns, begin: float, end: float) -> np.ndarray:
    share = np.linspace(0.0, 1.0, len(log["t_s"]))
    return (share >= begin) & (share < end)


def _frozen(end: float) -> Callable[[Columns], Columns]:
    def change(log: Columns) -> Columns:
        lost = _at(log, 0.3, end)
        return log | {name: np.where(lost, log[name][lost][0], log[name]) for name in POSE}

    return change


def _leaping(end: float) -> Callable[[Columns], Columns]:
    return lambda log: log | {"ref_x_m": log["ref_x_m"] + 0.18 * _at(log, 0.3, end)}


def _scattered(log: Columns) -> Columns:
    """One position in a hundred half a metre off."""
    return log | {"ref_y_m": log["ref_y_m"] + 0.5 * (np.arange(len(log["t_s"])) % 100 == 50)}


def _held(every: int) -> Callable[[Columns], Columns]:
    """A reference slower than the log, each value held until the next."""
    return lambda log: log | {name: log[name][np.arange(len(log["t_s"])) // every * every] for name in POSE}


def _gap(log: Columns) -> Columns:
    """Counts that go on while a tenth of the poses are empty."""
    return log | {name: np.where(_at(log, 0.4, 0.5), np.nan, log[name]) for name in POSE}


def _noisy(log: Columns) -> Columns:
    rng = np.random.default_rng(1)
    return log | {name: log[name] + rng.normal(0.0, 0.02, len(log[name])) for name in POSE}


@pytest.mark.parametrize(
    ("change", "what", "from_s"),
    [
        (_frozen(0.45), "stands still", 6.0),
        (_frozen(1.1), "stands still", 6.0),
        (_leaping(0.4), "leaps", 6.0),
        (_leaping(1.1), "leaps", 6.0),
        (_scattered, "leaps", None),
    ],
)
def test_a_reference_that_was_lost_is_named_with_its_time(
    change: Callable[[Columns], Columns], what: str, from_s: float | None
) -> None:
    """Frozen for a part or to the end, moved for a part or for good, or scattered; in single runs."""
    found = list(lost_reference(_driven(change, 2, 5)))
    assert [note.run_id for note in found] == ["r002", "r005"]
    for note in found:
        assert what in note.text
        begin, end = (float(word) for word in re.findall(r"from (\S+) to (\S+) s", note.text)[0])
        # of 20 s, in samples of 20 ms; a leap that ends is one, too
        assert from_s is None or any(abs(begin - at) < 0.05 for at in (from_s, 8.0))
        assert begin < end


@pytest.mark.parametrize(
    "change",
    [
        lambda log: log,
        _held(50),
        _gap,
        lambda log: log | {name: np.round(log[name], 2) for name in POSE},
        lambda log: (
            log | {name: log[name] + np.random.default_rng(1).normal(0.0, 0.02, len(log[name])) for name in POSE}
        ),
    ],
    ids=["as it is", "slow", "gap", "rounded to centimetres", "ten times the noise stated"],
)
def test_references_that_follow_the_wheels_are_left_alone(change: Callable[[Columns], Columns]) -> None:
    assert list(lost_reference(_driven(change, *range(8)))) == []


def test_a_sensor_far_from_the_axle_swings_and_is_not_lost() -> None:
    """On the spot a sensor 0.5 m ahead moves, the axle does not."""
    routes = [("square", square(2.0, sense)) for sense in (1, -1) * 4]
    made = campaign(routes, Truth(sensor=(0.5, 0.1, 0.2)), np.random.default_rng(3), along=True)
    assert list(lost_reference(made)) == []


@pytest.mark.parametrize(
    ("names", "factor", "words"),
    [
        (("ref_x_m", "ref_y_m"), 1e3, "millimetres"),
        (("counts_left", "counts_right"), 4.0, "four times too many counts"),
    ],
)
def test_a_session_in_another_unit_along_the_path_is_named(names: tuple[str, ...], factor: float, words: str) -> None:
    made = _driven(lambda log: log | {name: factor * log[name] for name in names}, 0, 1, 2, 3)
    sessions = np.repeat(["day1", "day2", "day3"], (4, 4, 8))
    made = made.select([*range(8), *range(4, 8), *range(4, 8)])
    made = replace(made, runs=replace(made.runs, labels={**made.runs.labels, "session": sessions}))
    (found,) = implausible_paths(made)
    assert "in session day1" in found.text
    assert words in found.text
