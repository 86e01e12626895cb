"""Which numbers a ROS message holds: message type -> names and a function that picks them; one entry a type."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.readers.times import NS_PER_S

#: a part of a message: suffix of its stream, names of its columns, its numbers, the nanoseconds of its stamp or None
Part = tuple[str, tuple[str, ...], Sequence[float], "int | None"]

POSE: Final = ("x", "y", "z", "qx", "qy", "qz", "qw")
_TWIST: Final = ("v_x", "v_y", "omega")


def _stamp(header: Any) -> int | None:
    stamp = header.stamp
    nanoseconds: int = stamp.sec * NS_PER_S + stamp.nanosec
    return nanoseconds or None


def _pose(pose: Any) -> tuple[float, ...]:
    place, turn = pose.position, pose.orientation
    return (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)


def _twist(twist: Any) -> tuple[float, ...]:
    return (twist.linear.x, twist.linear.y, twist.angular.z)


@lru_cache(maxsize=256)
def _joint_columns(names: tuple[str, ...], lengths: tuple[int, ...]) -> tuple[tuple[str, ...], tuple[bool, ...]]:
    """Return the columns of a JointState of such names and lengths, and which of its three fields they stand for."""
    names = names or tuple(str(index) for index in range(max(lengths)))
    there = tuple(length == len(names) for length in lengths)
    fields = [field for field, given in zip(("position", "velocity", "effort"), there, strict=True) if given]
    return tuple(f"{field}.{name}" for field in fields for name in names), there


def _joint_state(message: Any) -> Iterator[Part]:
    position, velocity, effort = message.position, message.velocity, message.effort
    names, there = _joint_columns(tuple(message.name), (len(position), len(velocity), len(effort)))
    numbers: list[float] = position.tolist() if there[0] else []
    if there[1]:
        numbers += velocity.tolist()
    if there[2]:
        numbers += effort.tolist()
    yield "", names, numbers, _stamp(message.header)


def _odometry(message: Any) -> Iterator[Part]:
    yield "", POSE + _TWIST, _pose(message.pose.pose) + _twist(message.twist.twist), _stamp(message.header)


def _pose_stamped(message: Any) -> Iterator[Part]:
    yield "", POSE, _pose(message.pose), _stamp(message.header)


def _pose_with_covariance(message: Any) -> Iterator[Part]:
    yield "", POSE, _pose(message.pose.pose), _stamp(message.header)


def _transform(message: Any) -> Iterator[Part]:
    place, turn = message.transform.translation, message.transform.rotation
    numbers = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
    yield f"[{message.header.frame_id}>{message.child_frame_id}]", POSE, numbers, _stamp(message.header)


def _transforms(message: Any) -> Iterator[Part]:
    for transform in message.transforms:
        yield from _transform(transform)


def _twist_message(message: Any) -> Iterator[Part]:
    yield "", _TWIST, _twist(message), None


def _twist_stamped(message: Any) -> Iterator[Part]:
    yield "", _TWIST, _twist(message.twist), _stamp(message.header)


def _range(message: Any) -> Iterator[Part]:
    yield "", ("range",), (_finite(message.range),), _stamp(message.header)


def _laser_scan(message: Any) -> Iterator[Part]:
    """One beam is its range; of more beams the one nearest to straight ahead."""
    beams = len(message.ranges)
    if not beams:
        yield "", ("range",), (math.nan,), _stamp(message.header)
        return
    ahead = 0
    if beams > 1 and message.angle_increment:
        ahead = min(max(round(-message.angle_min / message.angle_increment), 0), beams - 1)
    name = "range" if beams == 1 else "range_ahead"
    yield "", (name,), (_finite(float(message.ranges[ahead])),), _stamp(message.header)


def _finite(value: float) -> float:
    return float(value) if math.isfinite(value) else math.nan


def _scalar(message: Any) -> Iterator[Part]:
    yield "", ("data",), (float(message.data),), None


#: message type -> function that yields its parts
SUPPORTED: Final[Mapping[str, Callable[[Any], Iterator[Part]]]] = {
    "sensor_msgs/msg/JointState": _joint_state,
    "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/PoseStamped": _pose_stamped,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _pose_with_covariance,
    "geometry_msgs/msg/TransformStamped": _transform,
    "tf2_msgs/msg/TFMessage": _transforms,
    "tf/msg/tfMessage": _transforms,
    "geometry_msgs/msg/Twist": _twist_message,
    "geometry_msgs/msg/TwistStamped": _twist_stamped,
    "sensor_msgs/msg/Range": _range,
    "sensor_msgs/msg/LaserScan": _laser_scan,
    **{
        f"std_msgs/msg/{kind}": _scalar
        for kind in ("Float32", "Float64", "Int8", "Int16", "Int32", "Int64", "UInt8", "UInt16", "UInt32", "UInt64")
    },
}

#: units of the columns, by the last part of their name; what a JointState's position counts, only its driver knows
UNITS: Final[Mapping[str, str]] = {
    "x": "m",
    "y": "m",
    "z": "m",
    "yaw": "rad",
    "v_x": "mps",
    "v_y": "mps",
    "omega": "rad/s",
    "range": "m",
    "range_ahead": "m",
}


def parts(msgtype: str, message: Any) -> Iterator[Part]:
    """Yield what calib reads of a message.

    `msgtype`: one of `SUPPORTED`.
    """
    return SUPPORTED[msgtype](message)


def finished(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return columns with quaternions replaced by the yaw that they stand for, continuous over the turn.

    `columns` (shape (n_samples,)).
    """
    if "qw" not in columns:
        return dict(columns)
    qx, qy, qz, qw = (columns[name] for name in POSE[3:])
    # a quaternion of zeros stands for no orientation
    size = qx * qx + qy * qy + qz * qz + qw * qw
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), size - 2.0 * (qy * qy + qz * qz))
    known = size > 0.25
    yaw = np.where(known, yaw, np.nan)
    yaw[known] = np.unwrap(yaw[known])
    out = {name: values for name, values in columns.items() if name not in POSE[3:]}
    names = list(out)
    out["yaw"] = yaw
    # where a pose's other columns stand, yaw follows its place
    order = [*POSE[:3], "yaw", *(name for name in names if name not in POSE)]
    return {name: out[name] for name in order if name in out}
