"""One counter and the steering drive the odometry: what the load does to its wheels, and runs that nothing measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.check import notes_for_results
from calib.campaign.model import Campaign
from calib.campaign.settings import Encoder, Odometry, OdometryModel, Reference
from calib.gap.apply import applied_model
from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects.library import library, model_of, with_effects
from calib.gap.effects.turning import DriveSlip
from calib.gap.observations.from_campaign import observations_of
from calib.io import write_bytes
from calib.odometry.replay import stood_in
from calib.vehicle import Vehicle
from tests.gap.observations.paths import COUNTS, RADIUS_M, TRACK_M, campaign_of

BASE_M, LAW = 0.65, -2e-6
PAYLOADS = np.tile([0.0, 12.0, 25.0], 8)
#: loads of both wheels, unlike, and of each run the steering angle held
LOADS_N = np.stack([105.0 + 3.0 * PAYLOADS, 105.0 + 5.0 * PAYLOADS])
ANGLES = np.repeat([0.0, 0.0, 0.2, -0.2], 6)
WAY_M = np.repeat([10.0, 18.0, 8.0, 8.0], 6)
#: of the reference
SIGMA = 5e-4


def car(drive: str, slopes: tuple[float, float], truth: tuple[float, float], *, seed: int = 1) -> Campaign:
    """Return runs of a car by its drive shaft, or a tricycle by its front wheel: arcs under three payloads.

    `slopes`: of both wheels in the model; `truth`: the law of the counted wheels.
    """
    rng = np.random.default_rng(seed)
    logs, source = [], "shaft" if drive == "ackermann" else "front"
    ends = []
    for loads, angle, way in zip(LOADS_N.T, ANGLES, WAY_M, strict=True):
        radius = RADIUS_M + 0.5 * float(np.dot(truth, loads - 105.0)) + 1e-6 * rng.standard_normal()
        t = np.linspace(0.0, 20.0, 401)
        # from rest to rest
        rolled = way * (t / 20.0 - np.sin(2.0 * np.pi * t / 20.0) / (2.0 * np.pi))
        ahead = rolled * (1.0 if source == "shaft" else np.cos(angle))
        turned = ahead[-1] * np.tan(angle) / BASE_M
        chord = ahead[-1] * np.sinc(0.5 * turned / np.pi)
        ends.append([chord * np.cos(0.5 * turned), chord * np.sin(0.5 * turned), turned])
        counter = "counts_rear" if source == "shaft" else "counts_front"
        logs.append({"t_s": t, counter: rolled / radius * COUNTS / (2.0 * np.pi), "steer_rad": np.full(401, angle)})
    x, y, theta = (np.array(ends) + SIGMA * rng.standard_normal((len(ends), 3))).T
    numbers = {"ref_x_m": x, "ref_y_m": y, "ref_theta_rad": theta, "payload_kg": PAYLOADS, "speed_mps": WAY_M / 20.0}
    numbers |= {"load_left_N": LOADS_N[0], "load_right_N": LOADS_N[1]}
    made = campaign_of(logs, Reference(sigma_xy_m=SIGMA, sigma_theta_rad=SIGMA, frame="start"), numbers)
    return replace(
        made,
        vehicle=Vehicle(drive=drive, track_m=TRACK_M, wheelbase_m=BASE_M, wheel_radius_m=RADIUS_M, mass_kg=40.0),  # type: ignore[arg-type]
        encoder=Encoder(COUNTS, COUNTS, counts_per_rev_front=COUNTS),
        model=OdometryModel(RADIUS_M, RADIUS_M, TRACK_M, 105.0, *slopes),
        odometry=Odometry(source),  # type: ignore[arg-type]
    )


def test_a_drive_shaft_rolls_by_the_mean_law_of_both_wheels() -> None:
    """The model's slopes act on what a shaft counts, in the diagnosis and in replay alike: the truth is reached."""
    made = car("ackermann", (LAW, 3.0 * LAW), (LAW, 3.0 * LAW))
    ways = observations_of(made).length_m
    # the scatter of the radius, and one count
    np.testing.assert_allclose(ways, WAY_M, rtol=5e-5)
    _, steps = stood_in(made, made.model)
    np.testing.assert_allclose(np.add.reduceat(steps, made.logs.offsets[:-1]), WAY_M, rtol=5e-5)


@pytest.mark.parametrize("share", [0.0, 0.01])
def test_a_car_rolls_by_the_radii_of_its_model_and_not_by_the_nominal_one(share: float, tmp_path: Path) -> None:
    """The model's mean radius acts once: as it is there is no gap, a share off it is found, and written as it is."""
    made = car("ackermann", (0.0, 0.0), (0.0, 0.0))
    model = replace(made.model, radius_left_m=(1.002 - share) * RADIUS_M, radius_right_m=(0.998 - share) * RADIUS_M)
    made = replace(made, model=model, vehicle=replace(made.vehicle, wheel_radius_m=1.004 * RADIUS_M))
    np.testing.assert_allclose(observations_of(made).length_m, (1.0 - share) * WAY_M, rtol=5e-5)
    diagnosis = diagnose_in_full(made)
    assert [cause.effect for cause in diagnosis.causes] == ["radius_scale"] * (share > 0.0)
    if share:
        file = applied_model(diagnosis, made)
        path = tmp_path / "model.json"
        write_bytes(path, file.to_bytes(), force=False)
        applied, _ = model_of(path, made)
        # the interval of the share found: some hundredths of a per mille of 24 runs of 8 to 18 m
        assert applied.front is not None and applied.front.radius_m == pytest.approx(RADIUS_M, rel=1e-4)
        assert file.joint_geometry is not None
        (variance,) = (each.covariance.value for each in file.joint_geometry.covariance)
        assert 1e-6 < np.sqrt(variance) / RADIUS_M < 1e-4


def test_a_load_law_that_a_car_lacks_is_named_as_one_and_no_slip(tmp_path: Path) -> None:
    """The found mean slope is the truth's; the model that it is written into leaves no gap."""
    made = car("ackermann", (0.0, 0.0), (LAW, 3.0 * LAW))
    diagnosis = diagnose_in_full(made, plan=False)
    assert {cause.effect for cause in diagnosis.causes} <= {"load_radius", "load_radius_nonlinear"}
    (slope,) = (cause.parameters["slope_mean"] for cause in diagnosis.causes[:1])
    # of loads that grow as 3 and 5
    assert slope.value == pytest.approx((3.0 * LAW + 5.0 * 3.0 * LAW) / 8.0, rel=0.02)
    path = tmp_path / "model.json"
    write_bytes(path, applied_model(diagnosis, made).to_bytes(), force=False)
    applied, _ = model_of(path, made)
    assert applied.front is not None
    np.testing.assert_allclose(observations_of(made, applied).length_m, WAY_M, rtol=2e-4)


def test_slip_is_never_what_follows_the_load() -> None:
    """A front wheel's radius under its load is no slip, nor has it the rear wheels' law."""
    made = car("tricycle", (LAW, LAW), (LAW, LAW))
    observations = observations_of(made)
    assert observations.model.slope_left_m_per_N == 0.0
    names = {one.name for form in DriveSlip().forms(observations) for one in form.parameters}
    assert "slip_rolling" not in names
    assert not {"load_radius"} & {effect.id for effect in library(observations)}
    assert any("they are not applied" in note for note in notes_for_results(made))
    assert not any("they are not applied" in note for note in notes_for_results(car("ackermann", (LAW, LAW), (0, 0))))


@pytest.mark.parametrize("drive", ["ackermann", "tricycle"])
def test_runs_that_nothing_measured_offer_nothing(drive: str) -> None:
    """Turning runs without a reading add no effect to guided corridors: the library is that of the corridors."""
    made = car(drive, (0.0, 0.0), (0.0, 0.0))
    blank = np.full(len(WAY_M), np.nan)
    bare = {"ref_x_m": blank, "ref_y_m": blank, "ref_theta_rad": blank, "distance_m": np.where(ANGLES, blank, WAY_M)}
    both = replace(made, runs=replace(made.runs, numbers={**made.runs.numbers, **bare}))
    corridors = both.select(ANGLES == 0.0)
    found, alone = observations_of(both), observations_of(corridors)
    assert len(found) == len(alone)
    offered = [[effect.id for effect in library(each) if effect.forms(each)] for each in (found, alone)]
    assert offered[0] == offered[1]


def test_a_radius_found_by_one_counter_is_in_the_applied_model(tmp_path: Path) -> None:
    """Counts a share too many: the model written rolls what was measured."""
    made = car("tricycle", (0.0, 0.0), (0.0, 0.0), seed=4)
    counts = 1.004 * COUNTS
    made = replace(made, encoder=Encoder(counts, counts, counts_per_rev_front=counts))
    path = tmp_path / "model.json"
    write_bytes(path, applied_model(diagnose_in_full(made, plan=False), made).to_bytes(), force=False)
    applied, _ = model_of(path, made)
    assert applied.front is not None
    # the interval of the share found
    assert applied.front.radius_m == pytest.approx(1.004 * RADIUS_M, rel=1e-4)


def test_the_radius_of_a_driven_front_wheel_follows_its_own_load(tmp_path: Path) -> None:
    """It carries the weight that the rear wheels do not; a radius that follows that is named, sized and written."""
    made, slope = car("tricycle", (0.0, 0.0), (0.0, 0.0)), -2e-5
    front_N = 9.81 * (made.vehicle.mass_kg + PAYLOADS) - LOADS_N.sum(axis=0)
    grown = np.repeat(1.0 + slope * (front_N - front_N.mean()), np.diff(made.logs.offsets))
    columns = {**made.logs.columns, "counts_front": made.logs.columns["counts_front"] / grown}
    loaded = replace(made, logs=replace(made.logs, columns=columns))
    np.testing.assert_allclose(observations_of(loaded).number("load_front_N"), front_N, rtol=1e-9)
    diagnosis = diagnose_in_full(loaded, plan=False)
    assert [cause.effect for cause in diagnosis.causes] == ["covariate:load_front_N"] and diagnosis.recommended
    low, high = diagnosis.causes[0].parameters["relative_per_sd"].ci95 or (0.0, 0.0)
    assert low < slope * front_N.std() < high
    path = tmp_path / "model.json"
    write_bytes(path, applied_model(diagnosis, loaded).to_bytes(), force=False)
    model, effects = model_of(path, loaded)
    again = with_effects(observations_of(loaded, model), effects)[0]
    # the interval of the size: some hundredths of a per mille
    np.testing.assert_allclose(again.simulated[:, 1][ANGLES == 0.0], WAY_M[ANGLES == 0.0], rtol=2e-4)
