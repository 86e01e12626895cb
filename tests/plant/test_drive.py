"""The drive obeys kinematics that can be written down in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.settings import OdometryModel
from calib.plant import Cause, Noise, build_world, draw_noise, quiet, wheel_loads
from calib.plant.design import Design, good_design
from calib.plant.drive import drive, reference_poses, simulated_poses
from calib.plant.make import apply_causes, make_campaign
from calib.vehicle import Vehicle

MODEL = OdometryModel(radius_left_m=0.1, radius_right_m=0.1, track_m=0.7, reference_load_N=300.0)


def some(kinds: list[str], **settings: object) -> Design:
    n_runs = len(kinds)
    zero = np.zeros(n_runs)
    plain = Design(
        kind=np.array(kinds),
        direction=np.array([""] * n_runs),
        session=np.array(["s1"] * n_runs),
        payload_kg=zero,
        payload_x_m=zero,
        payload_y_m=zero,
        speed_mps=zero + 0.5,
        temperature_C=zero + 20,
        minutes_under_load=zero,
        flying=np.zeros(n_runs, dtype=bool),
        stops=np.zeros(n_runs, dtype=np.int64),
        log_period_s=0.1,
    )
    return replace(plain, **settings)  # type: ignore[arg-type]


ALL_KINDS = ["corridor", "square_cw", "square_ccw", "figure8", "route_left", "route_right", "slalom"]


def ends(design: Design, causes: list[Cause]) -> tuple[np.ndarray, np.ndarray]:
    """True and believed end poses, each (3, n_runs), without noise."""
    world = apply_causes(build_world(design, MODEL), causes)
    record = drive(world, quiet(len(design)), quantise=False)
    true = np.stack([record.last(a) for a in (record.x_m, record.y_m, record.theta_rad)])
    return true, record.last(record.odo)


def test_a_right_model_leaves_no_gap() -> None:
    """With true radii and track the vehicle's odometry ends where the vehicle ends, on every route."""
    true, believed = ends(some(ALL_KINDS), [])
    # atol: the two integrations take the same steps in another order of additions; rounding only
    np.testing.assert_allclose(true, believed[:3], atol=1e-9)


def test_the_routes_end_where_they_should() -> None:
    """The follower, closed on odometry, ends the paper's route near (8, 8, 90 deg) and a corridor on its line."""
    true, _ = ends(some(["corridor", "route_left", "route_right"]), [])
    # atol: the follower cuts the eased ends of the arc; centimetres, not more
    np.testing.assert_allclose(true[:, 0], [20.0, 0.0, 0.0], atol=0.02)
    np.testing.assert_allclose(true[:, 1], [8.0, 8.0, np.pi / 2], atol=0.05)
    np.testing.assert_allclose(true[:, 2], [8.0, -8.0, -np.pi / 2], atol=0.05)


def test_both_radii_too_large_stretch_the_corridor_in_proportion() -> None:
    """Wheels 1 % larger than believed: the vehicle believes in 20 m and rolls 20.2 m, straight on."""
    true, believed = ends(some(["corridor"]), [Cause("radius_scale", 0.01)])
    np.testing.assert_allclose(true[0] / believed[0], 1.01, rtol=1e-9)  # exact on a straight line
    np.testing.assert_allclose(true[2], 0.0, atol=1e-9)


def test_unequal_radii_bend_a_straight_run_by_the_papers_formula() -> None:
    """Believed straight over S, ratio 1 + e: heading e S / b, lateral e S^2 / 2 b to first order."""
    size, length = 1e-3, 15.0
    true, _ = ends(some(["corridor"], length_m=length), [Cause("unequal_radii", size)])
    np.testing.assert_allclose(true[2], size * length / 0.7, rtol=2e-3)  # second order in size * S / b = 0.02
    np.testing.assert_allclose(true[1], size * length**2 / 1.4, rtol=5e-3)


def test_a_wider_track_turns_less() -> None:
    """True track 2 % wider: the true turn is the believed one over 1.02."""
    true, believed = ends(some(["square_ccw", "square_cw"]), [Cause("track_width", 0.02)])
    np.testing.assert_allclose(true[2] * 1.02, believed[2], rtol=1e-9)  # exact


def test_the_load_law_enters_by_moments() -> None:
    """The paper's Fig. 3: 100 kg at x 0.5 m shifted sideways by 0.2333 m puts 212.55 and 866.55 N on the wheels."""
    vehicle = Vehicle(cog_x_m=0.40)
    left, right = wheel_loads(vehicle, np.array([100.0]), np.array([0.5]), np.array([-0.2333333]))
    # atol: the paper's numbers are printed to 0.01 N
    np.testing.assert_allclose([left[0], right[0]], [212.55, 866.55], atol=0.02)


def test_creep_grows_to_the_closed_form() -> None:
    """After minutes m under load F the radius has lost c F (1 - exp(-m / tau))."""
    design = some(
        ["corridor", "corridor"], payload_kg=np.array([100.0, 100.0]), minutes_under_load=np.array([0.0, 20.0])
    )
    true, believed = ends(design, [Cause("load_creep", 2e-6, knobs={"tau_min": 10.0})])
    load, _ = wheel_loads(design.vehicle, design.payload_kg, design.payload_x_m, design.payload_y_m)
    share = load[0] - design.vehicle.unladen_load_N
    lost = 2e-6 * share * (1 - np.exp(-2.0))
    np.testing.assert_allclose(true[0] / believed[0], [1.0, 1.0 - lost], rtol=1e-8)  # exact on a straight line


def test_side_slip_pushes_outwards_with_speed_squared_times_turn() -> None:
    """Over a closed right-angled bend the drift across the path is K v^2 theta, to first order."""
    size = 0.02
    design = some(["route_left"], speed_mps=np.array([0.6]))
    slipping, _ = ends(design, [Cause("side_slip", size)])
    straight, _ = ends(design, [])
    drift = slipping[:2, 0] - straight[:2, 0]
    # spread evenly over a quarter turn the drift (outwards) sums to K v^2 (1, -1), whose length is sqrt 2 K v^2
    # rtol: the speed ramps at both ends lie on the straights; the eased curve is not quite a circle
    np.testing.assert_allclose(np.hypot(*drift), np.sqrt(2) * size * 0.36, rtol=0.03)


def test_finer_steps_change_nothing_that_matters() -> None:
    """Halving the time step moves what an effect does by less than 2 %: the plant's steps are fine enough."""
    design = some(["route_left", "square_cw"], speed_mps=np.array([0.6, 0.5]))
    for cause in (Cause("curve_scrub", 0.02), Cause("braking_skid", 1e-3)):
        world = apply_causes(build_world(design, MODEL), [cause])
        gaps = []
        for step_s in (0.02, 0.01):
            record = drive(world, quiet(2), quantise=False, step_s=step_s)
            true = np.stack([record.last(a) for a in (record.x_m, record.y_m, record.theta_rad)])
            gaps.append(true - record.last(record.odo)[:3])
        # atol: a tenth of the instruments' millimetres
        np.testing.assert_allclose(gaps[0], gaps[1], rtol=0.02, atol=2e-4)


@pytest.mark.parametrize("delay_s", [0.06, 0.09, 0.125])
def test_a_late_steering_sensor_shows_the_angle_of_then(delay_s: float) -> None:
    """At any rate of the log it reads what the angle was the delay ago: known from the same drive, logged finely."""
    fine, coarse = (some(["slalom", "square_cw"], log_period_s=period_s) for period_s in (0.02, 0.1))
    late, true = (
        drive(apply_causes(build_world(design, MODEL), [Cause("steering_delay", delay_s)]), quiet(2), quantise=False)
        for design in (coarse, fine)
    )
    assert np.abs(true.steer_rad).max() > 0.2
    for run in range(2):
        past_s = late.t_s[: late.frames[run], run] - delay_s
        expected = np.interp(past_s, true.t_s[: true.frames[run], run], true.steer_rad[: true.frames[run], run])
        # atol: the oracle's straight line between steps of 0.02 s, at up to some 10 rad/s^2: 10 * 0.02^2 / 8
        np.testing.assert_allclose(late.late_rad[: late.frames[run], run], expected, atol=6e-4)


def test_exact_arcs_of_the_log_agree_with_the_fine_steps() -> None:
    """The log's rate loses less than half a millimetre: an empty campaign is empty for whoever reads its logs."""
    design = some(ALL_KINDS)
    world = build_world(design, MODEL)
    record = drive(world, quiet(len(design)), quantise=False)
    simulated = simulated_poses(world, record)
    np.testing.assert_allclose(simulated, record.last(record.odo)[:3], atol=5e-4)  # below the quietest instrument


def test_counters_are_whole_and_the_end_of_the_log_is_the_run_table() -> None:
    rng = np.random.default_rng(5)
    campaign = make_campaign(good_design(rng, n_runs=30, needs={"front"}), {}, rng)
    for run in range(0, 30, 7):
        log = campaign.logs.of(run)
        for column in ("counts_left", "counts_right", "counts_front"):
            assert np.array_equal(log[column], np.round(log[column]))
        assert log["counts_left"][-1] == campaign.runs.number("counts_left")[run]
        assert (np.diff(log["t_s"]) > 0).all()
        assert log["t_s"][0] == 0.0
        assert log["counts_left"][0] == 0.0


def test_stops_on_the_way_are_real_stops() -> None:
    """A run with three stops stands still three times before its end."""
    design = some(["corridor"], stops=np.array([3]))
    record = drive(build_world(design, MODEL), quiet(1))
    still = record.v_mps[1 : record.frames[0] - 1, 0] == 0.0
    assert int(np.sum(np.diff(still.astype(int)) == 1)) == 3


def test_a_flying_run_ends_at_speed() -> None:
    design = some(["corridor"], flying=np.array([True]))
    record = drive(build_world(design, MODEL), quiet(1))
    assert record.last(record.v_mps)[0] == pytest.approx(0.5, abs=1e-6)  # the set speed, exactly held


@pytest.mark.parametrize("delay_s", [0.03, 0.05, 0.31])
def test_a_late_reference_shows_the_pose_of_then(delay_s: float) -> None:
    """At a halt and on the move, where a route closes too: known from the same drive, logged finely."""
    flying = np.arange(2 * len(ALL_KINDS)) % 2 == 1
    kinds = [kind for kind in ALL_KINDS for _ in range(2)]
    fine = drive(build_world(some(kinds, flying=flying, log_period_s=0.02), MODEL), quiet(len(kinds)), quantise=False)
    design = some(kinds, flying=flying)
    world, noise = apply_causes(build_world(design, MODEL), [Cause("reference_latency", delay_s)]), quiet(len(kinds))
    late = drive(world, noise, quantise=False)
    seen = reference_poses(world, noise, late)
    for run in range(len(kinds)):
        past_s, then_s = late.t_s[: late.frames[run], run] - delay_s, fine.t_s[: fine.frames[run], run]
        for part, true in zip(seen, (fine.x_m, fine.y_m, fine.theta_rad), strict=True):
            expected = np.interp(past_s, then_s, true[: fine.frames[run], run])
            # atol: the oracle's straight line between steps of 0.02 s, at up to some 2 rad/s^2: 2 * 0.02^2 / 8, twice
            np.testing.assert_allclose(part[: late.frames[run], run], expected, atol=2e-4)
    lag_m = np.hypot(late.last(late.x_m - seen[0]), late.last(late.y_m - seen[1]))
    # rtol: the follower holds its speed to a thousandth where a route ends in a turn
    np.testing.assert_allclose(lag_m[flying], 0.5 * delay_s, rtol=3e-3)
    # a vehicle that brakes has moved far less
    assert (lag_m[~flying] < 0.25 * 0.5 * delay_s).all()


def test_the_same_seed_gives_the_same_campaign() -> None:
    design = good_design(np.random.default_rng(1), n_runs=24)
    one, two = (make_campaign(design, {"load_radius": 8e-6}, np.random.default_rng(9)) for _ in range(2))
    for name, column in one.runs.numbers.items():
        np.testing.assert_array_equal(column, two.runs.numbers[name])


def test_noise_has_the_scales_it_claims_and_heavy_tails() -> None:
    """Student's t over runs: unit variance after scaling, and more beyond four sigma than the normal."""
    draw = draw_noise(Noise(tail=5.0), 40_000, np.random.default_rng(2))
    # rtol: the variance of t(5) has a fourth moment of 9; 40 000 draws give 1.5 %, three times that
    np.testing.assert_allclose(np.std(draw.laser_m), Noise().laser_m, rtol=0.05)
    np.testing.assert_allclose(np.sqrt(np.mean(draw.texture_m**2)), Noise().texture_m, rtol=0.05)
    beyond = np.mean(np.abs(draw.laser_m) > 4 * Noise().laser_m)
    assert beyond > 10 * 6.3e-5
