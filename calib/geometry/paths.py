"""Paths of a campaign's runs by the nominal and the calibrated vehicle, beside the reference: what a figure draws."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calib.arrays import FloatArray
from calib.geometry.estimate import recordings_put_right
from calib.geometry.joint_fit import drive_of
from calib.geometry.parts import RunPath
from calib.geometry.path import integrate_motion, moved_between
from calib.geometry.result import Geometry

if TYPE_CHECKING:
    from calib.campaign.model import Campaign


def paths_of(campaign: Campaign, geometry: Geometry) -> tuple[RunPath, ...]:
    """Return the paths of the runs of a campaign.

    `campaign`: the one that was calibrated.
    """
    recording, _ = recordings_put_right(campaign, geometry.source)
    drive = drive_of(campaign, geometry.source, recording)
    values = geometry.values
    nominal = np.array([item.nominal for item in drive.parameters])
    fitted = np.array([values.get(item.name, item.nominal) for item in drive.parameters])
    poses = [integrate_motion(drive.motion(at, recording.steps)).pose for at in (nominal, fitted)]
    paths = []
    for run in range(len(recording)):
        part = slice(int(recording.offsets[run]), int(recording.offsets[run + 1]))
        before, after = (_from_start(pose[:, part]) for pose in poses)
        seen = recording.reference[:, part]
        seen = seen[:, np.isfinite(seen).all(axis=0)]
        reference = _from_start(seen) if seen.shape[1] > 1 else recording.end_pose[run : run + 1, :2]
        paths.append(RunPath(str(recording.run_id[run]), str(recording.kind[run]), before, after, reference))
    return tuple(paths)


def _from_start(pose: FloatArray) -> FloatArray:
    samples = np.arange(pose.shape[1])
    return np.asarray(moved_between(pose, np.zeros_like(samples), samples)[:, :2])
