"""Ackermann drive, skid steer and wheel speeds, through check, geometry, diagnose, replay and export."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import yaml

from calib.campaign.read import read_campaign
from calib.cli.main import run as calib
from calib.kinematics import recording_of
from calib.kinematics.adequacy import GeometryVerdict
from calib.kinematics.blunders import front_faults, straight_reading_rad
from calib.kinematics.drives import RearShaft, Steps, rear_shaft
from calib.kinematics.estimate import estimate_geometry
from calib.kinematics.joint_fit import drive_of, fit_parameters, steering_zero_spread_rad
from calib.kinematics.model import window_segments
from tests.kinematics.ackermann import RADIUS_M, TRACK_M, WHEELBASE_M, Truth, campaign, spoilt


def test_an_axle_that_is_counted_turns_by_the_tangent() -> None:
    """Taken for a front wheel's sine, squares of one sense at 0 and 0.6 rad read 0.2 rad straight ahead."""
    steer, way = np.tile([0.0] * 30 + [0.6] * 20, 8), np.full(400, 0.2)
    ends = np.arange(0, 400, 7)

    def between(steps: np.ndarray) -> np.ndarray:
        return np.add.reduceat(steps, ends)

    turned = between(0.2 * way * np.tan(steer - 0.01))
    assert straight_reading_rad(way, steer, turned, between, by_shaft=True) == 0.0
    turned = between(0.2 * way * np.tan(steer - 0.25))
    assert straight_reading_rad(way, steer, turned, between, by_shaft=True) == pytest.approx(0.25, abs=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_runs_that_are_steered_straight_tell_no_sign(seed: int) -> None:
    """Chance gives the slope by the angle a sign; turns of another sign, which the angle follows, are named."""
    rng = np.random.default_rng(seed)
    steer = np.repeat(0.01 + rng.normal(0.0, 1e-4, 40), 10)
    for angle, names in ((steer, set()), (steer + np.repeat(np.tile([0.2, -0.2], 20), 10), {"reversed_steering"})):
        turned = np.add.reduceat(0.2 * 0.1 * np.tan(-angle if names else 0.0 * angle), np.arange(0, 400, 10))
        turned += rng.normal(0.0, 1e-3, 40)
        measured, seen = np.column_stack([np.ones(40), np.zeros(40), turned]), np.ones((40, 3), bool)
        recording = SimpleNamespace(steps=SimpleNamespace(steer_rad=angle, turned_rad=np.full((1, 400), 0.1)))
        recording.with_steering = lambda _, same=recording: same
        segments = SimpleNamespace(
            between=lambda steps: np.add.reduceat(steps, np.arange(0, 400, 10), axis=-1),
            measured=measured, seen=seen, first=np.arange(0, 400, 10), level=np.zeros(40), run=np.arange(40),
        )  # fmt: skip
        faults = front_faults(recording, segments, 1.0, by_shaft=True)[1]  # type: ignore[arg-type]
        assert {fault.code for fault in faults} == names


@pytest.mark.parametrize(("offset_rad", "runs"), [(0.08, 4), (0.15, 8), (np.pi, 4), (-0.5 * np.pi, 8)])
def test_an_angle_that_is_not_counted_from_straight_ahead_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], offset_rad: float, runs: int
) -> None:
    """From a tenth of a radian on an offset is a sensor never set to zero: named with its size, and taken off."""
    truth = Truth(zero_rad=0.0)
    folder = campaign(tmp_path / "car", truth, runs=runs)
    for path in (folder / "logs").glob("*.csv"):
        log = pd.read_csv(path)
        log["steer_rad"] += offset_rad
        log.to_csv(path, index=False)
    status = calib(["geometry", str(folder), "--json", "-"])
    found = json.loads(capsys.readouterr().out)
    named = [sentence for sentence in found["why"] if sentence.startswith("steer_rad: it reads")]
    if abs(offset_rad) < 0.1:
        assert (status, named) == (0, [])
        low, high = found["parameters"]["steering_zero_rad"]["ci95"]
        assert low < -offset_rad < high
        return
    assert status == 1 and len(found["why"]) == 1
    assert abs(np.angle(np.exp(1j * (float(named[0].split()[3]) - offset_rad)))) < 0.02
    # what is left beside the offset is what these runs say without one
    values = {name: parameter["value"] for name, parameter in found["parameters"].items()}
    assert values["rear_radius_m"] == pytest.approx(truth.radius * RADIUS_M, rel=2e-3)
    assert values["steering_zero_rad"] == pytest.approx(0.0, abs=0.02)


def true_values(truth: Truth) -> dict[str, float]:
    x, y, yaw = truth.sensor
    return {
        "rear_radius_m": truth.radius * RADIUS_M,
        "wheelbase_m": truth.wheelbase * WHEELBASE_M,
        "steering_zero_rad": truth.zero_rad,
        "steering_scale": 1.0,
        "sensor_x_m": x,
        "sensor_y_m": y,
        "sensor_yaw_rad": yaw,
        "understeer_s2_per_m2": truth.understeer,
        "side_slip_s2_per_m": truth.side_slip,
    }


#: column of the log, and what a logger or an export can do to it
SPOILT = {
    "steering in degrees": ("steer_rad", np.degrees),
    "steering of the other sign": ("steer_rad", np.negative),
    "no steering": ("steer_rad", lambda values: 0.0 * values),
    "steering at a right angle": ("steer_rad", lambda values: 0.0 * values + np.pi / 2.0),
    "no counts": ("counts_rear", lambda values: 0 * values),
    "counts backwards": ("counts_rear", np.negative),
    "clock backwards": ("t_s", lambda values: values[::-1]),
    "clock stands": ("t_s", lambda values: 0.0 * values + 1.0),
}


@pytest.mark.usefixtures("diagnosed_once", "estimated_once")
@pytest.mark.parametrize("what", SPOILT)
def test_spoilt_logs_end_in_words_never_in_a_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], what: str
) -> None:
    """Geometry is wrong or refused; every command ends with a status of its own, none with a bug."""
    column, change = SPOILT[what]
    folder = spoilt(campaign(tmp_path / "car", Truth(), runs=3, seconds=3.0), column, change)
    assert calib(["geometry", str(folder), "--json", "-"]) in {1, 2}
    for command in (["check"], ["diagnose"], ["fit"], ["plan", "--most", "1"]):
        assert calib([*command, str(folder)]) in {0, 1, 2}, command
    assert "bug in calib" not in capsys.readouterr().err


#: standard deviations within which each of some nine estimates lies; one in a thousand campaigns is beyond
WITHIN = 4.5


@pytest.mark.parametrize("columns", ["counts", "speed"])
def test_geometry_finds_lengths_zero_and_the_sensor_ahead_of_the_axle(tmp_path: Path, columns: str) -> None:
    """From the folder alone, nothing said of the sensor: no finding that it is implausible, everything within noise."""
    truth = Truth()
    found = estimate_geometry(read_campaign(campaign(tmp_path / "car", truth, columns, runs=8)))
    assert found.passed, found.why
    expected = true_values(truth)
    assert {"rear_radius_m", "steering_zero_rad", "sensor_x_m"} <= {one.name for one in found.estimates}
    for one in found.estimates:
        if one.name != "delay_s":
            assert abs(one.value - expected[one.name]) < WITHIN * one.std, one
    assert found["sensor_x_m"].value == pytest.approx(0.115, abs=3e-3)
    assert found["sensor_yaw_rad"].value == pytest.approx(0.008, abs=5e-3)


def test_geometry_finds_slip_in_fast_turns(tmp_path: Path) -> None:
    """Turns at up to 4 m/s^2 that widen with speed, the rear axle sliding outwards."""
    truth = Truth(understeer=0.03, side_slip=0.01, fastest_mps=2.0)
    found = estimate_geometry(read_campaign(campaign(tmp_path / "car", truth)), using="windows")
    assert found.passed, found.why
    for name in ("understeer_s2_per_m2", "side_slip_s2_per_m", "sensor_x_m", "steering_zero_rad"):
        assert abs(found[name].value - true_values(truth)[name]) < WITHIN * found[name].std, found[name]
    assert found["understeer_s2_per_m2"].value > 10.0 * found["understeer_s2_per_m2"].std


@pytest.mark.parametrize("play_rad", [0.0, 0.03])
def test_the_play_of_a_steering_is_the_scatter_of_its_zero_between_recordings(tmp_path: Path, play_rad: float) -> None:
    """Each recording has a steering zero of its own, by a servo's play."""
    rng, folder = np.random.default_rng(4), campaign(tmp_path / "car", Truth(), runs=6)
    read = read_campaign(spoilt(folder, "steer_rad", lambda angle: angle + rng.normal(0.0, play_rad)))
    recording = recording_of(read, "shaft")
    drive = drive_of(read, "shaft", recording)
    fitted = fit_parameters(read, drive, recording, window_segments(recording, 60), sensor=True)
    found = steering_zero_spread_rad(fitted)
    # six recordings know a standard deviation to a third; without play nothing beyond the noise of a recording's zero
    assert found == pytest.approx(play_rad, rel=0.7, abs=2e-3)


def test_recordings_with_zeros_of_their_own_make_a_result_doubtful_and_its_intervals_wide(tmp_path: Path) -> None:
    """The common zero is known as well as the scatter of eight recordings tells it; other parameters stay right."""
    zeros_rad, truth = np.random.default_rng(6).normal(0.0, 0.03, 8), Truth()
    each = iter(zeros_rad)
    folder = spoilt(campaign(tmp_path / "car", truth, runs=8), "steer_rad", lambda angle: angle + next(each))
    found = estimate_geometry(read_campaign(folder), using="windows")
    assert found.verdict is GeometryVerdict.DOUBTFUL
    assert any("differs between recordings" in reason for reason in found.why), found.why
    zero = found["steering_zero_rad"]
    low, high = zero.ci95
    assert low < truth.zero_rad < high
    # the error of a mean of eight, and up to half more for the scale of the angle, which eight zeros tell less well
    assert 1.0 < zero.std / (zeros_rad.std(ddof=1) / np.sqrt(8.0)) < 1.5
    for name in ("rear_radius_m", "wheelbase_m", "sensor_x_m"):
        if name in found.values and name not in found.held:
            assert abs(found[name].value - true_values(truth)[name]) < WITHIN * found[name].std, name
    # with its own zero each recording is at the noise; a further one is not
    assert found.judgement.position.after < 0.2 * found.judgement.position.held_out


def test_derivatives_are_those_of_the_motion() -> None:
    """Against central differences, forward and in oversteer."""
    rng = np.random.default_rng(3)
    steps = Steps(rng.uniform(0.0, 0.2, (1, 40)), rng.uniform(-0.4, 0.4, 40), None, rng.uniform(0.0, 2.0, 40))
    drive_of_steps = RearShaft(RADIUS_M, WHEELBASE_M, slips=True)
    for understeer in (0.05, -0.05):
        values = np.array([0.05, 0.3, 0.01, 1.02, understeer, 0.01])
        motion = drive_of_steps.motion(values, steps)
        for at in range(len(values)):
            change = np.zeros(len(values))
            change[at] = 1e-6
            ahead, behind = (drive_of_steps.motion(values + sign * change, steps).body for sign in (1, -1))
            # central differences at 1e-6 of unit size are good to 1e-8
            np.testing.assert_allclose(motion.by_parameter()[at], (ahead - behind) / 2e-6, atol=1e-7)


def test_slip_is_estimated_in_fast_turns_only() -> None:
    steer = np.full(40, 0.3)
    for speed, slips in ((0.2, False), (2.0, True)):
        steps = Steps(np.full((1, 40), 0.1), steer, None, np.full(40, speed))
        assert rear_shaft(RADIUS_M, WHEELBASE_M, steps).slips is slips
    # fast turns between long straights: these show it, however many samples are straight
    steer = np.where(np.arange(400) < 20, 0.3, 0.0)
    steps = Steps(np.full((1, 400), 0.1), steer, None, np.full(400, 2.0))
    assert rear_shaft(RADIUS_M, WHEELBASE_M, steps).slips


def test_every_command_takes_an_ackermann_vehicle(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Check, geometry with a coefficient file, replay, diagnose before and with the geometry, ROS 2 parameters."""
    folder, file, out = campaign(tmp_path / "car", Truth(), runs=8), tmp_path / "coefficients.json", tmp_path / "ros2"
    assert calib(["check", str(folder)]) == 0
    assert calib(["geometry", str(folder), "--output", str(file)]) == 0
    capsys.readouterr()
    assert calib(["simulate", "replay", str(folder), "--model", str(file), "--json", "-"]) == 0
    ends = json.loads(capsys.readouterr().out)["rms_m"]
    # the reference's noise over the sensor's arm and path
    assert ends["corrected"] < 0.01 < 0.1 < ends["model"]
    assert calib(["diagnose", str(folder), "--json", "-"]) == 0
    before = json.loads(capsys.readouterr().out)
    assert {"steering_zero", "reference_lever_arm"} <= {cause["effect"] for cause in before["causes"]}
    assert before["recommended"]
    assert calib(["diagnose", str(folder), "--model", str(file), "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "no_gap"
    assert calib(["export", str(file), "--to", "ros2", "--output", str(out)]) == 0
    text = next(out.iterdir()).read_text()
    controllers = yaml.safe_load(text)
    assert set(controllers) == {"bicycle_steering_controller", "ackermann_steering_controller"}
    radius = controllers["bicycle_steering_controller"]["ros__parameters"]["traction_wheel_radius"]
    assert radius == pytest.approx(0.99 * RADIUS_M, rel=1e-3)
    assert "true steering angle" in text


def test_side_slip_and_understeer_are_diagnosed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Slip sideways is named, none along the path."""
    truth = Truth(radius=1.0, wheelbase=1.0, zero_rad=0.0, sensor=(0, 0, 0), understeer=0.03, side_slip=0.01)
    folder = campaign(tmp_path / "car", Truth(**{**vars(truth), "fastest_mps": 2.0}), runs=16)
    calib(["diagnose", str(folder), "--json", "-"])
    found = json.loads(capsys.readouterr().out)
    causes = {cause["effect"]: cause for cause in found["causes"]}
    assert {"understeer", "side_slip"} <= set(causes)
    assert not {"drive_slip", "speed_radius"} & set(causes)
    # the effect counts by the model's own curvature, which understeer leaves by up to 12 %
    assert causes["side_slip"]["parameters"]["slip_per_acceleration"]["value"] == pytest.approx(0.01, rel=0.12)


@pytest.mark.parametrize("columns", ["left and right", "v and omega"])
@pytest.mark.parametrize("kind", ["skid", "differential"])
def test_speeds_stand_for_counts(tmp_path: Path, columns: str, kind: str) -> None:
    """Speeds by the nominal radius, 1 % too large: the radii come out 1 % short, the (effective) track as it is."""
    truth = Truth(sensor=(0.0, 0.0, 0.0))
    found = estimate_geometry(read_campaign(campaign(tmp_path / "robot", truth, columns, kind)), using="windows")
    assert found.drive == kind and found.passed
    for name in ("radius_left_m", "radius_right_m"):
        assert abs(found[name].value - 0.99 * RADIUS_M) < WITHIN * found[name].std
    assert abs(found["track_m"].value - TRACK_M) < WITHIN * found["track_m"].std
