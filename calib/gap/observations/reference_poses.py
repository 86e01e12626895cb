"""The reference's poses as poses of the vehicle: the sensor's place taken off, each run in its own start frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.settings import Reference
from calib.gap.observations.observation import Setup, log_rows
from calib.types import FloatArray, IntArray

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
            return np.array([np.nan, np.nan, np.nan]), float("nan")
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
    dx, dy = last[0] - first[0], last[1] - first[1]
    c, s = np.cos(first[2]), np.sin(first[2])
    return np.array([c * dx + s * dy, c * dy - s * dx, last[2] - first[2]])


def poses_are_in_a_map(campaign: Campaign) -> bool:
    """Return whether the logs' poses stand in one frame for all runs: so stated, or runs do not begin at zero."""
    reference, logs = campaign.reference, campaign.logs
    if reference.frame is not None:
        return reference.frame == "map"
    x, y, heading = (logs.columns.get(name) for name in ("ref_x_m", "ref_y_m", "ref_theta_rad"))
    if x is None or y is None:
        return False
    far = np.maximum(MAP_START_M, MAP_START_SIGMAS * reference.sigma_xy_m)
    bent = np.maximum(MAP_START_RAD, MAP_START_SIGMAS * reference.sigma_theta_rad)
    for begin, end in zip(logs.offsets[:-1], logs.offsets[1:], strict=True):
        there = np.flatnonzero(np.isfinite(x[begin:end]) & np.isfinite(y[begin:end]))
        # a reference that only begins on the way says nothing of the run's start
        if not len(there) or there[0] > 0:
            continue
        at = int(begin)
        turned = 0.0 if heading is None or not np.isfinite(heading[at]) else abs(float(heading[at]))
        if np.hypot(x[at], y[at]) > far or turned > bent:
            return True
    return False


def reference_poses(log: Mapping[str, FloatArray], setup: Setup) -> ReferencePoses | None:
    """Return the vehicle's poses of a run by its log's reference; None where the log has too few."""
    reference, model, per_rad = setup.campaign.reference, setup.model, setup.per_rad
    if not {"ref_x_m", "ref_y_m"} <= log.keys():
        return None
    rows = log_rows(log)
    there = np.isfinite(log["ref_x_m"][rows]) & np.isfinite(log["ref_y_m"][rows])
    heading = log.get("ref_theta_rad")
    if heading is not None:
        with_heading = there & np.isfinite(heading[rows])
        heading, there = (heading, with_heading) if with_heading.sum() >= MIN_POSES else (None, there)
    rows = rows[there]
    if len(rows) < MIN_POSES:
        return None
    left = log["counts_left"][rows] / per_rad.left * model.radius_left_m
    right = log["counts_right"][rows] / per_rad.right * model.radius_right_m
    rolled = 0.5 * (np.abs(np.diff(left)) + np.abs(np.diff(right)))
    travelled = np.concatenate(([0.0], np.cumsum(rolled)))
    seen = np.stack([log["ref_x_m"][rows], log["ref_y_m"][rows]], axis=1)
    if heading is None:
        way = max(1.5 * model.track_m, COURSE_SIGMAS * reference.sigma_xy_m)
        course = CourseOverGround(
            positions=seen,
            by_wheels=_by_wheels(left, right, model.track_m),
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
    sensor = np.column_stack([seen, np.unwrap(heading[rows])])
    poses = _of_vehicle(sensor, reference, in_map=setup.in_map)
    return ReferencePoses(rows, poses, travelled, setup.in_map, from_first=setup.in_map, course=None)


def _by_wheels(left_m: FloatArray, right_m: FloatArray, track_m: float) -> FloatArray:
    """Return the vehicle's poses by its wheels, shape (n, 3)."""
    ds, turn = 0.5 * np.diff(left_m + right_m), np.diff(right_m - left_m) / track_m
    heading = np.concatenate(([0.0], np.cumsum(turn)))
    mid = heading[:-1] + 0.5 * turn
    x = np.concatenate(([0.0], np.cumsum(ds * np.cos(mid))))
    y = np.concatenate(([0.0], np.cumsum(ds * np.sin(mid))))
    return np.stack([x, y, heading], axis=1)


def _of_vehicle(sensor: FloatArray, reference: Reference, *, in_map: bool) -> FloatArray:
    """Turn poses of the sensor (n, 3) into poses of the vehicle.

    In a map they are poses of the sensor; else the sensor's motion since its own start pose, V = X S X^-1 with the
    sensor's place X on the vehicle.
    """
    x, y, yaw = reference.sensor_x_m, reference.sensor_y_m, reference.sensor_yaw_rad
    if (x, y, yaw) == (0.0, 0.0, 0.0):
        return sensor
    if (x, y) == (0.0, 0.0) and not in_map:
        # on the axle its position is the vehicle's, with or without a heading
        c, s = np.cos(yaw), np.sin(yaw)
        turned = (c * sensor[:, 0] - s * sensor[:, 1], s * sensor[:, 0] + c * sensor[:, 1])
        return np.stack([*turned, sensor[:, 2]], axis=1)
    moved = sensor
    if not in_map:
        c, s = np.cos(yaw), np.sin(yaw)
        moved = np.stack(
            [x + c * sensor[:, 0] - s * sensor[:, 1], y + s * sensor[:, 0] + c * sensor[:, 1], sensor[:, 2] + yaw],
            axis=1,
        )
    heading = moved[:, 2] - yaw
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([moved[:, 0] - c * x + s * y, moved[:, 1] - s * x - c * y, heading], axis=1)


def end_pose_of_vehicle(pose: FloatArray, reference: Reference) -> FloatArray:
    """Turn end poses of the run table (n, 3), taken since the sensor's own start pose, into those of the vehicle.

    A position without a heading stays as it is where the sensor sits on the axle, and cannot be used elsewhere.
    """
    if (reference.sensor_x_m, reference.sensor_y_m) == (0.0, 0.0) and reference.sensor_yaw_rad == 0.0:
        return pose
    return _of_vehicle(pose, reference, in_map=False)
