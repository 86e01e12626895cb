"""A run or a window of a recording: its wheel angles, what was measured at its end, and the reference's poses in it."""

from __future__ import annotations

import mmap
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from tempfile import TemporaryFile
from typing import Final

import numpy as np

from calib.campaign.model import Campaign, RunTable
from calib.campaign.settings import WHEEL_LOADS, Encoder, OdometryModel, Reference
from calib.campaign.wheels import ASIDE, WHEEL_COLUMNS
from calib.types import FloatArray, IntArray, in_frame

#: steps of a thinned log; the arcs between are exact for what the wheels rolled
MAX_STEPS: Final = 400
#: steps of a run whose totals alone are known
STEPS_WITHOUT_LOG: Final = 40
#: arrays of more steps lie in temporary files
HELD_STEPS: Final = 2**21


@dataclass(frozen=True, slots=True)
class CountsPerRadian:
    """Counts of each encoder for a radian of its wheel."""

    left: float
    right: float
    front: float

    @staticmethod
    def from_encoder(encoder: Encoder) -> CountsPerRadian:
        """Return the scales of an encoder section."""
        per_rev = (encoder.counts_per_rev_left, encoder.counts_per_rev_right, encoder.front)
        return CountsPerRadian(*(counts / (2 * np.pi) for counts in per_rev))


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """What all runs of a campaign are read with."""

    campaign: Campaign
    model: OdometryModel  #: what the simulator believes
    per_rad: CountsPerRadian
    in_map: bool  #: whether the reference's poses stand in one frame for all runs
    stands_in: bool  #: whether the two wheels represent a front wheel, or for four wheels


def _nan(*shape: int) -> FloatArray:
    return np.full(shape, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """A run, or a window of a recording."""

    run: int  #: row of the run table
    window: int  #: number of the window within its run, 0 for a whole run
    #: time_s, left_rad, right_rad: shape (n_steps + 1,): time since the run's start and angles of the wheels by their
    #: counters
    time_s: FloatArray
    left_rad: FloatArray
    right_rad: FloatArray
    #: front_rad, steer_rad: shape (n_steps + 1,): angle of the front wheel and its steering angle
    front_rad: FloatArray | None = None
    steer_rad: FloatArray | None = None
    aside_m: FloatArray | None = None  #: shape (n_steps + 1,): what mecanum wheels rolled to the left
    #: load_left_N, load_right_N: shape (n_steps + 1,): mean wheel loads in the step that ends at each sample
    load_left_N: FloatArray | None = None
    load_right_N: FloatArray | None = None
    from_log: bool = True  #: false where the steps were made up from the totals
    #: measured, simulated: shape (4,): distance, x, y and heading at the end, in the frame of its start; NaN
    #: where not measured
    measured: FloatArray = field(default_factory=lambda: _nan(4))
    simulated: FloatArray = field(default_factory=lambda: _nan(4))
    #: sigma_xy_m, sigma_theta_rad: standard uncertainty of the measured position and heading; NaN where the settings'
    #: holds
    sigma_xy_m: float = float("nan")
    sigma_theta_rad: float = float("nan")
    #: standard uncertainty of the heading of the observation's start frame, where that was read too
    sigma_start_rad: float = 0.0
    #: shape (3,): where the observation starts in the frame common to all runs; NaN where there is none
    start_pose: FloatArray = field(default_factory=lambda: _nan(3))
    by_gyro: bool = False  #: whether a gyro measured its turn

    @property
    def n_steps(self) -> int:
        """Number of steps."""
        return len(self.left_rad) - 1


#: fields of `Observation` with a value for each sample
ALONG_RUN: Final = ("time_s", "left_rad", "right_rad", "front_rad", "steer_rad", "aside_m", *WHEEL_LOADS)


def log_rows(log: Mapping[str, FloatArray]) -> IntArray:
    """Return the samples of a log that have a time and both counts, shape (n_samples,); none if a column is missing."""
    if not {"t_s", "counts_left", "counts_right"} <= log.keys():
        return np.zeros(0, dtype=np.int64)
    return np.flatnonzero(np.isfinite(log["t_s"]) & np.isfinite(log["counts_left"]) & np.isfinite(log["counts_right"]))


def thinned(rows: IntArray) -> IntArray:
    """Return at most `MAX_STEPS` + 1 of the samples, evenly spread, first and last kept."""
    return rows if len(rows) <= MAX_STEPS + 1 else rows[_evenly(len(rows))]


@lru_cache(maxsize=16)
def _evenly(n_rows: int) -> IntArray:
    return np.unique(np.linspace(0, n_rows - 1, MAX_STEPS + 1).astype(np.int64))


def observation_from_log(
    run: int, log: Mapping[str, FloatArray], rows: IntArray, per_rad: CountsPerRadian
) -> Observation:
    """Make a unit of two or more samples of a log, thinned here; nothing is measured yet.

    The front wheel, or the shaft, counts where all of its samples are there.
    """
    index = thinned(rows)
    counted = "counts_front" if "counts_front" in log else WHEEL_COLUMNS["shaft"][0]
    front, steer, aside = (log[name][index] if name in log else None for name in (counted, "steer_rad", ASIDE))
    loads = [_means(log[name], index) if name in log else None for name in WHEEL_LOADS]
    return Observation(
        run=run,
        window=0,
        time_s=log["t_s"][index],
        left_rad=log["counts_left"][index] / per_rad.left,
        right_rad=log["counts_right"][index] / per_rad.right,
        front_rad=None if front is None or np.isnan(front).any() else front / per_rad.front,
        steer_rad=None if steer is None or np.isnan(steer).any() else steer,
        aside_m=aside,
        load_left_N=loads[0],
        load_right_N=loads[1],
    )


def _means(samples: FloatArray, index: IntArray) -> FloatArray:
    """Return the means of samples (n,) between the picked ones, each at the later, shape (n_picked,)."""
    return np.append(samples[index[0]], np.diff(np.cumsum(samples)[index]) / np.diff(index))


def observation_from_row(run: int, runs: RunTable, per_rad: CountsPerRadian) -> Observation | None:
    """Make a unit of a row's totals, as one arc; None where the row has no counts."""
    left, right = float(runs.number("counts_left")[run]), float(runs.number("counts_right")[run])
    if not (np.isfinite(left) and np.isfinite(right)):
        return None
    share, time_s = np.linspace(0.0, 1.0, STEPS_WITHOUT_LOG + 1), _nan(STEPS_WITHOUT_LOG + 1)
    left_rad, right_rad = share * left / per_rad.left, share * right / per_rad.right
    return Observation(run=run, window=0, time_s=time_s, left_rad=left_rad, right_rad=right_rad, from_log=False)


#: a log needs so many poses for a reference of its own
MIN_POSES: Final = 3
#: a first pose so far from zero, in stated uncertainties, was not taken in the frame of the run's start
MAP_START_SIGMAS: Final = 8.0
MAP_START_M, MAP_START_RAD = 0.01, 0.02
#: a course is taken over at least so many stated uncertainties of a position
COURSE_SIGMAS: Final = 100.0
#: over no more than this share of the run
COURSE_SHARE: Final = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class ReferencePoses:
    """Poses of the middle of the rear axle in a run, by the reference."""

    rows: IntArray  #: shape (n_poses,): samples of the log that have a pose and counts
    #: shape (n_poses, 3): x, y and unwrapped heading; in one frame for the whole run. NaN headings where only positions
    #: were measured.
    poses: FloatArray
    #: shape (n_poses,): what the wheels rolled up to each pose, the mean of both, standing turns included
    travelled_m: FloatArray
    in_map: bool  #: true where the frame is one that all runs share
    from_first: bool  #: true where the run's own frame is that of its first pose, not the frame that the poses stand in
    course: CourseOverGround | None  #: how headings are made up where the reference has none

    def pose(self, number: int) -> tuple[FloatArray, float]:
        """Return a pose, and the standard uncertainty of its heading where that was made up (else NaN)."""
        if self.course is None:
            return self.poses[number], float("nan")
        return self.course.pose(number)


@dataclass(frozen=True, slots=True, eq=False)
class CourseOverGround:
    """Headings from positions: the course over a short way, less what the wheels say of heading against it."""

    positions: FloatArray  #: shape (n_poses, 2): of the sensor
    by_wheels: FloatArray  #: shape (n_poses, 3): the vehicle's pose by its wheels
    travelled_m: FloatArray  #: shape (n_poses,): what was rolled up to each pose
    place_m: FloatArray  #: shape (2,): the sensor's place on the vehicle
    sigma_xy_m: float  #: standard uncertainty of a position
    way_m: float  #: way over which a course is taken

    def pose(self, number: int) -> tuple[FloatArray, float]:
        """Return the vehicle's pose at a sample, and the standard uncertainty of its heading; NaN where it stood."""
        here = self.travelled_m[number]
        first = int(np.searchsorted(self.travelled_m, here - 0.5 * self.way_m, side="right")) - 1
        last = int(np.searchsorted(self.travelled_m, here + 0.5 * self.way_m))
        first, last = max(first, 0), min(last, len(self.travelled_m) - 1)
        # at the ends of the run the whole way lies on one side
        if first == 0:
            last = max(last, min(int(np.searchsorted(self.travelled_m, self.way_m)), len(self.travelled_m) - 1))
        if last == len(self.travelled_m) - 1:
            begin = int(np.searchsorted(self.travelled_m, self.travelled_m[-1] - self.way_m, side="right")) - 1
            first = min(first, max(begin, 0))
        moved = self.positions[last] - self.positions[first]
        wheels = self._sensor_by_wheels(last) - self._sensor_by_wheels(first)
        chord = float(np.hypot(*moved))
        if chord < 0.3 * self.way_m or np.hypot(*wheels) < 0.3 * self.way_m:
            return _nan(3), float("nan")
        course = np.arctan2(moved[1], moved[0]) - np.arctan2(wheels[1], wheels[0])
        heading = self.by_wheels[number, 2] + (course + np.pi) % (2 * np.pi) - np.pi
        place = self.positions[number] - _turned(self.place_m, heading)
        return np.array([*place, heading]), float(np.sqrt(2.0)) * self.sigma_xy_m / chord

    def _sensor_by_wheels(self, number: int) -> FloatArray:
        return self.by_wheels[number, :2] + _turned(self.place_m, self.by_wheels[number, 2])


def _turned(vector: FloatArray, angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def relative_pose(first: FloatArray, last: FloatArray) -> FloatArray:
    """Return a pose (x, y, heading) as seen from another."""
    return np.asarray(in_frame((last - first)[:, None], first[2:])[0])


def poses_are_in_a_map(campaign: Campaign) -> bool:
    """Return whether the logs' poses stand in one frame for all runs: so stated, or runs do not begin at zero."""
    reference, logs = campaign.reference, campaign.logs
    if reference.frame is not None:
        return reference.frame == "map"
    x, y, heading = (logs.columns.get(name) for name in ("ref_x_m", "ref_y_m", "ref_theta_rad"))
    if x is None or y is None:
        return False
    far = max(MAP_START_M, MAP_START_SIGMAS * reference.sigma_xy_m)
    bent = max(MAP_START_RAD, MAP_START_SIGMAS * reference.sigma_theta_rad)
    # a reference that only begins on the way says nothing of the run's start
    first = logs.offsets[:-1][np.diff(logs.offsets) > 0]
    turned = np.zeros(len(first)) if heading is None else np.nan_to_num(np.abs(heading[first]))
    away = np.hypot(x[first], y[first])
    return bool((np.isfinite(away) & ((away > far) | (turned > bent))).any())


def reference_poses(log: Mapping[str, FloatArray], setup: Setup) -> ReferencePoses | None:
    """Return the vehicle's poses of a run by its log's reference; None where the log has too few."""
    reference, model, per_rad = setup.campaign.reference, setup.model, setup.per_rad
    if not {"ref_x_m", "ref_y_m"} <= log.keys():
        return None
    all_rows = log_rows(log)
    there = np.isfinite(log["ref_x_m"][all_rows]) & np.isfinite(log["ref_y_m"][all_rows])
    heading = log.get("ref_theta_rad")
    if heading is not None:
        with_heading = there & np.isfinite(heading[all_rows])
        heading, there = (heading, with_heading) if with_heading.sum() >= MIN_POSES else (None, there)
    if len(rows := all_rows[there]) < MIN_POSES:
        return None
    # at every sample: between the poses of a slow reference the vehicle turns
    left = log["counts_left"][all_rows] / per_rad.left * model.radius_left_m
    right = log["counts_right"][all_rows] / per_rad.right * model.radius_right_m
    travelled = np.concatenate(([0.0], np.cumsum(0.5 * (np.abs(np.diff(left)) + np.abs(np.diff(right))))))[there]
    seen = np.stack([log["ref_x_m"][rows], log["ref_y_m"][rows]], axis=1)
    if heading is None:
        way = max(1.5 * model.track_m, COURSE_SIGMAS * reference.sigma_xy_m)
        course = CourseOverGround(
            positions=seen,
            by_wheels=_by_wheels(left, right, model.track_m)[there],
            travelled_m=travelled,
            place_m=np.array([reference.sensor_x_m, reference.sensor_y_m]),
            sigma_xy_m=reference.sigma_xy_m,
            way_m=min(way, COURSE_SHARE * float(travelled[-1])),
        )
        # in the frame of its start a sensor on the axle needs no heading, whose makers knew that of the start
        on_axle = (reference.sensor_x_m, reference.sensor_y_m) == (0.0, 0.0)
        from_first = not (reference.frame == "start" and on_axle)
        poses = np.column_stack([seen, np.full(len(rows), np.nan)])
        return ReferencePoses(rows, poses, travelled, setup.in_map, from_first, course)
    poses = poses_of_vehicle(np.column_stack([seen, np.unwrap(heading[rows])]), reference, in_map=setup.in_map)
    return ReferencePoses(rows, poses, travelled, setup.in_map, from_first=setup.in_map, course=None)


def _by_wheels(left_m: FloatArray, right_m: FloatArray, track_m: float) -> FloatArray:
    ds, turn = 0.5 * np.diff(left_m + right_m), np.diff(right_m - left_m) / track_m
    mid = np.cumsum(turn) - 0.5 * turn
    return np.vstack([np.zeros(3), np.cumsum(np.stack([ds * np.cos(mid), ds * np.sin(mid), turn], axis=1), axis=0)])


def poses_of_vehicle(sensor: FloatArray, reference: Reference, *, in_map: bool) -> FloatArray:
    """Turn poses of the sensor (n, 3) into poses of the vehicle.

    In a map they are poses of the sensor; else the sensor's motion since its own start pose, V = X S X^-1 with the
    sensor's place X on the vehicle. A position without a heading stays as it is where the sensor sits on the axle, and
    cannot be used elsewhere.
    """
    place, yaw = complex(reference.sensor_x_m, reference.sensor_y_m), reference.sensor_yaw_rad
    if place == 0.0 and yaw == 0.0:
        return sensor
    at, heading = sensor[:, 0] + 1j * sensor[:, 1], sensor[:, 2] - yaw
    if not in_map:
        at, heading = place + np.exp(1j * yaw) * at, sensor[:, 2]
    if place != 0.0:
        at = at - np.exp(1j * heading) * place
    return np.stack([at.real, at.imag, heading], axis=1)


def step_array(n_steps: int) -> FloatArray:
    """Return zeros, shape (n_steps,): of many steps in a temporary file, mapped, whose pages `let_go` gives back."""
    if n_steps > HELD_STEPS and hasattr(os, "posix_fallocate") and hasattr(mmap, "MADV_DONTNEED"):
        # all of its room is taken here: where the disk has none, the array is held in memory
        with suppress(OSError), TemporaryFile() as file:
            os.posix_fallocate(file.fileno(), 0, 8 * n_steps)
            return np.ndarray(n_steps, buffer=mmap.mmap(file.fileno(), 8 * n_steps))
    return np.zeros(n_steps)


def let_go(*arrays: FloatArray | None) -> None:
    """Give back the memory of arrays that lie in files; the system reads again what is asked for again."""
    bases: list[object] = [array.base for array in arrays if array is not None]
    for base in bases:
        if isinstance(base, mmap.mmap):
            base.madvise(mmap.MADV_DONTNEED)
