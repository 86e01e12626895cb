"""Replay of logged runs whose load changes on the way."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from calib.campaign import write_campaign
from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.campaign.settings import Reference
from calib.coefficients.build import Header, coefficients_of, from_law
from calib.coefficients.file import CoefficientFile, GeometrySection, believed_model
from calib.coefficients.sections import Quantity
from calib.errors import RefusedError
from calib.gap.effects.library import model_of
from calib.gap.effects.load import LoadRadius
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict
from calib.odometry import end_poses
from calib.odometry.poses import Poses
from calib.odometry.replay import replay
from calib.odometry.routes import loads_in_steps, travel_from_counts
from calib.radius.law import RadiusLaw, WheelLaw
from calib.reporting.topics.simulation import replay_trajectories
from tests.campaign.making import with_log_columns, with_numbers
from tests.odometry.frames import moved

POSES = ("ref_x_m", "ref_y_m", "ref_theta_rad")
LADEN_N = (900.0, 400.0)


@pytest.fixture(scope="module")
def coefficients() -> CoefficientFile:
    return coefficients_of(Path(__file__).resolve().parents[2] / "sample_runs" / "corridor_crossed").file


@pytest.fixture(scope="module")
def campaign(coefficients: CoefficientFile) -> Campaign:
    """Four runs, unladen up to the middle sample and laden from there on; the reference is driven in two pieces."""
    whole = read_campaign(Path(__file__).resolve().parents[2] / "sample_runs" / "corridor_crossed")
    made = whole.select(np.arange(4))
    law, track = coefficients.law, coefficients.geometry.track_m
    loads = [np.full(int(made.logs.offsets[-1]), np.nan) for _ in range(2)]
    ends = []
    for run in range(4):
        log = made.logs.of(run)
        middle = len(log["t_s"]) // 2
        pose = np.zeros(3)
        for part, pair in ((slice(0, middle + 1), (300.0, 300.0)), (slice(middle, None), LADEN_N)):
            radii = float(law.left.radius_m(pair[0])), float(law.right.radius_m(pair[1]))
            travel = travel_from_counts(log["counts_left"][part], log["counts_right"][part], made.encoder, *radii)
            pose = end_poses(*travel, track, start=pose).stacked()
        ends.append(pose)
        # said once, at the sample from which the load is carried
        for column, load in zip(loads, LADEN_N, strict=True):
            column[made.logs.offsets[run] + middle] = load
    ref = np.array(ends).T
    made = with_numbers(
        made,
        load_left_N=np.full(4, 300.0),
        load_right_N=np.full(4, 300.0),
        ref_x_m=ref[0],
        ref_y_m=ref[1],
        ref_theta_rad=ref[2],
    )
    return with_log_columns(made, load_left_N=loads[0], load_right_N=loads[1])


def test_radii_follow_the_load_that_the_log_says(campaign: Campaign, coefficients: CoefficientFile) -> None:
    found = replay(campaign, coefficients, rng=np.random.default_rng(0))
    # a thousand additions of numbers of the order of 40 m
    assert found.rms_m["corrected"] < 1e-10
    # radii of the unladen load, kept: half a percent over some twenty metres
    assert found.rms_m["constant"] > 0.05
    assert found.runtime.faults == {}
    assert found.runtime.largest_difference_m < 1e-9  # what both promise


@pytest.mark.parametrize("frame", ["start", "map"])
def test_the_frame_and_the_sensors_place_are_taken_out(
    campaign: Campaign, coefficients: CoefficientFile, frame: Literal["start", "map"]
) -> None:
    """A sensor anywhere on the vehicle, whose poses begin at zero or stand in a map: the vehicle's way is the same."""
    runs, logs = campaign.runs, campaign.logs
    driven = Poses(*(runs.number(name) for name in POSES))
    x, y, yaw = 0.3, 0.1, 0.4
    place = Poses.from_stacked([x, y, yaw])
    # in a map each run starts elsewhere; the sensor's own start is zero else
    at = Poses.from_stacked([[3.0 * run, -2.0, 1.0 + run] for run in range(4)])
    first = moved(place, at) if frame == "map" else Poses.from_stacked(np.zeros((4, 3)))
    c, s = np.cos(yaw), np.sin(yaw)
    back = Poses.from_stacked([-c * x - s * y, s * x - c * y, -yaw])
    last = moved(moved(place, driven), at if frame == "map" else back)
    columns = {name: np.full(int(logs.offsets[-1]), np.nan) for name in POSES}
    for poses, rows in ((first, logs.offsets[:-1]), (last, logs.offsets[1:] - 1)):
        for name, values in zip(POSES, poses.stacked().T, strict=True):
            columns[name][rows] = values
    rows = dict(zip(POSES, last.stacked().T, strict=True))
    reference = replace(campaign.reference, frame=frame, sensor_x_m=x, sensor_y_m=y, sensor_yaw_rad=yaw)
    made = replace(with_numbers(campaign, **rows), reference=reference)
    found = replay(with_log_columns(made, **columns), coefficients, rng=np.random.default_rng(0))
    assert found.rms_m["corrected"] < 1e-9
    if frame == "map":
        with pytest.raises(RefusedError, match="in a map at both ends"):
            replay(made, coefficients, rng=np.random.default_rng(0))


def test_the_geometry_says_where_the_sensor_sits(coefficients: CoefficientFile) -> None:
    reference = Reference(sensor_x_m=0.5, sensor_yaw_rad=0.1)
    assert coefficients.sensor(reference) == reference
    parameters = {name: Quantity(value=2.0, unit=unit) for name, unit in (("sensor_x_m", "m"), ("track_m", "m"))}
    section = GeometrySection(drive="tricycle", source="rear", parameters=parameters, covariance=[])
    found = coefficients.changed(joint_geometry=section.model_dump(mode="json")).sensor(reference)
    assert found == replace(reference, sensor_x_m=2.0)


OTHERS: dict[str, dict[str, Any]] = {
    "counts_per_rev_right 4096 (not 4000)": {"counts_per_rev_right": 4000.0},
    "drive tricycle (not differential)": {"drive": "differential"},
    "wheel_radius_m 0.1": {"wheel_radius_m": 0.08},
    "track_m 0.7 (not 0.52)": {"track_m": 0.52},
}


@pytest.mark.parametrize("named", OTHERS)
def test_coefficients_of_another_vehicle_are_refused(
    campaign: Campaign, coefficients: CoefficientFile, named: str, tmp_path: Path
) -> None:
    """Else the arrays, by the campaign's vehicle, and the runtime, by the file's, end metres apart."""
    changes = OTHERS[named]
    part = "encoder" if "counts_per_rev_right" in changes else "vehicle"
    other = replace(campaign, **{part: replace(getattr(campaign, part), **changes)})
    path = tmp_path / "c.json"
    path.write_bytes(coefficients.to_bytes())
    with pytest.raises(RefusedError, match=re.escape(named)):
        replay(other, coefficients, rng=np.random.default_rng(0))
    with pytest.raises(RefusedError, match="give coefficients of this vehicle"):
        model_of(path, other)


def test_what_calibration_moves_is_no_other_vehicle(campaign: Campaign, coefficients: CoefficientFile) -> None:
    vehicle = replace(campaign.vehicle, track_m=0.6, wheel_radius_m=0.095)
    coefficients.refuse_other_vehicle(replace(campaign, vehicle=vehicle))
    skid = coefficients.changed(
        vehicle=coefficients.to_dict()["vehicle"] | {"drive": "differential"}, joint_geometry=None
    )
    skid.refuse_other_vehicle(replace(campaign, vehicle=replace(vehicle, drive="skid", track_m=0.3)))
    # lengths that a user accepted are not doubted again
    accepted = coefficients.accepted("a test", ["found a radius"])
    accepted.refuse_other_vehicle(replace(campaign, vehicle=replace(vehicle, wheel_radius_m=0.05)))


def test_the_diagnosis_follows_the_load_that_the_log_says(campaign: Campaign, coefficients: CoefficientFile) -> None:
    """By the model's slopes, or by a load effect of a model without: as replayed, of the mean load on the way."""
    replayed = replay(campaign, coefficients, rng=np.random.default_rng(0), runtime_runs=1).ends["corrected"]
    model = believed_model(coefficients, 300.0)
    flat = replace(model, slope_left_m_per_N=0.0, slope_right_m_per_N=0.0)
    s = replace(observations_of(campaign, flat), applied=True)
    slopes = (model.slope_left_m_per_N, model.slope_right_m_per_N)
    by_effect = [p.scaled(c) for p, c in zip(LoadRadius().forms(s)[0].perturbations(predict(s)), slopes, strict=True)]
    for path in (predict(observations_of(campaign, model)), predict(s, by_effect)):
        # thinned to 400 steps: below a millimetre on 40 m
        np.testing.assert_allclose(path.end[:, 0], replayed.x_m, rtol=0.0, atol=1e-3)
        np.testing.assert_allclose(path.end[:, 1], replayed.y_m, rtol=0.0, atol=1e-3)
        np.testing.assert_allclose(path.end[:, 2], replayed.theta_rad, rtol=0.0, atol=1e-4)
    assert (np.abs(s.wheel_loads_N.T - (np.array(LADEN_N) + 300.0) / 2) < 5.0).all()


def test_a_load_out_of_range_on_the_way_takes_the_run_out(campaign: Campaign, coefficients: CoefficientFile) -> None:
    left = campaign.logs.columns["load_left_N"].copy()
    left[np.flatnonzero(np.isfinite(left))[1]] = 3000.0
    found = replay(with_log_columns(campaign, load_left_N=left), coefficients, rng=np.random.default_rng(0))
    assert found.in_range.tolist() == [True, False, True, True]
    assert found.runtime.faults == {"LOAD_OUT_OF_RANGE": 1}


def test_runs_without_loads_are_unladen_as_a_diagnosis_takes_them(campaign: Campaign, tmp_path: Path) -> None:
    """A model corrected from runs without loads holds at the unladen load alone, not where its law is centred."""
    unladen = campaign.vehicle.unladen_load_N
    nan = np.full(4, np.nan)
    bare = with_numbers(campaign, load_left_N=nan, load_right_N=nan, payload_kg=nan)
    columns = {name: column for name, column in bare.logs.columns.items() if "load" not in name}
    bare = replace(bare, logs=replace(bare.logs, columns=columns))
    wheel = WheelLaw(unladen + 50.0, 0.1, 1e-6, np.zeros((2, 2)), 9.0, 0.0, unladen, unladen, 4)
    header = Header("bare", simulated=True, outside="clamp")
    file = from_law(RadiusLaw(wheel, wheel), bare.vehicle, bare.encoder, header)
    found = replay(bare, file, rng=np.random.default_rng(0))
    by_diagnosis = observations_of(bare, believed_model(file, 300.0)).radius_left_m
    np.testing.assert_allclose(found.load_left_N, unladen)
    np.testing.assert_allclose(file.law.left.radius_m(found.load_left_N), by_diagnosis)
    assert found.runtime.largest_difference_m < 1e-9
    # trajectories are those of the same runs
    written = replay_trajectories(bare, file, tmp_path / "tum", force=False)
    assert [path.name for path in written] == [f"{name}.tum" for name in found.run_id]


def test_loads_in_logs_are_read_back(campaign: Campaign, tmp_path: Path) -> None:
    write_campaign(campaign, tmp_path / "c")
    back = read_campaign(tmp_path / "c")
    for name in ("load_left_N", "load_right_N"):
        np.testing.assert_array_equal(back.logs.columns[name], campaign.logs.columns[name])


def test_a_load_holds_from_the_step_after_its_sample_to_the_end_of_its_run() -> None:
    nan = np.nan
    logged = [nan, 5.0, nan, 6.0, nan, nan, 7.0, nan]
    got = loads_in_steps([1.0, 2.0, 3.0], logged, [0, 5, 5, 8])
    assert got.tolist() == [1.0, 1.0, 5.0, 5.0, 6.0, 3.0, 3.0, 7.0]
    assert loads_in_steps([1.0, 3.0], None, [0, 2, 3]).tolist() == [1.0, 1.0, 3.0]


def test_the_gap_of_the_model_is_the_one_that_the_diagnosis_sees() -> None:
    """With load slopes in the model, both simulate the same end poses: the same errors, run by run."""
    yard = Path(__file__).resolve().parents[2] / "sample_runs" / "yard"
    campaign = read_campaign(yard)
    assert campaign.model.slope_left_m_per_N != 0.0
    replayed = replay(campaign, coefficients_of(yard).file, rng=np.random.default_rng(0), runtime_runs=1)
    nominal = predict(observations_of(campaign))
    unit = {str(name): number for number, name in enumerate(nominal.s.labels["run_id"])}
    chosen = [unit[str(name)] for name in replayed.run_id]
    # the diagnosis takes some twenty samples of a log as steps: sub-millimetre on ways of up to 60 m
    tolerance_m = 2e-3
    np.testing.assert_allclose(replayed.ends["model"].x_m, nominal.end[chosen, 0], rtol=0.0, atol=tolerance_m)
    np.testing.assert_allclose(replayed.ends["model"].y_m, nominal.end[chosen, 1], rtol=0.0, atol=tolerance_m)
    without = replace(campaign.model, slope_left_m_per_N=0.0, slope_right_m_per_N=0.0)
    flat = replay(replace(campaign, model=without), coefficients_of(yard).file, rng=np.random.default_rng(0))
    # what leaving the slopes out costs on this campaign
    assert flat.rms_m["model"] > 5 * replayed.rms_m["model"]


def test_what_speaks_against_logs_or_law_is_said_in_a_note_each(
    campaign: Campaign, coefficients: CoefficientFile
) -> None:
    """Fresh coefficients: none. Radii 1 % off, a log of half the counts of its run, a load of one wheel alone: one."""

    def notes(made: Campaign, law: CoefficientFile = coefficients) -> str:
        return " ".join(replay(made, law, rng=np.random.default_rng(0)).notes)

    assert notes(campaign) == ""
    worn = coefficients.to_dict()["wheels"]
    for wheel in worn.values():
        wheel["radius_ref"]["value"] *= 1.01
    assert "4 of 4 runs end more than 3 standard" in notes(campaign, coefficients.changed(wheels=worn))
    counts = campaign.runs.number("counts_left") * np.array([2.0, 1.0, 1.0, 1.0])
    cut = notes(with_numbers(campaign, counts_left=counts))
    assert cut.startswith("1 log(s) count other than the run table") and campaign.runs.run_id[0] in cut
    of_one = replace(campaign.logs, columns={k: v for k, v in campaign.logs.columns.items() if k != "load_left_N"})
    assert "load of the other wheel alone" in notes(replace(campaign, logs=of_one))


def test_a_vehicle_that_stands_at_the_end_is_where_it_was_last_seen(
    campaign: Campaign, coefficients: CoefficientFile
) -> None:
    """Poses come less often than counts: the last sample of a log hardly ever has one."""
    offsets, ends = campaign.logs.offsets, np.stack([campaign.runs.number(name) for name in POSES])
    poses = np.full((3, offsets[-1]), np.nan)
    poses[:, offsets[:-1]] = 0.0
    # two samples before the end; the vehicle stands in the first two runs
    poses[:, offsets[1:] - 3] = ends
    counts = {name: campaign.logs.columns[name].copy() for name in ("counts_left", "counts_right")}
    for end in offsets[1:3]:
        for column in counts.values():
            column[end - 2 : end] = column[end - 3]
    nan = np.full(4, np.nan)
    logged = with_log_columns(campaign, **dict(zip(POSES, poses, strict=True)), **counts)
    found = replay(with_numbers(logged, **dict.fromkeys(POSES, nan)), coefficients, rng=np.random.default_rng(0))
    assert found.run_id.tolist() == campaign.runs.run_id[:2].tolist()
    np.testing.assert_allclose(found.reference.stacked(), ends.T[:2], atol=1e-12)
