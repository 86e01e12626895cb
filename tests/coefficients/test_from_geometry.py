"""A geometry becomes a coefficient file that says what was found together, and old files still read."""

from __future__ import annotations

import csv
import io
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.coefficients.build import HELD, export, from_geometry
from calib.coefficients.file import CoefficientFile, load_coefficients
from calib.coefficients.formats import ExportOptions, LoadPair
from calib.errors import ImplausibleError
from calib.kinematics.estimate import estimate_geometry
from calib.kinematics.result import Geometry
from calib.runtime import Odometer
from calib.runtime.coefficients import CoefficientError, Coefficients
from calib.types import unit_of
from calib.vehicle import wheel_loads_N
from tests.kinematics.campaigns import Truth, campaign, mixed, square
from tests.kinematics.unaided import Drive, Gyro, unaided


@pytest.fixture(scope="module")
def made() -> Campaign:
    return campaign(mixed(3), Truth(), np.random.default_rng(1))


@pytest.fixture(scope="module")
def geometry(made: Campaign) -> Geometry:
    return estimate_geometry(made)


def test_the_file_holds_radii_track_and_their_joint_covariance(made: Campaign, geometry: Geometry) -> None:
    """The laws' joint covariance has the estimate's own terms, with those that couple left, right and track."""
    file = from_geometry(geometry, made)
    assert file.law.left.radius_ref_m == geometry["radius_left_m"].value
    assert file.geometry.track_m == geometry["track_m"].value
    joint = file.law.covariance(file.vehicle.track_std.value)
    np.testing.assert_allclose(joint[np.ix_([0, 2, 4], [0, 2, 4])], geometry.covariance, rtol=1e-12)
    assert joint[0, 2] != 0.0


def test_lengths_held_with_the_nominal_mean_radius_are_called_so(made: Campaign, geometry: Geometry) -> None:
    """Closed loops tell ratios alone: a controller's file calls nothing of them calibrated."""
    rng = np.random.default_rng(2)
    loops = unaided(
        [Drive("square", square(2.0, (-1) ** n), frozenset({"loop"})) for n in range(8)], Truth(), Gyro(), rng
    )
    for campaign_, found, held in ((loops, estimate_geometry(loops), True), (made, geometry, False)):
        file = from_geometry(found, campaign_)
        assert (set(HELD) <= set(file.assumed)) is held
        (yaml, *_) = export(file, "ros2")
        assert (b"HELD by their nominal mean" in yaml.data, b"# calibrated:" in yaml.data) == (held, not held)


def test_without_loads_the_slope_is_zero_with_its_standard_deviation(made: Campaign, geometry: Geometry) -> None:
    """The uncertainty of a radius grows with the distance from the load driven."""
    law = from_geometry(geometry, made).law.left
    assert law.slope_m_per_N == 0.0
    near, far = law.mean_std_m([law.reference_load_N, law.reference_load_N + 1000.0])
    assert near == pytest.approx(geometry["radius_left_m"].std)
    assert far == pytest.approx(np.hypot(near, 0.01 * law.radius_ref_m), rel=1e-6)


def test_the_file_holds_what_radii_differ_by_from_run_to_run(made: Campaign, geometry: Geometry) -> None:
    """Of the mean radius both wheels have all of, of their difference half each, against each other."""
    file, by_name = from_geometry(geometry, made), geometry.noise_expected
    radii = np.array([file.law.left.radius_ref_m, file.law.right.radius_ref_m])
    shares = np.array([[by_name["radius_scatter"]] * 2, np.array([-0.5, 0.5]) * by_name["yaw_scatter"]])
    scatter = np.diag(np.square([file.law.left.residual_std_m, file.law.right.residual_std_m]))
    scatter[[0, 1], [1, 0]] = file.law.run_covariance_m2
    np.testing.assert_allclose(scatter, shares.T @ shares * np.outer(radii, radii), rtol=1e-12)
    assert Coefficients.parse(file.to_bytes().decode()).run_covariance_m2 == file.law.run_covariance_m2 != 0.0


def test_no_band_of_a_single_run_is_stated_that_was_not_measured(tmp_path: Path) -> None:
    """Of five runs walks along the path take up what differs between them: table, runtime and header state none."""
    few = campaign(mixed(1), Truth(), np.random.default_rng(1))
    file = from_geometry(estimate_geometry(few), few)
    rows = list(csv.DictReader(io.StringIO(export(file, "csv")[0].data.decode())))
    cells = [
        (row[f"radius_{side}_mean_u95_m"], row[f"radius_{side}_prediction_u95_m"])
        for row in rows
        for side in ("left", "right")
    ]
    assert all(mean and not single for mean, single in cells)
    coefficients = Coefficients.parse(file.to_bytes().decode())
    Odometer(coefficients)
    with pytest.raises(CoefficientError, match="expected 'mean' or a file with the scatter of single runs"):
        Odometer(coefficients, band="prediction")
    if (compiler := shutil.which("cc")) is None:
        pytest.skip("no C compiler here")
    (tmp_path / "odometry.h").write_bytes(export(file, "c")[0].data)
    (tmp_path / "odometry.c").write_text('#include "odometry.h"\n')
    for wanted in (0, 1):
        command = [compiler, f"-DCALIB_PREDICTION_BAND={wanted}", "-fsyntax-only", str(tmp_path / "odometry.c")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert ("no scatter of single runs" in done.stderr, done.returncode != 0) == (wanted == 1, wanted == 1)


def test_what_the_geometry_measured_is_not_assumed(made: Campaign, geometry: Geometry) -> None:
    assert from_geometry(geometry, made).assumed == []


def test_it_reads_back_as_it_was_written(made: Campaign, geometry: Geometry, tmp_path: Path) -> None:
    file = from_geometry(geometry, made)
    path = tmp_path / "coefficients.json"
    path.write_bytes(file.to_bytes())
    assert load_coefficients(path) == file


def test_a_payload_gives_the_wheel_loads_of_the_campaign_whatever_track_was_calibrated(
    made: Campaign, geometry: Geometry
) -> None:
    """The law was fitted with loads by the vehicle's own lengths; a calibrated track is the odometry's alone."""
    file, payload = from_geometry(geometry, made), (2.0, 0.05, -0.03)
    assert file.geometry.track_m != made.vehicle.track_m
    front, left, right = wheel_loads_N(made.vehicle, *payload)
    on_vehicle = Coefficients.parse(file.to_bytes().decode())
    assert on_vehicle.wheel_loads_N(*payload) == pytest.approx((float(left), float(right), float(front)), rel=1e-12)
    assert wheel_loads_N(file.loaded, *payload) == (front, left, right)
    assert f"CALIB_LOAD_TRACK_M {made.vehicle.track_m!r}\n" in export(file, "c")[0].data.decode()


def test_a_file_without_a_joint_geometry_is_as_it_was(file: CoefficientFile) -> None:
    """No key is added to a file of two wheels that were fitted separately, and they stay independent."""
    assert "joint_geometry" not in json.loads(file.to_bytes())
    assert file.law.joint is None
    assert file.law.covariance()[0, 2] == 0.0


def test_ros2_writes_the_calibrated_separation_and_states_where_it_is_nominal(
    made: Campaign, geometry: Geometry, file: CoefficientFile
) -> None:
    text = export(from_geometry(geometry, made), "ros2", ExportOptions(loads=(LoadPair(300.0, 300.0),)))[
        0
    ].data.decode()
    assert f"wheel_separation: {geometry['track_m'].value!r}" in text
    assert "# calibrated" in text
    assert "# NOT calibrated: the nominal track" in export(file, "ros2")[0].data.decode()


def test_a_blunder_is_not_exported(made: Campaign) -> None:
    off = campaign(mixed(2), Truth(), np.random.default_rng(2), nominal=(0.05, 0.05, 0.2))
    with pytest.raises(ImplausibleError, match="twice the track"):
        from_geometry(estimate_geometry(off), off)


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("rear_radius_m", "m"),
        ("slope_left_m_per_N", "m/N"),
        ("steering_zero_rad", "rad"),
        ("steering_scale", "1"),
        ("understeer_s2_per_m2", "s^2/m^2"),
        ("side_slip_s2_per_m", "s^2/m"),
    ],
)
def test_a_parameter_has_the_unit_that_its_name_ends_in(name: str, unit: str) -> None:
    """The longest suffix decides: a slip in s^2/m is no length."""
    assert unit_of(name) == unit
