"""Recordings written by the tests with the libraries that read them: ROS bags of every kind, TDMS, MATLAB."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

#: a moment of 2026 whose nanoseconds a float64 of seconds cannot hold
EPOCH_NS = 1_777_888_999_123_456_789
JOINTS = ("front", "left", "right")


@dataclass(frozen=True)
class Drive:
    """What sensors gave: wheels (ns, counts left, counts right), range (ns, m), poses (ns, x m, y m, yaw rad)."""

    wheels: tuple[np.ndarray, np.ndarray, np.ndarray]
    range_m: tuple[np.ndarray, np.ndarray]
    poses: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def weave(seconds: float = 20.0, *, lag_s: float = 0.0) -> Drive:
    """A vehicle that weaves along x with changing speed; the pose sensor's stamps come `lag_s` late."""
    step, beat, frame = 20_000_000, 50_000_001, 10_000_003
    wheel_ns = EPOCH_NS + np.arange(0, int(seconds * 1e9), step)
    range_ns = EPOCH_NS + 7_000_000 + np.arange(0, int((seconds - 0.1) * 1e9), beat)
    pose_ns = EPOCH_NS + 3_000_000 + np.arange(0, int((seconds - 0.1) * 1e9), frame)

    def along(time_ns: np.ndarray) -> np.ndarray:
        t = (time_ns - EPOCH_NS) / 1e9
        return 0.5 * t + 0.3 * np.sin(0.9 * t)

    def turned(time_ns: np.ndarray) -> np.ndarray:
        return 0.2 * np.sin(1.3 * (time_ns - EPOCH_NS) / 1e9)

    per_m = 4096 / (2 * np.pi * 0.1)
    x, yaw = along(wheel_ns), turned(wheel_ns)
    left, right = np.rint((x - 0.35 * yaw) * per_m), np.rint((x + 0.35 * yaw) * per_m)
    true_ns = pose_ns - int(lag_s * 1e9)
    return Drive(
        wheels=(wheel_ns, left, right),
        range_m=(range_ns, 30.0 - along(range_ns)),
        poses=(pose_ns, along(true_ns), 0.1 * turned(true_ns), turned(true_ns)),
    )


def _messages(drive: Drive, store: Any, *, ros1: bool) -> Iterator[tuple[int, str, str, Any]]:
    """Yield arrival, topic, type and message in the order of arrival."""
    types = store.types

    def header(time_ns: int, frame: str) -> Any:
        stamp = types["builtin_interfaces/msg/Time"](sec=time_ns // 10**9, nanosec=time_ns % 10**9)
        sequence = {"seq": 0} if ros1 else {}
        return types["std_msgs/msg/Header"](**sequence, stamp=stamp, frame_id=frame)

    def vector(kind: str, *xyz: float) -> Any:
        return types[f"geometry_msgs/msg/{kind}"](*map(float, xyz))

    def turn(yaw: float) -> Any:
        return types["geometry_msgs/msg/Quaternion"](0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))

    out: list[tuple[int, str, str, Any]] = []
    radians = 2 * np.pi / 4096
    for time_ns, left, right in zip(*drive.wheels, strict=True):
        position = np.array([0.0, left * radians, right * radians])
        out.append(
            (
                int(time_ns) + 1_000_000,
                "/joint_states",
                "sensor_msgs/msg/JointState",
                types["sensor_msgs/msg/JointState"](
                    header(int(time_ns), ""), list(JOINTS), position, np.zeros(3), np.zeros(0)
                ),
            )
        )
    for time_ns, distance in zip(*drive.range_m, strict=True):
        message = types["sensor_msgs/msg/Range"]
        names = set(message.__dataclass_fields__)
        fields: dict[str, Any] = {
            "header": header(int(time_ns), "laser"),
            "radiation_type": 1,
            "field_of_view": 0.01,
            "min_range": 0.05,
            "max_range": 250.0,
            "range": float(distance),
        }
        if "variance" in names:
            fields["variance"] = 0.0
        out.append((int(time_ns) + 2_000_000, "/range", "sensor_msgs/msg/Range", message(**fields)))
    cov = np.zeros(36)
    for time_ns, x, y, yaw in zip(*drive.poses, strict=True):
        pose = types["geometry_msgs/msg/Pose"](vector("Point", x, y, 0.0), turn(yaw))
        twist = types["geometry_msgs/msg/Twist"](vector("Vector3", 0, 0, 0), vector("Vector3", 0, 0, 0))
        odometry = types["nav_msgs/msg/Odometry"](
            header(int(time_ns), "odom"),
            "base_link",
            types["geometry_msgs/msg/PoseWithCovariance"](pose, cov),
            types["geometry_msgs/msg/TwistWithCovariance"](twist, cov),
        )
        transform = types["geometry_msgs/msg/TransformStamped"](
            header(int(time_ns), "map"),
            "base_link",
            types["geometry_msgs/msg/Transform"](vector("Vector3", x, y, 0.0), turn(yaw)),
        )
        out.append((int(time_ns) + 3_000_000, "/odom", "nav_msgs/msg/Odometry", odometry))
        # a rate that tells each sample from the others: a hundredth of the heading
        imu = types["sensor_msgs/msg/Imu"](
            header(int(time_ns), "imu"),
            turn(yaw),
            np.zeros(9),
            vector("Vector3", 0, 0, 0.01 * yaw),
            np.zeros(9),
            vector("Vector3", 0, 0, 9.81),
            np.zeros(9),
        )
        out.append((int(time_ns) + 3_000_002, "/imu", "sensor_msgs/msg/Imu", imu))
        out.append((int(time_ns) + 3_000_001, "/tf", _TF[ros1], types[_TF[ros1]]([transform])))
    yield from sorted(out, key=lambda one: one[0])


_TF = {False: "tf2_msgs/msg/TFMessage", True: "tf/msg/tfMessage"}


def write_rosbag2(drive: Drive, folder: Path, storage: str) -> Path:
    """Write a rosbag2 folder with ``sqlite3`` or ``mcap`` inside."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(folder, version=9, storage_plugin=plugin) as bag:
        connections: dict[str, Any] = {}
        for arrival, topic, kind, message in _messages(drive, store, ros1=False):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=store)
            bag.write(connections[topic], arrival, store.serialize_cdr(message, kind))
    return folder


def write_rosbag1(drive: Drive, path: Path) -> Path:
    """Write a ROS 1 bag."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    if _TF[True] not in store.types:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _TF[True]))
    with Writer(path) as bag:
        connections: dict[str, Any] = {}
        for arrival, topic, kind, message in _messages(drive, store, ros1=True):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=store)
            bag.write(connections[topic], arrival, store.serialize_ros1(message, kind))
    return path


def write_tdms(drive: Drive, path: Path, *, segments: int = 3) -> Path:
    """Write a DAQ card's file: a group of two counters at one rate, a group of the rangefinder at another."""
    from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter

    start = np.datetime64(EPOCH_NS // 1000, "us")
    wheel_ns, left, right = drive.wheels
    range_ns, distance = drive.range_m

    def track(time_ns: np.ndarray, unit: str) -> dict[str, Any]:
        return {
            "wf_start_time": start,
            "wf_start_offset": (int(time_ns[0]) - EPOCH_NS) / 1e9,
            "wf_increment": float(np.diff(time_ns)[0]) / 1e9,
            "unit_string": unit,
        }

    with TdmsWriter(path) as daq:
        for part in range(segments):
            objects: list[Any] = [RootObject({"operator": "M. Weber"}), GroupObject("Encoder", {"card": "PXIe-6614"})]
            for group, name, time_ns, values, unit in (
                ("Encoder", "left", wheel_ns, left.astype(np.int32), ""),
                ("Encoder", "right", wheel_ns, right.astype(np.int32), ""),
                ("Laser", "distance", range_ns, distance, "m"),
            ):
                cut: Sequence[np.ndarray] = np.array_split(values, segments)
                objects.append(ChannelObject(group, name, cut[part], track(time_ns, unit)))
            daq.write_segment(objects)
    return path
