"""Truths of instruments: rangefinder and pose reference."""

from __future__ import annotations

import numpy as np

from tests.gap.effects.making import Motion, Run, end_pose
from tests.gap.effects.truths.cases import LOGGED, RUNS, case, mean


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


@case("reference_scale", "", 2e-3)
def _(run: Run, now: Motion) -> None:
    now.end_x_m, now.end_y_m = 2e-3 * end_pose(now.ds_m, now.turn_rad)[:2]


@case("reference_scale", "with the temperature", 1e-4)
def _(run: Run, now: Motion) -> None:
    over = run.numbers["temperature_C"] - mean(RUNS, lambda one: one.numbers["temperature_C"])
    now.end_x_m, now.end_y_m = 1e-4 * over * end_pose(now.ds_m, now.turn_rad)[:2]


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
