"""References without headings: the course stands for these, which depends on the sensor's place and on its delay."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.api import diagnose
from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.campaign.settings import Reference
from calib.gap.apply import applied_model
from calib.gap.decision.diagnosis import Diagnosis, VerdictKind
from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects.library import effect_class
from calib.gap.effects.mounting import DisplacedSensor, LateReference
from calib.gap.effects.reference import ReferenceLatency, ReferenceLeverArm
from calib.gap.inference.fit import signature_columns
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import measured_gap, predict
from tests.gap import free_drives
from tests.kinematics.campaigns import mecanum

#: of the sensor's place in `free_drives`, to the left over ahead
ASIDE = 0.3
#: of a reference that follows the vehicle, the drift of its wheels from recording to recording
SCATTER = 1e-4
#: by how much the root mean square of some fifty windows exceeds the noise level where nothing else is left: each level
#: is known to a fifth
ROOT_SPREAD = 1.4


def driven(folder: Path, sizes: dict[str, float], seed: int, drive: str = "differential") -> Campaign:
    """Return recordings of six drives whose reference has no headings."""
    rng = np.random.default_rng(seed)
    return read_campaign(free_drives.write(folder / "free", drive, sizes, SCATTER, rng, headings=False))


def held(diagnosis: Diagnosis, effect: str, **sizes: float) -> bool:
    """Return whether a named cause's intervals hold its true sizes, within twice their width: beyond four sd."""
    (cause,) = [cause for cause in diagnosis.causes if cause.effect == effect]
    found = {name: cause.parameters[name] for name in sizes}
    return all(abs(one.value - sizes[name]) <= one.ci95[1] - one.ci95[0] for name, one in found.items() if one.ci95)


@pytest.mark.parametrize(
    ("sizes", "seed", "drive"),
    [
        ({"reference_lever_arm": 0.3, "radius_scale": -0.012}, 1, "differential"),
        ({"reference_lever_arm": 0.12, "reference_latency": 0.12}, 2, "differential"),
        ({"reference_latency": 0.25}, 3, "differential"),
        ({"reference_lever_arm": 0.5}, 4, "tricycle"),
    ],
)
def test_place_and_delay_are_found_with_what_is_beside_them(
    tmp_path: Path, sizes: dict[str, float], seed: int, drive: str
) -> None:
    """Linear about the stated place a lever of half a track is 3 % off, and a radius 1.2 % off is not named."""
    diagnosis = diagnose_in_full(driven(tmp_path, sizes, seed, drive), plan=False)
    assert {cause.effect for cause in diagnosis.causes} == set(sizes) and diagnosis.recommended
    if lever := sizes.get("reference_lever_arm"):
        assert held(diagnosis, "reference_lever_arm", lever_x=lever, lever_y=ASIDE * lever)
    if delay := sizes.get("reference_latency"):
        assert held(diagnosis, "reference_latency", latency=delay)
    if scale := sizes.get("radius_scale"):
        assert held(diagnosis, "radius_scale", relative=scale)


def off_axle(campaign: Campaign, lever: float) -> Campaign:
    """Return the campaign with the sensor stated where it is."""
    return replace(campaign, reference=replace(campaign.reference, sensor_x_m=lever, sensor_y_m=ASIDE * lever))


@pytest.mark.parametrize(("drive", "slip"), [("tricycle", 0.04), ("differential", 0.15)])
def test_an_axle_that_slips_aside_bends_the_course_that_stands_for_its_heading(
    tmp_path: Path, drive: str, slip: float
) -> None:
    """Taken for a motion aside alone it was a delay of the steering or another place of the sensor."""
    campaign = off_axle(driven(tmp_path, {"side_slip": slip, "reference_lever_arm": 0.3}, 9, drive), 0.3)
    diagnosis = diagnose_in_full(campaign, plan=False)
    assert [cause.effect for cause in diagnosis.causes] == ["side_slip"] and diagnosis.recommended
    assert held(diagnosis, "side_slip", speed_per_acceleration=slip)


@pytest.mark.parametrize("drive", ["tricycle", "differential"])
def test_a_sensor_off_the_axle_that_reads_late_is_late_alone(tmp_path: Path, drive: str) -> None:
    """In a curve it moves otherwise than the axle: by that one's speed the delay was half as long, beside slip."""
    campaign = off_axle(driven(tmp_path, {"reference_latency": 0.15, "reference_lever_arm": 0.4}, 11, drive), 0.4)
    diagnosis = diagnose_in_full(campaign, plan=False)
    assert [cause.effect for cause in diagnosis.causes] == ["reference_latency"] and diagnosis.recommended
    assert held(diagnosis, "reference_latency", latency=0.15)


def test_a_sensor_off_the_axle_acts_as_the_same_positions_read_from_another_place(tmp_path: Path) -> None:
    campaign = off_axle(driven(tmp_path, {"reference_lever_arm": 0.3}, 10, "tricycle"), 0.3)
    step_m = 1e-3
    moved = replace(campaign, reference=replace(campaign.reference, sensor_x_m=0.3 + step_m))
    seen, other = observations_of(campaign), observations_of(moved)
    path = predict(seen)
    (form,) = effect_class("reference_lever_arm")().forms(seen)
    by_step = signature_columns(path, [form])[0][:, :, 0] / form.typical[0] * step_m
    change = measured_gap(path, path) - measured_gap(replace(path, s=other), path)
    size = np.sqrt(np.mean(np.square(change), axis=0))
    # of the second order in a step of a millimetre beside ways of metres
    assert np.abs(by_step - change).max(axis=0)[1:4] == pytest.approx(0.0, abs=0.02 * size[1:4].max())


@pytest.mark.parametrize("sizes", [{"reference_lever_arm": 0.3, "radius_scale": -0.012}, {"reference_latency": 0.25}])
def test_a_written_place_and_delay_leave_no_gap_on_other_drives(tmp_path: Path, sizes: dict[str, float]) -> None:
    """Added to a course as an effect the same place left up to eight times the noise where drives reverse."""
    campaign = driven(tmp_path / "one", sizes, 5)
    file = applied_model(diagnose_in_full(campaign, plan=False), campaign)
    (tmp_path / "model.json").write_bytes(file.to_bytes())
    other = tmp_path / "other"
    driven(other, sizes, 6)
    left = diagnose(other / "free", model=tmp_path / "model.json").closure.channels
    assert left and all(line.before_rms < ROOT_SPREAD * line.floor_rms for line in left)


@pytest.mark.parametrize("effect", ["unequal_radii", ""])
def test_positions_have_no_axes_to_be_turned(tmp_path: Path, effect: str) -> None:
    """A course is taken from the positions themselves: a yaw beside it would be chance."""
    diagnosis = diagnose_in_full(driven(tmp_path, {effect: 0.02} if effect else {}, 7), plan=False)
    assert "reference_yaw" not in diagnosis.probabilities
    assert [cause.effect for cause in diagnosis.causes] == ([effect] if effect else [])


def test_a_place_is_added_to_the_stated_one_and_a_delay_to_the_wheels_times(tmp_path: Path) -> None:
    """Counts of an even drive at the time before are those less the way driven since."""
    campaign = driven(tmp_path, {}, 8)
    campaign = replace(campaign, reference=Reference(sensor_x_m=0.1, sensor_y_m=-0.2, frame="map"))
    placed = DisplacedSensor("", ReferenceLeverArm.NAMES, np.array([0.3, 0.1]), np.zeros(2)).correct(campaign).reference
    assert (placed.sensor_x_m, placed.sensor_y_m) == pytest.approx((0.4, -0.1))
    even = 200.0 * campaign.logs.columns["t_s"]
    campaign = replace(campaign, logs=replace(campaign.logs, columns={**campaign.logs.columns, "counts_left": even}))
    late = LateReference(ReferenceLatency.OF_POSE, (ReferenceLatency.DELAY,), np.array([0.12]), np.zeros(1))
    moved = late.correct(campaign).logs
    since = moved.columns["t_s"] > 0.12
    assert moved.columns["counts_left"][since] == pytest.approx(even[since] - 24.0)
    assert np.array_equal(moved.columns["ref_x_m"], campaign.logs.columns["ref_x_m"])


def test_wheels_that_roll_aside_tell_the_course_of_a_vehicle_that_strafes() -> None:
    """A sound mecanum robot beside positions alone; its course was taken for its heading."""
    sound = mecanum(np.random.default_rng(3), nominal=(0.068, 0.36), positions=True)
    labels = {name: sound.runs.labels[name] for name in ("run_id", "session")}
    numbers = {name: values for name, values in sound.runs.numbers.items() if not name.startswith("ref_")}
    alone = replace(sound, runs=replace(sound.runs, labels=labels, numbers=numbers))
    assert diagnose_in_full(alone, plan=False).kind is VerdictKind.NO_GAP


@pytest.mark.parametrize("headings", [True, False])
def test_a_delay_of_its_own_in_each_session_is_found_as_such(tmp_path: Path, headings: bool) -> None:
    """A reference that reads later in the second session is late in both by what it is late, and nothing else."""
    sizes, rng = {"reference_latency": 0.08}, np.random.default_rng(12)
    folder = free_drives.write(tmp_path / "free", "differential", sizes, SCATTER, rng, headings=headings)
    campaign = read_campaign(folder)
    logs, columns = campaign.logs, dict(campaign.logs.columns)
    for name in (name for name in columns if name.startswith("ref_")):
        columns[name] = columns[name].copy()
        for run in np.flatnonzero(campaign.runs.label("session") == "d1"):
            rows = slice(logs.offsets[run], logs.offsets[run + 1])
            t_s, read = columns["t_s"][rows], columns[name][rows]
            known = np.isfinite(read)
            columns[name][rows][known] = np.interp(t_s[known] - 0.1, t_s[known], read[known])
    diagnosis = diagnose_in_full(replace(campaign, logs=replace(logs, columns=columns)), plan=False)
    assert [cause.effect for cause in diagnosis.causes] == ["reference_latency"]
    assert held(diagnosis, "reference_latency", latency_d0=0.08, latency_d1=0.18)
