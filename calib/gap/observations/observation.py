"""A run or window of a recording: wheel angles, what was measured at its end, and reference poses."""

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
from calib.campaign.settings import WHEEL_LOADS, OdometryModel, Reference
from calib.campaign.wheels import ASIDE, WHEEL_COLUMNS
from calib.odometry.poses import poses_of_vehicle
from calib.types import ComplexArray, FloatArray, IntArray, in_frame

#: steps of a thinned log; arcs between are exact for the wheels
MAX_STEPS: Final = 400
#: steps of a run by its totals
STEPS_WITHOUT_LOG: Final = 40
#: more lie in temporary files
HELD_STEPS: Final = 2**21


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """What all runs are read with."""

    campaign: Campaign
    model: OdometryModel  #: what the simulator believes
    per_rad: FloatArray  #: shape (3,): counts of left, right and front encoder for a radian of its wheel
    in_map: bool  #: whether reference poses stand in one frame for all runs
    stands_in: bool  #: whether both wheels represent a front wheel, or four


def _nan(*shape: int) -> FloatArray:
    return np.full(shape, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """A run, or a window of a recording."""

    run: int
    window: int  #: within the run, 0 for a whole one
    #: time_s, left_rad, right_rad: shape (n_steps + 1,): time since the run's start and counted wheel angles
    time_s: FloatArray
    left_rad: FloatArray
    right_rad: FloatArray
    #: front_rad, steer_rad: shape (n_steps + 1,): front wheel's angle and steering angle
    front_rad: FloatArray | None = None
    steer_rad: FloatArray | None = None
    aside_m: FloatArray | None = None  #: shape (n_steps + 1,): mecanum wheels' roll to the left
    #: load_left_N, load_right_N: shape (n_steps + 1,): mean wheel loads by the log in the step that ends at each
    load_left_N: FloatArray | None = None
    load_right_N: FloatArray | None = None
    from_log: bool = True  #: false where made up from totals
    #: measured, simulated: shape (4,): distance, x, y and heading at the end, in the start frame
    measured: FloatArray = field(default_factory=lambda: _nan(4))
    simulated: FloatArray = field(default_factory=lambda: _nan(4))
    #: sigma_xy_m, sigma_theta_rad: standard uncertainty of measured position and heading; NaN: the settings'
    sigma_xy_m: float = float("nan")
    sigma_theta_rad: float = float("nan")
    #: standard uncertainty of the start frame's heading, where that was read too
    sigma_start_rad: float = 0.0
    #: shape (3,): start in the frame common to all runs, else NaN
    start_pose: FloatArray = field(default_factory=lambda: _nan(3))
    #: shape (2, 5): see `Observations`
    course_error: FloatArray = field(default_factory=lambda: np.zeros((2, 5)))
    by_gyro: bool = False
    reference: "ReferencePoses | None" = None  #: of a run, by its log

    @property
    def n_steps(self) -> int:
        """Number of steps."""
        return len(self.left_rad) - 1


ALONG_RUN: Final = ("time_s", "left_rad", "right_rad", "front_rad", "steer_rad", "aside_m", *WHEEL_LOADS)


def log_rows(log: Mapping[str, FloatArray]) -> IntArray:
    """Return a log's samples with time and both counts, (n_samples,); none without the columns."""
    if not {"t_s", "counts_left", "counts_right"} <= log.keys():
        return np.zeros(0, dtype=np.int64)
    return np.flatnonzero(np.isfinite(log["t_s"]) & np.isfinite(log["counts_left"]) & np.isfinite(log["counts_right"]))


def thinned(rows: IntArray) -> IntArray:
    """Return at most `MAX_STEPS` + 1 samples, evenly spread, first and last kept."""
    return rows if len(rows) <= MAX_STEPS + 1 else rows[_evenly(len(rows))]


@lru_cache(maxsize=16)
def _evenly(n_rows: int) -> IntArray:
    return np.unique(np.linspace(0, n_rows - 1, MAX_STEPS + 1).astype(np.int64))


def observation_from_log(run: int, log: Mapping[str, FloatArray], rows: IntArray, per_rad: FloatArray) -> Observation:
    """Make a unit, not yet measured, of two or more samples of a log, thinned here.

    Front wheel or shaft count where all their samples are there.
    """
    index = thinned(rows)
    counted = "counts_front" if "counts_front" in log else WHEEL_COLUMNS["shaft"][0]
    front, steer, aside = (log[name][index] if name in log else None for name in (counted, "steer_rad", ASIDE))
    loads = [_means(log[name], index) if name in log else None for name in WHEEL_LOADS]
    return Observation(
        run=run,
        window=0,
        time_s=log["t_s"][index],
        left_rad=log["counts_left"][index] / per_rad[0],
        right_rad=log["counts_right"][index] / per_rad[1],
        front_rad=None if front is None or np.isnan(front).any() else front / per_rad[2],
        steer_rad=None if steer is None or np.isnan(steer).any() else steer,
        aside_m=aside,
        load_left_N=loads[0],
        load_right_N=loads[1],
    )


def _means(samples: FloatArray, index: IntArray) -> FloatArray:
    return np.append(samples[index[0]], np.diff(np.cumsum(samples)[index]) / np.diff(index))


def observation_from_row(run: int, runs: RunTable, per_rad: FloatArray) -> Observation | None:
    """Make a unit of a row's totals, one arc; None without counts."""
    left, right = float(runs.number("counts_left")[run]), float(runs.number("counts_right")[run])
    if not (np.isfinite(left) and np.isfinite(right)):
        return None
    share, time_s = np.linspace(0.0, 1.0, STEPS_WITHOUT_LOG + 1), _nan(STEPS_WITHOUT_LOG + 1)
    left_rad, right_rad = share * left / per_rad[0], share * right / per_rad[1]
    return Observation(run=run, window=0, time_s=time_s, left_rad=left_rad, right_rad=right_rad, from_log=False)


#: poses of a log's own reference, at least
MIN_POSES: Final = 3
#: least way of a course, in stated uncertainties of a position
COURSE_SIGMAS: Final = 100.0
#: its largest share of the run
COURSE_SHARE: Final = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class ReferencePoses:
    """Poses of the middle of the rear axle in a run, by the reference."""

    rows: IntArray  #: shape (n_poses,): samples with a pose and counts
    #: shape (n_poses, 3): x, y and unwrapped heading, in one frame for the run; headings NaN if only positions were
    #: measured
    poses: FloatArray
    #: shape (n_poses,): mean roll of both wheels up to each, standing turns included
    travelled_m: FloatArray
    in_map: bool  #: whether all runs share the frame
    from_first: bool  #: whether the run's frame is that of its first pose, not of the poses

    def pose(self, number: int) -> tuple[FloatArray, float, FloatArray]:
        """Return a pose; of a heading from the course its standard uncertainty (else NaN) and `course_error`, (5,)."""
        return self.poses[number], float("nan"), np.zeros(5)


@dataclass(frozen=True, slots=True, eq=False)
class CourseOverGround(ReferencePoses):
    """Positions alone, headings from them: the course over a short way, less the wheels' against it."""

    by_wheels: FloatArray  #: shape (n_poses, 3): of the vehicle
    place_m: FloatArray  #: shape (2,): the sensor's place on the vehicle
    sigma_xy_m: float
    way_m: float  #: of a course
    velocity_mps: ComplexArray  #: shape (n_poses,): of the sensor by the wheels, x + i y
    turn_rate_rad_per_s: FloatArray  #: shape (n_poses,): by the wheels
    slips_m: ComplexArray  #: shape (n_poses, 2): way aside by slip angles of -v^2 and -v times the curvature

    def pose(self, number: int) -> tuple[FloatArray, float, FloatArray]:
        """Return the vehicle's pose at a sample, its heading's standard uncertainty and `course_error`; NaN at rest.

        In a curve a sensor elsewhere, or a late one, moves along another course.
        """
        at_m = self.travelled_m[number]
        first = int(np.searchsorted(self.travelled_m, at_m - 0.5 * self.way_m, side="right")) - 1
        last = int(np.searchsorted(self.travelled_m, at_m + 0.5 * self.way_m))
        first, last = max(first, 0), min(last, len(self.travelled_m) - 1)
        if first == 0:
            last = max(last, min(int(np.searchsorted(self.travelled_m, self.way_m)), len(self.travelled_m) - 1))
        if last == len(self.travelled_m) - 1:
            begin = int(np.searchsorted(self.travelled_m, self.travelled_m[-1] - self.way_m, side="right")) - 1
            first = min(first, max(begin, 0))
        moved = self.poses[last, :2] - self.poses[first, :2]
        wheels = self._sensor_by_wheels(last) - self._sensor_by_wheels(first)
        chord = float(np.hypot(*moved))
        if chord < 0.3 * self.way_m or np.hypot(*wheels) < 0.3 * self.way_m:
            return _nan(3), float("nan"), np.zeros(5)
        course = np.arctan2(moved[1], moved[0]) - np.arctan2(wheels[1], wheels[0])
        heading = self.by_wheels[number, 2] + (course + np.pi) % (2 * np.pi) - np.pi
        place = self.poses[number, :2] - _turned(self.place_m, heading)
        by_place = complex(np.diff(np.exp(1j * self.by_wheels[[first, last], 2]))[0]) / complex(*wheels)
        rate = float((complex(self.velocity_mps[last] - self.velocity_mps[first]) / complex(*wheels)).imag)
        by_slip = ((self.slips_m[last] - self.slips_m[first]) / complex(*wheels)).imag
        error = np.array([by_place.imag, by_place.real, self.turn_rate_rad_per_s[number] - rate, *by_slip])
        return np.array([*place, heading]), float(np.sqrt(2.0)) * self.sigma_xy_m / chord, error

    def _sensor_by_wheels(self, number: int) -> FloatArray:
        return self.by_wheels[number, :2] + _turned(self.place_m, self.by_wheels[number, 2])


def _turned(vector: FloatArray, angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def relative_pose(first: FloatArray, last: FloatArray) -> FloatArray:
    """Return a pose (x, y, heading) as seen from another."""
    return np.asarray(in_frame((last - first)[:, None], first[2:])[0])


def reference_poses(log: Mapping[str, FloatArray], setup: Setup) -> ReferencePoses | None:
    """Return the vehicle's poses by a log's reference; None if too few."""
    reference, model, per_rad = setup.campaign.reference, setup.model, setup.per_rad
    if not {"ref_x_m", "ref_y_m"} <= log.keys():
        return None
    all_rows = log_rows(log)
    valid = np.isfinite(log["ref_x_m"][all_rows]) & np.isfinite(log["ref_y_m"][all_rows])
    heading = log.get("ref_theta_rad")
    if heading is not None:
        with_heading = valid & np.isfinite(heading[all_rows])
        whole = with_heading.sum() >= min(MIN_POSES, max(2, valid.sum()))
        heading, valid = (heading, with_heading) if whole else (None, valid)
    if len(rows := all_rows[valid]) < (MIN_POSES if heading is None else 2):
        return None
    left = log["counts_left"][all_rows] / per_rad[0] * model.radius_left_m
    right = log["counts_right"][all_rows] / per_rad[1] * model.radius_right_m
    aside = log.get(ASIDE, np.zeros(len(log["counts_left"])))[all_rows]
    rolled = 0.5 * (np.abs(np.diff(left)) + np.abs(np.diff(right)))
    travelled = np.concatenate(([0.0], np.cumsum(np.hypot(rolled, np.diff(aside)))))[valid]
    seen = np.stack([log["ref_x_m"][rows], log["ref_y_m"][rows]], axis=1)
    if heading is None:
        way = max(1.5 * model.track_m, COURSE_SIGMAS * reference.sigma_xy_m)
        by_wheels = _by_wheels(left, right, model.track_m, aside)[valid]
        lasts_s = np.gradient(log["t_s"][rows]) if "t_s" in log else np.full(len(rows), np.inf)
        axle_m, ahead = by_wheels[:, 0] + 1j * by_wheels[:, 1], np.exp(1j * by_wheels[:, 2])
        of_sensor_m = axle_m + complex(reference.sensor_x_m, reference.sensor_y_m) * ahead
        # in the frame of its start a sensor on the axle needs no heading
        on_axle = (reference.sensor_x_m, reference.sensor_y_m) == (0.0, 0.0)
        return CourseOverGround(
            rows=rows,
            poses=np.column_stack([seen, np.full(len(rows), np.nan)]),
            travelled_m=travelled,
            in_map=setup.in_map,
            from_first=not (reference.frame == "start" and on_axle),
            by_wheels=by_wheels,
            velocity_mps=np.gradient(of_sensor_m) / lasts_s,
            turn_rate_rad_per_s=np.gradient(by_wheels[:, 2]) / lasts_s,
            slips_m=_slips_m(np.gradient(axle_m) / lasts_s, by_wheels[:, 2]),
            place_m=np.array([reference.sensor_x_m, reference.sensor_y_m]),
            sigma_xy_m=reference.sigma_xy_m,
            way_m=min(way, COURSE_SHARE * float(travelled[-1])),
        )
    turned = _by_wheels(left, right, model.track_m, aside)[valid, 2] if len(rows) < MIN_POSES else 0.0
    of_sensor = np.column_stack([seen, turned + np.unwrap(heading[rows] - turned)])
    begins_there = not setup.in_map and travelled[0] <= reference.sigma_xy_m and _begins_at_place(of_sensor, reference)
    poses = poses_of_vehicle(of_sensor, reference, in_map=setup.in_map or begins_there)
    return ReferencePoses(rows, poses, travelled, setup.in_map, from_first=setup.in_map)


#: poses begin at the sensor's place where the first is nearer to it than this share of its distance from the origin
NEAR_PLACE: Final = 0.25


def _begins_at_place(of_sensor: FloatArray, reference: Reference) -> bool:
    place = np.array([reference.sensor_x_m, reference.sensor_y_m, reference.sensor_yaw_rad])
    turns = 2.0 * np.pi * np.round((of_sensor[0, 2] - place[2]) / (2.0 * np.pi))
    first = of_sensor[0] - [0.0, 0.0, turns]
    sigma = np.array([reference.sigma_xy_m, reference.sigma_xy_m, reference.sigma_theta_rad])
    off, lever = (float(np.linalg.norm(pose / sigma)) for pose in (first - place, place))
    if begins := off < NEAR_PLACE * lever:
        of_sensor[:, 2] -= turns
    return begins


def _slips_m(velocity_mps: ComplexArray, heading_rad: FloatArray) -> ComplexArray:
    speed = (velocity_mps * np.exp(-1j * heading_rad)).real
    aside = np.gradient(np.exp(1j * heading_rad)) * np.sign(speed)
    return -np.cumsum(np.stack([aside * speed**2, aside * np.abs(speed)], axis=1), axis=0)


def _by_wheels(left_m: FloatArray, right_m: FloatArray, track_m: float, aside_m: FloatArray) -> FloatArray:
    turn = np.diff(right_m - left_m) / track_m
    moved = (0.5 * np.diff(left_m + right_m) + 1j * np.diff(aside_m)) * np.exp(1j * (np.cumsum(turn) - 0.5 * turn))
    return np.vstack([np.zeros(3), np.cumsum(np.stack([moved.real, moved.imag, turn], axis=1), axis=0)])


def step_array(n_steps: int) -> FloatArray:
    """Return zeros (n_steps,), many in a mapped temporary file, whose pages `let_go` gives back."""
    if n_steps > HELD_STEPS and hasattr(os, "posix_fallocate") and hasattr(mmap, "MADV_DONTNEED"):
        # all room is taken here: a full disk leaves the array in memory
        with suppress(OSError), TemporaryFile() as file:
            os.posix_fallocate(file.fileno(), 0, 8 * n_steps)
            return np.ndarray(n_steps, buffer=mmap.mmap(file.fileno(), 8 * n_steps))
    return np.zeros(n_steps)


def let_go(*arrays: FloatArray | None) -> None:
    """Give back memory of arrays in files; it is read again where asked for."""
    bases: list[object] = [array.base for array in arrays if array is not None]
    for base in bases:
        if isinstance(base, mmap.mmap):
            base.madvise(mmap.MADV_DONTNEED)
