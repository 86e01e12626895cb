"""A departure that residuals need not show is named where it explains them, and only there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.campaign.read import read_campaign
from calib.kinematics.estimate import estimate_geometry
from tests.blunders import plant
from tests.blunders.blunders import TRICYCLE, Change, columns_times
from tests.kinematics import steered


def faults(folder: Path, change: Change | None) -> dict[str, str]:
    """Return codes and sentences of the faults that a tricycle's geometry along the path names."""
    recording = plant.tricycle(np.random.default_rng(3))
    if change is not None:
        change(recording)
    found = estimate_geometry(read_campaign(plant.write(recording, folder / "c")), using="windows")
    assert found.passed is (change is None)
    return {fault.code: fault.text for fault in found.faults}


def test_a_sound_recording_has_none(tmp_path: Path) -> None:
    assert not faults(tmp_path, None)


def test_the_play_of_a_steering_is_named_with_its_size(tmp_path: Path) -> None:
    """20 mrad, to a tenth: each curvature is reached from either side."""
    text = faults(tmp_path, TRICYCLE["steering with a play of 0.02 rad"])["steering_play"]
    play_mrad = float(text.partition("play of ")[2].partition(" mrad")[0])
    assert play_mrad == pytest.approx(20.0, rel=0.1)


def test_an_axis_that_is_squeezed_is_named(tmp_path: Path) -> None:
    """Or the other one as stretched, which is the same but for the scale of the wheels."""
    text = faults(tmp_path, columns_times(1.0, 0.95, 1.0))["axis_scale"]
    assert ("ref_y_m" in text and "short" in text) or ("ref_x_m" in text and "long" in text)


@pytest.mark.parametrize("lag_s", [0.0, 0.2])
def test_wheels_that_follow_their_angle_late_are_named(lag_s: float, tmp_path: Path) -> None:
    """Where no route is driven twice too, with the delay to a quarter; a vehicle that steers at once is calibrated."""
    folder = steered.write(tmp_path / "c", lambda angle, _: steered.late(angle, lag_s), radius_m=0.1005)
    found = estimate_geometry(read_campaign(folder))
    text = {fault.code: fault.text for fault in found.faults}.get("steering_shift", "")
    assert found.passed is (lag_s == 0.0)
    if lag_s:
        assert float(text.partition("steers ")[2].partition(" s ")[0]) == pytest.approx(lag_s, rel=0.25)


def test_a_wheelbase_that_no_vehicle_has_leads_to_the_steering_too(tmp_path: Path) -> None:
    """Play bends short changes of the angle most, as a longer wheelbase does."""
    folder = steered.write(tmp_path / "c", lambda angle, _: 0.8 * angle, drive="ackermann", runs=8)
    settings = folder / "campaign.toml"
    settings.write_text(settings.read_text().replace("wheelbase_m = 1.0", "wheelbase_m = 0.7"))
    found = estimate_geometry(read_campaign(folder))
    assert any("play or lag of the steering acts alike: see 'calib diagnose'" in sentence for sentence in found.why)
