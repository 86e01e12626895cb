"""Paths, gap and noise of every run, each in its start frame, as ROS 2 messages in one MCAP file."""

import math
import tempfile
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.coefficients.formats import Artifact
from calib.errors import MissingExtraError
from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.observations import Channel
from calib.gap.observations.from_campaign import measured_poses
from calib.gap.observations.observation import relative_pose
from calib.gap.predict import Path as PredictedPath
from calib.reporting.exports import diagnosed
from calib.types import FloatArray, Progress, evenly

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

PAUSE_S: Final = 2.0
#: of a path; more are thinned evenly
MOST_POSES: Final = 1000
#: of a run without a log
UNKNOWN_SPEED_MPS: Final = 1.0
FRAME: Final = "start"
PATHS: Final = ("measured", "simulated", "corrected")
NUMBERS: Final = ("gap", "gap_corrected", "noise")
INFO: Final = 20
PATH_TYPE, POSE_TYPE = "nav_msgs/msg/Path", "geometry_msgs/msg/PoseStamped"
NUMBER_TYPE, LOG_TYPE = "std_msgs/msg/Float64", "rcl_interfaces/msg/Log"


#: a path: time since the run's start (n,), and x, y, heading (n, 3)
Track = tuple[FloatArray, FloatArray]


#: of a run: label, duration (s), paths, and by topic the numbers at its end
_ShownRun = tuple[str, float, dict[str, Track], dict[str, float]]


def render(path: Path, accept: str, progress: Progress) -> tuple[Artifact, ...]:  # noqa: ARG001
    """Diagnose a campaign and return the recording of its runs; see `export_from`."""
    campaign, diagnosis = diagnosed(path, progress)
    named = ", ".join(cause.effect for cause in diagnosis.causes) or "no cause named"
    notes = (f"corrected: with {named}; gap_corrected: on runs held out",)
    return (Artifact(f"{campaign.name}.mcap", recording(shown_runs(campaign, diagnosis)), notes),)


def shown_runs(campaign: Campaign, diagnosis: Diagnosis) -> Iterator[_ShownRun]:
    """Yield what is shown of each observation, in the order driven."""
    observations, held_out = diagnosis.observations, diagnosis.arrays.held_out
    sources: dict[str, PredictedPath] = {"simulated": diagnosis.nominal}
    if diagnosis.causes:
        sources["corrected"] = diagnosis.fitted.path
    predicted = {name: tracks_of(source) for name, source in sources.items()}
    tables = dict(zip(NUMBERS, (held_out.before, held_out.after, held_out.floor), strict=True))
    labels = observations.labels
    for number, measured in enumerate(measured_poses(campaign, observations)):
        paths = {name: tracks[number] for name, tracks in predicted.items()}
        time_s, _ = paths["simulated"]
        if measured is not None:
            rows, poses = measured
            paths["measured"] = (rows, np.array([relative_pose(poses[0], pose) for pose in poses]))
        elif observations.usable[number, Channel.ALONG]:
            paths["measured"] = (time_s[-1:], np.nan_to_num(observations.measured[number, 1:4])[None, :])
        numbers = {
            f"{name}/{channel.label}_{channel.unit}": float(values[number, channel])
            for name, values in tables.items()
            for channel in Channel
            if observations.usable[number, channel]
        }
        part = observations.windowed and observations.usable[number, Channel.ALONG]
        window = f", window {observations.window[number]}" if part else ""
        label = f"run {labels['run_id'][number]}{window}, {labels['kind'][number]}, session {labels['session'][number]}"
        yield label, float(time_s[-1]), paths, numbers


def tracks_of(path: PredictedPath) -> list[Track]:
    """Return the predicted track of each observation; without a log it is driven at 1 m/s."""
    s, ds_m = path.s, path.steps.ds_m
    tracks = []
    for poses, (first, last) in zip(path.traces(), pairwise(s.starts.tolist()), strict=True):
        part = slice(first, last)
        middle = s.time_s[part] - 0.5 * s.duration_s[part]
        begin, end = float(s.time_s[first] - s.duration_s[first]), float(s.time_s[last - 1])
        if not np.isfinite(middle).all():
            way = np.cumsum(np.abs(ds_m[part])) / UNKNOWN_SPEED_MPS
            middle, begin, end = way, 0.0, float(way[-1]) + 1.0
        tracks.append((np.concatenate(([begin], middle, [end])) - begin, poses))
    return tracks


def recording(runs: Iterator[_ShownRun]) -> bytes:
    """Return runs as the bytes of an MCAP file of ROS 2 messages."""
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingExtraError("an MCAP file", "rosbags", "ros") from error
    store = get_typestore(Stores.ROS2_HUMBLE)
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            sink = _Sink(writer, store)
            begin = 0.0
            for run in runs:
                sink.show(run, begin)
                begin += run[1] + PAUSE_S
        (file,) = bag.glob("*.mcap")
        return file.read_bytes()


class _Sink:
    def __init__(self, writer: Any, store: Any) -> None:
        self.writer, self.store, self.types = writer, store, store.types
        self.connections: dict[str, Connection] = {}

    def show(self, run: _ShownRun, begin_s: float) -> None:
        label, duration_s, paths, numbers = run
        log = self.types[LOG_TYPE](self._stamp(begin_s), INFO, "calib", label, "", "", 0)
        messages = [(begin_s, "/run", LOG_TYPE, log)]
        for name in (name for name in PATHS if name in paths):
            time_s, places = paths[name]
            kept = evenly(len(time_s), MOST_POSES)
            times = [begin_s + float(t) for t in time_s[kept]]
            poses = [self._pose(t, *pose) for t, pose in zip(times, places[kept].tolist(), strict=True)]
            messages.append((begin_s, f"/{name}/path", PATH_TYPE, self.types[PATH_TYPE](self._header(begin_s), poses)))
            messages += [(t, f"/{name}/pose", POSE_TYPE, pose) for t, pose in zip(times, poses, strict=True)]
        for topic, value in numbers.items():
            messages.append((begin_s + duration_s, f"/{topic}", NUMBER_TYPE, self.types[NUMBER_TYPE](value)))
        for t, topic, kind, message in sorted(messages, key=lambda entry: entry[0]):
            if topic not in self.connections:
                self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
            self.writer.write(self.connections[topic], round(t * 1e9), self.store.serialize_cdr(message, kind))

    def _stamp(self, t: float) -> Any:
        second, nano = divmod(round(t * 1e9), 1_000_000_000)
        return self.types["builtin_interfaces/msg/Time"](sec=second, nanosec=nano)

    def _header(self, t: float) -> Any:
        return self.types["std_msgs/msg/Header"](stamp=self._stamp(t), frame_id=FRAME)

    def _pose(self, t: float, x: float, y: float, heading: float) -> Any:
        point = self.types["geometry_msgs/msg/Point"](x, y, 0.0)
        turned = self.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(0.5 * heading), math.cos(0.5 * heading))
        pose = self.types["geometry_msgs/msg/Pose"](point, turned)
        return self.types["geometry_msgs/msg/PoseStamped"](self._header(t), pose)
