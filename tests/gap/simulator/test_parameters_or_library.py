"""What a parameter of the simulator, or several, can do is theirs; what none may do is the library's."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.gap.simulator.made import numpy_settings
from tests.gap.simulator.test_diagnose_simulator import diagnosed

#: five typical half widths of the intervals, 3e-6 m: the radii that are set are those of the vehicle
RADIUS_ABS_M = 1.5e-5


@pytest.mark.parametrize("right_m", [0.0995, 0.0998])
def test_radii_of_both_wheels_are_two_parameters_and_no_wear(tmp_path: Path, right_m: float) -> None:
    """A zero point of its own must not let an effect of size zero stand for radii that are off."""
    hidden = {"wheel_radius_left": 0.0995, "wheel_radius_right": right_m}
    found = diagnosed(tmp_path, hidden).diagnosis
    assert {cause.effect for cause in found.causes} == {f"simulator:{name}" for name in hidden}
    assert found.recommended
    assert found.fix.parameters == pytest.approx(hidden, abs=RADIUS_ABS_M)


def test_a_sign_that_is_given_wrong_is_said(tmp_path: Path) -> None:
    """The track is too long, and its parameter may only grow."""
    sim = numpy_settings(tmp_path)
    before, after = sim.read_text().split('name = "track"')
    sim.write_text(before + 'name = "track"\nsign = 1' + after)
    found = diagnosed(tmp_path, {"track": 0.69}, sim).diagnosis
    assert [cause.effect for cause in found.causes] == ["track_width"]
    assert "track of your simulator would, but for the sign = 1 that it is given" in found.sentence
