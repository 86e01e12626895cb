"""The steering angle of an Ackermann vehicle: an offset of any size is found exactly, or refused with words."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.campaign.read import read_campaign
from calib.errors import BadInputError
from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects.steering import FARTHEST_STRAIGHT_RAD
from tests.kinematics.ackermann import Truth, campaign, spoilt

RUNS = 4
#: of the zero: windows of some 0.3 m know it to a milliradian or two each
ZERO_RAD = 4e-3
#: with the nominal wheelbase: one that is 1 % off, and too little to be named, takes as much of a large zero
TRUTH = Truth(wheelbase=1.0)


def offset_by(folder: Path, offset_rad: float) -> Diagnosis:
    made = campaign(folder / "car", TRUTH, runs=RUNS)
    return diagnose_in_full(read_campaign(spoilt(made, "steer_rad", lambda angle: angle + offset_rad)), plan=False)


@pytest.mark.parametrize("offset_rad", [0.05, 0.3])
def test_an_offset_beyond_the_linear_is_found_with_its_size_and_no_scale_beside_it(
    tmp_path: Path, offset_rad: float
) -> None:
    """The tangent about the logged angle made 2 % to 7 % of scale of it; about the straight one it makes none."""
    diagnosis = offset_by(tmp_path, offset_rad)
    sizes = {cause.effect: cause.parameters for cause in diagnosis.causes}
    assert sizes["steering_zero"]["zero"].value == pytest.approx(offset_rad - TRUTH.zero_rad, abs=ZERO_RAD)
    assert set(sizes) <= {"steering_zero", "reference_lever_arm", "radius_scale", "reference_yaw"}


@pytest.mark.parametrize("offset_rad", [0.5, -0.5 * np.pi])
def test_an_angle_counted_from_elsewhere_is_refused_with_its_size(tmp_path: Path, offset_rad: float) -> None:
    """Repeats scatter by it, so that no noise can be told: a play or a scale was named before."""
    assert abs(offset_rad) > FARTHEST_STRAIGHT_RAD
    with pytest.raises(BadInputError, match="where the wheels stand straight ahead") as refused:
        offset_by(tmp_path, offset_rad)
    found_rad = float(str(refused.value).split("found ")[1].split()[0])
    assert found_rad == pytest.approx(offset_rad - TRUTH.zero_rad, abs=0.01)


@pytest.mark.parametrize("still_rad", [0.0, 0.5 * np.pi])
def test_an_angle_that_never_moves_while_the_vehicle_turns_is_refused(tmp_path: Path, still_rad: float) -> None:
    made = campaign(tmp_path / "car", Truth(), runs=RUNS)
    with pytest.raises(BadInputError, match="throughout, while the vehicle turned"):
        diagnose_in_full(read_campaign(spoilt(made, "steer_rad", lambda angle: 0.0 * angle + still_rad)), plan=False)


def test_an_effect_that_acts_along_its_own_path_is_fitted_about_that(tmp_path: Path) -> None:
    """Curvature over 1 + K v^2, up to a sixth less: about the nominal path K came out 8 % too small."""
    truth = Truth(radius=1.0, wheelbase=1.0, zero_rad=0.0, sensor=(0.0, 0.0, 0.0), understeer=0.03, fastest_mps=2.5)
    diagnosis = diagnose_in_full(read_campaign(campaign(tmp_path / "car", truth, runs=8)), plan=False)
    named = {cause.effect: cause for cause in diagnosis.causes}
    low, high = named["understeer"].parameters["per_speed_squared"].ci95
    assert low < truth.understeer < high
    # known well enough to tell: the difference above is several of these
    assert high - low < 0.02 * truth.understeer
