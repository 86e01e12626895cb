"""Geometry of real vehicles: what others published of the same recordings, and how the ways of estimating agree."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.ingest.describe import describe
from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.cli.main import run as calib
from calib.kinematics.adequacy import GeometryVerdict
from calib.kinematics.estimate import estimate_geometry
from calib.kinematics.result import Geometry
from tests.kinematics.published import published, tuples_of
from tests.real import recordings
from tests.real.dart import SENSOR_M, SENSOR_YAW_RAD, STEERING_ZERO_RAD, dart
from tests.real.recordings import available

#: how far the general estimate may be from the published one, relative: the full recordings, and thirds of them
FULL, THIRD = 2e-3, 4e-3
#: published name -> parameter, and how many of the parameter make it
PUBLISHED = {"l_diam": ("radius_left_m", 2.0), "r_diam": ("radius_right_m", 2.0), "axle": ("track_m", 1.0)}


def _published(folder: Path, name: str) -> dict[str, float]:
    path = folder / f"khepera_{name.split('_', maxsplit=1)[0]}" / f"{name}_results.json"
    values: dict[str, float] = json.loads(path.read_text(encoding="utf-8"))
    return values


@pytest.fixture(scope="module")
def khepera(shared_data: Path) -> dict[str, Geometry]:
    names = [f"{base}{part}" for base in ("l90", "lstraight") for part in ("", "_0", "_1", "_2")]
    return {name: estimate_geometry(recordings.khepera(shared_data, name)) for name in names}


def test_the_general_estimate_meets_the_published_one(khepera: dict[str, Geometry], shared_data: Path) -> None:
    """Diameters and axle within 0.2 % on full recordings, 0.4 % on thirds; the laser's yaw within 0.02 rad."""
    for name, found in khepera.items():
        published = _published(shared_data, name)
        for key, (parameter, factor) in PUBLISHED.items():
            allowed = THIRD if "_" in name else FULL
            assert factor * found[parameter].value == pytest.approx(published[key], rel=allowed), (name, key)
        assert found["sensor_yaw_rad"].value == pytest.approx(published["l_theta"], abs=0.02)


def test_the_stated_covariance_is_that_of_the_thirds(khepera: dict[str, Geometry]) -> None:
    """Thirds scatter about their mean as stated: chi squared with two degrees of freedom for each of two vehicles."""
    for parameter, _ in PUBLISHED.values():
        total = 0.0
        for base in ("l90", "lstraight"):
            thirds = [khepera[f"{base}_{part}"] for part in range(3)]
            values = np.array([third[parameter].value for third in thirds])
            std = np.array([third[parameter].std for third in thirds])
            total += float(np.sum(np.square((values - values.mean()) / std)))
        # 0.2 and 14.9: chi squared with four degrees of freedom is beyond in one of 200 either way
        assert 0.2 < total < 14.9


@pytest.mark.parametrize("name", [f"{base}{part}" for base in ("l90", "lstraight") for part in ("", "_0", "_1", "_2")])
def test_the_published_procedure_gives_the_published_values(name: str, shared_data: Path) -> None:
    """Rebuilt from the paper, it meets the makers' printed six digits: the data are read as they were meant."""
    turned, moved = tuples_of(
        recordings.available(shared_data, f"khepera_{name.split('_', maxsplit=1)[0]}/{name}.tuple")
    )
    rebuilt = published(turned, moved)
    wanted = _published(shared_data, name)
    for key in ("l_diam", "r_diam", "axle", "l_x", "l_y", "l_theta"):
        assert rebuilt[key] == pytest.approx(wanted[key], rel=1e-5), key


@pytest.fixture(scope="module")
def differential(shared_data: Path) -> Campaign:
    return recordings.optiodom_differential(shared_data)


@pytest.fixture(scope="module")
def everything(differential: Campaign) -> Geometry:
    return estimate_geometry(differential, using="end_poses")


def test_optiodom_joint_estimate_of_all_routes(everything: Geometry) -> None:
    """All 102 runs: radii and track of an independent robust fit, and intervals as wide as the routes disagree."""
    found = everything
    for name, value in (("radius_left_m", 0.04193), ("radius_right_m", 0.04187), ("track_m", 0.2017)):
        low, high = found[name].ci95
        assert low < value < high
    assert found.clusters[0] == "route"


def test_optiodom_recordings_held_out_are_met_better_than_before(differential: Campaign) -> None:
    """Every third of the 14 recordings, by the others of these."""
    names = np.unique(differential.runs.label("session"))[::3]
    some = differential.select(np.isin(differential.runs.label("session"), names))
    rows = estimate_geometry(some, using="end_poses", leave_out="session").transfer
    assert {row.left_out for row in rows} == set(names)
    assert all(row.after_rms_m < row.before_rms_m for row in rows)


def test_optiodom_squares_and_circles_agree_within_their_intervals(
    differential: Campaign, everything: Geometry
) -> None:
    """Squares by UMBmark and by least squares, circles alone: the ratios that each determines lie in all intervals."""
    campaign = differential
    nominal = campaign.model.track_m / (0.5 * (campaign.model.radius_left_m + campaign.model.radius_right_m))
    squares = estimate_geometry(campaign, kinds=["square_cw", "square_ccw"], using="end_poses")
    circles = estimate_geometry(campaign, kinds=["circular_cw", "circular_ccw"], using="end_poses")
    mark = squares.umbmark
    assert mark.applies
    assert squares.ratio("radius_right_m", "radius_left_m").value == pytest.approx(mark.E_d, abs=3e-4)
    by_squares = squares.track_over_radius().value / nominal
    assert by_squares == pytest.approx(mark.E_b, abs=1e-3)
    low, high = everything.track_over_radius().ci95
    for other in (squares, circles):
        assert low < other.track_over_radius().value < high


def test_optiodom_tricycle_intervals_hold_the_reference(shared_data: Path) -> None:
    """Front radius, wheelbase and steering zero of the makers' own calibration, which used further runs."""
    found = estimate_geometry(recordings.optiodom_tricycle(shared_data), using="end_poses")
    for name, value in (("front_radius_m", 0.0623 / 2), ("wheelbase_m", 0.1522), ("steering_zero_rad", -0.0197)):
        low, high = found[name].ci95
        assert low < value < high, name


def test_mecanum_radius_and_arm_are_within_one_per_cent(shared_data: Path) -> None:
    """bag2: r and l + w of an independent windowed fit of the same recording."""
    found = estimate_geometry(recordings.mecanum(shared_data, "bag2"))
    assert found["wheel_radius_m"].value == pytest.approx(0.0680, rel=0.01)
    assert found["half_length_plus_half_width_m"].value == pytest.approx(0.360, rel=0.01)


def test_where_the_vehicle_hardly_turned_its_arm_is_named_as_open(shared_data: Path) -> None:
    """bag1 has next to no rotation: the radius is found, l + w is not printed."""
    found = estimate_geometry(recordings.mecanum(shared_data, "bag1"))
    assert "half_length_plus_half_width_m" in found.undetermined
    assert "half_length_plus_half_width_m" not in found.to_dict()["parameters"]
    assert found["wheel_radius_m"].value == pytest.approx(0.0680, rel=0.02)


def test_a_real_cars_recordings_are_taken_at_the_first_try(shared_data: Path, tmp_path: Path) -> None:
    """The proposed mapping finds clock, speed, steering and reference of DART's files; six lengths are filled in."""
    source = tmp_path / "dart"
    source.mkdir()
    for path in sorted(available(shared_data, "dart").glob("*_ramp.csv"))[:2]:
        shutil.copy(path, source)
    mapping = describe([source]).to_toml()
    for line in (
        'drive = "ackermann"',
        'kind = "speed"',
        'speed_rear_mps = {column = "vel encoder"',
        "ref_theta_rad = {",
    ):
        assert line in mapping
    for key, value in {"track_m": 0.15, "wheelbase_m": 0.1735, "wheel_radius_m": 0.03, "mass_kg": 1.58}.items():
        mapping = mapping.replace(f"#{key} =", f"{key} = {value}")
    (tmp_path / "map.toml").write_text(mapping.replace("#cog_x_m =", "cog_x_m = 0.093"))
    assert calib(["ingest", str(source), "--mapping", str(tmp_path / "map.toml"), "--into", str(tmp_path / "c")]) == 0
    made = read_campaign(tmp_path / "c")
    assert made.vehicle.drive == "ackermann" and {"counts_rear", "steer_rad", "ref_x_m"} <= set(made.logs.columns)


def test_a_real_car_under_motion_capture(shared_data: Path) -> None:
    """DART up to 1.2 m/s: the makers' reference point within 3 mm and 5 mrad, their zero of the steering."""
    found = estimate_geometry(dart(shared_data, fastest_mps=1.2), using="windows")
    assert found["sensor_x_m"].value == pytest.approx(SENSOR_M[0], abs=3e-3)
    assert found["sensor_y_m"].value == pytest.approx(SENSOR_M[1], abs=3e-3)
    assert abs(found["sensor_yaw_rad"].value) == pytest.approx(SENSOR_YAW_RAD, abs=5e-3)
    low, high = found["steering_zero_rad"].ci95
    assert low < STEERING_ZERO_RAD < high
    assert not any("sensor" in sentence for sentence in found.why)
    # the servo's zero is another one in each recording, and the result says so
    assert found.verdict is GeometryVerdict.DOUBTFUL
    assert any("steering_zero_rad differs between recordings" in sentence for sentence in found.why)
