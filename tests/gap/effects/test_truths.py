"""Every effect explains the campaign in which it is true, at its true size.

The truths are worked out run by run from the plan of the drive, by the effect's physics and without the diagnosis: the
wheels' counts and the instruments' readings follow from how the vehicle really moved.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from calib.campaign.settings import OdometryModel
from calib.gap.data.from_campaign import observations_of
from calib.gap.data.observations import Observations
from calib.gap.effects.effect import Form
from calib.gap.effects.library import library
from calib.gap.predict.path import predict
from calib.gap.predict.push import Push
from tests.gap.effects.making import (
    MODEL,
    RADIUS_M,
    ROUTE,
    SQUARE,
    STRAIGHT,
    TRACK_M,
    Motion,
    Run,
    Truth,
    campaign,
    end_pose,
    gap,
    motion_of,
    rich_runs,
    situation,
)

G = 9.81
RUNS = rich_runs()
LOGGED = [replace(run, log=True) for run in RUNS]
FORWARD = [replace(run, pieces=[(abs(length), kappa) for length, kappa in run.pieces]) for run in RUNS]
ROLLING = [replace(run, log=True, stops=False) for run in RUNS]
SLOPED = OdometryModel(RADIUS_M, RADIUS_M, TRACK_M, 300.0, 1.2e-6, 1.2e-6)


def form_of(s: Observations, effect: str, label: str = "") -> Form:
    """The form of an effect whose label starts so."""
    found = [f for e in library(s) if e.id == effect for f in e.forms(s) if f.label.startswith(label)]
    assert found, f"{effect} has no form {label!r}"
    return found[0]


def mean(runs: list[Run], what: Callable[[Run], float]) -> float:
    return float(np.mean([what(run) for run in runs]))


@dataclass
class Case:
    """An effect, its size, the truth, and how closely it has to close the gap (share of the largest gap)."""

    effect: str
    label: str
    sizes: list[float]
    truth: Truth
    within: float = 5e-3
    runs: list[Run] | None = None
    model: OdometryModel = MODEL


CASES: list[Case] = []


def case(effect: str, label: str, *sizes: float, **settings: object) -> Callable[[Truth], Truth]:
    """Register a truth, written as a function of the run and its motion."""

    def register(truth: Truth) -> Truth:
        CASES.append(Case(effect, label, list(sizes), truth, **settings))  # type: ignore[arg-type]
        return truth

    return register


@case("radius_scale", "", 4e-3)
def _(run: Run, now: Motion) -> None:
    now.left = now.right = 4e-3


@case("unequal_radii", "", 2e-3)
def _(run: Run, now: Motion) -> None:
    now.left, now.right = -1e-3, 1e-3


@case("track_width", "", -1e-2)
def _(run: Run, now: Motion) -> None:
    now.track = -1e-2


@case("load_radius", "", 1.3e-6, -0.8e-6)
def _(run: Run, now: Motion) -> None:
    now.left = 1.3e-6 * (run.load_left_N - 300.0) / RADIUS_M
    now.right = -0.8e-6 * (run.load_right_N - 300.0) / RADIUS_M


def nonlinear(exponent: float, label: str) -> None:
    @case("load_radius_nonlinear", label, 1.3e-6, 0.9e-6)
    def _(run: Run, now: Motion) -> None:
        # c F^p less its value at 300 N, c such that the slope there is the size
        def change(load: float, slope: float) -> float:
            c = slope / (exponent * 300.0 ** (exponent - 1.0))
            return c * (load**exponent - 300.0**exponent) / RADIUS_M

        now.left, now.right = change(run.load_left_N, 1.3e-6), change(run.load_right_N, 0.9e-6)


nonlinear(0.5, "exponent 0.5")
nonlinear(0.7, "exponent 0.7")
nonlinear(0.85, "exponent 0.85")
nonlinear(2.0, "quadratic")


# the band gives way during the run too, by half a minute on three minutes at most: within 2 % of the largest
@case("load_creep", "whole load, time constant 3 min", 2e-7, 3e-7, within=2e-2, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    gone = 1.0 - np.exp(-(run.numbers["minutes_under_load"] + (now.t_s - 0.5 * now.dt_s) / 60.0) / 3.0)
    now.left, now.right = -2e-7 * run.load_left_N * gone / RADIUS_M, -3e-7 * run.load_right_N * gone / RADIUS_M


@case("load_creep", "load above the reference, time constant 30 min", 2e-7, 3e-7, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    gone = 1.0 - np.exp(-(run.numbers["minutes_under_load"] + (now.t_s - 0.5 * now.dt_s) / 60.0) / 30.0)
    now.left = -2e-7 * (run.load_left_N - 300.0) * gone / RADIUS_M
    now.right = -3e-7 * (run.load_right_N - 300.0) * gone / RADIUS_M


@case("load_creep", "change of load, time constant 30 min", 2e-7, 3e-7, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    """The band's set follows the loads in the order driven: old load, then exponentially to the new one."""
    index = next(i for i, other in enumerate(LOGGED) if other is run)
    left = right = 0.5 * 100.0 * G * (1.0 - 0.388)
    for earlier in reversed(LOGGED[:index]):
        if earlier.load_left_N != run.load_left_N:
            left, right = earlier.load_left_N, earlier.load_right_N
            break
    rest = np.exp(-(run.numbers["minutes_under_load"] + (now.t_s - 0.5 * now.dt_s) / 60.0) / 30.0)
    now.left = -2e-7 * ((run.load_left_N - 300.0) * (1.0 - rest) + (left - 300.0) * rest) / RADIUS_M
    now.right = -3e-7 * ((run.load_right_N - 300.0) * (1.0 - rest) + (right - 300.0) * rest) / RADIUS_M


@case("temperature_radius", "", 8e-5)
def _(run: Run, now: Motion) -> None:
    over = run.numbers["temperature_C"] - mean(RUNS, lambda one: one.numbers["temperature_C"])
    now.left = now.right = 8e-5 * over


@case("speed_radius", "", 5e-4)
def _(run: Run, now: Motion) -> None:
    now.left = now.right = 5e-4 * (run.speed_mps - mean(RUNS, lambda one: one.speed_mps))


# the curvature that the diagnosis sees is a mean over five steps of the 28 of a corner: within 5 %
@case("curve_scrub", "", 1e-2, within=5e-2, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    now.track = 1e-2 * np.abs(now.kappa)


@case("curve_load_transfer", "", 1e-6, within=5e-2, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    # roll moment of the centrifugal force, taken by the rear wheels alone
    force_N = (100.0 + run.numbers["payload_kg"]) * now.v_mps**2 * now.kappa
    moved_N = force_N * 0.4 / TRACK_M
    now.left, now.right = -1e-6 * moved_N / RADIUS_M, 1e-6 * moved_N / RADIUS_M


@case("load_dependent_track", "", 6e-6)
def _(run: Run, now: Motion) -> None:
    now.track = 6e-6 * (run.load_left_N + run.load_right_N - 600.0)


@case("session_step", "", 5e-4, -3e-4, 2e-4, 4e-4)
def _(run: Run, now: Motion) -> None:
    share = {name: mean(RUNS, lambda one, name=name: float(one.session == name)) for name in ("s2", "s3")}
    now.left = 5e-4 * ((run.session == "s2") - share["s2"]) + 2e-4 * ((run.session == "s3") - share["s3"])
    now.right = -3e-4 * ((run.session == "s2") - share["s2"]) + 4e-4 * ((run.session == "s3") - share["s3"])


@case("wear", "per session", -3e-4, -1e-4)
def _(run: Run, now: Motion) -> None:
    number = int(run.session[1:]) - mean(RUNS, lambda one: float(one.session[1:]))
    now.left, now.right = -3e-4 * number, -1e-4 * number


@case("wear", "per km", -1e-3, 5e-4, runs=FORWARD)
def _(run: Run, now: Motion) -> None:
    lengths = [sum(abs(length) for length, _ in one.pieces) for one in FORWARD]
    before = np.concatenate(([0.0], np.cumsum(lengths)[:-1])) / 1000.0
    index = next(i for i, one in enumerate(FORWARD) if one is run)
    now.left, now.right = -1e-3 * (before[index] - before.mean()), 5e-4 * (before[index] - before.mean())


@case("side_slip", "", 5e-3, within=5e-2, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    # slip angle against the lateral acceleration v omega
    acceleration = now.v_mps * now.turn_rad / now.dt_s
    now.lateral_m = -5e-3 * acceleration * np.abs(now.v_mps) * now.dt_s


@case("rangefinder_scale", "", 2e-3)
def _(run: Run, now: Motion) -> None:
    now.laser_m = 2e-3 * np.sum(now.ds_m)


@case("rangefinder_offset", "", -4e-3)
def _(run: Run, now: Motion) -> None:
    now.laser_m = -4e-3


@case("beam_misalignment", "", 1.0 / np.cos(np.deg2rad(2.0)) - 1.0)
def _(run: Run, now: Motion) -> None:
    now.laser_m = np.hypot(1.0, np.tan(np.deg2rad(2.0))) * np.sum(now.ds_m) - np.sum(now.ds_m)


@case("reference_lever_arm", "", 0.02, -0.01)
def _(run: Run, now: Motion) -> None:
    moved = (0.02 - 0.01j) * (np.exp(1j * np.sum(now.turn_rad)) - 1.0)
    now.end_x_m, now.end_y_m = moved.real, moved.imag


@case("reference_yaw", "position alone", 4e-3)
def _(run: Run, now: Motion) -> None:
    x, y, _ = end_pose(now.ds_m, now.turn_rad)
    moved = (x + 1j * y) * (np.exp(4e-3j) - 1.0)
    now.end_x_m, now.end_y_m = moved.real, moved.imag


def late(run: Run, now: Motion, delay_s: float) -> np.ndarray:
    """End pose as it was `delay_s` ago, less the end pose."""
    left = np.clip(now.t_s[-1] - delay_s - (now.t_s - now.dt_s), 0.0, now.dt_s) / now.dt_s
    return end_pose(now.ds_m * left, now.turn_rad * left) - end_pose(now.ds_m, now.turn_rad)


# the way of the last 30 ms is bent, which the form leaves out
@case("reference_latency", "end pose", 0.03, within=2e-2, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    now.end_x_m, now.end_y_m, now.end_rad = late(run, now, 0.03)


@case("reference_latency", "laser", 0.08, within=2e-2, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    now.laser_m = late(run, now, 0.08)[0]


@case("rear_drag", "right wheel, rolling forward", 1e-3, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    now.right = np.where(now.ds_m > 0.0, 1e-3, 0.0)


@case("rear_drag", "left wheel, going out", -1e-3, runs=FORWARD)
def _(run: Run, now: Motion) -> None:
    now.left = -1e-3 if run.direction == "out" else 0.0


@case("travel_direction", "", 1e-3)
def _(run: Run, now: Motion) -> None:
    now.left = now.right = 1e-3 if run.direction == "out" else -1e-3


@case("lost_counts", "left wheel, constant share", 3e-3)
def _(run: Run, now: Motion) -> None:
    # of 1000 counts 3 are lost
    now.left = 1000.0 / 997.0 - 1.0


@case("lost_counts", "right wheel, share growing above 0.30", 5e-3, within=1e-2)
def _(run: Run, now: Motion) -> None:
    now.right = 1.0 / (1.0 - 5e-3 * (run.speed_mps - 0.3)) - 1.0


@case("wheel_eccentricity", "both wheels", 2e-4, -1e-4, 1e-4, 3e-4, within=1e-2, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    def gained(way_m: np.ndarray, e_cos: float, e_sin: float) -> np.ndarray:
        e, phi_0 = np.hypot(e_cos, e_sin), np.arctan2(e_sin, e_cos)
        way = np.cumsum(way_m)
        angle = way / RADIUS_M
        for _ in range(20):
            angle = (way - e * (np.sin(angle + phi_0) - np.sin(phi_0))) / RADIUS_M
        return np.diff(np.concatenate(([0.0], e * (np.sin(angle + phi_0) - np.sin(phi_0)))))

    half = 0.5 * now.turn_rad * TRACK_M
    now.left_m, now.right_m = gained(now.ds_m - half, 2e-4, -1e-4), gained(now.ds_m + half, 1e-4, 3e-4)


def skid(run: Run, now: Motion, slide_m: float) -> None:
    if run.stops:
        now.along_m = np.zeros(len(now.ds_m))
        last = np.flatnonzero(now.ds_m)[-1]
        now.along_m[last] = slide_m
        # it slides on along its curve
        now.yaw_rad = now.along_m * now.kappa


@case("braking_skid", "the same", 2e-3, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    skid(run, now, 2e-3)


@case("braking_skid", "~ v^2", 4e-3, within=1e-2, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    skid(run, now, 4e-3 * run.speed_mps**2)


# the cosine of the zero, 1e-5 of the way, is taken as 1
@case("steering_zero", "", 5e-3, runs=LOGGED, within=2e-2)
def _(run: Run, now: Motion) -> None:
    now.steer_error_rad = 5e-3


def winding(kappa: float, speed_mps: float) -> Run:
    """A turn to one side and a lesser one to the other, the curvature rising and falling evenly."""
    rise = [(0.03, 0.01 * k) for k in range(1, 100)]
    side = [*rise, (3.0, 1.0), *reversed(rise)]
    shape = [(3.0, 0.0), *side, (1.0, 0.0), *((length, -0.6 * k) for length, k in side), *rise]
    return Run([(length, kappa * k) for length, k in shape], speed_mps=speed_mps, steps=830)


WINDING = [winding(0.1 * (i - 5.5), 0.3 + 0.1 * (i % 4)) for i in range(12)]


@case("steering_scale", "scale of the angle", 1e-2, runs=WINDING, within=2e-2)
def _(run: Run, now: Motion) -> None:
    now.steer_error_rad = 1e-2 * now.steer_rad


# on one arc each: an angle that jumps between two frames is logged by half
ARCS = [Run([(4.0 + 0.5 * i, 0.1 * (i - 5.5))]) for i in range(12)]


@case("steering_scale", "wheelbase", 1e-2, runs=ARCS, within=2e-2)
def _(run: Run, now: Motion) -> None:
    now.steer_rad = np.arctan(1.01 * now.kappa)


@case("steering_backlash", "by the side", 1e-2, runs=LOGGED, within=5e-2)
def _(run: Run, now: Motion) -> None:
    now.steer_error_rad = 0.5e-2 * np.sign(now.steer_rad)


@case("steering_backlash", "by the moves of the motor, through 2", 1e-2, runs=ROLLING, within=5e-2)
def _(run: Run, now: Motion) -> None:
    error, side, before = [], 0.0, now.steer_rad[0]
    for angle in now.steer_rad:
        if angle != before:
            side = 1.0 if angle > before else -1.0
        error.append(0.5e-2 * side)
        before = angle
    now.steer_error_rad = np.array(error)


# the rear wheels' turn is taken over a quarter of a metre, which blurs where the moves turn round
@case("steering_backlash", "by the moves of the wheel, through 20", 2e-2, runs=WINDING, within=0.1)
def _(run: Run, now: Motion) -> None:
    shown, error = 0.0, []
    for angle in now.steer_rad:
        shown = min(max(shown, angle - 1e-2), angle + 1e-2)
        error.append(shown - angle)
    now.steer_error_rad = np.array(error)


@case("steering_delay", "", 0.02, runs=WINDING, within=5e-2)
def _(run: Run, now: Motion) -> None:
    middle = now.t_s - 0.5 * now.dt_s
    now.steer_error_rad = np.interp(middle - 0.02, middle, now.steer_rad) - now.steer_rad


# counts that slipped already are multiplied by the slip again: slip squared
@case("drive_slip", "by the force, rolling", 1e-2, runs=LOGGED, within=2e-2)
def _(run: Run, now: Motion) -> None:
    weight = 100.0 + run.numbers["payload_kg"]
    now.front = 1e-2 * weight / mean(LOGGED, lambda one: 100.0 + one.numbers["payload_kg"])


RAMPED = [replace(run, ramp=True) for run in ROLLING]


# the acceleration is a difference over four steps, blurred where the ramp ends
@case("drive_slip", "by the force, speeding up", 3e-2, runs=RAMPED, within=5e-2)
def _(run: Run, now: Motion) -> None:
    way = np.cumsum(np.abs(now.ds_m)) - 0.5 * np.abs(now.ds_m)
    whole = float(np.sum(np.abs(now.ds_m)))
    # v^2 = 2 a s
    acceleration = np.where(way < 0.2 * whole, run.speed_mps**2 / (0.4 * whole), 0.0)
    weight = (100.0 + run.numbers["payload_kg"]) / mean(RAMPED, lambda one: 100.0 + one.numbers["payload_kg"])
    now.front = 3e-2 * acceleration * weight


def loaded(load_N: float) -> float:
    """Radius of the sloped model under a load."""
    return RADIUS_M + 1.2e-6 * (load_N - 300.0)


@case("payload_mass", "payload of 150 kg", 0.2, model=SLOPED)
def _(run: Run, now: Motion) -> None:
    if run.numbers["payload_kg"] == 150.0:
        more_N = 0.2 * 150.0 * G
        now.left = 1.2e-6 * more_N * (0.5 * (1.0 - 0.3) + 0.02 / TRACK_M) / loaded(run.load_left_N)
        now.right = 1.2e-6 * more_N * (0.5 * (1.0 - 0.3) - 0.02 / TRACK_M) / loaded(run.load_right_N)


@case("payload_mass", "all payloads", 0.1, model=SLOPED)
def _(run: Run, now: Motion) -> None:
    """A scale that reads a tenth too little under every payload."""
    more_N = 0.1 * run.numbers["payload_kg"] * G
    now.left = 1.2e-6 * more_N * (0.5 * (1.0 - 0.3) + 0.02 / TRACK_M) / loaded(run.load_left_N)
    now.right = 1.2e-6 * more_N * (0.5 * (1.0 - 0.3) - 0.02 / TRACK_M) / loaded(run.load_right_N)


@case("payload_position", "sideways", 0.05, model=SLOPED)
def _(run: Run, now: Motion) -> None:
    moved_N = run.numbers["payload_kg"] * G * 0.05 / TRACK_M
    now.left, now.right = 1.2e-6 * moved_N / loaded(run.load_left_N), -1.2e-6 * moved_N / loaded(run.load_right_N)


@case("payload_position", "lengthways", -0.05, model=SLOPED, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    moved_N = run.numbers["payload_kg"] * G * -0.05 / 1.0
    now.left = -1.2e-6 * 0.5 * moved_N / loaded(run.load_left_N)
    now.right = -1.2e-6 * 0.5 * moved_N / loaded(run.load_right_N)
    # a larger front wheel counts less for its way
    now.front = 1.0 / (1.0 + 1.2e-6 * moved_N / RADIUS_M) - 1.0


def on_map(run: Run, now: Motion) -> np.ndarray:
    return now.theta_rad + (np.pi if run.direction == "back" else 0.0)


@case("floor_slope", "along x, radii and pull", 5e-4, 3e-4, within=1e-2)
def _(run: Run, now: Motion) -> None:
    now.left = now.right = 5e-4 * np.cos(on_map(run, now))
    now.yaw_rad = 3e-4 * np.abs(now.ds_m) * np.sin(on_map(run, now))
    unseen_turn(now)


@case("floor_slope", "across, pull alone", 4e-4, within=1e-2)
def _(run: Run, now: Motion) -> None:
    now.yaw_rad = 4e-4 * np.abs(now.ds_m) * np.cos(on_map(run, now))
    unseen_turn(now)


def unseen_turn(now: Motion) -> None:
    """Let the vehicle really turn by what no wheel sees: the wheels keep to their plan."""
    now.turn_rad = now.turn_rad + now.yaw_rad
    # the front wheel follows the true path
    with np.errstate(divide="ignore", invalid="ignore"):
        now.steer_rad = np.arctan(np.where(now.ds_m != 0.0, now.turn_rad / now.ds_m, 0.0))


@case("floor_zone", "x 5 m, y 0 m", 3e-3, 2e-3, 1e-3, within=3e-2, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    sign = -1.0 if run.direction == "back" else 1.0
    x, y = (10.0 if run.kind == "corridor" and sign < 0 else 0.0) + sign * now.x_m, sign * now.y_m
    inside = (np.abs(x - 5.0) < 1.0) & (np.abs(y) < 1.0)
    now.left = now.right = np.where(inside, 3e-3, 0.0)
    turn = 2e-3 + 1e-3 * np.cos(on_map(run, now))
    now.yaw_rad = np.where(inside, turn * np.abs(now.ds_m), 0.0)
    unseen_turn(now)


@case("floor_slope", "any direction", 2e-4, -4e-4, within=1e-2)
def _(run: Run, now: Motion) -> None:
    # downhill by 4.5e-4 at -63 degrees
    now.left = now.right = np.hypot(2e-4, 4e-4) * np.cos(on_map(run, now) - np.arctan2(-4e-4, 2e-4))


@case("floor_zone", "x 2 m, whole width", 3e-3, 2e-3, 1e-3, within=3e-2, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    sign = -1.0 if run.direction == "back" else 1.0
    x = (10.0 if run.kind == "corridor" and sign < 0 else 0.0) + sign * now.x_m
    inside = np.abs(x - 2.0) < 1.0
    now.left = now.right = np.where(inside, 3e-3, 0.0)
    now.yaw_rad = np.where(inside, (2e-3 + 1e-3 * np.cos(on_map(run, now))) * np.abs(now.ds_m), 0.0)
    unseen_turn(now)


LANES = [replace(run, kind="corridor_b") if number % 6 == 3 else run for number, run in enumerate(RUNS)]


@case("floor_undulation", "route corridor", 8e-4, runs=LANES)
def _(run: Run, now: Motion) -> None:
    if run.kind == "corridor":
        # wheels roll 1 / (1 - q) for each metre
        now.left = now.right = -8e-4


NOTED = [
    Run(STRAIGHT, log=False, front=False, numbers={"amplitude_m": 0.02 * i, "wavelength_m": 4.0}) for i in range(14)
]


@case("path_weave", "by the noted", 1.0, runs=NOTED)
def _(run: Run, now: Motion) -> None:
    # arc length of the sine by quadrature: the wheels roll the plan's 10 m, the line is shorter
    x = np.linspace(0.0, 4.0, 20001)
    slope = 2 * np.pi * run.numbers["amplitude_m"] / 4.0 * np.cos(2 * np.pi * x / 4.0)
    line = 10.0 * 4.0 / float(np.trapezoid(np.sqrt(1.0 + slope**2), x))
    now.laser_m = now.end_x_m = line - 10.0


HUMID = [run.numbers["humidity"] for run in RUNS]


@case("covariate:humidity", "right radius", 1e-3)
def _(run: Run, now: Motion) -> None:
    now.right = 1e-3 * (run.numbers["humidity"] - np.mean(HUMID)) / np.std(HUMID)


@case("covariate:humidity", "yaw per metre", 5e-4, within=1e-2)
def _(run: Run, now: Motion) -> None:
    now.yaw_rad = 5e-4 * (run.numbers["humidity"] - np.mean(HUMID)) / np.std(HUMID) * now.ds_m
    unseen_turn(now)


@pytest.mark.parametrize("one", CASES, ids=lambda c: f"{c.effect}-{c.label}".rstrip("-"))
def test_an_effect_closes_the_gap_of_the_campaign_in_which_it_is_true(one: Case) -> None:
    runs = one.runs if one.runs is not None else RUNS
    plain = gap(situation(runs, model=one.model))
    s = situation(runs, model=one.model, truth=one.truth)
    form = form_of(s, one.effect, one.label)
    assert len(form.parameters) == len(one.sizes)
    before = gap(s) - plain
    path = predict(s)
    for _ in range(3):
        # about the fitted model, as the diagnosis does
        pushes = [push.scaled(size) for push, size in zip(form.pushes(path), one.sizes, strict=True)]
        path = predict(s, pushes)
    after = gap(s, pushes) - plain
    for channel in range(6):
        largest = np.abs(before[:, channel]).max()
        if largest < 1e-3 * np.abs(before).max():
            # nothing to close: nothing may be opened either
            largest = np.abs(before).max()
        assert np.abs(after[:, channel]).max() <= one.within * largest, f"channel {channel}"
    assert np.abs(before).max() > 0.0


@pytest.mark.parametrize(("label", "side"), [("end-point", 1.0), ("start heading", 0.0)])
def test_integration_scheme_is_the_difference_of_the_coarse_simulation(label: str, side: float) -> None:
    """The outside simulator steps along the heading at one end of each log step."""
    runs = ROLLING
    made = campaign(runs)
    numbers = dict(made.runs.numbers)
    poses = []
    for run in runs:
        now = motion_of(run)
        heading = np.concatenate([[0.0], np.cumsum(now.turn_rad)])
        taken = heading[1:] if side else heading[:-1]
        poses.append([np.sum(now.ds_m * np.cos(taken)), np.sum(now.ds_m * np.sin(taken)), heading[-1]])
    for j, name in enumerate(("sim_x_m", "sim_y_m", "sim_theta_rad")):
        numbers[name] = np.array([pose[j] for pose in poses])
    s = observations_of(replace(made, runs=replace(made.runs, numbers=numbers)))
    path = predict(s)
    (push,) = form_of(s, "integration_scheme", label).pushes(path)
    true_gap = s.measured[:, 1:3] - s.simulated[:, 1:3]
    said = predict(s, [push]).reading[:, 1:3] - path.reading[:, 1:3]
    # calib's own path rounds the plan's jumps of curvature off within a step: 0.06 rad / 24 of 0.03 m at each
    np.testing.assert_allclose(said, true_gap, rtol=0, atol=1e-2 * np.abs(true_gap).max())
    assert np.abs(true_gap).max() > 5e-3


def test_payload_effects_take_the_slope_of_a_load_law_that_the_hypothesis_brings() -> None:
    """With a load law fitted beside it, a share means the same as where the model has that law."""
    of_model, bare = situation(RUNS, model=SLOPED), situation(RUNS)
    law = [Push(**{side: 1.2e-6 * (bare.number(f"load_{side}_N") - 300.0) / RADIUS_M}) for side in ("left", "right")]
    for effect, label in (("payload_mass", "payload of 150"), ("payload_position", "sideways")):
        (known,) = form_of(of_model, effect, label).pushes(predict(of_model))
        (found,) = form_of(bare, effect, label).pushes(predict(bare, law))
        # the radius under it differs by 1e-2 at most
        np.testing.assert_allclose(found.left, known.left, rtol=2e-2)
        np.testing.assert_allclose(found.right, known.right, rtol=2e-2)


def test_a_wrong_truth_is_not_closed() -> None:
    """The check above can fail: a right wheel's slope on the left wheel leaves the gap open."""
    s = situation(RUNS, truth=lambda run, now: setattr(now, "left", 1.3e-5 * (run.load_left_N - 300.0)))
    push = form_of(s, "load_radius").pushes(predict(s))[1]
    assert np.abs(gap(s, [push.scaled(1.3e-6)])).max() > 0.5 * np.abs(gap(s)).max()


def test_routes_are_there() -> None:
    """The campaign of these tests holds straights, bends and squares."""
    assert all(any(run.pieces == pieces for run in RUNS) for pieces in (STRAIGHT, ROUTE, SQUARE))
