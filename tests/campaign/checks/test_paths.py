"""References along the path: lost ones, and those that are mirrored against their headings."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest

from calib.campaign.checks.paths import lost_reference, lost_stretches_s, mirrored_path
from tests.campaign.checks.test_poses import driven_squares
from tests.kinematics.campaigns import Truth, campaign, square
from tests.kinematics.test_named_blunders import Columns, changed

POSE = ("ref_x_m", "ref_y_m", "ref_theta_rad")
COUNTS = ("counts_left", "counts_right")


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


def _aside(log: Columns) -> Columns:
    """Ten readings a second, 5 cm apart as the wheels roll, a stretch of which lies 0.25 m to the left."""
    course = np.arctan2(np.gradient(log["ref_y_m"]), np.gradient(log["ref_x_m"]))
    off = 0.25 * _at(log, 0.32, 0.36) * np.exp(1j * (np.round(course / (np.pi / 2)) * np.pi / 2 + np.pi / 2))
    moved = log | {"ref_x_m": log["ref_x_m"] + off.real, "ref_y_m": log["ref_y_m"] + off.imag}
    read = np.arange(len(log["t_s"])) % 15 == 0
    return moved | {name: np.where(read, moved[name], np.nan) for name in POSE}


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
        (_aside, "leaps", None),
        (_scattered, "leaps", None),
    ],
)
def test_a_reference_that_was_lost_is_named_with_its_time(
    change: Callable[[Columns], Columns], what: str, from_s: float | None
) -> None:
    """Frozen for a part or to the end, moved for a part or for good, or scattered; in single runs."""
    found = list(lost_reference(driven_squares(change, 2, 5)))
    assert [note.run_id for note in found] == ["r002", "r005"]
    for note in found:
        assert what in note.text
        begin, end = (float(word) for word in re.findall(r"from (\S+) to (\S+) s", note.text)[0])
        # of 20 s, in samples of 20 ms; a leap that ends is one, too
        assert from_s is None or any(abs(begin - at) < 0.05 for at in (from_s, 8.0))
        assert begin < end


def _sliding(log: Columns) -> Columns:
    """Wheels that are locked while the vehicle goes on for a twentieth of the run."""
    locked = _at(log, 0.3, 0.35)
    held = {name: log[name] - np.cumsum(np.diff(log[name], prepend=0.0) * locked) for name in COUNTS}
    read = np.arange(len(log["t_s"])) % 25 == 0
    return log | held | {name: np.where(read, log[name], np.nan) for name in POSE}


@pytest.mark.parametrize(("change", "lost"), [(_aside, True), (_frozen(0.45), True), (_sliding, False)])
def test_stretches_are_the_references_where_no_skid_explains_them(
    change: Callable[[Columns], Columns], lost: bool
) -> None:
    """On locked wheels a vehicle slides ahead, not aside; a position that is repeated exactly is not read."""
    made = driven_squares(change, 2, 5)
    assert [note.run_id for note in lost_reference(made)] == ["r002", "r005"]
    assert list(lost_stretches_s(made)) == [2, 5] * lost


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
    assert list(lost_reference(driven_squares(change, *range(8)))) == []


def test_a_sensor_far_from_the_axle_swings_and_is_not_lost() -> None:
    """On the spot a sensor 0.5 m ahead moves, the axle does not."""
    routes = [("square", square(2.0, sense)) for sense in (1, -1) * 4]
    made = campaign(routes, Truth(sensor=(0.5, 0.1, 0.2)), np.random.default_rng(3), along=True)
    assert list(lost_reference(made)) == []


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda log: log, False),
        (_noisy, False),
        (lambda log: log | {"ref_y_m": -log["ref_y_m"]}, True),
        (lambda log: log | {"ref_theta_rad": -log["ref_theta_rad"]}, True),
        (lambda log: log | {"ref_x_m": log["ref_y_m"], "ref_y_m": log["ref_x_m"]}, True),
        (lambda log: log | {"ref_y_m": -log["ref_y_m"], "ref_theta_rad": -log["ref_theta_rad"]}, False),
        (lambda log: log | {"ref_theta_rad": log["ref_theta_rad"] + np.pi}, False),
    ],
    ids=["as it is", "noise", "y", "headings", "x and y exchanged", "both", "backward"],
)
def test_positions_that_are_mirror_images_of_their_headings_are_named(
    change: Callable[[Columns], Columns], named: bool
) -> None:
    """The course tells, wherever the sensor stands; it does not know of wheels, nor of what is mirrored as a whole."""
    turns = ((2.0, 1.0), (3.0, 2.0), (2.0, -0.5)) * 3
    routes = [("route", [(way, sense * turn) for way, turn in turns]) for sense in (1, 1, 1, -1)]
    made = campaign(routes, Truth(sensor=(0.2, 0.05, 0.0)), np.random.default_rng(4), along=True, samples=400)
    assert bool(list(mirrored_path(changed(made, change)))) is named
