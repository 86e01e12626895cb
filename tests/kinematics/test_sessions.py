"""What differs between sessions is no noise: it is stated, and the intervals count sessions."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from calib.campaign.read import read_campaign
from calib.kinematics.adequacy import GeometryVerdict
from calib.kinematics.estimate import estimate_geometry
from tests.kinematics import steered


def as_read(angle: steered.Array, _session: int) -> steered.Array:
    """Return the angle of wheels that follow the sensor."""
    return angle


def test_sessions_that_are_alike_are_calibrated_by_their_runs(tmp_path: Path) -> None:
    """Of routes that are driven once."""
    found = estimate_geometry(read_campaign(steered.write(tmp_path / "c", as_read, radius_m=0.1005)))
    assert found.passed
    assert found.clusters == ("run", 24)


@pytest.mark.parametrize(
    "settings",
    [{"days": (1.0, 1.01, 0.99, 1.006)}, {"turned_rad": (0.0, 0.0, 0.03, 0.03)}],
    ids=["radius of the day", "reference turned"],
)
def test_sessions_that_differ_are_doubtful_and_counted(settings: dict[str, tuple[float, ...]], tmp_path: Path) -> None:
    """A radius of the day, and the frame of the reference turned from the third session on."""
    found = estimate_geometry(read_campaign(steered.write(tmp_path / "c", as_read, runs=16, **settings)))  # type: ignore[arg-type]
    assert found.verdict is GeometryVerdict.DOUBTFUL
    assert any("sessions differ" in sentence for sentence in found.why)
    assert found.clusters == ("session", 4)


@pytest.mark.parametrize("turned_rad", [0.012, -0.1])
def test_a_reference_turned_alike_in_all_sessions_is_no_difference_between_them(
    turned_rad: float, tmp_path: Path
) -> None:
    """Its axes are named with what to state, and the runs stay the groups of the intervals."""
    found = estimate_geometry(read_campaign(steered.write(tmp_path / "c", as_read, turned_rad=(turned_rad,) * 4)))
    assert found.verdict is GeometryVerdict.WRONG
    assert not any("sessions differ" in sentence for sentence in found.why)
    (text,) = (sentence for sentence in found.why if "axes are turned" in sentence)
    stated = re.search(r"add (\S+) to sensor_yaw_rad", text)
    # the mean of 24 end positions of 2 mm some 10 m off, and of a heading walk of 3e-4 rad per sqrt(m)
    assert stated and float(stated[1]) == pytest.approx(-turned_rad, abs=1e-3)
    assert found.clusters == ("run", 24)


def test_a_steering_zero_of_each_session_is_stated(tmp_path: Path) -> None:
    """10 mrad to either side: the lengths hold beside it, and the spread is named."""
    zeros = (0.01, -0.01, 0.005, -0.005)
    folder = steered.write(tmp_path / "c", lambda angle, session: angle + zeros[session], runs=16, drive="ackermann")
    found = estimate_geometry(read_campaign(folder))
    assert found.verdict is GeometryVerdict.DOUBTFUL
    assert any("steering_zero_rad differs between sessions" in sentence for sentence in found.why)
    assert found.residual_rms.theta_rad < 3.0 * steered.SIGMA_RAD
    low, high = found["rear_radius_m"].ci95
    assert low < steered.RADIUS_M < high
    assert high - low < 0.01 * steered.RADIUS_M
