"""The vehicle's runtime fed with logged runs, against the array odometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.coefficients.file import CoefficientFile
from calib.motion.odometry.integrate import integrate
from calib.motion.odometry.loaded import loads_in_steps, radii_under_load, travel_from_counts
from calib.runtime import Coefficients, Odometer, OdometerFault, Status


@dataclass(frozen=True, slots=True, eq=False)
class RuntimeCheck:
    """The vehicle's runtime against the array odometry on the same logs."""

    runs: int  #: runs fed
    samples: int  #: samples fed
    #: largest_difference_m, largest_difference_rad: over all samples of these runs; NaN where none was accepted
    largest_difference_m: float
    largest_difference_rad: float
    faults: dict[str, int]  #: refused loads and samples by status


#: of a vehicle that the runtime, which reads two wheels on one axle, cannot follow
NOT_FED: Final = RuntimeCheck(0, 0, float("nan"), float("nan"), {})


def runtime_check(campaign: Campaign, coefficients: CoefficientFile, *, runs: int) -> RuntimeCheck:
    """Feed the vehicle's runtime the logs of the first `runs` runs and compare it, sample by sample, with the arrays.

    Refused samples are counted and left out of the comparison of that run.
    """
    odometer = Odometer(Coefficients.parse(coefficients.to_bytes().decode("utf-8")))
    law, track = coefficients.law, coefficients.geometry.track_m
    logs = campaign.logs
    carried = [
        loads_in_steps(campaign.runs.number(name), logs.columns.get(name), logs.offsets)
        for name in ("load_left_N", "load_right_N")
    ]
    faults: dict[str, int] = {}
    samples = fed = 0
    worst_m = worst_rad = float("nan")
    for run in range(min(runs, len(campaign.runs))):
        log = campaign.logs.of(run)
        odometer.reset()
        fed += 1
        part = slice(int(logs.offsets[run]), int(logs.offsets[run + 1]))
        loads = np.stack([load[part] for load in carried], axis=1)
        changed = np.concatenate(([True], (np.diff(loads, axis=0) != 0.0).any(axis=1))).tolist()
        fine, clamped = True, False
        poses = []
        samples_of_run = zip(
            log["counts_left"].tolist(),
            log["counts_right"].tolist(),
            log["t_s"].tolist(),
            loads.tolist(),
            changed,
            strict=True,
        )
        for left, right, t, pair, new in samples_of_run:
            try:
                if new:
                    odometer.set_wheel_loads(*pair)
            except OdometerFault as fault:
                faults[fault.status.name] = faults.get(fault.status.name, 0) + 1
                fine = False
                break
            status = odometer.feed(left, right, t)
            samples += 1
            if status is not Status.OK:
                faults[status.name] = faults.get(status.name, 0) + 1
                fine = False
                break
            pose = odometer.pose
            clamped = clamped or pose.clamped
            poses.append((pose.x_m, pose.y_m, pose.theta_rad))
        if not fine or clamped:
            continue
        radii = radii_under_load(law, loads[:, 0], loads[:, 1])
        left_m, right_m = travel_from_counts(log["counts_left"], log["counts_right"], campaign.encoder, *radii)
        gap = np.abs(integrate(left_m, right_m, track).stacked() - np.array(poses)).max(axis=0)
        worst_m = float(np.fmax(worst_m, max(gap[0], gap[1])))
        worst_rad = float(np.fmax(worst_rad, gap[2]))
    return RuntimeCheck(fed, samples, worst_m, worst_rad, faults)
