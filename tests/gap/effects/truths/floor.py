"""Truths of places: slope, zones, lanes, a weave."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.gap.effects.making import STRAIGHT, Motion, Run
from tests.gap.effects.truths.cases import HUMID, LOGGED, RUNS, case


def unseen_turn(now: Motion) -> None:
    """Let the vehicle really turn by what no wheel sees: the wheels keep to their plan."""
    now.turn_rad = now.turn_rad + now.yaw_rad
    # the front wheel follows the true path
    with np.errstate(divide="ignore", invalid="ignore"):
        now.steer_rad = np.arctan(np.where(now.ds_m != 0.0, now.turn_rad / now.ds_m, 0.0))


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


@case("floor_slope", "across, drift alone", 3e-3, within=1e-2)
def _(run: Run, now: Motion) -> None:
    now.lateral_m = 3e-3 * np.abs(now.ds_m) * np.cos(on_map(run, now))


@case("floor_slope", "any direction, drift alone", 3e-3, -2e-3, within=1e-2)
def _(run: Run, now: Motion) -> None:
    # downhill at -34 degrees; what of it lies to the left of the heading
    now.lateral_m = np.hypot(3e-3, 2e-3) * np.abs(now.ds_m) * np.sin(np.arctan2(-2e-3, 3e-3) - on_map(run, now))


@case("floor_slope", "any direction, pull alone", 4e-4, -3e-4, within=1e-2)
def _(run: Run, now: Motion) -> None:
    # downhill at -37 degrees: the heading turns towards it
    now.yaw_rad = 5e-4 * np.abs(now.ds_m) * np.sin(np.arctan2(-3e-4, 4e-4) - on_map(run, now))
    unseen_turn(now)


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


@case("covariate:humidity", "yaw per metre", 5e-4, within=1e-2)
def _(run: Run, now: Motion) -> None:
    now.yaw_rad = 5e-4 * (run.numbers["humidity"] - np.mean(HUMID)) / np.std(HUMID) * now.ds_m
    unseen_turn(now)
