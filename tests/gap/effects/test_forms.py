"""When an effect is offered at all, and what its forms look at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.gap.effects import Form, matching_form
from calib.gap.effects.encoder import find_blunder
from calib.gap.effects.floor import CELL_M, MAX_STRIPS
from calib.gap.effects.library import library
from calib.gap.effects.quantities import driven_speed_mps, end_motion, sessions
from calib.gap.effects.radii import stops
from calib.gap.observations import Channel, Observations
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict, residuals, signature
from calib.radius.path_length import whole_period_excess
from calib.vehicle import Vehicle
from tests.gap.effects.making import (
    MODEL,
    RADIUS_M,
    ROUTE,
    SQUARE,
    STRAIGHT,
    TRACK_M,
    WHEELBASE_M,
    Motion,
    Run,
    campaign,
    motion_of,
    rich_runs,
    situation,
)


def offered(s: Observations, effect: str) -> list[str]:
    return [form.label for e in library(s) if e.id == effect for form in e.forms(s)]


def test_stops_are_counted_in_the_log_one_without_a_log_none_when_read_rolling() -> None:
    runs = [Run(STRAIGHT, stops=True) for _ in range(12)]
    runs[1] = Run(STRAIGHT, stops=False)
    runs[2] = Run(STRAIGHT, log=False)
    # a second stop in run 0: its counters rest for two seconds half way
    made = campaign(runs)
    first = made.logs.offsets[0] + 50
    columns = {name: np.insert(column, first, column[first - 1]) for name, column in made.logs.columns.items()}
    columns["t_s"][first : made.logs.offsets[1] + 1] += 2.0
    offsets = made.logs.offsets + (np.arange(len(made.logs.offsets)) > 0)
    s = observations_of(replace(made, logs=replace(made.logs, offsets=offsets, columns=columns)))
    np.testing.assert_array_equal(s.total(stops(s))[:4], [2, 0, 1, 1])


def test_a_turn_on_the_spot_ends_in_no_slide_of_the_axle() -> None:
    """Its wheels roll against each other: the middle of the axle has no way to slide on, but stops before the spin."""
    spin = [(0.01, 5.0 * np.pi)] * 10
    s = situation([Run(spin, stops=True) for _ in range(6)] + [Run([(2.0, 0.0), *spin], stops=True) for _ in range(6)])
    np.testing.assert_array_equal(s.total(stops(s)), [0] * 6 + [1] * 6)
    np.testing.assert_allclose(s.curvature_per_m[stops(s)], 0.0, atol=1e-9)


def test_a_slide_has_a_turn_of_its_own_where_a_stop_lies_in_a_curve() -> None:
    """ROUTE ends on a straight, the first two of its pieces end in a bend."""
    for pieces, names in ((ROUTE, ["per_stop"]), (ROUTE[:2], ["per_stop", "turning_per_stop"])):
        s = situation([Run(pieces, kind="route", stops=True) for _ in range(12)])
        form, unlike = (form for effect in library(s) if effect.id == "braking_skid" for form in effect.forms(s))
        assert [parameter.name for parameter in form.parameters] == names
        assert [parameter.name for parameter in unlike.parameters] == [*names, "right_over_left_per_stop"]


def test_the_driven_speed_is_the_mean_over_the_way() -> None:
    """From rest to v over a fifth of the way at constant acceleration: v = sqrt(s) there, 2/3 of v on its mean."""
    s = situation([Run(STRAIGHT, speed_mps=0.6, ramp=True, steps=400) for _ in range(12)])
    # sums over 400 steps
    np.testing.assert_allclose(driven_speed_mps(s), 0.6 * (0.8 + 0.2 * 2 / 3), rtol=1e-3)


def test_the_motion_at_the_end_is_that_of_the_log() -> None:
    s = situation(
        [Run(ROUTE[:2], kind="bend", speed_mps=0.6) for _ in range(11)] + [Run(STRAIGHT, speed_mps=0.6, stops=True)]
    )
    speed, rate = end_motion(s)
    # the counts carry the steps exactly
    np.testing.assert_allclose(speed[:11], 0.6, rtol=1e-9)
    np.testing.assert_allclose(rate[:11], 0.2, rtol=1e-9)
    assert speed[11] == 0.0


def test_latency_is_silent_where_every_run_stands_still_when_it_is_read() -> None:
    assert offered(situation([Run(STRAIGHT, stops=True) for _ in range(12)]), "reference_latency") == []


def test_a_lever_arm_is_silent_on_closed_squares_and_straights() -> None:
    """R(theta) l - l vanishes at 0 and at 2 pi."""
    assert offered(situation([Run(SQUARE, kind="square") for _ in range(12)]), "reference_lever_arm") == []
    assert offered(situation([Run(ROUTE, kind="route") for _ in range(12)]), "reference_lever_arm") == [""]


@pytest.mark.parametrize("share", [-0.03, 0.03])
def test_ordinary_errors_are_no_gross_fault(share: float) -> None:
    """Radii off by 3 %, unequal radii of 3 %, a track off by 6 % on 40 m and on squares."""

    def truth(run: Run, now: Motion) -> None:
        now.left, now.right, now.track = share, 0.0, 2 * share

    runs = [Run([(40.0, 0.0)]) for _ in range(6)] + [Run(SQUARE, kind="square") for _ in range(6)]
    s = situation(runs, truth=truth)
    assert find_blunder(s, predict(s)) is None


def test_floor_zones_stay_within_their_number_on_a_large_floor() -> None:
    runs = [Run([(20.0 + 7 * (i % 9), 0.02 * (i % 5))], kind=f"way{i % 5}", steps=400) for i in range(60)]
    s = situation(runs)
    found = next(e for e in library(s) if e.id == "floor_zone").forms(s)
    strips = [form for form in found if form.settings["lane"] < 0]
    assert 0 < len(strips) <= MAX_STRIPS
    assert len(found) - len(strips) == MAX_STRIPS // 2
    assert all(form.tries == len(found) for form in found)


def test_a_floor_zone_that_all_runs_cross_alike_is_left_out() -> None:
    assert offered(situation([Run(STRAIGHT) for _ in range(12)]), "floor_zone") == []


def test_a_zone_on_the_way_back_lies_where_it_lay_on_the_way_out() -> None:
    runs = [Run(STRAIGHT, direction="back" if i % 2 else "out", steps=200) for i in range(12)]
    s = situation(runs)
    forms = next(e for e in library(s) if e.id == "floor_zone").forms(s)
    form = next(f for f in forms if f.settings["x_m"] == 2.0)
    part = form.perturbations(predict(s))[0].left
    assert part is not None
    for number, run in enumerate(runs):
        x = motion_of(run).x_m
        inside = x[part[s.starts[number] : s.starts[number + 1]] > 0]
        middle = 8.0 if run.direction == "back" else 2.0
        # to half a step of 5 cm
        assert inside.mean() == pytest.approx(middle, abs=0.03)
        assert np.ptp(inside) == pytest.approx(CELL_M, abs=0.11)


def test_windows_of_a_recording_have_no_place_on_the_floor() -> None:
    s = replace(situation([Run(ROUTE, kind="a" if i % 2 else "b") for i in range(12)]), windowed=True)
    assert offered(s, "floor_zone") == [] and offered(s, "floor_slope") == []


def test_lanes_by_column_come_before_kinds() -> None:
    runs = [
        Run(STRAIGHT, kind="corridor" if i % 2 else "corridor_b", numbers={"lane": float(i % 3)}) for i in range(12)
    ]
    assert offered(situation(runs), "floor_undulation") == ["lane 0", "lane 1", "lane 2"]


@pytest.mark.parametrize(
    ("amplitude_m", "wavelength_m", "percent"),
    # surplus of a sine's length over its line, as published for the corridor runs
    [(0.05, 40.0, 0.001542), (0.50, 40.0, 0.154035), (0.10, 5.0, 0.393623), (1.00, 5.0, 32.065823)],
)
def test_the_surplus_of_a_sine_is_that_of_fig_9(amplitude_m: float, wavelength_m: float, percent: float) -> None:
    # half an observation in the last printed digit
    excess = whole_period_excess(np.array([amplitude_m]), np.array([wavelength_m]))
    assert 100 * float(excess[0]) == pytest.approx(percent, abs=5e-7)


def test_runs_that_all_end_elsewhere_in_their_wave_turn_alike() -> None:
    """A sine of amplitude A and wavelength l that ends a quarter wave on: the wheels have turned by 2 pi A / l."""
    weaves = [{"amplitude_m": 0.01 * (1 + i % 2), "wavelength_m": 5.0} for i in range(12)]

    def quarter(run: Run, now: Motion) -> None:
        swing = 2 * np.pi * run.numbers["amplitude_m"] / run.numbers["wavelength_m"]
        now.yaw_rad = -swing * now.ds_m / now.ds_m.sum()

    made = campaign([Run(STRAIGHT, log=False, numbers=weave) for weave in weaves], truth=quarter)
    nowhere = {name: np.full(12, np.nan) for name in ("ref_x_m", "ref_y_m", "ref_theta_rad")}
    s = observations_of(replace(made, runs=replace(made.runs, numbers=made.runs.numbers | nowhere)))
    assert s.guided.all()
    forms = {form.label: form for e in library(s) if e.id == "path_weave" for form in e.forms(s)}
    form, path = forms["by the noted amplitude, turned at the end"], predict(s)
    assert [p.name for p in form.parameters] == ["share", "end_heading"]
    end_heading = form.perturbations(path)[1]
    # taken to end as they began, they end by one swing to the other side of what their wheels say
    np.testing.assert_allclose(
        residuals(path, path)[:, Channel.HEADING], -signature(path, end_heading)[:, Channel.HEADING], rtol=1e-9
    )


def test_session_steps_count_from_the_first_session_driven() -> None:
    runs = [Run(STRAIGHT, session=("zeta", "alpha", "mid")[i // 4]) for i in range(12)]
    s = situation(runs)
    form, *lasting = next(e for e in library(s) if e.id == "session_step").forms(s)
    assert [p.name for p in form.parameters] == ["left_alpha", "right_alpha", "left_mid", "right_mid"]
    # one that lasts is in all sessions from one on, and pays for where it was sought
    assert [(one.label, [p.name for p in one.parameters], one.tries) for one in lasting] == [
        ("from alpha on", ["left_alpha", "right_alpha"], 4),
        ("from mid on", ["left_mid", "right_mid"], 4),
    ]
    path = predict(s)
    alpha, mid = (form.perturbations(path)[k].left for k in (0, 2))
    assert np.allclose(lasting[0].perturbations(path)[0].left, alpha + mid)
    of_two = situation([run for run in runs if run.session != "mid"])
    (single,) = next(e for e in library(of_two) if e.id == "session_step").forms(of_two)
    assert (single.label, single.tries) == ("", 1)


def test_recordings_of_loads_that_come_back_are_no_sessions() -> None:
    """Twelve windows of one run under one load are one run: a step for each would imitate any law of the load."""
    runs = [Run(STRAIGHT, load_left_N=load_N, load_right_N=load_N) for load_N in (300.0, 500.0, 700.0) * 4]
    s = situation([run for run in runs for _ in range(4)])
    windows = replace(s, run=np.repeat(np.arange(12), 4), windowed=True)
    assert set(sessions(windows)) == {"s1"}
    # under each load once, anything may have changed with it
    once = situation([run for run in runs[:3] for _ in range(4)])
    assert len(set(sessions(replace(once, run=np.repeat(np.arange(3), 4), windowed=True)))) == 3


def test_a_slip_alike_in_all_runs_is_said_to_be_perhaps_the_front_wheels_radius() -> None:
    """Without payloads no force varies: a share by the force is a constant one."""
    alike = offered(situation([Run(STRAIGHT, front=True) for _ in range(4)]), "drive_slip")
    assert [label for label in alike if label.endswith(("radius", ", rolling"))] == [
        "a constant share, or the front wheel's radius"
    ]


def test_all_payloads_at_once_are_asked_of_only_where_the_model_follows_the_load() -> None:
    """Without slopes in the model a wrong scale does nothing, and slopes that are off would be its exact alias."""
    assert "all payloads" not in offered(situation(rich_runs()), "payload_mass")
    sloped = replace(MODEL, slope_left_m_per_N=1e-6, slope_right_m_per_N=1e-6)
    assert "all payloads" in offered(situation(rich_runs(), model=sloped), "payload_mass")
    one = [run for run in rich_runs() if run.numbers["payload_kg"] in (0.0, 100.0)]
    assert offered(situation(one, model=sloped), "payload_mass") == ["payload of 100 kg"]


@pytest.mark.parametrize("effect", ["floor_zone", "floor_slope", "floor_undulation"])
def test_places_and_slopes_of_the_floor_need_poses_in_one_frame(effect: str) -> None:
    """Where every run has a frame of its own, nothing says that two runs crossed the same place."""
    lanes = [
        replace(run, kind="corridor_b") if number % 6 == 3 else run
        for number, run in enumerate(rich_runs())
        if number % 3 == 0 or effect != "floor_undulation"
    ]
    s = situation(lanes)
    assert offered(s, effect)
    object.__setattr__(s, "common_frame", False)
    assert offered(s, effect) == []


def test_a_numbered_lane_needs_no_frame() -> None:
    runs = [Run(STRAIGHT, numbers={"lane": float(n % 2)}) for n in range(12)]
    s = situation(runs)
    object.__setattr__(s, "common_frame", False)
    assert offered(s, "floor_undulation") == ["lane 0", "lane 1"]


def moved(x_m: float, y_m: float, theta_rad: float) -> np.ndarray:
    """A motion in the plane as a matrix."""
    c, s = np.cos(theta_rad), np.sin(theta_rad)
    return np.array([[c, -s, x_m], [s, c, y_m], [0.0, 0.0, 1.0]])


def back(speed_mps: float, curvature_per_m: float, seconds: float) -> np.ndarray:
    """Where a vehicle on an arc was so many seconds ago, seen from where it is."""
    turn = -speed_mps * curvature_per_m * seconds
    if turn == 0.0:
        return moved(-speed_mps * seconds, 0.0, 0.0)
    return moved(np.sin(turn) / curvature_per_m, (1.0 - np.cos(turn)) / curvature_per_m, turn)


BEND = (0.5 * np.pi * 3.0, 1 / 3.0)
BACKWARD = [(-6.0, 0.0), (-5.0, 0.3)]


@pytest.mark.parametrize("latency_s", [0.02, -0.02, 0.3])
@pytest.mark.parametrize(
    "pieces", [[(6.0, 0.0), BEND], [BEND, (6.0, 0.0)], [BEND], [(-6.0, 0.0), (-5.0, 0.3)]], ids=str
)
def test_a_window_of_a_late_reference_is_late_at_both_ends(pieces: list[tuple[float, float]], latency_s: float) -> None:
    """The pose between two late readings is the true one with the motion of the delay taken back at either end."""
    speed = 0.5
    s = situation([Run(pieces, speed_mps=speed, steps=2000, front=False)] * 3)
    windows = replace(s, windowed=True)
    path = predict(windows)
    (form,) = next(e for e in library(windows) if e.id == "reference_latency").forms(windows)[:1]
    (perturbation,) = form.perturbations(path)
    moved_by = (predict(windows, [perturbation.scaled(latency_s)]).reading - path.reading)[0]
    ends = [(np.sign(length), kappa) for length, kappa in (pieces[0], pieces[-1])]
    # the pieces' curvature is turn per distance without sign
    first, last = (back(sign * speed, sign * kappa, latency_s) for sign, kappa in ends)
    late = np.linalg.inv(first) @ moved(*path.end[0]) @ last
    turned = np.arctan2(late[1, 0], late[0, 0]) - path.end[0, 2]
    wanted = [*(late[:2, 2] - path.end[0, :2]), np.angle(np.exp(1j * turned))]
    # arcs of constant curvature at both ends: what is left is the halves of a step at the joints
    np.testing.assert_allclose(moved_by[1:4], wanted, rtol=0, atol=1e-4)
    # a vehicle that goes on and on along one arc shows no delay at all
    assert (np.abs(moved_by[1:4]).max() < 1e-4) == (len(pieces) == 1)


def test_a_slow_robot_may_have_a_late_reference() -> None:
    """At 30 mm/s it is in motion when it is read, and not when it has stopped."""
    slow = [Run([(0.6, 0.0)], speed_mps=0.03, steps=200, stops=n % 2 == 0) for n in range(12)]
    s = situation(slow)
    speed, _ = end_motion(s)
    np.testing.assert_allclose(speed[1::2], 0.03, rtol=1e-3)
    assert not speed[::2].any()
    assert offered(s, "reference_latency")


def test_plausible_sizes_follow_the_vehicle() -> None:
    """The same vehicle made smaller may be off by less in length and, being lighter, by more per newton."""

    def largest(effect: str, size: float, mass_kg: float) -> float:
        vehicle = Vehicle(
            track_m=0.7 * size,
            wheelbase_m=size,
            wheel_radius_m=RADIUS_M * size,
            mass_kg=mass_kg,
            cog_x_m=0.388 * size,
        )
        model = replace(MODEL, radius_left_m=RADIUS_M * size, radius_right_m=RADIUS_M * size, track_m=0.7 * size)
        s = situation(rich_runs(), vehicle=vehicle, model=model)
        return next(e for e in library(s) if e.id == effect).forms(s)[0].parameters[0].largest

    # anywhere between the axles of a steered vehicle
    assert [largest("reference_lever_arm", size, 100.0) for size in (0.5, 1.0, 2.0)] == [0.5, 1.0, 2.0]
    for effect in ("payload_position", "curve_scrub"):
        assert largest(effect, 0.2, 0.7) == pytest.approx(0.2 * largest(effect, 1.0, 100.0))
        # larger vehicles keep the sizes of the field
        assert largest(effect, 2.0, 800.0) == largest(effect, 1.0, 100.0)
    own_N = 0.5 * 0.7 * 9.81 * (1.0 - 0.388)
    for effect in ("load_radius", "curve_load_transfer", "load_creep"):
        ratio = largest(effect, 0.2, 0.7) / largest(effect, 1.0, 100.0)
        # per metre of radius, as many times more as its wheel carries less than 300 N
        assert ratio == pytest.approx(0.2 * 300.0 / own_N, rel=1e-9)


@pytest.mark.parametrize("scale", [0.02, 1.0, 20.0])
def test_what_follows_speed_or_load_is_sought_on_slow_and_light_vehicles_alike(scale: float) -> None:
    """Two speeds are two, and two loads, by their shares; a speed kept to some per cent is one."""
    vehicle = Vehicle(TRACK_M, WHEELBASE_M, mass_kg=60.0 * scale)

    def made(speed_mps: float, added_N: float) -> Observations:
        own_N, lab = 100.0 * scale, Run(ROUTE, 0.5 * scale, stops=True)
        first = replace(lab, load_left_N=own_N, load_right_N=own_N)
        second = replace(first, speed_mps=speed_mps * scale, load_left_N=own_N + added_N * scale)
        return observations_of(campaign([first, second] * 8, vehicle=vehicle))

    two, one = made(0.7, 20.0), made(0.51, 0.0)
    assert [len(offered(two, effect)) for effect in ("speed_radius", "braking_skid")] == [1, 4]
    assert [len(offered(one, effect)) for effect in ("speed_radius", "braking_skid")] == [0, 2]
    assert offered(two, "load_radius") and offered(two, "load_dependent_track") and not offered(one, "load_radius")


@pytest.mark.parametrize(
    ("written", "offered", "acts"),
    [
        ("end pose and laser", ("end pose", "a clock at another rate"), "end pose"),
        ("end pose and laser", ("laser",), "laser"),
        ("position and heading", ("position alone",), "position alone"),
        ("end pose and laser", ("end pose", "end pose and laser"), "end pose and laser"),
        ("laser", ("end pose",), None),
    ],
)
def test_a_form_of_two_readings_acts_on_the_one_that_runs_have(
    written: str, offered: tuple[str, ...], acts: str | None
) -> None:
    """A delay found by end poses and laser was omitted on recordings, which have poses alone."""
    found = matching_form([Form("reference_latency", label, (), lambda _: []) for label in offered], written, {})
    assert (found and found.label) == acts
