"""Four wheels whose columns are exchanged or run backwards: recognised, named, corrected; sound ones are left alone."""

from __future__ import annotations

import numpy as np
import pytest

from calib.errors import RefusedError
from calib.kinematics import Recording, recording_of
from calib.kinematics.blunders import WHEELS, refuse_heading_unit, wheels_faults
from calib.kinematics.joint_fit import drive_of
from calib.kinematics.model import end_pose_segments
from calib.kinematics.readings import factor_faults
from tests.kinematics.campaigns import mecanum


@pytest.fixture(scope="module")
def campaign() -> object:
    return mecanum(np.random.default_rng(4))


@pytest.fixture(scope="module")
def recording(campaign: object) -> Recording:
    return recording_of(campaign, "wheels")  # type: ignore[arg-type]


@pytest.mark.parametrize("turned_by", [0.0, 1.5])
@pytest.mark.parametrize(
    ("order", "signs", "code", "named"),
    [
        ([0, 1, 2, 3], [1, 1, 1, 1], None, ""),
        ([1, 0, 2, 3], [1, 1, 1, 1], "swapped_wheels", "counts_front_left and counts_front_right"),
        ([0, 2, 1, 3], [1, 1, 1, 1], "swapped_wheels", "counts_front_right and counts_rear_left"),
        ([2, 3, 0, 1], [1, 1, 1, 1], "swapped_wheels", "counts_front_left and counts_rear_left"),
        ([0, 1, 2, 3], [1, 1, -1, 1], "reversed_rear_left", "the rear left counter"),
        ([0, 1, 2, 3], [-1, -1, -1, -1], "reversed_both", "all four"),
    ],
)
def test_columns_are_put_right(
    campaign: object,
    recording: Recording,
    order: list[int],
    signs: list[int],
    code: str | None,
    named: str,
    turned_by: float,
) -> None:
    """Any wheels are exchanged and however the sensor is turned, the wheels' own angles come back."""
    true = recording.steps.turned_rad
    spoilt = recording.with_turned(true[order] * np.array(signs, dtype=float)[:, None])
    segments = end_pose_segments(spoilt)
    cosine, sine = np.cos(turned_by), np.sin(turned_by)
    forward, left = segments.measured[:, 0].copy(), segments.measured[:, 1].copy()
    segments.measured[:, 0], segments.measured[:, 1] = cosine * forward + sine * left, cosine * left - sine * forward
    drive = drive_of(campaign, "wheels", spoilt)  # type: ignore[arg-type]
    right, faults = wheels_faults(spoilt, segments, drive)
    assert [fault.code for fault in faults] == ([] if code is None else [code])
    assert all(named in fault.text for fault in faults)
    np.testing.assert_array_equal(right.steps.turned_rad, true)
    assert len(WHEELS) == len(true)


@pytest.mark.parametrize(("factor", "what"), [(np.pi / 180, "taken for degrees"), (180 / np.pi, "taken for radians")])
def test_a_heading_in_another_unit_is_refused(factor: float, what: str) -> None:
    """The wheels say how far the vehicle turned; a heading 57 times more or less is no radian."""
    told = np.array([1.5, -0.4, 0.7, 0.0])
    with pytest.raises(RefusedError, match=what):
        refuse_heading_unit(told, factor * told * np.array([1.0, 1.05, 0.95, 1.0]))
    # a track of half the size, a sensor upside down, hardly a turn: none of them is a unit
    for measured in (told, 0.5 * told, -told, 1e-3 * told):
        refuse_heading_unit(told, measured)
    refuse_heading_unit(1e-2 * told, factor * 1e-2 * told)
    # one counter backwards: turns that follow no factor, though their sum may
    refuse_heading_unit(told, factor * told + 60.0 * np.array([0.4, 1.5, 0.0, 1.0]))


@pytest.mark.parametrize(
    ("ratio", "words"),
    [(1e-3, "taken for mm"), (1e3, "mm taken for m"), (57.3, "rad taken for degrees"), (7.0, "check")],
)
def test_a_radius_of_another_unit_is_a_fault(ratio: float, words: str) -> None:
    """No radius is a thousandth of its nominal value; what makes it so is said."""
    (fault,) = factor_faults({"wheel_radius_m": ratio})
    assert words in fault.text
    assert not factor_faults({"wheel_radius_m": 1.3})
