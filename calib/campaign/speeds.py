"""Speeds of the wheels instead of counts: integrated once, so that everything downstream reads counts."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.campaign.model import Border, Logs
from calib.campaign.settings import Encoder
from calib.types import FloatArray
from calib.vehicle import Vehicle

#: columns of speeds, which counts replace in memory
SPEEDS: Final = ("speed_left_mps", "speed_right_mps", "speed_rear_mps", "v_mps", "omega_radps")


def with_counts(logs: Logs, encoder: Encoder, vehicle: Vehicle, border: Border) -> Logs:
    """Return the logs with the counts that the logged speeds amount to.

    A speed is the wheel's rate times its nominal radius; ``v_mps`` and ``omega_radps`` of a vehicle's own odometry are
    the speeds v -+ omega track / 2 of its wheels. Between samples a speed changes linearly (trapezoids). Counts that
    were logged are kept.

    Parameters
    ----------
    logs : Logs
        Of all runs.
    encoder : Encoder
        Counts per revolution of the result.
    vehicle : Vehicle
        Nominal radius and track, by which the vehicle computed its speeds.
    border : Border
        Takes what was done.
    """
    columns = dict(logs.columns)
    for name, speed_mps, per_rev in _wheel_speeds(columns, encoder, vehicle):
        way_m = _integral(speed_mps, columns["t_s"], logs)
        counts = way_m * (per_rev / (2.0 * np.pi * vehicle.wheel_radius_m))
        logged = columns.get(name)
        columns[name] = counts if logged is None else np.where(np.isnan(logged), counts, logged)
        border.say("logs", f"{name} integrated from speeds, by the nominal radius", "speeds")
    kept = {name: column for name, column in columns.items() if name not in SPEEDS}
    return Logs(logs.offsets, kept)


def _wheel_speeds(
    columns: dict[str, FloatArray], encoder: Encoder, vehicle: Vehicle
) -> list[tuple[str, FloatArray, float]]:
    """Return the column of counts, the speed, shape (n_samples,), and the counts per revolution of each wheel."""
    left, right = encoder.counts_per_rev_left, encoder.counts_per_rev_right
    wheels: list[tuple[str, FloatArray, float]] = []
    if {"v_mps", "omega_radps"} <= columns.keys():
        half = 0.5 * vehicle.track_m * columns["omega_radps"]
        wheels += [("counts_left", columns["v_mps"] - half, left), ("counts_right", columns["v_mps"] + half, right)]
    for side, per_rev in (("left", left), ("right", right), ("rear", left)):
        speed = columns.get(f"speed_{side}_mps")
        if speed is not None:
            wheels.append((f"counts_{side}", speed, per_rev))
    return wheels


def _integral(rate: FloatArray, t_s: FloatArray, logs: Logs) -> FloatArray:
    """Return the integral of a rate from the start of each log, shape (n_samples,); NaN where a log lacks the rate."""
    step = np.zeros(len(rate))
    step[1:] = 0.5 * (rate[1:] + rate[:-1]) * np.diff(t_s)
    begin = logs.offsets[:-1][logs.lengths > 0]
    step[begin] = np.where(np.isnan(rate[begin]), np.nan, 0.0)
    total = np.cumsum(np.nan_to_num(step))
    total -= np.repeat(total[begin], logs.lengths[logs.lengths > 0])
    has = np.isfinite(rate)
    return np.where(has, total, np.nan)
