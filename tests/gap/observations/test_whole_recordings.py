"""What a front wheel and a laser measure is compared over whole recordings, beside the windows cut of these."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.campaign.settings import Encoder
from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.observations import Channel
from calib.gap.observations.from_campaign import observations_of
from calib.reporting.figures.gap import GapArrays
from calib.vehicle import Vehicle
from tests.kinematics.campaigns import Leg, Truth, campaign

Diagnosing = Callable[..., Diagnosis]
#: turns that a steered wheel makes, on no more than 0.6 per metre
CURVE: list[Leg] = [(2.0, 0.0), (3.0, 0.9), (2.0, 0.0), (3.0, -1.8), (3.0, 1.2), (2.0, 0.0)]
CORRIDOR: list[Leg] = [(12.0, 0.0)]
SIZES = Truth(0.05, 0.05, 0.4)
WHEELBASE_M, FRONT_RADIUS_M, COUNTS = 0.6, 0.08, 20000.0
#: standard deviation of the steering angle's noise, and share by which a front wheel's radius differs from run to run
STEER_RAD, FRONT_SCATTER = 1e-3, 1e-4


def recorded(*, zero_rad: float = 0.0, scale: float = 0.0, laser: bool = False) -> Campaign:
    """Recordings of a tricycle with all wheels counted; steering zero and reference's scale are off by so much."""
    routes = [("curve", CURVE), ("mirrored", [(way, -turn) for way, turn in CURVE]), ("corridor", CORRIDOR)] * 3
    rng = np.random.default_rng(4)
    made = campaign(routes, SIZES, rng, along=True, walk=2e-4, duration_s=40.0, samples=400)
    logs, columns = made.logs, dict(made.logs.columns)
    columns |= {name: (1.0 + scale) * columns[name] for name in ("ref_x_m", "ref_y_m")}
    front, steering = np.zeros((2, len(columns["t_s"])))
    for a, b in zip(logs.offsets[:-1], logs.offsets[1:], strict=True):
        left, right = (
            np.diff(columns[f"counts_{side}"][a:b]) * 2 * np.pi / COUNTS * 0.05 for side in ("left", "right")
        )
        way, turn = 0.5 * (left + right), (right - left) / SIZES.track_m
        angle = np.arctan(WHEELBASE_M * turn / np.maximum(way, 1e-9))
        rolled = np.cumsum(way / np.cos(angle)) / FRONT_RADIUS_M * (1.0 + FRONT_SCATTER * rng.normal())
        front[a + 1 : b] = np.rint(rolled * COUNTS / (2 * np.pi))
        steering[a:b] = np.interp(np.arange(b - a) - 0.5, np.arange(b - a - 1), angle) + zero_rad
    columns |= {"counts_front": front, "steer_rad": steering + STEER_RAD * rng.normal(size=len(steering))}
    numbers = dict(made.runs.numbers)
    if laser:
        straight = made.runs.label("kind") == "corridor"
        numbers["distance_m"] = np.where(straight, 12.0 + 1.5e-3 * rng.normal(size=len(straight)), np.nan)
    return replace(
        made,
        vehicle=Vehicle(track_m=SIZES.track_m, wheel_radius_m=FRONT_RADIUS_M, wheelbase_m=WHEELBASE_M),
        encoder=Encoder(COUNTS, COUNTS, COUNTS),
        logs=replace(logs, columns=columns),
        runs=replace(made.runs, numbers=numbers),
    )


def test_windows_have_poses_and_whole_recordings_the_rest() -> None:
    seen = observations_of(recorded(laser=True))
    posed, beside = seen.usable[:, Channel.ALONG], seen.usable[:, [Channel.FRONT, Channel.STEERING]].all(axis=1)
    assert seen.windowed and not (posed & beside).any()
    np.testing.assert_array_equal(np.unique(seen.run[beside]), np.arange(9))
    assert beside.sum() == 9 and posed.sum() > 9
    assert seen.usable[:, Channel.DISTANCE].sum() == 3
    # whole ways, each by its own
    assert seen.length_m[beside] == pytest.approx(np.bincount(seen.run[posed], seen.length_m[posed]), rel=2e-2)


@pytest.mark.parametrize("zero_rad", [0.0, 0.006])
def test_a_steering_zero_shows_beside_windows(zero_rad: float, diagnosing: Diagnosing) -> None:
    """Windows alone hold nothing of it, and called the simulation right."""
    found = diagnosing(recorded(zero_rad=zero_rad), plan=False)
    assert [cause.effect for cause in found.causes] == (["steering_zero"] if zero_rad else [])
    if zero_rad:
        low, high = found.causes[0].parameters["zero"].ci95
        assert low < zero_rad < high and high - low < 0.2 * zero_rad
    # the floor plan has the windows' paths, whose gap it shows
    drawn = [len(path) > 1 for path in GapArrays.of(found).paths_m]
    np.testing.assert_array_equal(drawn, found.observations.usable[:, Channel.ALONG])


def test_a_laser_tells_the_scale_of_the_reference_that_made_the_windows(diagnosing: Diagnosing) -> None:
    """Without front wheel or laser it is radii and track off alike, or the reference; what to measure is said."""

    def without_front(made: Campaign) -> Campaign:
        columns = {name: made.logs.columns[name] for name in made.logs.columns if name != "counts_front"}
        return replace(made, logs=replace(made.logs, columns=columns))

    unaided = diagnosing(without_front(recorded(scale=4e-3)), plan=False)
    assert ("radius_scale", "track_width", "reference_scale") in [group[:3] for group in unaided.groups]
    assert not unaided.recommended and "distance_m" in " ".join(unaided.fix.why)
    for made in (recorded(scale=4e-3), without_front(recorded(scale=4e-3, laser=True))):
        found = diagnosing(made, plan=False)
        assert [cause.effect for cause in found.causes] == ["reference_scale"]
        low, high = found.causes[0].parameters["relative"].ci95
        assert low < 4e-3 < high
