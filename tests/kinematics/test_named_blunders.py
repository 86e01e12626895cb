"""Blunders that residuals refuse are named by their column and unit; sound data of the same kind are not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.campaign.check import swapped_sessions
from calib.campaign.checks import listed
from calib.campaign.model import Border, Campaign
from calib.campaign.wheels import with_counts
from calib.gap.diagnose import diagnose_in_full
from calib.kinematics import recording_of
from calib.kinematics.blunder_search import find_blunder
from calib.kinematics.blunders import rear_faults, still_counters
from calib.kinematics.departures import find_departure
from calib.kinematics.drives import nominal_motion
from calib.kinematics.estimate import Using, estimate_geometry
from calib.kinematics.joint_fit import drive_of, fit_parameters
from calib.kinematics.model import window_segments
from calib.kinematics.readings import PLAUSIBLE_TRACK_CHANGE, factor_faults, implausible
from calib.kinematics.result import Geometry
from tests.kinematics.campaigns import Truth, both_ways, campaign, mixed
from tests.kinematics.test_departures import ROUTE

Columns = dict[str, np.ndarray]
TRUTH = Truth()


def changed(made: Campaign, change: Callable[[Columns], Columns]) -> Campaign:
    """Return the campaign with the columns of each log changed."""
    logs = [change(made.logs.of(run)) for run in range(len(made.runs))]
    columns = {name: np.concatenate([log[name] for log in logs]) for name in logs[0]}
    return replace(made, logs=replace(made.logs, columns=columns))


def in_map(
    runs: int, change: Callable[[Columns], Columns] = lambda log: log, samples: int = 600, truth: Truth = TRUTH
) -> Campaign:
    """Return recordings along the path that begin at any heading of a map, then changed."""
    rng = np.random.default_rng(1)
    routes = [("route", [(way, sense * turn) for way, turn in ROUTE]) for sense in (1, -1) * (runs // 2)]
    made = campaign(routes, truth, rng, along=True, walk=1e-3, duration_s=60.0, samples=samples)

    def placed(log: Columns) -> Columns:
        angle = rng.uniform(-3.0, 3.0)
        place = (log["ref_x_m"] + 1j * log["ref_y_m"]) * np.exp(1j * angle)
        return change(
            log | {"ref_x_m": place.real, "ref_y_m": place.imag, "ref_theta_rad": log["ref_theta_rad"] + angle}
        )

    return changed(made, placed)


def named(found: Geometry) -> dict[str, str]:
    """Return code and sentence of each fault."""
    return {fault.code: fault.text for fault in found.faults}


def right(found: Geometry, *names: str) -> bool:
    """Return whether the true values are within two 95 % intervals: beyond four standard uncertainties."""
    return all(abs(found[name].value - getattr(TRUTH, name)) < 2.0 * found[name].half_width for name in names)


def test_the_z_of_a_quaternion_is_told_in_a_map_whose_runs_begin_at_any_heading() -> None:
    """Of z two headings are left at each start, and nothing tells between them but what the wheels turn from there."""
    found = estimate_geometry(in_map(6, lambda log: log | {"ref_theta_rad": np.sin(0.5 * log["ref_theta_rad"])}))
    assert [*named(found)] == ["heading_quaternion"] and right(found, "track_m", "radius_left_m", "radius_right_m")


@pytest.mark.parametrize("wider", [1.6, 1.9])
def test_the_track_of_a_skid_steered_vehicle_is_an_effective_one(wider: float) -> None:
    """It is estimated beside the stated one and noted, also where nominal turns are off by whole ones."""
    made = campaign(mixed(1), TRUTH, np.random.default_rng(5), nominal=(0.05, 0.05, TRUTH.track_m / wider), samples=50)
    found = estimate_geometry(replace(made, vehicle=replace(made.vehicle, drive="skid")), using="end_poses")
    assert found.passed and right(found, "track_m")
    assert found["track_m"].nominal == pytest.approx(TRUTH.track_m / wider)
    assert any("effective track" in note for note in found.notes)


def test_a_track_that_no_skid_steering_makes_is_a_fault() -> None:
    """Up to 2.5 times it is none of a skid-steered vehicle; of two wheels skid steering is named."""
    (fault,) = factor_faults({"track_m": 1.96})
    assert 'drive = "skid"' in fault.text
    assert not factor_faults({"track_m": 1.96}, "skid")
    assert factor_faults({"track_m": 0.5}, "skid")
    for times, wrong in ((2.4, False), (2.6, True), (0.6, True)):
        assert implausible("track_m", times, PLAUSIBLE_TRACK_CHANGE, "skid") is wrong
    assert implausible("track_m", 1.6, PLAUSIBLE_TRACK_CHANGE, "differential")


def test_a_mirrored_reference_is_named_beside_swapped_wheels() -> None:
    """To the wheels both are the same; obeying the wrong one would exchange the two radii."""
    made = campaign(mixed(2), TRUTH, np.random.default_rng(5))
    numbers = dict(made.runs.numbers)
    numbers |= {name: -numbers[name] for name in ("ref_y_m", "ref_theta_rad")}
    text = named(estimate_geometry(replace(made, runs=replace(made.runs, numbers=numbers))))["swapped_wheels"]
    assert "counts_left and counts_right" in text and "ref_y_m and ref_theta_rad are both mirrored" in text


def twist(change: Callable[[Columns], Columns], recordings: int = 4) -> Campaign:
    """Return recordings of v and omega by the nominal vehicle, changed, integrated as on reading."""
    made = in_map(recordings, samples=300)
    per_count, track_m = (
        2.0 * np.pi * made.vehicle.wheel_radius_m / made.encoder.counts_per_rev_left,
        made.vehicle.track_m,
    )

    def speeds(log: Columns) -> Columns:
        left, right = (per_count * np.gradient(log.pop(f"counts_{side}"), log["t_s"]) for side in ("left", "right"))
        return change(log | {"v_mps": 0.5 * (left + right), "omega_radps": (right - left) / track_m})

    logs = changed(made, speeds).logs
    return replace(made, logs=with_counts(logs, made.encoder, made.vehicle, Border(lenient=False)))


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (lambda log: log, "", ""),
        (lambda log: log | {"omega_radps": -log["omega_radps"]}, "reversed_omega", "omega_radps has the other sign"),
        (lambda log: log | {"t_s": 1e3 * log["t_s"]}, "radius_factor", "t_s in ms taken for s"),
        (lambda log: log | {"v_mps": 1e3 * log["v_mps"]}, "radius_factor", "v_mps in mm/s taken for m/s"),
    ],
)
def test_speeds_are_named_by_their_own_columns(change: Callable[[Columns], Columns], code: str, words: str) -> None:
    """The counts that they stand for, and the reference, are not to blame."""
    texts = named(estimate_geometry(twist(change)))
    assert set(texts) == {code} - {""}
    assert words in texts.get(code, "")


def test_a_departure_whose_equations_have_no_solution_is_none() -> None:
    """Two recordings in ms: a departure leaves no covariance; what was found stays, wrong by its sizes."""
    found = estimate_geometry(twist(lambda log: log | {"t_s": 1e3 * log["t_s"]}, 2))
    assert found.verdict == "wrong" and not found.passed
    assert "check lengths, counts per revolution and units" in " ".join(found.why)


def test_a_yaw_rate_in_degrees_is_named_by_its_column() -> None:
    """No unit of the heading explains the positions as well."""
    made = twist(lambda log: log | {"omega_radps": np.degrees(log["omega_radps"])})
    recording = recording_of(made, "rear")
    found = find_blunder(made, recording, "rear", lambda _, other: window_segments(other, 3))
    assert found is not None
    assert found[2].code == "omega_unit" and "omega_radps: found degrees/s" in found[2].text


@pytest.mark.parametrize(("times", "words"), [(1.0, ""), (1e3, "times in ms"), (100.0 / 3.0, "numbers of rows")])
def test_times_that_no_vehicle_takes_are_named(times: float, words: str) -> None:
    """By less than 1 cm/s (or whole rows at 20 mm/s) they are no seconds: no delay is found, nor is it a clock's."""
    found = estimate_geometry(in_map(4, lambda log: log | {"t_s": times * log["t_s"]}, samples=2000))
    assert named(found).keys() == ({"time_unit"} if words else set())
    assert words in named(found).get("time_unit", "")


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda log: log | {name: 1e3 * log[name] for name in ("ref_x_m", "ref_y_m")}, "position_unit"),
        (lambda log: log | {"ref_y_m": -log["ref_y_m"]}, "y_mirrored"),
    ],
)
def test_a_sensor_off_the_axle_hides_no_unit_and_no_axis(change: Callable[[Columns], Columns], code: str) -> None:
    """Windows tell its place beside each reading: a lever arm is no share of the way that a unit leaves."""
    found = estimate_geometry(in_map(8, change, samples=100, truth=replace(TRUTH, sensor=(0.18, -0.07, 0.0))))
    assert named(found).keys() == {code}
    assert right(found, "radius_left_m", "track_m")


def test_a_sensor_that_looks_back_makes_no_length_negative() -> None:
    """Half a turn of the sensor and all lengths with the other sign are the same motion."""
    found = estimate_geometry(in_map(4, truth=replace(TRUTH, sensor=(0.18, -0.07, 2.9))))
    assert found.passed and right(found, "radius_left_m", "track_m")
    assert found["sensor_yaw_rad"].value == pytest.approx(2.9, abs=5e-3)


def test_outliers_of_a_tracker_turn_no_axes() -> None:
    """A small turn is the sensor's yaw, which windows tell anyway."""
    rng = np.random.default_rng(5)

    def spoilt(log: Columns) -> Columns:
        return log | {"ref_x_m": log["ref_x_m"] + 2.0 * (rng.random(len(log["t_s"])) < 0.004)}

    found = estimate_geometry(in_map(4, spoilt, truth=replace(TRUTH, sensor=(0.18, -0.07, 0.07))))
    assert "axes_turned" not in named(found)


def test_a_spike_of_one_counter_is_not_the_other_one_standing_still() -> None:
    """Its own name, and the runs."""

    def spiked(log: Columns) -> Columns:
        return log | {"counts_left": log["counts_left"] + 1e6 * (np.arange(len(log["t_s"])) == 200)}

    faults = {fault.code: fault.text for fault in estimate_geometry(in_map(8, spiked, samples=300)).faults}
    assert faults.keys() == {"count_spike"}
    assert faults["count_spike"].startswith("counts_left: 8 sample(s) jump")


def test_four_runs_of_noise_swap_no_wheels() -> None:
    """Two slopes of four headings leave two degrees of freedom: what stands out there by five deviations is chance."""
    rng = np.random.default_rng(1)
    swapped = 0
    for _ in range(300):
        turned = 40.0 * np.pi + rng.normal(0.0, 0.1, (2, 4))
        measured, seen = rng.normal(0.0, 0.01, (4, 3)), np.ones((4, 3), bool)
        steps = SimpleNamespace(turned_rad=turned)
        recording = SimpleNamespace(speeds=(), steps=steps, with_turned=lambda _: None)
        segments = SimpleNamespace(between=lambda steps: steps, measured=measured, seen=seen, first=np.arange(4))
        swapped += bool(rear_faults(recording, segments)[1])  # type: ignore[arg-type]
    assert swapped == 0


@pytest.mark.parametrize("stuck", [False, True])
def test_a_counter_that_stands_still_is_named_with_its_run_and_time(stuck: bool) -> None:
    """The vehicle would turn about a wheel that stands still."""

    def stopped(log: Columns) -> Columns:
        late = log["t_s"] > 30.0
        return log | {"counts_left": np.where(late, log["counts_left"][~late][-1], log["counts_left"])}

    sound = in_map(4)
    first = sound.logs.of(0)["ref_x_m"][0]
    made = changed(sound, lambda log: stopped(log) if stuck and log["ref_x_m"][0] == first else log)
    recording = recording_of(made, "rear")
    drive = drive_of(made, "rear", recording)
    texts = [fault.text for fault in still_counters(recording, nominal_motion(drive, recording.steps)[2])]
    assert len(texts) == stuck
    assert all("counts_left: it stands still from 30 to 60 s in r000" in text for text in texts)


@pytest.mark.parametrize("scale", [1.0, 1.02])
@pytest.mark.parametrize("since_start", [False, True])
def test_headings_of_another_scale_than_the_path_are_named(since_start: bool, scale: float) -> None:
    """By 2 %, of the heading or of the turn since the start, as a gyro's."""

    def wound(log: Columns) -> Columns:
        begin = log["ref_theta_rad"][0] if since_start else 0.0
        return log | {"ref_theta_rad": scale * (log["ref_theta_rad"] - begin) + begin}

    made = in_map(4, wound)
    recording = recording_of(made, "rear")
    segments = window_segments(recording, 40)
    fitted = fit_parameters(made, drive_of(made, "rear", recording), recording, segments, sensor=True)
    found = find_departure(fitted, misfit=True)
    assert (found is None) is (scale == 1.0)
    if found:
        departure, size = found
        assert departure.named(size).code == "heading_scale" and "too much" in departure.named(size).text
        # a step of a linear model, taken again by the estimate until it is small
        assert size == pytest.approx(1.0 - scale, rel=0.3)


@pytest.mark.parametrize("longer", [1.0, 1.02])
@pytest.mark.parametrize(("runs", "using"), [(4, "windows"), (8, "end_poses")])
def test_an_axis_of_the_map_that_is_too_long_is_named(runs: int, using: Using, longer: float) -> None:
    """By windows of few recordings and by the ends of many: residuals depend on the direction of travel in the map."""
    made = in_map(runs, lambda log: log | {"ref_x_m": longer * log["ref_x_m"]}, samples=400)
    found = estimate_geometry(made, using=using)
    assert found.passed is (longer == 1.0)
    assert set(named(found)) == ({"axis_scale"} if longer > 1.0 else set())
    assert right(found, "radius_left_m", "radius_right_m", "track_m")


@pytest.mark.parametrize(
    ("code", "change"),
    [
        ("heading_clockwise", lambda log: log | {"ref_theta_rad": -log["ref_theta_rad"]}),
        ("y_mirrored", lambda log: log | {"ref_y_m": -log["ref_y_m"]}),
        ("axes_exchanged", lambda log: log | {"ref_x_m": log["ref_y_m"], "ref_y_m": log["ref_x_m"]}),
    ],
)
def test_axes_of_a_map_are_named_by_ends_from_any_heading(code: str, change: Callable[[Columns], Columns]) -> None:
    """An end in a map is seen from the start's own heading, which the blunder changes as well."""
    found = estimate_geometry(in_map(6, change, samples=100), using="end_poses")
    assert not found.passed and code in named(found)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda log: {}, ""),
        (lambda log: {"ref_theta_rad": -log["ref_theta_rad"]}, "the heading is clockwise: left"),
        (lambda log: {"ref_theta_rad": np.pi / 2 - log["ref_theta_rad"]}, "clockwise from y, as a compass"),
        (lambda log: {"ref_theta_rad": -log["ref_theta_rad"], "ref_y_m": -log["ref_y_m"]}, "both mirrored"),
    ],
)
def test_clockwise_headings_of_a_turned_sensor_are_named_in_closed_loops(
    change: Callable[[Columns], Columns], words: str
) -> None:
    """The ends of squares are alike in a mirror; windows tell, beside a sensor that is turned by three degrees."""
    truth = Truth(sensor=(0.1, 0.02, 0.05))
    made = campaign(both_ways(4), truth, np.random.default_rng(1), along=True, samples=80)
    found = estimate_geometry(changed(made, lambda log: log | change(log)))
    assert (found.using, found.passed) == ("windows", not words)
    assert [words in fault.text for fault in found.faults] == [True] * bool(words)


def test_straights_that_leave_the_track_open_call_it_neither_wrong_nor_wide() -> None:
    """A guide keeps the vehicle straight while wheels slip: counts that differ at random tell of no track."""
    rng = np.random.default_rng(3)
    made = campaign([("corridor", [(20.0, 0.0)])] * 30, Truth(), rng)

    def slipped(log: Columns) -> Columns:
        return log | {"counts_right": log["counts_right"] * (1.0 + rng.normal(0.0, 2e-4))}

    found = estimate_geometry(changed(made, slipped))
    assert found.passed and "track_m" in found.undetermined and found.values["track_m"] == pytest.approx(0.4)


@pytest.mark.parametrize("unit", [1.0, 9.80665], ids=["newtons", "kilograms"])
def test_slopes_by_loads_of_another_unit_are_wrong(unit: float) -> None:
    """The fit is as good by either: radius and slope absorb the factor, and only vehicle and payload show it."""
    rng = np.random.default_rng(8)
    payload = np.tile([0.0, 20.0, 40.0, 60.0], 10)
    # 40 kg, of which the rear axle at 0.1 of 0.6 m carries five sixths
    load = (0.5 * 9.80665 * (40.0 * 5.0 / 6.0 + payload))[:, None] * np.ones(2)
    truth = Truth(slope_left=-2e-6, slope_right=-2e-6)
    made = campaign(mixed(8), truth, rng, loads=load)
    runs = made.runs
    loads = {f"load_{side}_N": load[:, 0] / unit for side in ("left", "right")}
    numbers = runs.numbers | loads | {"payload_kg": payload, "payload_x_m": np.zeros(40), "payload_y_m": np.zeros(40)}
    made = replace(made, vehicle=replace(made.vehicle, mass_kg=40.0), runs=replace(runs, numbers=numbers))
    found = estimate_geometry(made)
    assert found.passed is (unit == 1.0)
    assert unit == 1.0 or "load_left_kgf" in named(found)["loads_implausible"]


def test_the_most_loaded_runs_of_a_straight_kind_are_straight() -> None:
    """Unlike slopes bend a corridor under the heaviest load by more than one arc: no run of it is omitted."""
    rng = np.random.default_rng(9)
    load = np.tile([100.0, 200.0, 300.0, 900.0], 8)[:, None] * np.ones(2)
    truth = Truth(radius_left_m=0.05, radius_right_m=0.05, slope_left=-3e-6, slope_right=-1e-6)
    made = campaign([("Gerade", [(8.0, 0.0)])] * 24 + both_ways(4), truth, rng, loads=load, scatter=1e-4)
    straight = made.runs.label("kind") == "Gerade"
    numbers = {
        name: np.where(straight, np.nan, cells) if name.startswith("ref_") else cells
        for name, cells in made.runs.numbers.items()
    }
    numbers["distance_m"] = np.where(straight, 8.0 + 1e-3 * rng.standard_normal(32), np.nan)
    made = replace(made, runs=replace(made.runs, numbers=numbers))
    assert estimate_geometry(made).n_runs == 32


def test_counters_exchanged_in_one_session_are_named_as_that() -> None:
    """Its turns have the other sense than the reference's, and its headings are no whole turns off."""
    made = campaign(mixed(6), TRUTH, np.random.default_rng(10), scatter=1e-4)
    second = np.arange(30) % 3 == 1
    logs, sides = made.logs, ("counts_left", "counts_right")
    of_second = second[np.repeat(np.arange(30), np.diff(logs.offsets))]
    left, right = (logs.columns[name] for name in sides)
    columns = logs.columns | dict(
        zip(sides, (np.where(of_second, right, left), np.where(of_second, left, right)), strict=True)
    )
    left, right = (made.runs.number(name) for name in sides)
    numbers = made.runs.numbers | dict(
        zip(sides, (np.where(second, right, left), np.where(second, left, right)), strict=True)
    )
    labels = made.runs.labels | {"session": np.where(second, "b", "a")}
    exchanged = replace(
        made, logs=replace(logs, columns=columns), runs=replace(made.runs, numbers=numbers, labels=labels)
    )
    faults = named(estimate_geometry(exchanged))
    assert "in session b" in faults["swapped_wheels"] and "heading_turn" not in faults
    (note,) = swapped_sessions(exchanged)
    # a line tells no sense
    turning = exchanged.runs.run_id[second & (made.runs.label("kind") != "line")]
    assert note.text.startswith(f"in session b ({listed(turning)})")
    diagnosis = diagnose_in_full(exchanged, plan=False)
    assert not diagnosis.recommended
    assert not list(swapped_sessions(made))
