"""Truths of wheels and what turns them: radii, track, drift, counts, direction, turns, braking."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.vehicle import Vehicle
from tests.gap.effects.making import RADIUS_M, TRACK_M, Motion, Run
from tests.gap.effects.truths.cases import FORWARD, HUMID, LOGGED, ROLLING, RUNS, case, mean


@case("radius_scale", "", 4e-3)
def _(run: Run, now: Motion) -> None:
    now.left = now.right = 4e-3


@case("unequal_radii", "", 2e-3)
def _(run: Run, now: Motion) -> None:
    now.left, now.right = -1e-3, 1e-3


@case("track_width", "", -1e-2)
def _(run: Run, now: Motion) -> None:
    now.track = -1e-2


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


#: quarter turns on the spot, in pieces of nine degrees, beside bends
ON_SPOT = [
    replace(run, pieces=[*run.pieces, *[(0.01, 5.0 * np.pi * (-1) ** number)] * 10, (2.0, 0.0)])
    for number, run in enumerate(LOGGED)
]


@case("curve_scrub", "on the spot", 1e-2, within=5e-2, runs=ON_SPOT)
def _(run: Run, now: Motion) -> None:
    now.track = np.where(np.abs(now.kappa) > 2.0 / TRACK_M, 1e-2 * 2.0 / TRACK_M, 0.0)


@case("curve_load_transfer", "", 1e-6, within=5e-2, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    # roll moment of the centrifugal force, taken by the rear wheels alone
    force_N = (100.0 + run.numbers["payload_kg"]) * now.v_mps**2 * now.kappa
    moved_N = force_N * 0.4 / TRACK_M
    now.left, now.right = -1e-6 * moved_N / RADIUS_M, 1e-6 * moved_N / RADIUS_M


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


@case("side_slip", "sideways speed", 5e-3, within=5e-2, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    # it slides at a speed in proportion to the lateral acceleration
    now.lateral_m = -5e-3 * now.v_mps * now.turn_rad


@case("rear_drag", "right wheel, rolling forward", 1e-3, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    now.right = np.where(now.ds_m > 0.0, 1e-3, 0.0)


@case("rear_drag", "left wheel, going out", -1e-3, runs=FORWARD)
def _(run: Run, now: Motion) -> None:
    now.left = -1e-3 if run.direction == "out" else 0.0


@case("travel_direction", "", 1e-3)
def _(run: Run, now: Motion) -> None:
    now.left = now.right = 1e-3 if run.direction == "out" else -1e-3


@case("travel_direction", "rolling forward or backward", 1e-3, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    now.left = now.right = np.where(now.ds_m > 0.0, 1e-3, -1e-3)


@case("lost_counts", "left wheel, constant share", 3e-3)
def _(run: Run, now: Motion) -> None:
    # of 1000 counts 3 are lost
    now.left = 1000.0 / 997.0 - 1.0


@case("lost_counts", "right wheel, share growing above the least", 5e-3, within=1e-2)
def _(run: Run, now: Motion) -> None:
    # none below the speed of the slowest run
    own_mps = np.abs(now.ds_m + 0.5 * now.turn_rad * TRACK_M) / now.dt_s
    now.right = 1.0 / (1.0 - 5e-3 * np.maximum(own_mps - 0.3, 0.0)) - 1.0


RAMPED = [replace(run, ramp=True) for run in LOGGED]


@case("lost_counts", "left wheel, share growing with speed", 2e-3, within=1e-2, runs=RAMPED)
def _(run: Run, now: Motion) -> None:
    # by the wheel's own speed: fewer while it speeds up, and on the inner side of a turn
    own_mps = np.abs(now.ds_m - 0.5 * now.turn_rad * TRACK_M) / now.dt_s
    now.left = 1.0 / (1.0 - 2e-3 * own_mps) - 1.0


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


def skid(run: Run, now: Motion, slide_m: float, turning: float = 1.0) -> None:
    if run.stops:
        now.along_m = np.zeros(len(now.ds_m))
        last = np.flatnonzero(now.ds_m)[-1]
        now.along_m[last] = slide_m
        now.yaw_rad = turning * now.along_m * now.kappa


@case("braking_skid", "the same", 2e-3, 2e-3, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    # it slides on along its curve
    skid(run, now, 2e-3)


@case("braking_skid", "the same", 2e-3, 0.0, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    # locked wheels do not turn it
    skid(run, now, 2e-3, turning=0.0)


@case("braking_skid", "the same at each stop, one wheel further", 2e-3, 0.0, 1e-3, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    # the right wheel by half a slide more than the middle of both, the left one by as much less
    skid(run, now, 2e-3, turning=0.0)
    if now.yaw_rad is not None and now.along_m is not None:
        unlike_rad = 0.5 * now.along_m / TRACK_M
        # it turns where it stops, not along its last step
        now.yaw_rad, now.lateral_m = now.yaw_rad + unlike_rad, -0.5 * unlike_rad * now.ds_m


@case("braking_skid", "~ v^2", 4e-3, 4e-3, within=1e-2, runs=RAMPED)
def _(run: Run, now: Motion) -> None:
    # it brakes from its full speed, which its mean speed is not
    skid(run, now, 4e-3 * run.speed_mps**2)


DIFFERENTIAL = Vehicle(track_m=TRACK_M, wheelbase_m=1.0, drive="differential")
SPEEDING_UP = [replace(run, ramp=True, front=False) for run in ROLLING]


# the acceleration is a difference over four steps, blurred over two of the twenty of the ramp
@case("wheel_slip", "speeding up and braking", 3e-2, runs=SPEEDING_UP, within=1e-1, vehicle=DIFFERENTIAL)
@case("wheel_slip", "speeding up", 3e-2, runs=SPEEDING_UP, within=1e-1, vehicle=DIFFERENTIAL)
def _(run: Run, now: Motion) -> None:
    way = np.cumsum(np.abs(now.ds_m)) - 0.5 * np.abs(now.ds_m)
    whole = float(np.sum(np.abs(now.ds_m)))
    # v^2 = 2 a s; a wheel that slips rolls more than the vehicle travels
    slip = 3e-2 * np.where(way < 0.2 * whole, run.speed_mps**2 / (0.4 * whole), 0.0)
    now.left = now.right = -slip / (1.0 + slip)


@case("covariate:humidity", "right radius", 1e-3)
def _(run: Run, now: Motion) -> None:
    now.right = 1e-3 * (run.numbers["humidity"] - np.mean(HUMID)) / np.std(HUMID)
