"""Gaps as a first simulation has them, on a vehicle that shares no code with the package."""

from __future__ import annotations

import numpy as np
import pytest

from tests.gap.large_gaps import RADIUS_M, TRACK_M, answer, draw, motion, path_of, wheel_angles

SEED = 20


@pytest.mark.parametrize(("number", "seed"), [(0, SEED), (10, SEED), (20, SEED), (48, 4711), (86, 4711)])
def test_every_large_effect_is_named_closed_and_recommended(number: int, seed: int) -> None:
    """Load law and track together; scrub and turned axes; a delay, a temperature and a track.

    And a load law whose two forms share its probability beside a track of twenty times its share; a load law, a delay
    and turned axes, of which a search through a lack of fit that holds everything once ran away.
    """
    one = answer(number, seed)
    assert one.all_named, (one.case.sizes, one.named)
    assert one.nothing_else, (one.case.sizes, one.named)
    assert one.closed, one.closure
    assert one.recommended, one.why


def test_the_vehicle_of_these_campaigns_rolls_as_its_wheels_say() -> None:
    """Without effects, odometry from the wheels' angles gives the path back: the plant by itself is right."""
    case = draw(1, SEED)
    nothing = type(case)(0, {}, False)
    way, turn = motion("route_left", 0.6)
    rng = np.random.default_rng(0)
    rolled = wheel_angles(way, turn, np.array([300.0, 300.0]), 20.0, nothing, 1.0, rng)
    travel = np.diff(rolled, axis=0) * RADIUS_M
    odometry = path_of(travel.mean(axis=1), (travel[:, 1] - travel[:, 0]) / TRACK_M)
    # each wheel's radius scatters by 1e-4 from run to run: some millimetres on a route of 15 m
    np.testing.assert_allclose(odometry[-1], path_of(way, turn)[-1], atol=0.03)
