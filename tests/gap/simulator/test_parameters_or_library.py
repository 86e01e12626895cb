"""What a parameter of the simulator, or several, can do is theirs; what none may do is the library's."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.gap.simulator.made import numpy_settings
from tests.gap.simulator.test_diagnose_simulator import diagnosed, other_settings

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


def test_a_parameter_goes_no_further_than_its_largest(tmp_path: Path) -> None:
    """A track 12 mm off, of which 5 mm are said to be plausible: the simulator may fail beyond."""
    track = '[[parameter]]\nname = "t"\nnominal = 0.7\nstep = 0.001\nlargest = 0.005\nunit = "m"\n'
    done = diagnosed(tmp_path, {"track": 0.712}, other_settings(tmp_path, 'p["track"] = given["t"]', track))
    assert done.diagnosis.fix.parameters == pytest.approx({"t": 0.705}, abs=1e-12)
    assert not done.diagnosis.recommended
    assert "t of your simulator stands at its largest: raise that where more is possible" in done.diagnosis.fix.why


@pytest.mark.parametrize(("sign", "named"), [(1, "simulator:k"), (-1, "load_radius")])
def test_a_sign_that_forbids_what_is_asked_leaves_the_effect_to_the_library(
    tmp_path: Path, sign: int, named: str
) -> None:
    """Else a neighbour of the effect that the parameter stands for would take its place."""
    law, size = 'p["load_slope"] = 1e-7 * given["k"]', f"step = {sign}.0\nlargest = 60.0\nsign = {sign}\n"
    parameter = f'[[parameter]]\nname = "k"\nnominal = 0.0\neffect = "load_radius"\n{size}'
    done = diagnosed(tmp_path, {"load_slope": 1e-6}, other_settings(tmp_path, law, parameter))
    assert [cause.effect for cause in done.diagnosis.causes] == [named]
