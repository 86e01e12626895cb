"""Read a large bag against rosbags alone: seconds of the processor, and the most memory that either held.

``python -m tests.benchmarks.reading_bag --megabytes 1024 --kind scans FOLDER`` makes the bag in FOLDER where it is not
there yet (it is never committed) and reads it three ways, each in a process of its own.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

WAYS = ("rosbags alone", "calib, everything", "calib, wheels and range")
EPOCH_NS = 1_777_888_999_123_456_789


def _messages(store: Any, kind: str) -> Iterator[tuple[int, str, str, Any]]:
    """Joint states at 100 Hz, ranges at 20 Hz, and laser scans of 1081 beams at 40 Hz where the kind is ``scans``."""
    types = store.types
    stamp, header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    scan, joint = types["sensor_msgs/msg/LaserScan"], types["sensor_msgs/msg/JointState"]
    rng = np.random.default_rng(1)
    beams = rng.uniform(1.0, 20.0, (50, 1081)).astype(np.float32)
    number = 0
    while True:
        time_ns = EPOCH_NS + number * 5_000_000
        top = header(stamp(time_ns // 10**9, time_ns % 10**9), "base")
        if number % 2 == 0 or kind == "joints":
            angle = 0.005 * number
            yield (
                time_ns,
                "/joint_states",
                "sensor_msgs/msg/JointState",
                joint(top, ["left", "right"], np.array([angle, 1.001 * angle]), np.zeros(2), np.zeros(0)),
            )
        if number % 10 == 0:
            yield (
                time_ns,
                "/range",
                "sensor_msgs/msg/Range",
                types["sensor_msgs/msg/Range"](top, 1, 0.01, 0.05, 250.0, 5.0 + 1e-4 * number),
            )
        if number % 5 == 0 and kind == "scans":
            ranges = beams[number % 50]
            yield (
                time_ns,
                "/scan",
                "sensor_msgs/msg/LaserScan",
                scan(top, -2.35, 2.35, 0.00436, 0.0, 0.025, 0.1, 30.0, ranges, ranges),
            )
        number += 1


def make(path: Path, megabytes: int, kind: str) -> None:
    """Write a bag of about so many megabytes."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    written = 0
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connections: dict[str, Any] = {}
        for arrival, topic, name, message in _messages(store, kind):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, name, typestore=store)
            data = store.serialize_cdr(message, name)
            bag.write(connections[topic], arrival, data)
            written += len(data) + 40
            if written > megabytes * 1_000_000:
                break


def read(way: str, path: Path) -> int:
    """Read the bag in one way; return how many samples were got."""
    if way == WAYS[0]:
        from rosbags.highlevel import AnyReader

        count = 0
        with AnyReader([path]) as reader:
            for connection, _, data in reader.messages():
                reader.deserialize(data, connection.msgtype)
                count += 1
        return count
    from calib.campaign.readers import read_recording
    from calib.campaign.readers.recording import WantedColumns

    names = frozenset({"/joint_states:position.left", "/joint_states:position.right", "/range:range"})
    found = read_recording(path, str(path), None if way == WAYS[1] else WantedColumns(names))
    return sum(map(len, found.streams))


def main() -> None:
    """Make, read, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--megabytes", type=int, default=1024)
    parser.add_argument("--kind", choices=("scans", "joints"), default="scans")
    parser.add_argument("--way", choices=WAYS)
    options = parser.parse_args()
    path = options.folder / f"{options.kind}_{options.megabytes}"
    if options.way:
        # the processor's time, so that what else runs on the machine does not count
        start = time.process_time()
        samples = read(options.way, path)
        seconds = time.process_time() - start
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        sys.stdout.write(f"{options.way:<24} {seconds:8.1f} s  {samples:9d} samples  peak {peak:6.0f} MB\n")
        return
    if not path.exists():
        make(path, options.megabytes, options.kind)
    size = sum(one.stat().st_size for one in path.iterdir()) / 1e6
    sys.stdout.write(f"{path.name}: {size:.0f} MB\n")
    sys.stdout.flush()
    for way in WAYS:
        command = [sys.executable, "-m", "tests.benchmarks.reading_bag", str(options.folder)]
        command += ["--megabytes", str(options.megabytes), "--kind", options.kind, "--way", way]
        subprocess.run(command, check=True)


if __name__ == "__main__":
    main()
