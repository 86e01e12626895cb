"""An effect that is written into the model is the one that was found, and closes the gap it was found in."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.coefficients.file import believed_model, load_coefficients, sealed
from calib.coefficients.sections import EffectSection, Quantity
from calib.errors import RefusedError
from calib.gap.apply import applied_model, on_vehicle
from calib.gap.decision.diagnosis import Diagnosis, VerdictKind
from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects.library import applied_perturbations, model_of, with_effects, with_mounting_of
from calib.gap.effects.quantities import numbered_sessions
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict, residuals
from calib.io import write_bytes
from calib.odometry.replay import replay
from calib.plant.design import good_design
from calib.plant.effects import find
from calib.plant.make import make_campaign
from calib.runtime import Coefficients
from tests.gap import free_drives
from tests.gap.effects.making import Motion, Run, rich_runs
from tests.gap.effects.making import campaign as campaign_of
from tests.kinematics.campaigns import mecanum


def campaign_with(effect: str, times: float = 3.0, seed: int = 3, n_runs: int = 40) -> Campaign:
    """Return a campaign of several tests, driven once; nobody changes it."""
    return _driven(effect, times, seed, n_runs)


@cache
def _driven(effect: str, times: float, seed: int, n_runs: int) -> Campaign:
    rng = np.random.default_rng(seed)
    form = find(effect, "")
    return make_campaign(good_design(rng, n_runs=n_runs, needs=form.needs), {effect: times * form.typical}, rng)


@cache
def diagnosed(effect: str, seed: int) -> Diagnosis:
    """Return the diagnosis of a campaign of several tests; nobody changes it."""
    return diagnose_in_full(campaign_with(effect, seed=seed), plan=False)


def _section(effect: str, form: str, sizes: dict[str, float], **settings: float) -> EffectSection:
    parameters = {name: Quantity(value=value, unit="1") for name, value in sizes.items()}
    return EffectSection(effect=effect, form=form, settings=settings, parameters=parameters)


@pytest.mark.parametrize(
    ("effect", "seed"),
    [
        ("track_width", 5),
        # 2,400 times as strong as the noise: one part in a hundred of it is a gap of its own
        ("load_radius", 4),
        ("temperature_radius", 3),
        ("reference_lever_arm", 3),
    ],
)
def test_with_the_effect_added_there_is_no_gap_on_the_same_runs(effect: str, seed: int, tmp_path: Path) -> None:
    campaign, found = campaign_with(effect, seed=seed), diagnosed(effect, seed)
    assert effect in {cause.effect for cause in found.causes}
    path = write_bytes(tmp_path / "model.json", applied_model(found, campaign).to_bytes())
    model, sections = model_of(path, campaign)
    again = diagnose_in_full(campaign, model=model, applied=sections, plan=False)
    assert again.kind is VerdictKind.NO_GAP
    # wheel loads, which the law was fitted with, follow the vehicle and no calibrated track
    assert load_coefficients(path).loaded == campaign.vehicle


def test_a_zone_of_the_floor_is_named_and_no_part_of_a_recommended_fix() -> None:
    """It is mended where it lies; the correction of a vehicle correlates with it to every other floor."""
    verdict = diagnose_in_full(campaign_with("floor_zone", seed=5), plan=False)
    assert [cause.effect for cause in verdict.causes] == ["floor_zone"]
    assert not verdict.recommended


def test_what_is_left_with_the_written_model_is_what_the_fit_left(tmp_path: Path) -> None:
    """The written model predicts as the fit did."""
    campaign, found = campaign_with("temperature_radius", seed=3), diagnosed("temperature_radius", 3)
    path = write_bytes(tmp_path / "model.json", applied_model(found, campaign).to_bytes())
    model, sections = model_of(path, campaign)
    s, notes = with_effects(observations_of(campaign, model), sections)
    nominal = predict(s)
    assert notes == ()
    moved = (residuals(nominal, nominal) - found.correction.left) / found.noise.floor
    # recalibration and effect multiply in the file and add in the fit: 1e-3 of 1e-3, a hundredth of a floor at most
    assert np.abs(moved[:, :4]).max() < 0.01


def test_what_is_written_of_the_calibration_and_is_no_cause_is_stated_with_its_size() -> None:
    """Temperatures are counted from their mean on the runs: the radius there, other than believed, is written, too."""
    campaign, found = campaign_with("temperature_radius", seed=3), diagnosed("temperature_radius", 3)
    law, before = applied_model(found, campaign).law, campaign.model
    written = law.left.radius_ref_m / before.radius_left_m - 1.0, law.right.radius_ref_m / before.radius_right_m - 1.0
    assert [cause.effect for cause in found.causes] == ["temperature_radius"]
    assert [*found.fix.moves] == ["radius_scale"]
    size = found.fix.moves["radius_scale"]
    assert written == pytest.approx((size.value, size.value), rel=1e-6)
    assert size.ci95[0] < size.value < size.ci95[1]


def test_wear_is_written_from_the_end_of_the_campaign_and_acts_on_its_runs_alone(tmp_path: Path) -> None:
    """The next campaign begins with the radii of the last session, and counts its sessions anew."""
    campaign = replace(campaign_with("wear", times=6.0), hashes={"campaign.toml": "a" * 64, "runs.csv": "b" * 64})
    found = diagnose_in_full(campaign, plan=False)
    (form,), (rates,) = found.correction.forms, found.correction.theta
    file = applied_model(found, campaign)
    worn = observations_of(campaign).number("travelled_km") if form.label == "per km" else None
    last = float(max(numbered_sessions(observations_of(campaign))[0]) if worn is None else worn.max())
    assert form.effect == "wear" and form.centre is not None and file.effects[0].settings["centre"] == last
    grown = found.correction.calibration[:2] + rates * (last - form.centre.mean)
    radii_m = [campaign.model.radius_left_m, campaign.model.radius_right_m] * (1.0 + grown)
    assert [file.law.left.radius_ref_m, file.law.right.radius_ref_m] == pytest.approx(radii_m, rel=1e-12)
    path = write_bytes(tmp_path / "model.json", file.to_bytes())
    model, sections = model_of(path, campaign)
    s, notes = with_effects(observations_of(campaign, model), sections)
    moved = (residuals(predict(s), predict(s)) - found.correction.left) / found.noise.floor
    assert notes == () and np.abs(moved[:, :4]).max() < 0.01
    later = replace(campaign, hashes={"campaign.toml": "a" * 64, "runs.csv": "c" * 64})
    _, notes = with_effects(observations_of(later, model), model_of(path, later)[1])
    assert len(notes) == 1 and "of other runs" in notes[0]


def test_a_load_effect_goes_into_the_law_and_nowhere_else(tmp_path: Path) -> None:
    campaign, found = campaign_with("load_radius", seed=4), diagnosed("load_radius", 4)
    file = applied_model(found, campaign)
    slopes = {cause.effect: cause for cause in found.causes}["load_radius"].parameters
    before = campaign.model
    assert "load_radius" not in {section.effect for section in file.effects}
    # the old slope is scaled by the recalibration, which is below 1 %
    assert file.law.left.slope_m_per_N == pytest.approx(
        before.slope_left_m_per_N + slopes["slope_left"].value, rel=1e-2, abs=1e-12
    )


def test_what_is_written_errs_together_as_it_was_fitted(tmp_path: Path) -> None:
    """Ratio of the radii and track at 900 N: variance of the fit, by the file's law and by the vehicle's runtime."""
    campaign, found = campaign_with("load_radius", seed=4), diagnosed("load_radius", 4)
    path, fitted = write_bytes(tmp_path / "model.json", applied_model(found, campaign).to_bytes()), found.correction
    file, model = load_coefficients(path), found.observations.model
    above_N = 900.0 - model.reference_load_N
    place = 4 + sum(len(theta) for theta in fitted.theta[: [form.effect for form in fitted.forms].index("load_radius")])
    rates = np.zeros((3, len(fitted.covariance)))
    rates[0, 0] = model.radius_left_m + model.slope_left_m_per_N * above_N
    rates[1, 1] = model.radius_right_m + model.slope_right_m_per_N * above_N
    rates[2, 2], rates[0, place], rates[1, place + 1] = model.track_m, above_N, above_N
    of_fit = rates @ fitted.covariance @ rates.T
    np.testing.assert_allclose(file.law.covariance_at((900.0, 900.0)), of_fit, rtol=1e-9, atol=1e-18)
    own = Coefficients.read(path)
    joint = np.zeros((5, 5))
    for one, other, value in own.cross_covariance:
        joint[one, other] = joint[other, one] = value
    for first, wheel in ((0, own.left), (2, own.right)):
        cross = wheel.covariance_m2_per_N
        joint[first : first + 2, first : first + 2] = [
            [wheel.variance_radius_ref_m2, cross],
            [cross, wheel.variance_slope_m2_per_N2],
        ]
    joint[4, 4] = own.track_std_m**2
    np.testing.assert_allclose(joint, file.law.joint, rtol=1e-9, atol=1e-30)


def test_a_covariate_is_counted_from_the_mean_that_the_file_says() -> None:
    """On other temperatures the radius is that of the same law: alpha (T - centre)."""
    campaign = campaign_with("temperature_radius")
    s = observations_of(campaign)
    section = EffectSection(
        effect="temperature_radius",
        settings={"centre": 5.0, "spread": 1.0},
        parameters={"alpha": Quantity(value=1e-4, unit="1/K")},
    )
    (perturbation,), notes = applied_perturbations(s, [section])
    assert notes == []
    assert perturbation.left is not None
    # closed form
    np.testing.assert_allclose(perturbation.left, 1e-4 * (s.number("temperature_C") - 5.0), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(
    ("section", "left"),
    [
        # of runs at one temperature, one speed and forward alone; closed forms
        (_section("temperature_radius", "", {"alpha": 1e-4}, centre=15.0, spread=1.0), 1e-4 * (20.0 - 15.0)),
        (_section("rear_drag", "left wheel, rolling forward", {"relative": 1e-3}), 1e-3),
        (_section("rear_drag", "left wheel, rolling backward", {"relative": 1e-3}), 0.0),
        (
            _section(
                "lost_counts", "left wheel, share growing above 0.23 m/s", {"share_per_mps": 1e-3}, speed_mps=0.23
            ),
            1e-3 * (0.5 - 0.23),
        ),
    ],
)
def test_what_the_model_has_acts_where_nothing_varies(section: EffectSection, left: float) -> None:
    straight = [Run([(5.0, 0.0)], speed_mps=0.5, numbers={"temperature_C": 20.0}) for _ in range(3)]
    s = observations_of(campaign_of(straight))
    (perturbation,), notes = applied_perturbations(s, [section])
    assert notes == []
    assert perturbation.left is not None
    np.testing.assert_allclose(perturbation.left, left, rtol=1e-9, atol=1e-15)


def test_an_effect_that_has_nothing_to_act_on_is_said() -> None:
    s = observations_of(campaign_with("track_width"))
    section = EffectSection(effect="steering_zero", parameters={"zero": Quantity(value=0.01, unit="rad")})
    perturbations, notes = applied_perturbations(s, [section])
    assert perturbations == []
    assert "steering_zero" in notes[0]


def test_what_a_vehicle_has_of_the_file_alone_is_said_beside_what_the_effects_add() -> None:
    """By the replay's own odometry; a scrubbing track is no better by a fixed track and radii, and by its effect is."""
    rng = np.random.default_rng(2)
    made = make_campaign(good_design(rng, n_runs=40, needs=find("curve_scrub", "").needs), {"curve_scrub": 2e-2}, rng)
    found = diagnose_in_full(made, plan=False)
    assert [cause.effect for cause in found.causes] == ["curve_scrub"]
    file = applied_model(found, made)
    by_replay = replay(made, file, rng=rng, runtime_runs=1).rms_m
    left_out, sizes = on_vehicle(file, found, made)
    before, alone, whole = (float(text) for text in re.findall(r"([\d.]+) m ", sizes))
    # three digits are printed
    assert (before, alone) == pytest.approx((by_replay["model"], by_replay["corrected"]), rel=6e-3)
    assert found.closure.floor_rms_m is not None and whole < 1.2 * found.closure.floor_rms_m
    assert "curve_scrub" in left_out and whole < 0.5 * alone
    assert ("keep those before" in sizes) == (before < 1.05 * alone)


def test_a_payload_that_stands_elsewhere_is_entered_there() -> None:
    """Its loads are wrong, no radius is: the written radii change nothing."""
    rng = np.random.default_rng(4)
    form = find("payload_position", "")
    made = make_campaign(good_design(rng, n_runs=40, needs=form.needs), {"payload_position": 3 * form.typical}, rng)
    found = diagnose_in_full(made, plan=False)
    (size,) = next(cause for cause in found.causes if cause.effect == "payload_position").parameters.values()
    advice = on_vehicle(applied_model(found, made), found, made)[-1]
    assert advice.startswith("enter payloads as found: further ") and f"{size.value:+.3g} m" in advice


def test_without_a_cause_there_is_nothing_to_write() -> None:
    campaign = campaign_with("track_width", 0.0)
    found = diagnose_in_full(campaign, plan=False)
    assert found.kind is VerdictKind.NO_GAP
    with pytest.raises(RefusedError, match="no effect to add"):
        applied_model(found, campaign)


DECLARED = {
    "id": "damp",
    "title": "damp bands",
    "column": "humidity",
    "acts_on": "both",
    "typical": 5e-3,
    "largest": 5e-2,
}


def damp(higher: float, per_unit: float = 0.01) -> Campaign:
    """Rich runs whose bands swell with the humidity above 0.5, on days that are more humid by `higher`."""
    rng = np.random.default_rng(1)

    def truth(run: Run, now: Motion) -> None:
        now.left = now.right = per_unit * (run.numbers["humidity"] - 0.5)
        now.laser_m, now.end_x_m, now.end_y_m = rng.normal(0, [0.0015, 0.002, 0.002])
        now.end_rad = rng.normal(0, 0.0008)

    runs = [replace(run, front=False, numbers=dict(run.numbers)) for run in rich_runs()]
    for run in runs:
        run.numbers["humidity"] += higher
    return replace(campaign_of(runs, truth=truth), extra={"effects": [DECLARED]})


def test_a_declared_effect_is_named_alone_and_its_model_holds_on_other_days(tmp_path: Path) -> None:
    """The column is no second candidate beside its declaration, and the model written down is zero where it was."""
    here, there = damp(0.0), damp(0.4)
    found = diagnose_in_full(here, plan=False)
    assert found.kind is VerdictKind.EXPLAINED
    assert [cause.effect for cause in found.causes] == ["damp"]
    low, high = found.causes[0].parameters["size"].ci95
    assert low <= 0.01 <= high
    path = write_bytes(tmp_path / "model.json", applied_model(found, here).to_bytes())
    model, sections = model_of(path, there)
    bare = predict(observations_of(there))
    observations, notes = with_effects(observations_of(there, model), sections, there.extra["effects"])
    assert notes == ()
    corrected = predict(observations)
    before, after = (np.abs(residuals(nominal, nominal)[:, 0]).max() for nominal in (bare, corrected))
    # what is left: the instruments, 2 mm of 40 mm, and the uncertainty of the size over half a unit of humidity; zero
    # at these runs' own mean, nine tenths would be left
    assert after < 0.2 * before


def test_a_sensor_mounted_turned_is_written_with_its_yaw(tmp_path: Path) -> None:
    """A recommended correction that the file did not hold came back whole in the next diagnosis."""
    made = sound_recordings(tmp_path)
    angle = 0.3
    columns = dict(made.logs.columns)
    columns["ref_theta_rad"] = columns["ref_theta_rad"] + angle
    turned = replace(made, logs=replace(made.logs, columns=columns))
    found = diagnose_in_full(turned, plan=False)
    assert found.recommended and [cause.effect for cause in found.causes] == ["reference_yaw"]
    path = write_bytes(tmp_path / "model.json", applied_model(found, turned).to_bytes())
    placed, others = with_mounting_of(path, turned)
    assert placed.reference.sensor_yaw_rad == pytest.approx(angle, abs=5e-3) and others == ()
    model, sections = model_of(path, turned)
    again = diagnose_in_full(placed, model=model, applied=sections, plan=False)
    # of some fifty windows, over a noise level that is known to a fifth
    assert all(line.before_rms < 1.4 * line.floor_rms for line in again.closure.channels)


def test_no_model_is_written_for_mirrored_data(tmp_path: Path) -> None:
    """The sensor's stated place tells them from swapped wheels, whose model would be mirrored, too."""
    made = sound_recordings(tmp_path, lever=0.1)
    columns = {name: -v if name in ("ref_y_m", "ref_theta_rad") else v for name, v in made.logs.columns.items()}
    reference = replace(made.reference, sensor_x_m=0.1, sensor_y_m=0.03)
    mirrored = replace(made, logs=replace(made.logs, columns=columns), reference=reference)
    found = diagnose_in_full(mirrored, plan=False)
    assert [(cause.effect, cause.form) for cause in found.causes] == [("reference_yaw", "y and headings are mirrored")]
    with pytest.raises(RefusedError, match="change the signs of ref_y_m and ref_theta_rad"):
        applied_model(found, mirrored)


def sound_recordings(folder: Path, lever: float = 0.0) -> Campaign:
    """Return sound recordings of free drives, the sensor so far ahead of the axle and a third as far to the left."""
    sizes, rng = {"reference_lever_arm": lever}, np.random.default_rng(11)
    return read_campaign(free_drives.write(folder / "free", "differential", sizes, 1e-4, rng))


def test_sides_of_a_mecanum_drive_that_differ_are_corrected_in_full() -> None:
    """Left wheels half a percent larger: four wheels turn about l + w, not about the track between them."""
    made = mecanum(np.random.default_rng(4), left=0.005, nominal=(0.068, 0.36))
    diagnosis = diagnose_in_full(made, plan=False)
    sizes = {cause.effect: cause.parameters for cause in diagnosis.causes}
    low, high = sizes["unequal_radii"]["relative"].ci95
    assert low < -0.005 < high and high - low < 0.001
    model = believed_model(applied_model(diagnosis, made), made.model.reference_load_N)
    assert diagnose_in_full(made, model=model, plan=False).kind is VerdictKind.NO_GAP


def test_what_was_not_diagnosed_is_as_uncertain_as_the_given_model_says(tmp_path: Path) -> None:
    """Radii shrink below a file with slopes: these keep uncertainty and range, and runs no less than their scatter."""
    campaign = campaign_with("load_radius", seed=4)
    fitted = applied_model(diagnosed("load_radius", 4), campaign).to_dict()
    for wheel in fitted["wheels"].values():
        wheel["radius_ref"]["value"] *= 1.003
        wheel["variance_slope"]["value"] *= 4.0
        wheel["residual_std"]["value"] *= 2.0
        wheel["valid_load"]["max"]["value"] += 500.0
    given = sealed(**fitted)
    model, _ = model_of(write_bytes(tmp_path / "given.json", given.to_bytes()), campaign)
    found = diagnose_in_full(campaign, model=model, plan=False)
    assert "load_radius" not in {cause.effect for cause in found.causes}
    written = applied_model(found, campaign, believed=given)
    for side, wheel in written.wheels:
        before = getattr(given.wheels, side)
        assert wheel.variance_slope.value == pytest.approx(before.variance_slope.value, rel=1e-2)
        assert wheel.residual_std.value >= before.residual_std.value
        assert wheel.valid_load == before.valid_load
    # at their own mean load the runs tell the radius at any slope
    at_N = np.nanmean(found.observations.loads_N[0])
    of_fit = model.radius_left_m * np.sqrt(found.correction.covariance[0, 0])
    assert written.law.left.mean_std_m(at_N) == pytest.approx(of_fit, rel=2e-2)
