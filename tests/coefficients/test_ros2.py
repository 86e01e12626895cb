"""What the ROS 2 controllers get: their own parameter names and types, and variances that agree with the odometry."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable
from typing import Any, get_args

import numpy as np
import pytest
import yaml

from calib.campaign.settings import Encoder
from calib.coefficients.build import Header, export, from_law
from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import FORMATS, ExportOptions, LoadPair, for_vehicle
from calib.coefficients.formats.for_vehicle import CONTROLLERS, OF_DRIVE
from calib.errors import BadInputError, RefusedError
from calib.radius.law import RadiusLaw
from calib.runtime import Coefficients, Odometer
from calib.vehicle import Drive, Vehicle

#: parameters as the controllers declare them, with their types; a value of another type is refused at configuration
ARRAY = list
DECLARED: dict[str, dict[str, Any]] = {
    "diff_drive_controller": {
        "wheel_separation": float,
        "wheel_radius": float,
        "wheel_separation_multiplier": float,
        "left_wheel_radius_multiplier": float,
        "right_wheel_radius_multiplier": float,
        "pose_covariance_diagonal": ARRAY,
        "twist_covariance_diagonal": ARRAY,
        "open_loop": bool,
        "position_feedback": bool,
    },
    "tricycle_controller": {
        "wheelbase": float,
        "wheel_radius": float,
        "pose_covariance_diagonal": ARRAY,
        "twist_covariance_diagonal": ARRAY,
        "open_loop": bool,
    },
    "tricycle_steering_controller": {
        "wheelbase": float,
        "traction_wheels_radius": float,
        "traction_track_width": float,
        "pose_covariance_diagonal": ARRAY,
        "twist_covariance_diagonal": ARRAY,
        "open_loop": bool,
        "position_feedback": bool,
    },
    "bicycle_steering_controller": {
        "wheelbase": float,
        "traction_wheel_radius": float,
        "pose_covariance_diagonal": ARRAY,
        "twist_covariance_diagonal": ARRAY,
        "open_loop": bool,
        "position_feedback": bool,
    },
    "ackermann_steering_controller": {
        "wheelbase": float,
        "traction_wheels_radius": float,
        "traction_track_width": float,
        "pose_covariance_diagonal": ARRAY,
        "twist_covariance_diagonal": ARRAY,
        "open_loop": bool,
        "position_feedback": bool,
    },
    "mecanum_drive_controller": {
        "kinematics": {"wheels_radius": float, "sum_of_robot_center_projection_on_X_Y_axis": float},
        "pose_covariance_diagonal": ARRAY,
        "twist_covariance_diagonal": ARRAY,
    },
}

#: variances are written with six significant digits
SIX_DIGITS = 1e-5
LOAD = LoadPair(400.0, 800.0)


def parameters(file: CoefficientFile, *pairs: LoadPair, **choices: Any) -> dict[str, dict[str, Any]]:
    """Return the parameters of the first file of an export, by controller."""
    first = export(file, "ros2", ExportOptions(loads=pairs, **choices))[0]
    return {root: body["ros__parameters"] for root, body in yaml.safe_load(first.data).items()}


def of_drive(file: CoefficientFile, drive: str, **vehicle: Any) -> CoefficientFile:
    return file.changed(vehicle=file.to_dict()["vehicle"] | {"drive": drive} | vehicle)


def fits(values: dict[str, Any], declared: dict[str, Any]) -> bool:
    """Return whether every parameter is declared and of its type; doubles have to be written as doubles."""
    for name, value in values.items():
        kind = declared.get(name)
        if isinstance(kind, dict):
            good = fits(value, kind)
        elif kind is ARRAY:
            good = len(value) == 6 and all(type(part) is float and part >= 0.0 for part in value)
        else:
            good = type(value) is kind
        if not good:
            return False
    return True


@pytest.mark.parametrize("drive", get_args(Drive))
def test_every_parameter_is_one_that_its_controller_declares(file: CoefficientFile, drive: str) -> None:
    """By name and by type, for each drive; the drive chooses the controllers."""
    front = {"value": 0.125, "unit": "m"}
    found = parameters(of_drive(file, drive, front_wheel_radius=front))
    assert tuple(found) == OF_DRIVE[drive]
    for controller, values in found.items():
        assert fits(values, DECLARED[controller]), (controller, values)
        assert set(values) == set(DECLARED[controller])


def test_a_controller_can_be_chosen_for_any_drive(file: CoefficientFile) -> None:
    for name in CONTROLLERS:
        assert list(parameters(file, LOAD, controllers=(name,))) == [name]
    with pytest.raises(BadInputError, match="expected one of diff_drive_controller"):
        parameters(file, LOAD, controllers=("omni_controller",))


def test_feedback_and_open_loop_are_as_chosen(file: CoefficientFile) -> None:
    for chosen in (True, False):
        found = parameters(file, LOAD, position_feedback=chosen, open_loop=not chosen)
        assert all(body.get("position_feedback", chosen) is chosen for body in found.values())
        assert all(body["open_loop"] is not chosen for body in found.values())
    with pytest.raises(RefusedError, match="no such parameter"):
        parameters(of_drive(file, "mecanum"), LOAD, open_loop=True)
    for to in set(FORMATS) - {"ros2"}:
        with pytest.raises(BadInputError, match="ros2"):
            export(file, to, options=ExportOptions(open_loop=True))


def driven(file: CoefficientFile, travels: list[tuple[float, float]]) -> np.ndarray:
    """Return the covariance that the vehicle's own odometry states at the end of travels (left, right) in m."""
    odometer = Odometer(Coefficients.parse(file.to_bytes().decode()), max_step_m=1e9)
    odometer.set_wheel_loads(LOAD.left_N, LOAD.right_N)
    per_metre = [4096.0 / (2.0 * math.pi * radius) for radius in odometer.radii_m]
    counts = np.zeros(2)
    odometer.update(*counts)
    for travel in travels:
        counts = counts + np.multiply(travel, per_metre)
        odometer.update(*counts)
    return np.array(odometer.covariance)


def test_the_pose_variances_are_those_of_the_vehicles_own_odometry(file: CoefficientFile) -> None:
    """The runtime drives a straight for x and y; yaw adds the mean of a left and a right turn."""
    diagonal = parameters(file, LOAD)["diff_drive_controller"]["pose_covariance_diagonal"]
    length, steps = for_vehicle.PATH_M, 2000
    straight = driven(file, [(length / steps, length / steps)] * steps)
    # the sum of a random walk in steps against its integral: 1.5 / steps of the part of y
    assert diagonal[:2] == pytest.approx([straight[0, 0], straight[1, 1]], rel=2e-3)
    arc = 0.5 * file.vehicle.track.value * for_vehicle.TURN_RAD
    turns = [driven(file, [(length, length), (-side * arc, side * arc)])[2, 2] for side in (1.0, -1.0)]
    assert diagonal[5] == pytest.approx(np.mean(turns), rel=SIX_DIGITS)
    assert diagonal[2:5] == [1e6] * 3


def test_an_uncertain_track_shows_in_the_yaw_alone(file: CoefficientFile) -> None:
    """By the square of the turning times the track's relative uncertainty."""
    exact, wide = (
        parameters(of_drive(file, "differential", track_std={"value": std, "unit": "m"}), LOAD)["diff_drive_controller"]
        for std in (0.0, 0.02)
    )
    for name, turn in (("pose_covariance_diagonal", math.pi / 2), ("twist_covariance_diagonal", 1.0)):
        growth = np.subtract(wide[name], exact[name])
        assert growth[5] == pytest.approx((turn * 0.02 / 0.7) ** 2, rel=SIX_DIGITS)
        assert not growth[:5].any()


def test_a_steering_without_calibration_is_stated_as_assumed(file: CoefficientFile) -> None:
    """One degree of steering zero turns a vehicle of one metre wheelbase by one degree a metre."""
    text = export(file, "ros2", ExportOptions(loads=(LOAD,)))[0].data.decode()
    assert "assumed, since not calibrated: front_radius_m, wheelbase_m, steering_zero_rad, steering_scale" in text
    yaw = parameters(file, LOAD)["tricycle_steering_controller"]["pose_covariance_diagonal"][5]
    assert yaw > (for_vehicle.PATH_M * math.radians(1.0)) ** 2
    way = [parameters(file, LOAD)[name]["pose_covariance_diagonal"][0] for name in OF_DRIVE["tricycle"]]
    assert way[0] == way[2] < way[1]


@pytest.mark.parametrize("drive", get_args(Drive))
def test_a_vehicle_that_drove_no_loads_exports_in_every_format(
    loadless: CoefficientFile, drive: str, options_of: Callable[[str], ExportOptions]
) -> None:
    """One ROS 2 file with a comment, since the radii are the same at any load; unknown numbers stay empty."""
    file = of_drive(loadless, drive)
    made = {to: export(file, to, options=options_of(to)) for to in FORMATS}
    text = {to: artifacts[0].data.decode() for to, artifacts in made.items()}
    assert all(len(artifacts) == 1 for artifacts in made.values())
    assert not re.search(r"\b(nan|inf)\b", text["csv"] + text["json"] + text["ros2"], re.IGNORECASE)
    rows = list(csv.DictReader(io.StringIO(text["csv"])))
    assert {row["radius_left_m"] for row in rows} == {"0.099"}
    assert "do not follow the load" in text["ros2"] and "any load" in text["ros2"]
    assert tuple(parameters(file)) == OF_DRIVE[drive]


def test_the_drive_is_in_the_file_unless_it_is_a_tricycle(law: RadiusLaw) -> None:
    """The file of a tricycle has no key of the drive."""
    for drive in get_args(Drive):
        file = from_law(law, Vehicle(drive=drive), Encoder(), Header("n", True))
        assert file.geometry.drive == drive
        assert ("drive" in file.to_dict()["vehicle"]) == (drive != "tricycle")
        assert Coefficients.parse(file.to_bytes().decode()).checksum == file.checksum
