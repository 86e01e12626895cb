"""Which way counters count and headings turn: told by the whole way, wherever it ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.kinematics.estimate import estimate_geometry
from calib.kinematics.result import Geometry
from tests.kinematics.campaigns import Leg, Truth, campaign, tricycle

#: two opposite bends about a straight: the run ends behind its start, its heading within a radian of the first
HOOK: list[Leg] = [(2.0, 3.5), (4.0, 0.0), (2.0, -2.7)]
#: turns on the spot, in one sense more often
SPINS: list[Leg] = [(1.0, 0.0), (0.05, 8.0), (1.0, 0.0), (0.05, -3.0), (2.0, 0.5)]
#: standard uncertainties of the lengths that chance goes beyond once in 10,000 of some ten
WITHIN = 4.5


def codes(found: Geometry) -> set[str]:
    return {fault.code for fault in found.faults}


def near(found: Geometry, **lengths: float) -> bool:
    return all(abs(found[name].value - value) < WITHIN * found[name].std for name, value in lengths.items())


@pytest.mark.parametrize("front", [1.0, -1.0])
@pytest.mark.parametrize("steer", [1.0, -1.0])
def test_signs_of_a_steered_wheel_are_told_by_runs_that_end_behind_their_start(front: float, steer: float) -> None:
    """The net way along the first heading has the other sign there, and both signs together leave the same residual."""
    found = estimate_geometry(tricycle(np.random.default_rng(4), sign_front=front, sign_steer=steer, hooks=True))
    assert codes(found) == {
        name for name, sign in (("reversed_front", front), ("reversed_steering", steer)) if sign < 0.0
    }
    assert near(found, front_radius_m=0.102, wheelbase_m=1.03)


@pytest.mark.parametrize("seed", [0, 1])
def test_eights_of_a_steered_wheel_have_no_blunder(seed: int) -> None:
    """They end where they began with any radius and sign: noise alone says nothing of them."""
    found = estimate_geometry(tricycle(np.random.default_rng(seed), eights=True))
    assert found.passed and not codes(found)
    assert found.values["front_radius_m"] == pytest.approx(0.1, rel=0.05)


def hooked(sign: float) -> Campaign:
    """Return runs of two wheels along hooks of either sense whose counters count with a sign."""
    mirrored = [(way, -turn) for way, turn in HOOK]
    made = campaign([("hook", HOOK), ("koch", mirrored)] * 4, Truth(), np.random.default_rng(6), samples=200)
    columns = {name: sign * one if name.startswith("counts") else one for name, one in made.logs.columns.items()}
    return replace(made, logs=replace(made.logs, columns=columns))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_both_counters_backwards_are_no_exchanged_wheels(sign: float) -> None:
    """Headings alone cannot tell these; the way does, behind the start too."""
    assert codes(estimate_geometry(hooked(sign))) == ({"reversed_both"} if sign < 0.0 else set())


def test_headings_that_were_followed_keep_their_turns() -> None:
    """A skid-steered vehicle's nominal track makes turns 1.8 times too many: what the reference followed is right."""
    truth = Truth()
    mirrored = [(way, -turn) for way, turn in SPINS]
    made = campaign(
        [("spins", SPINS), ("nips", mirrored)] * 5,
        truth,
        np.random.default_rng(7),
        along=True,
        nominal=(0.05, 0.05, truth.track_m / 1.8),
        samples=400,
    )
    skid = replace(made, vehicle=replace(made.vehicle, drive="skid"))
    for using in ("end_poses", "windows"):
        found = estimate_geometry(skid, using=using)  # type: ignore[arg-type]
        assert "heading_turn" not in codes(found)
        assert found.passed and near(found, track_m=truth.track_m)


def test_a_reference_along_the_way_is_used_along_the_way() -> None:
    """From eight runs on, too: their ends alone leave the scale of closed paths open; asked for, they are taken."""
    closed: list[Leg] = [(2.0, np.pi)] * 2
    mirrored = [(way, -turn) for way, turn in closed]
    made = campaign([("left", closed), ("right", mirrored)] * 5, Truth(), np.random.default_rng(8), along=True)
    found, ends = estimate_geometry(made), estimate_geometry(made, using="end_poses")
    assert (found.using, ends.using) == ("windows", "end_poses")
    assert found.passed and near(found, radius_left_m=Truth().radius_left_m, track_m=Truth().track_m)
    assert found["radius_left_m"].std < 0.2 * ends["radius_left_m"].std
