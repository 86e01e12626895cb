from __future__ import annotations

import csv
import io
import re

import numpy as np
import pytest
from scipy.special import stdtrit

from calib.coefficients.export import FORMATS, export, parse_loads
from calib.coefficients.file import CoefficientFile
from calib.coefficients.loads import LoadPair
from calib.errors import BadInputError, RefusedError

NUMBER = r"-?\d+\.\d+(?:e[+-]\d+)?"


def strict_yaml(text: str) -> dict[str, dict[str, float | list[float]]]:
    """Read the subset that a ROS 2 parameter file needs; a double without decimal point is an error."""
    found: dict[str, dict[str, float | list[float]]] = {}
    root = ""
    for line in text.splitlines():
        if not line or line.lstrip().startswith("#") or line == "  ros__parameters:":
            continue
        if match := re.fullmatch(r"([a-z_]+):", line):
            root = match[1]
            found[root] = {}
        else:
            match = re.fullmatch(rf"    ([a-z_]+): (?:({NUMBER})|\[({NUMBER}(?:, {NUMBER})*)\])", line)
            assert match, line
            found[root][match[1]] = float(match[2]) if match[2] else [float(part) for part in match[3].split(", ")]
    return found


def test_ros2_parameters_give_back_the_radii_of_their_load(file: CoefficientFile) -> None:
    made = export(file, "ros2", [LoadPair(300.0, 300.0), LoadPair(500.0, 700.0)])
    assert [one.name for one in made] == ["controllers_300N.yaml", "controllers_L500N_R700N.yaml"]
    for one, (left, right) in zip(made, ((300.0, 300.0), (500.0, 700.0)), strict=True):
        found = strict_yaml(one.data.decode())
        diff = found["diff_drive_controller"]
        radii = file.radius_m(left, right)
        # rtol: two roundings of a double
        np.testing.assert_allclose(diff["wheel_radius"] * diff["left_wheel_radius_multiplier"], radii[0], rtol=4e-16)
        np.testing.assert_allclose(diff["wheel_radius"] * diff["right_wheel_radius_multiplier"], radii[1], rtol=4e-16)
        assert diff["wheel_separation"] * diff["wheel_separation_multiplier"] == file.vehicle.track.value
        steering = found["tricycle_steering_controller"]
        assert steering["traction_wheels_radius"] == pytest.approx((radii[0] + radii[1]) / 2, rel=1e-15)
        assert found["tricycle_controller"] == {"wheelbase": 1.0}
        assert f"left {left:.3f} N, right {right:.3f} N" in one.data.decode().splitlines()[0]


def test_ros2_parameters_read_the_same_with_a_yaml_library(file: CoefficientFile) -> None:
    yaml = pytest.importorskip("yaml")
    for one in export(file, "ros2"):
        found = {root: body["ros__parameters"] for root, body in yaml.safe_load(one.data).items()}
        assert found == strict_yaml(one.data.decode())
        parts = [np.ravel(value) for body in found.values() for value in body.values()]
        assert all(part.dtype == np.float64 for part in parts)


def test_ros2_states_the_variances_of_a_straight_of_ten_metres(file: CoefficientFile) -> None:
    """Along: the mean radius; in heading: the difference of the radii; across: half the way times the heading."""
    walks = {"along": {"value": 0.0, "unit": "m/m^0.5"}, "heading": {"value": 0.0, "unit": "rad/m^0.5"}}
    quiet = file.changed(noise=file.to_dict()["noise"] | walks)
    (one,) = export(quiet, "ros2", [LoadPair(300.0, 300.0)])
    x, y, *unseen, yaw = strict_yaml(one.data.decode())["diff_drive_controller"]["pose_covariance_diagonal"]
    left, right = (float(side.mean_std_m(300.0)) for side in (file.law.left, file.law.right))
    radius = 0.5 * sum(float(part) for part in file.radius_m(300.0, 300.0))
    assert x == pytest.approx((10.0 / radius) ** 2 * (left**2 + right**2) / 4, rel=1e-12)
    assert yaw == pytest.approx((10.0 / radius / file.vehicle.track.value) ** 2 * (left**2 + right**2), rel=1e-12)
    assert y == pytest.approx((10.0 / 2) ** 2 * yaw, rel=1e-12)
    assert unseen == [1e6, 1e6, 1e6]


def test_without_loads_ros2_makes_a_file_for_each_line_of_the_load_table(file: CoefficientFile) -> None:
    assert len(export(file, "ros2")) == 2
    assert len(export(file.changed(load_table=[]), "ros2")) == 3


def test_a_load_that_was_not_measured_gets_no_parameters_unless_clamped(file: CoefficientFile) -> None:
    with pytest.raises(RefusedError):
        export(file, "ros2", [LoadPair(2000.0, 2000.0)])
    clamped = export(file.changed(outside="clamp"), "ros2", [LoadPair(2000.0, 2000.0)])[0].data.decode()
    assert "CLAMPED" in clamped


@pytest.mark.parametrize("to", ["ros2", "c", "csv"])
def test_every_view_names_checksum_and_simulated_data(file: CoefficientFile, to: str) -> None:
    for one in export(file, to):
        text = one.data.decode()
        assert file.checksum[:23] in text and "simulated" in text.lower()
        real = export(file.changed(simulated=False), to)[0].data.decode()
        assert "SIMULATED DATA" not in real and "true,sha256" not in real


def test_the_table_holds_radius_and_its_bands(file: CoefficientFile) -> None:
    """Against the textbook formulas, k from another implementation of Student's t."""
    rows = list(csv.DictReader(io.StringIO(export(file, "csv")[0].data.decode())))
    assert len(rows) == 41
    k = stdtrit(58, 0.975)
    seen = 0
    for row in rows:
        load = float(row["load_left_N"])
        offset = load - 300.0
        variance = 9e-12 - 2e-14 * offset + 4e-17 * offset**2
        # rtol: rounding of a handful of operations
        assert float(row["radius_left_m"]) == pytest.approx(0.0990 + 1.3e-6 * offset, rel=1e-12)
        assert float(row["radius_left_std_m"]) == pytest.approx(variance**0.5, rel=1e-9)
        assert float(row["radius_left_mean_u95_m"]) == pytest.approx(k * variance**0.5, rel=1e-9)
        assert float(row["radius_left_prediction_u95_m"]) == pytest.approx(k * (variance + 4e-10) ** 0.5, rel=1e-9)
        inside = 212.551 <= load <= 1050.0
        assert (row["radius_right_m"] != "") == inside
        seen += inside
    assert 0 < seen < 41
    clamped = list(csv.DictReader(io.StringIO(export(file.changed(outside="clamp"), "csv")[0].data.decode())))
    assert all(row["radius_right_m"] for row in clamped)


def test_a_load_valid_for_no_wheel_gets_no_row(file: CoefficientFile) -> None:
    with pytest.raises(RefusedError):
        export(file, "csv", [LoadPair(5.0, 5.0)])


def test_loads_are_given_for_both_wheels_or_for_each() -> None:
    assert parse_loads(["300", "500,700.5"]) == (LoadPair(300.0, 300.0), LoadPair(500.0, 700.5))
    for bad in ("x", "1,2,3", "-5", "nan", "inf", ""):
        with pytest.raises(BadInputError, match="--load"):
            parse_loads([bad])


def test_every_registered_format_can_be_made(file: CoefficientFile) -> None:
    for to in FORMATS:
        first, second = export(file, to), export(file, to)
        assert first and first == second
    with pytest.raises(BadInputError, match="expected one of"):
        export(file, "xml")
