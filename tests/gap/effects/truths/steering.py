"""Truths of the front wheel: steering angle, play, delay, slip of the drive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.gap.effects.making import Motion, Run
from tests.gap.effects.truths.cases import LOGGED, ROLLING, case, mean


# the cosine of the zero, 1e-5 of the way, is taken as 1
@case("steering_zero", "", 5e-3, runs=LOGGED, within=2e-2)
def _(run: Run, now: Motion) -> None:
    now.steer_error_rad = 5e-3


@case("steering_zero_step", "", 5e-3, -3e-3, runs=LOGGED, within=2e-2)
def _(run: Run, now: Motion) -> None:
    share = {name: mean(LOGGED, lambda one, name=name: float(one.session == name)) for name in ("s2", "s3")}
    now.steer_error_rad = 5e-3 * ((run.session == "s2") - share["s2"]) - 3e-3 * ((run.session == "s3") - share["s3"])


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


@case("steering_delay", "about 0.3 s", 0.28, runs=WINDING, within=5e-2)
def _(run: Run, now: Motion) -> None:
    middle = now.t_s - 0.5 * now.dt_s
    now.steer_error_rad = np.interp(middle - 0.28, middle, now.steer_rad) - now.steer_rad


# a command: the wheel follows it later, and stood straight before
@case("steering_delay", "about -0.3 s", -0.28, runs=WINDING, within=5e-2)
def _(run: Run, now: Motion) -> None:
    middle = now.t_s - 0.5 * now.dt_s
    now.steer_error_rad = np.interp(middle + 0.28, middle, now.steer_rad) - now.steer_rad


# counts that slipped already are multiplied by the slip again: slip squared
@case("drive_slip", "by the force, rolling", 1e-2, runs=LOGGED, within=2e-2)
def _(run: Run, now: Motion) -> None:
    weight = 100.0 + run.numbers["payload_kg"]
    now.front = 1e-2 * weight / mean(LOGGED, lambda one: 100.0 + one.numbers["payload_kg"])


RAMPED = [replace(run, ramp=True) for run in ROLLING]


# the acceleration is a difference over four steps, blurred where the ramp ends
@case("drive_slip", "by the force, speeding up and braking", 3e-2, runs=RAMPED, within=5e-2)
@case("drive_slip", "by the force, speeding up", 3e-2, runs=RAMPED, within=5e-2)
def _(run: Run, now: Motion) -> None:
    way = np.cumsum(np.abs(now.ds_m)) - 0.5 * np.abs(now.ds_m)
    whole = float(np.sum(np.abs(now.ds_m)))
    # v^2 = 2 a s
    acceleration = np.where(way < 0.2 * whole, run.speed_mps**2 / (0.4 * whole), 0.0)
    weight = (100.0 + run.numbers["payload_kg"]) / mean(RAMPED, lambda one: 100.0 + one.numbers["payload_kg"])
    now.front = 3e-2 * acceleration * weight


# the front wheel is turned further than the curve that is driven, by 5 % at 1 m/s, and rolls at that angle to its way
@case("understeer", "", 5e-2, runs=WINDING, within=2e-2)
def _(run: Run, now: Motion) -> None:
    way_rad = np.arctan(now.kappa)
    now.steer_rad = np.arctan((1.0 + 5e-2 * run.speed_mps**2) * now.kappa)
    slip_rad = now.steer_rad - way_rad
    now.front = np.cos(slip_rad) * np.cos(now.steer_rad) / np.cos(way_rad) - 1.0
