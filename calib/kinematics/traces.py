"""Residuals of a geometry, run by run: aligned paths of the reference sensor, and residuals in time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calib.kinematics.drives import integrate_motion, moved_between
from calib.kinematics.estimate import recordings_put_right
from calib.kinematics.joint_fit import drive_of
from calib.kinematics.result import Geometry, RunTrace
from calib.types import FloatArray, IntArray

if TYPE_CHECKING:
    from calib.campaign.model import Campaign
    from calib.kinematics.recording import Recording


def traces_of(campaign: Campaign, geometry: Geometry) -> tuple[RunTrace, ...]:
    """Return paths and residuals of the runs of a campaign, before and after.

    `campaign`: the one that was calibrated.
    """
    recording, _ = recordings_put_right(campaign, geometry.source)
    drive = drive_of(campaign, geometry.source, recording)
    settings = campaign.reference
    nominal = {item.name: item.nominal for item in drive.parameters}
    nominal |= {name: float(getattr(settings, name)) for name in ("sensor_x_m", "sensor_y_m", "sensor_yaw_rad")}
    own_delay = {delay.label: delay.value_s for delay in geometry.delays}
    traces = []
    by_values = []
    for values in (nominal, nominal | dict(geometry.values)):
        parameters = np.array([values[item.name] for item in drive.parameters])
        by_values.append((integrate_motion(drive.motion(parameters, recording.steps)).pose, values))
    for run in range(len(recording)):
        label = str(recording.run_id[run]), str(recording.session[run])
        delay = next((own_delay[name] for name in label if name in own_delay), geometry.values.get("delay_s", 0.0))
        paths = [
            _sensor_path(pose, recording, run, values, late)
            for (pose, values), late in zip(by_values, (0.0, delay), strict=True)
        ]
        traces.append(_trace(recording, run, paths))
    return tuple(traces)


def _sensor_path(
    pose: FloatArray, recording: Recording, run: int, values: dict[str, float], delay_s: float
) -> FloatArray:
    """Return the sensor's poses at the samples of a run, `delay_s` before them, in the frame of its first, (3, n)."""
    part = slice(int(recording.offsets[run]), int(recording.offsets[run + 1]))
    t_s = recording.t_s[part]
    late = np.stack([np.interp(t_s - delay_s, t_s, axis) for axis in pose[:, part]])
    x, y, yaw = (values[name] for name in ("sensor_x_m", "sensor_y_m", "sensor_yaw_rad"))
    cosine, sine = np.cos(late[2]), np.sin(late[2])
    sensor = np.stack([late[0] + cosine * x - sine * y, late[1] + sine * x + cosine * y, late[2] + yaw])
    samples = np.arange(sensor.shape[1])
    return np.asarray(moved_between(sensor, np.zeros_like(samples), samples).T)


def _trace(recording: Recording, run: int, paths: list[FloatArray]) -> RunTrace:
    """Return a run's trace from the sensor's paths before and after, each (3, n_samples)."""
    part = slice(int(recording.offsets[run]), int(recording.offsets[run + 1]))
    reference = recording.reference[:, part]
    seen = np.flatnonzero(np.isfinite(reference).any(axis=0)).astype(np.int64)
    before, after = paths
    if len(seen) > 1:
        # the calibrated path stays in its start frame: the reference is aligned with it, the nominal path with that
        every = np.arange(len(seen))
        measured = _aligned(reference[:, seen], after[:, seen], every)
        aligned = [_aligned(before, measured, seen), after]
    else:
        seen = np.array([reference.shape[1] - 1], dtype=np.int64)
        measured, aligned = recording.end_pose[run][:, None], paths
    residuals = [_residuals(path[:, seen], measured) for path in aligned]
    return RunTrace(
        run_id=str(recording.run_id[run]),
        kind=str(recording.kind[run]),
        before_m=aligned[0][:2].T,
        after_m=aligned[1][:2].T,
        seen=seen,
        t_s=recording.t_s[part][seen],
        reference_m=measured[:2].T,
        residual_before=residuals[0],
        residual_after=residuals[1],
    )


def _aligned(path: FloatArray, onto: FloatArray, seen: IntArray) -> FloatArray:
    """Return a path turned and shifted as a whole so that its samples `seen` lie nearest to those of `onto`, (3, n)."""
    good = np.isfinite(path[:2, seen]).all(axis=0) & np.isfinite(onto[:2]).all(axis=0)
    if good.sum() < 2:
        turn = float(np.nanmean(onto[2] - path[2, seen]))
        return np.asarray(path + np.array([0.0, 0.0, turn])[:, None])
    own, other = path[:2, seen][:, good], onto[:2, good]
    own_mean, other_mean = own.mean(axis=1), other.mean(axis=1)
    a, b = own - own_mean[:, None], other - other_mean[:, None]
    turn = float(np.arctan2(np.sum(a[0] * b[1] - a[1] * b[0]), np.sum(a * b)))
    apart = onto[2] - path[2, seen]
    if np.isfinite(apart).any():
        turn += 2.0 * np.pi * float(np.rint((np.nanmedian(apart) - turn) / (2.0 * np.pi)))
    cosine, sine = np.cos(turn), np.sin(turn)
    rotate = np.array([[cosine, -sine], [sine, cosine]])
    place = rotate @ (path[:2] - own_mean[:, None]) + other_mean[:, None]
    return np.concatenate([place, path[2:] + turn])


def _residuals(path: FloatArray, measured: FloatArray) -> FloatArray:
    """Return measured less predicted along and to the left of the heading, and in the heading, shape (n_poses, 3)."""
    apart = measured - path
    cosine, sine = np.cos(path[2]), np.sin(path[2])
    return np.stack([cosine * apart[0] + sine * apart[1], cosine * apart[1] - sine * apart[0], apart[2]], axis=1)
