"""Long recordings with a continuous reference, cut into windows, each in the frame of its own start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.campaign.settings import Reference
from calib.gap.data.reference_poses import ReferencePoses, relative_pose
from calib.gap.data.unit import Setup, Unit, log_rows, unit_from_log

#: with fewer runs than this, recordings are cut into windows
FEW_RUNS: Final = 12
#: longest window
WINDOW_M: Final = 4.0
#: windows wanted of all recordings together
WINDOWS_WANTED: Final = 48
#: shortest window, in tracks
SHORTEST_TRACKS: Final = 1.5
#: fewest samples of a window
FEWEST_SAMPLES: Final = 4


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """A run with its log and the reference's poses in it."""

    unit: Unit
    log: Mapping[str, FloatArray]
    reference: ReferencePoses | None


def window_length_m(travelled_m: float, track_m: float) -> float:
    """Return the length of a window: short enough for many, long enough that wheels matter, shape ()."""
    return float(np.clip(travelled_m / WINDOWS_WANTED, min(SHORTEST_TRACKS * track_m, WINDOW_M), WINDOW_M))


def edges_along(way_m: FloatArray, count: float) -> IntArray:
    """Return the samples that border windows of equal way, at most one a sample however far the way seems to go.

    Parameters
    ----------
    way_m : array of float, shape (n_samples,)
        Way from the start on, rising.
    count : float
        Windows wanted.
    """
    windows = max(int(count), 1) if count < len(way_m) else len(way_m)
    edges = np.unique(np.searchsorted(way_m, np.linspace(0.0, way_m[-1], windows + 1)))
    return np.asarray(np.minimum(edges, len(way_m) - 1), dtype=np.int64)


def whole(unit: Unit, reference: ReferencePoses, settings: Reference) -> Unit:
    """Return a run's unit with its end pose by the log's own reference."""
    if reference.from_first:
        return _between(unit, reference, 0, len(reference.rows) - 1, settings)
    measured = unit.measured.copy()
    measured[1:] = reference.poses[-1]
    return replace(unit, measured=measured)


def cut(recorded: Recorded, setup: Setup, length_m: float) -> list[Unit]:
    """Cut a recording into windows of about a length, by what the wheels roll; empty where there is but one.

    A front wheel is kept where it drives the odometry; else it is compared over whole runs only.
    """
    reference, log = recorded.reference, recorded.log
    if reference is None:
        return []
    travelled = reference.travelled_m
    edges = edges_along(travelled, float(np.rint(travelled[-1] / length_m)))
    rows = log_rows(log)
    windows: list[Unit] = []
    for first, last in pairwise(edges):
        inside = rows[(rows >= reference.rows[first]) & (rows <= reference.rows[last])]
        if len(inside) < FEWEST_SAMPLES:
            continue
        unit = replace(unit_from_log(recorded.unit.run, log, inside, setup.per_rad), window=len(windows))
        unit = unit if setup.stands_in else replace(unit, front_rad=None, steer_rad=None)
        windows.append(_between(unit, reference, int(first), int(last), setup.campaign.reference))
    return windows if len(windows) > 1 else []


def _between(unit: Unit, reference: ReferencePoses, first: int, last: int, settings: Reference) -> Unit:
    """Return a unit with the motion between two poses of the reference: both of them read, both uncertain."""
    (start, start_sd), (end, end_sd) = reference.pose(first), reference.pose(last)
    start_sd = settings.sigma_theta_rad if np.isnan(start_sd) else start_sd
    end_sd = settings.sigma_theta_rad if np.isnan(end_sd) else end_sd
    measured = unit.measured.copy()
    measured[1:] = relative_pose(start, end)
    if reference.course is not None:
        # a course is known up to whole turns
        turned = reference.course.by_wheels[last, 2] - reference.course.by_wheels[first, 2]
        measured[3] = turned + (measured[3] - turned + np.pi) % (2 * np.pi) - np.pi
    return replace(
        unit,
        measured=measured,
        sigma_xy_m=float(np.sqrt(2.0)) * settings.sigma_xy_m,
        sigma_theta_rad=end_sd,
        sigma_start_rad=start_sd,
        start_pose=start if reference.in_map else unit.start_pose,
    )
