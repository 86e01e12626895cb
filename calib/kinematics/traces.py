"""Residuals of each run in time, and the sensor's aligned paths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.campaign.model import Campaign
from calib.kinematics.blunders import corrected
from calib.kinematics.drives import GYRO_SCALE, Drive, parameters_of
from calib.kinematics.estimate import divisions
from calib.kinematics.joint_fit import drive_of
from calib.kinematics.model import Model, Segments
from calib.kinematics.recording import Recording, recording_of
from calib.kinematics.result import Geometry, RunTrace
from calib.types import FloatArray, IntArray, in_frame


def traces_of(campaign: Campaign, geometry: Geometry) -> tuple[RunTrace, ...]:
    """Return paths and residuals of runs by the nominal and the calibrated vehicle."""
    source, recording = geometry.source, recording_of(campaign, geometry.source)
    coarse = next(divisions(recording, geometry.using))
    recording, _ = corrected(recording, coarse, source, drive_of(campaign, source, recording))
    drive = drive_of(campaign, source, recording)
    nominal = {item.name: item.nominal for item in parameters_of(drive, campaign.reference)}
    # a gyro's scale is no part of the path
    found = geometry.values | {GYRO_SCALE: 1.0}
    calibrated = np.array([found.get(name, value) for name, value in nominal.items()])
    own_delay = {delay.label: delay.value_s - calibrated[-1] for delay in geometry.delays}
    labels = zip(recording.run_id, recording.session, strict=True)
    added = np.array([next((own_delay[name] for name in pair if name in own_delay), 0.0) for pair in labels])
    before = _sensor_paths(drive, recording, np.array([*nominal.values()]))
    after = _sensor_paths(drive, replace(recording, own_delay_s=added), calibrated)
    return tuple(_trace(recording, run, [before, after]) for run in range(len(recording)))


def _sensor_paths(drive: Drive, recording: Recording, values: FloatArray) -> FloatArray:
    """Return the sensor's pose at each sample since the start of its run, shape (3, n_samples)."""
    run, n = recording.run, len(recording.t_s)
    seen, no_gyro = np.ones((n, 3), dtype=np.bool_), np.zeros(n, dtype=np.bool_)
    segments = Segments(run, recording.offsets[run], np.arange(n), np.zeros((n, 3)), seen, run, 0 * run, no_gyro)
    return -Model(drive, recording, segments).predict(values).residuals.T


def _trace(recording: Recording, run: int, paths: list[FloatArray]) -> RunTrace:
    part = slice(int(recording.offsets[run]), int(recording.offsets[run + 1]))
    reference = recording.reference[:, part]
    seen = np.flatnonzero(np.isfinite(reference).any(axis=0)).astype(np.int64)
    before, after = paths = [path[:, part] for path in paths]
    if len(seen) > 1:
        # the calibrated path stays in its start frame: the reference is aligned with it, the nominal path with that
        measured = _aligned(reference[:, seen], after[:, seen], np.arange(len(seen)))
        aligned = [_aligned(before, measured, seen), after]
    else:
        seen = np.array([reference.shape[1] - 1], dtype=np.int64)
        measured, aligned = recording.end_pose[run][:, None], paths
    residuals = [in_frame(measured - path[:, seen], path[2, seen]) for path in aligned]
    names = str(recording.run_id[run]), str(recording.kind[run])
    before_m, after_m = (path[:2].T for path in aligned)
    return RunTrace(*names, before_m, after_m, seen, recording.t_s[part][seen], measured[:2].T, *residuals)


def _aligned(path: FloatArray, onto: FloatArray, seen: IntArray) -> FloatArray:
    """Return a path (3, n) moved as a whole so that samples `seen` lie nearest to those of `onto`."""
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
    place = np.array([[cosine, -sine], [sine, cosine]]) @ (path[:2] - own_mean[:, None]) + other_mean[:, None]
    return np.concatenate([place, path[2:] + turn])
