"""A ROS laboratory's folder: Turtlebot recordings as MCAP files and rosbag2 folders, with motion capture that lags.

``python -m tests.campaign.ingest.ros_lab FOLDER`` writes it, to try the commands on.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

EPOCH_NS = 1_777_888_999_123_456_789
JOINTS = ("wheel_left_joint", "wheel_right_joint")
#: what was driven with: radii and track, and by how much the motion capture is late
RADIUS_LEFT_M, RADIUS_RIGHT_M, TRACK_M, DELAY_S = 0.03312, 0.03291, 0.1607, 0.08
WHEEL_HZ, MOCAP_HZ, STEP_S = 25.0, 40.0, 0.002
SIGMA_XY_M, SIGMA_RAD = 5e-4, 1e-3
#: time that the robot stands at either end
STAND_S = 1.5


@dataclass(frozen=True)
class Driven:
    """A path on a fine grid: times, wheel angles, poses."""

    t: np.ndarray
    wheels: np.ndarray
    pose: np.ndarray


def _driven(seconds: float, phase: float) -> Driven:
    """A robot that weaves in one place: speed and turn rate change all the time, both ends stand."""
    t = np.arange(0.0, seconds, STEP_S)
    ramp = np.clip(np.minimum(t - STAND_S, seconds - STAND_S - t), 0.0, 1.0)
    v = ramp * (0.15 + 0.05 * np.sin(0.7 * t + phase))
    omega = ramp * (0.9 * np.sin(0.23 * t + phase) + 0.4 * np.cos(0.61 * t))
    theta = np.cumsum(omega) * STEP_S
    x, y = (np.cumsum(v * f(theta - 0.5 * omega * STEP_S)) * STEP_S for f in (np.cos, np.sin))
    radii = np.array([RADIUS_LEFT_M, RADIUS_RIGHT_M])
    rates = (v[:, None] + np.array([-0.5, 0.5]) * TRACK_M * omega[:, None]) / radii
    # the robot stands anywhere in the hall when it starts
    turn, place = 0.4 + phase, np.array([1.0 + phase, -2.0])
    cos, sin = np.cos(turn), np.sin(turn)
    pose = np.column_stack([place[0] + cos * x - sin * y, place[1] + sin * x + cos * y, theta + turn])
    return Driven(t, np.cumsum(rates, axis=0) * STEP_S, pose)


def _write(folder: Path, driven: Driven, rng: np.random.Generator, *, mcap: bool) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    messages: list[tuple[int, str, Any]] = []

    def header(t: float, frame: str) -> Any:
        stamp = EPOCH_NS + round(1e9 * t)
        return types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9), frame)

    def pose(x: float, y: float, yaw: float) -> Any:
        turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
        return types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](float(x), float(y), 0.11), turn)

    end = float(driven.t[-1])
    for t in np.arange(0.0, end - 0.2, 1.0 / WHEEL_HZ):
        angles = np.array([np.interp(t, driven.t, driven.wheels[:, side]) for side in (0, 1)])
        empty = np.zeros(0)
        state = types["sensor_msgs/msg/JointState"](header(t, ""), list(JOINTS), angles, empty, empty)
        messages.append((round(1e9 * (t + 0.001)), "/joint_states", state))
        zero = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
        messages.append((round(1e9 * t), "/cmd_vel", types["geometry_msgs/msg/Twist"](zero, zero)))
    for t in np.arange(0.01, end - 0.2, 1.0 / MOCAP_HZ):
        at = [np.interp(t - DELAY_S, driven.t, driven.pose[:, axis]) for axis in (0, 1, 2)]
        noisy = np.asarray(at) + rng.standard_normal(3) * [SIGMA_XY_M, SIGMA_XY_M, SIGMA_RAD]
        message = types["geometry_msgs/msg/PoseStamped"](header(t, "world"), pose(*noisy))
        messages.append((round(1e9 * (t + 0.002)), "/mocap/turtlebot/pose", message))
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(folder, version=9, storage_plugin=plugin) as bag:
        topics: dict[str, Any] = {}
        for arrival, topic, message in sorted(messages, key=lambda one: one[:2]):
            kind = message.__msgtype__
            if topic not in topics:
                topics[topic] = bag.add_connection(topic, kind, typestore=store)
            bag.write(topics[topic], EPOCH_NS + arrival, store.serialize_cdr(message, kind))


def ros_lab(folder: Path, *, runs: int = 4, seconds: float = 30.0, seed: int = 3) -> Path:
    """Write the recordings, every second one as a single MCAP file, the others as rosbag2 folders of sqlite3."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    for run in range(runs):
        driven = _driven(seconds, 0.8 * run)
        target = folder / f"drive_{run + 1}"
        _write(target, driven, rng, mcap=not run % 2)
        if not run % 2:
            [written] = target.glob("*.mcap")
            written.rename(folder / f"drive_{run + 1}.mcap")
            (target / "metadata.yaml").unlink()
            target.rmdir()
    return folder


if __name__ == "__main__":
    ros_lab(Path(sys.argv[1]))
