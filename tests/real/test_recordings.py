"""The recordings arrive in a campaign as their makers describe them: lengths, senses of turn, signs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.campaign.model import Campaign
from tests.real import recordings

#: the nominal track of a small robot is within 6 % of the truth
TRACK_OFF = 0.06


def _ends(campaign: Campaign) -> tuple[np.ndarray, np.ndarray]:
    """Path and turn of each run by the counts, with the nominal vehicle."""
    roll = [
        campaign.runs.number(f"counts_{side}") / per_rev * 2 * np.pi * radius
        for side, per_rev, radius in (
            ("left", campaign.encoder.counts_per_rev_left, campaign.model.radius_left_m),
            ("right", campaign.encoder.counts_per_rev_right, campaign.model.radius_right_m),
        )
    ]
    return 0.5 * (roll[0] + roll[1]), (roll[1] - roll[0]) / campaign.model.track_m


def test_the_differential_drive_turns_as_its_reference_says(shared_data: Path) -> None:
    """102 runs of 14 recordings; on every one that turns the heading by counts is the reference's, signs included."""
    campaign = recordings.optiodom_differential(shared_data)
    assert len(campaign.runs) == 102
    assert len(set(campaign.runs.label("session"))) == 14
    _, turn = _ends(campaign)
    heading = campaign.runs.number("ref_theta_rad")
    turning = np.abs(turn) > 1
    np.testing.assert_allclose(heading[turning], turn[turning], rtol=TRACK_OFF)
    kinds = {str(kind) for kind in campaign.runs.label("kind")}
    assert kinds == {"square_cw", "square_ccw", "circular_cw", "circular_ccw", "line", "spin_cw", "spin_ccw"}


def test_the_tricycle_goes_as_its_front_wheel_says(shared_data: Path) -> None:
    """Heading by the front wheel's way and angle is the reference's to the published 0.02 rad of steering zero."""
    campaign = recordings.optiodom_tricycle(shared_data)
    assert len(campaign.runs) == 10
    for run in range(10):
        log = campaign.logs.of(run)
        way = np.diff(log["counts_front"]) / campaign.encoder.front * 2 * np.pi * campaign.vehicle.front_radius_m
        turn = (way * np.sin(log["steer_rad"][1:])).sum() / campaign.vehicle.wheelbase_m
        zero_rad = 0.03 * np.abs(way).sum() / campaign.vehicle.wheelbase_m
        assert abs(turn - log["ref_theta_rad"][-1]) < zero_rad


@pytest.mark.parametrize("name", ["lstraight", "l90", "l90_1"])
def test_the_scan_matcher_turns_with_the_wheels(name: str, shared_data: Path) -> None:
    """A yawed laser still sees the turn of the vehicle: heading on heading has slope one but for the nominal track."""
    campaign = recordings.khepera(shared_data, name, tuples_per_run=20)
    _, turn = _ends(campaign)
    heading = campaign.runs.number("ref_theta_rad")
    assert np.polyfit(turn, heading, 1)[0] == pytest.approx(1.0, abs=TRACK_OFF)
    assert abs(campaign.reference.sensor_yaw_rad) > (1.5 if name.startswith("l90") else 0.0)


def test_one_continuous_khepera_recording_is_the_sum_of_its_steps(shared_data: Path) -> None:
    whole = recordings.khepera(shared_data, "lstraight_0")
    parts = recordings.khepera(shared_data, "lstraight_0", tuples_per_run=1)
    assert (len(whole.runs), len(parts.runs)) == (1, whole.logs.lengths[0] - 1)
    # a count is rounded in each part
    assert abs(whole.runs.number("counts_left")[0] - parts.runs.number("counts_left").sum()) < len(parts.runs)


def test_the_straight_line_has_its_194_segments(shared_data: Path) -> None:
    campaign = recordings.straight_line(shared_data)
    assert len(campaign.runs) == 194
    assert np.isfinite(campaign.runs.number("distance_m")).all()


@pytest.mark.parametrize("bag", ["bag1", "bag2"])
def test_the_mecanum_robot_turns_with_its_wheels_and_strafes(bag: str, shared_data: Path) -> None:
    """Turn by the sides of the vehicle follows the reference; of the way sideways the wheels' means know nothing."""
    campaign = recordings.mecanum_as_differential(shared_data, bag)
    log = campaign.logs.of(0)
    _, turn = _ends(campaign)
    ticks_rad = 2 * np.pi / campaign.encoder.counts_per_rev_left * campaign.model.radius_left_m / campaign.model.track_m
    turned = log["ref_theta_rad"][-1] - log["ref_theta_rad"][0]
    # up to tens of ticks at standstill by rollers, and the nominal track
    assert abs(turn[0] - turned) < 20 * ticks_rad + TRACK_OFF * np.ptp(log["ref_theta_rad"])
    c, s = np.cos(log["ref_theta_rad"][:-1]), np.sin(log["ref_theta_rad"][:-1])
    sideways = -s * np.diff(log["ref_x_m"]) + c * np.diff(log["ref_y_m"])
    assert np.abs(sideways).sum() > 0.3
