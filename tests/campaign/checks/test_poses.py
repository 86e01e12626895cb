"""Poses of the reference in their unit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.checks.paths import implausible_paths
from calib.campaign.checks.poses import implausible_poses
from calib.campaign.model import Campaign
from tests.campaign.making import with_numbers
from tests.kinematics.campaigns import Truth, campaign, square
from tests.kinematics.test_named_blunders import Columns, changed
from tests.radius.campaigns import straight


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


def driven_squares(change: Callable[[Columns], Columns], *runs: int) -> Campaign:
    """Squares of 2 m each way under a noisy reference, some of them changed."""
    rng, number = np.random.default_rng(2), iter(range(8))
    made = campaign([("square", square(2.0, sense)) for sense in (1, -1) * 4], Truth(), rng, along=True, samples=1000)
    return changed(made, lambda log: change(log) if next(number) in runs else log)


@pytest.mark.parametrize(
    ("names", "factor", "words"),
    [
        (("ref_x_m", "ref_y_m"), 1e3, "millimetres"),
        (("counts_left", "counts_right"), 4.0, "four times too many counts"),
    ],
)
def test_a_session_in_another_unit_along_the_path_is_named(names: tuple[str, ...], factor: float, words: str) -> None:
    made = driven_squares(lambda log: log | {name: factor * log[name] for name in names}, 0, 1, 2, 3)
    sessions = np.repeat(["day1", "day2", "day3"], (4, 4, 8))
    made = made.select([*range(8), *range(4, 8), *range(4, 8)])
    made = replace(made, runs=replace(made.runs, labels={**made.runs.labels, "session": sessions}))
    (found,) = implausible_paths(made)
    assert "in session day1" in found.text
    assert words in found.text
