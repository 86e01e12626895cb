"""What a replay needs beside odometry: filled gaps, substitutes for missing readings, a check of the runtime."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.settings import OdometryModel
from calib.campaign.wheels import ASIDE, on_one_axle, without_rear_wheels
from calib.coefficients.file import CoefficientFile
from calib.odometry.integrate import integrate, loads_in_steps, radii_under_load, travel_from_counts
from calib.odometry.poses import Poses
from calib.radius.law import RadiusLaw
from calib.runtime import Coefficients, Odometer, OdometerFault, Status
from calib.types import FloatArray


def with_end_poses(campaign: Campaign) -> Campaign:
    """Return the campaign with the end poses that its logs' own references say, where a row has none."""
    columns, offsets = campaign.logs.columns, campaign.logs.offsets
    names = ("ref_x_m", "ref_y_m", "ref_theta_rad")
    ends = np.stack([campaign.runs.number(name) for name in names])
    if not set(names) <= columns.keys():
        return campaign
    for run in np.flatnonzero(campaign.logs.present & np.isnan(ends).all(axis=0)):
        part = slice(int(offsets[run]), int(offsets[run + 1]))
        x, y, theta = (columns[name][part] for name in names)
        if np.isfinite([x[0], y[0], theta[0], x[-1], y[-1], theta[-1]]).all():
            cosine, sine, dx, dy = np.cos(theta[0]), np.sin(theta[0]), x[-1] - x[0], y[-1] - y[0]
            turn = np.unwrap(theta[np.isfinite(theta)])
            ends[:, run] = cosine * dx + sine * dy, cosine * dy - sine * dx, turn[-1] - turn[0]
    numbers = {**campaign.runs.numbers, **dict(zip(names, ends, strict=True))}
    return replace(campaign, runs=replace(campaign.runs, numbers=numbers))


def with_loads(campaign: Campaign, law: RadiusLaw) -> tuple[Campaign, tuple[str, ...]]:
    """Return the campaign with loads where no run has any: those that the law is centred on."""
    runs = campaign.runs
    if any(np.isfinite(runs.number(name)).any() for name in ("load_left_N", "load_right_N")):
        return campaign, ()
    loads = {
        f"load_{side}_N": np.full(len(runs), wheel.reference_load_N)
        for side, wheel in (("left", law.left), ("right", law.right))
    }
    campaign = replace(campaign, runs=replace(runs, numbers={**runs.numbers, **loads}))
    if without_rear_wheels(campaign):
        return campaign, ()
    return campaign, ("no wheel load is given: all runs are taken at the load that the law is centred on",)


def carried_loads_N(campaign: Campaign) -> tuple[FloatArray, FloatArray]:
    """Return the loads of the left and the right wheel in each step, shape (n_samples,); see `loads_in_steps`."""
    logs = campaign.logs
    left, right = (
        loads_in_steps(campaign.runs.number(name), logs.columns.get(name), logs.offsets)
        for name in ("load_left_N", "load_right_N")
    )
    return left, right


def stood_in(campaign: Campaign, model: OdometryModel, *, scheme: str = "exact") -> tuple[Poses, FloatArray]:
    """Return the poses at all samples (n_samples,), each run from (0, 0, 0), and what was rolled in each step.

    That is the way of the axle's middle, to the side included, since the sample before; 0 at the first of a run. The
    campaign has no rear wheels, and each run a log; the model says what is believed of the front wheel or the four
    wheels.
    """
    axle = on_one_axle(campaign, model)
    columns, offsets = axle.logs.columns, axle.logs.offsets
    n = int(offsets[-1])
    radii = np.full(n, model.radius_left_m), np.full(n, model.radius_right_m)
    left, right = travel_from_counts(
        columns["counts_left"], columns["counts_right"], axle.encoder, *radii, offsets=offsets
    )
    poses = integrate(left, right, model.track_m, offsets=offsets, scheme=scheme)
    ahead = 0.5 * (left + right)
    if ASIDE not in columns:
        return poses, np.abs(ahead)
    aside = np.diff(columns[ASIDE], prepend=0.0)
    aside[offsets[:-1]] = 0.0
    half = 0.5 * (right - left) / model.track_m
    chord = aside * np.sinc(half / np.pi)
    x, y = (
        _running(part, offsets)
        for part in (-chord * np.sin(poses.theta_rad - half), chord * np.cos(poses.theta_rad - half))
    )
    return Poses(poses.x_m + x, poses.y_m + y, poses.theta_rad), np.hypot(ahead, aside)


def of_vehicle(ends: Poses, coefficients: CoefficientFile) -> Poses:
    """Return end poses of the reference's sensor, since its own start, as the vehicle's: V = X S X^-1.

    The geometry of the coefficient file says where on the vehicle the sensor sits, X.
    """
    together = coefficients.joint_geometry
    values = {} if together is None else {name: part.value for name, part in together.parameters.items()}
    x, y, yaw = (values.get(name, 0.0) for name in ("sensor_x_m", "sensor_y_m", "sensor_yaw_rad"))
    place = Poses(np.array(x), np.array(y), np.array(yaw))
    cosine, sine = np.cos(yaw), np.sin(yaw)
    back = Poses(np.array(-cosine * x - sine * y), np.array(sine * x - cosine * y), np.array(-yaw))
    return back.moved(ends.moved(place))


def _running(steps: FloatArray, offsets: np.ndarray) -> FloatArray:
    """Return the running sum within each run; the first step of a run is 0."""
    total = np.cumsum(steps)
    return np.asarray(total - np.repeat(total[offsets[:-1]], np.diff(offsets)))


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

    Refused samples are counted and omitted of the comparison of that run.
    """
    odometer = Odometer(Coefficients.parse(coefficients.to_bytes().decode("utf-8")))
    carried = np.stack(carried_loads_N(campaign), axis=1)
    faults: Counter[str] = Counter()
    samples = fed = 0
    worst_m = worst_rad = float("nan")
    for run in range(min(runs, len(campaign.runs))):
        log = campaign.logs.of(run)
        loads = carried[campaign.logs.offsets[run] : campaign.logs.offsets[run + 1]]
        poses, fault, taken = _fed(odometer, log, loads)
        fed, samples = fed + 1, samples + taken
        faults.update([fault] if fault else [])
        if poses is None:
            continue
        radii = radii_under_load(coefficients.law, *loads.T)
        travel = travel_from_counts(log["counts_left"], log["counts_right"], campaign.encoder, *radii)
        gap = np.abs(integrate(*travel, coefficients.geometry.track_m).stacked() - poses).max(axis=0)
        worst_m = float(np.fmax(worst_m, max(gap[0], gap[1])))
        worst_rad = float(np.fmax(worst_rad, gap[2]))
    return RuntimeCheck(fed, samples, worst_m, worst_rad, dict(faults))


def _fed(odometer: Odometer, log: dict[str, FloatArray], loads_N: FloatArray) -> tuple[FloatArray | None, str, int]:
    """Feed a run; return poses (n, 3), None where a sample or load was refused or clamped, the fault and the count."""
    odometer.reset()
    changed = np.concatenate(([True], (np.diff(loads_N, axis=0) != 0.0).any(axis=1))).tolist()
    readings = zip(*(log[name].tolist() for name in ("counts_left", "counts_right", "t_s")), strict=True)
    poses, clamped = [], False
    for number, (left, right, t_s) in enumerate(readings):
        try:
            if changed[number]:
                odometer.set_wheel_loads(*loads_N[number].tolist())
        except OdometerFault as fault:
            return None, fault.status.name, number
        status = odometer.feed(left, right, t_s)
        if status is not Status.OK:
            return None, status.name, number + 1
        pose = odometer.pose
        clamped = clamped or pose.clamped
        poses.append((pose.x_m, pose.y_m, pose.theta_rad))
    return None if clamped else np.array(poses), "", len(poses)
