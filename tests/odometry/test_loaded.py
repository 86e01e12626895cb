"""Odometry with radii that follow the load, also while it changes on the way."""

from __future__ import annotations

import numpy as np
import pytest

from calib.campaign.settings import Encoder
from calib.errors import BadInputError
from calib.odometry import end_poses
from calib.odometry.routes import loads_in_steps, radii_under_load, travel_from_counts
from calib.radius.law import RadiusLaw, WheelLaw


def wheel(radius: float, slope: float) -> WheelLaw:
    return WheelLaw(300.0, radius, slope, np.zeros((2, 2)), 58.0, 2e-5, 200.0, 1100.0, 60)


LAW = RadiusLaw(left=wheel(0.1, 1.3e-6), right=wheel(0.0995, -1.2e-6))
ENCODER = Encoder(4096.0, 2048.0)


def test_a_revolution_rolls_one_circumference_and_runs_start_at_rest() -> None:
    left, right = travel_from_counts(
        [0, 4096, 4096, 100, 4196], [0, 2048, 2048, 7, 2055], ENCODER, 0.1, 0.2, offsets=[0, 3, 5]
    )
    circumference = 2 * np.pi * 0.1
    np.testing.assert_allclose(left, [0, circumference, 0, 0, circumference], rtol=1e-15)
    np.testing.assert_allclose(right, [0, 2 * circumference, 0, 0, 2 * circumference], rtol=1e-15)


def test_radii_may_be_one_one_a_run_or_one_a_sample() -> None:
    counts = np.array([0.0, 100.0, 200.0, 0.0, 50.0])
    offsets = [0, 3, 5]
    by_run = travel_from_counts(counts, counts, ENCODER, [0.1, 0.2], [0.1, 0.2], offsets=offsets)
    by_sample = travel_from_counts(
        counts, counts, ENCODER, [0.1, 0.1, 0.1, 0.2, 0.2], [0.1, 0.1, 0.1, 0.2, 0.2], offsets=offsets
    )
    np.testing.assert_array_equal(by_run, by_sample)
    with pytest.raises(BadInputError, match="one a run"):
        travel_from_counts(counts, counts, ENCODER, [0.1] * 4, 0.1, offsets=offsets)


def test_loading_at_a_stop_changes_the_radii_from_there_on() -> None:
    """Half the run unladen, half laden: the end is that of two runs, one after the other, with two constant radii."""
    counts_left = np.concatenate([np.arange(0, 20001, 10), np.full(20, 20000), np.arange(20000, 50001, 10)])
    counts_right = np.concatenate([np.arange(0, 20001, 10), np.full(20, 20000), np.arange(20000, 50001, 10)]) / 2
    stop = 2005
    logged = np.where(np.arange(len(counts_left)) < stop, [[300.0], [300.0]], [[900.0], [400.0]])
    radii = radii_under_load(LAW, *(loads_in_steps([300.0], load, [0, len(counts_left)]) for load in logged))
    left, right = travel_from_counts(counts_left, counts_right, ENCODER, *radii)
    whole = end_poses(left, right, 0.7)
    pose = np.zeros(3)
    for part, loads in ((slice(0, stop + 1), (300.0, 300.0)), (slice(stop, None), (900.0, 400.0))):
        a, b = travel_from_counts(counts_left[part], counts_right[part], ENCODER, *radii_under_load(LAW, *loads))
        pose = end_poses(a, b, 0.7, start=pose).stacked()
    # a few thousand additions of numbers of the order of 10 m
    np.testing.assert_allclose(whole.stacked(), pose, rtol=0.0, atol=1e-11)
    constant = travel_from_counts(counts_left, counts_right, ENCODER, *radii_under_load(LAW, 300.0, 300.0))
    assert np.hypot(*(end_poses(*constant, 0.7).stacked() - pose)[:2]) > 0.01
