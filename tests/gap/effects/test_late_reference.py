"""A pose reference along the path, mounted turned or read late: one cause, its size, and nothing beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects.reference import ReferenceLatency
from calib.gap.observations.from_campaign import observations_of
from tests.kinematics.campaigns import Leg, Truth, campaign

#: straights, bends, and turns nearly on the spot, in which windows begin as well
ROUTE: list[Leg] = [(1.5, 0.0), (0.05, 2.5), (2.0, 1.0), (0.05, -4.0), (1.0, 0.0), (2.0, -1.5), (0.05, 3.0), (1.5, 0.3)]
PLACE_M = (0.3, -0.2)


def recorded(truth: Truth) -> Campaign:
    """Return recordings of a minute each; place and lengths are stated right, the sensor's yaw and clock as zero."""
    mirrored = [(way, -turn) for way, turn in ROUTE]
    rng = np.random.default_rng(11)
    nominal = (truth.radius_left_m, truth.radius_right_m, truth.track_m)
    made = campaign(
        [("left", ROUTE), ("right", mirrored)] * 3,
        truth,
        rng,
        along=True,
        walk=1e-3,
        duration_s=60.0,
        samples=600,
        nominal=nominal,
    )
    x_m, y_m = truth.sensor[:2]
    return replace(made, reference=replace(made.reference, frame="map", sensor_x_m=x_m, sensor_y_m=y_m))


@pytest.mark.parametrize(
    ("changes", "effect", "form", "size"),
    [
        ({"sensor": (*PLACE_M, 0.02)}, "reference_yaw", "position alone", -0.02),
        ({"delay_s": 0.1}, "reference_latency", ReferenceLatency.OF_POSE, 0.1),
        ({"clock_rate": 1e-3}, "reference_latency", ReferenceLatency.OF_CLOCK, 1e-3),
    ],
    ids=["turned on a stated place", "late", "late by its clock"],
)
def test_one_cause_explains_it(changes: dict[str, object], effect: str, form: str, size: float) -> None:
    """A turned sensor turns the lever too; a late window begins late in motion, on the spot too, at its own time."""
    sound = Truth(0.05, 0.05, 0.4, sensor=(*PLACE_M, 0.0), delay_s=0.0)
    found = diagnose_in_full(recorded(replace(sound, **changes)), plan=False)  # type: ignore[arg-type]
    assert [(cause.effect, cause.form) for cause in found.causes] == [(effect, form)]
    (quantity,) = found.causes[0].parameters.values()
    low, high = quantity.ci95
    assert low < size < high and high - low < 0.2 * abs(size)
    assert found.recommended and found.to_dict()["verdict"] == "explained"


def test_windows_follow_one_another_within_a_recording() -> None:
    """The first of each begins its recording."""
    observations = observations_of(recorded(Truth(0.05, 0.05, 0.4, sensor=(*PLACE_M, 0.0), delay_s=0.0)))
    assert observations.windowed
    np.testing.assert_array_equal(observations.follows, observations.window > 0)


#: draws of the noise; in the second the ends alone show an unlikely cause, braking_skid at 0.23
USUAL, MISLEADING = 5, 7


@pytest.mark.parametrize(
    ("repeats", "delay_s", "seed"), [(6, 0.12, USUAL), (6, 0.12, MISLEADING), (24, 0.12, USUAL), (6, 0.0, USUAL)]
)
def test_a_delay_shows_along_many_runs_that_end_at_rest(repeats: int, delay_s: float, seed: int) -> None:
    """Ends at standstill hold no delay, however often a route is driven: the paths of the recordings do."""
    truth = Truth(0.05, 0.05, 0.4, delay_s=delay_s)
    legs: list[Leg] = [(0.0, 0.0), (0.5, 0.0), (0.8, 1.5), (0.5, 0.0), (0.0, 0.0)]
    routes = [("left", legs), ("right", [(way, -turn) for way, turn in legs])] * repeats
    made = campaign(routes, truth, np.random.default_rng(seed), along=True, walk=1e-3, duration_s=8.0, samples=100)
    assert not observations_of(made).windowed
    found = diagnose_in_full(made, plan=False)
    if not delay_s:
        assert not found.causes and found.to_dict()["verdict"] == "no_gap"
        return
    assert [cause.effect for cause in found.causes] == ["reference_latency"]
    low, high = found.causes[0].parameters["latency"].ci95
    assert 0.5 * (low + high) == pytest.approx(delay_s, rel=0.02) and found.recommended
