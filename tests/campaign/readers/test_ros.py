"""ROS recordings give back what was recorded, each container holds them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.readers import read_recording, read_table
from calib.campaign.readers.recording import Recording, WantedColumns
from calib.errors import BadFileError
from tests.campaign.readers.recordings import Drive, weave, write_rosbag1, write_rosbag2

#: ROS stores a rangefinder's distance as float32
SINGLE = 2e-6
#: yaw comes back through sine and cosine of half of it
TRIGONOMETRY = 1e-12

WRITERS: dict[str, Callable[[Drive, Path], Path]] = {
    "ros1": lambda drive, folder: write_rosbag1(drive, folder / "run.bag"),
    "sqlite3 folder": lambda drive, folder: write_rosbag2(drive, folder / "run", "sqlite3"),
    "sqlite3 file": lambda drive, folder: next(write_rosbag2(drive, folder / "run", "sqlite3").glob("*.db3")),
    "mcap folder": lambda drive, folder: write_rosbag2(drive, folder / "run", "mcap"),
    "mcap file": lambda drive, folder: next(write_rosbag2(drive, folder / "run", "mcap").glob("*.mcap")),
}


@pytest.fixture(scope="module")
def drive() -> Drive:
    return weave(4.0)


@pytest.fixture(scope="module", params=WRITERS)
def recording(request: pytest.FixtureRequest, drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = WRITERS[request.param](drive, tmp_path_factory.mktemp("bag"))
    return read_recording(path, "run")


def _column(recording: Recording, name: str) -> np.ndarray:
    stream = recording.stream_of(name)
    assert stream is not None, recording.column_names
    return stream.columns[name]


def test_every_container_gives_the_numbers_recorded(recording: Recording, drive: Drive) -> None:
    """Joint positions exactly, ranges to single precision, poses of odometry and transforms exactly, yaw from both."""
    radians = 2 * np.pi / 4096
    np.testing.assert_array_equal(_column(recording, "/joint_states:position.left"), drive.wheels[1] * radians)
    np.testing.assert_array_equal(_column(recording, "/joint_states:position.right"), drive.wheels[2] * radians)
    np.testing.assert_allclose(_column(recording, "/range:range"), drive.range_m[1], atol=SINGLE)
    np.testing.assert_array_equal(_column(recording, "/imu:angular_velocity_z"), 0.01 * drive.poses[3])
    for stream in ("/odom", "/tf[map>base_link]"):
        np.testing.assert_array_equal(_column(recording, f"{stream}:x"), drive.poses[1])
        np.testing.assert_array_equal(_column(recording, f"{stream}:y"), drive.poses[2])
        np.testing.assert_allclose(_column(recording, f"{stream}:yaw"), drive.poses[3], atol=TRIGONOMETRY)


def test_stamps_are_kept_to_the_nanosecond(recording: Recording, drive: Drive) -> None:
    """A float of seconds holds no nanoseconds of this century; integers do, through every container."""
    for stream, times in (
        ("/joint_states", drive.wheels[0]),
        ("/range", drive.range_m[0]),
        ("/odom", drive.poses[0]),
    ):
        found = next(one for one in recording.streams if one.name == stream)
        assert found.time_ns is not None
        assert found.time_ns.dtype == np.int64
        np.testing.assert_array_equal(found.time_ns, times)


def test_span_rate_gaps_and_delay_of_arrival_are_reported(recording: Recording, drive: Drive) -> None:
    wheels = next(one for one in recording.streams if one.name == "/joint_states")
    found = wheels.contents()
    assert found.start_ns == int(drive.wheels[0][0])
    assert found.span_s == pytest.approx(int(drive.wheels[0][-1] - drive.wheels[0][0]) / 1e9, rel=1e-12)
    assert (found.n_samples, found.n_gaps, found.longest_gap_s) == (len(drive.wheels[0]), 0, 0.0)
    assert found.rate_Hz == pytest.approx(50.0)
    assert wheels.behind_arrival_s == pytest.approx(0.001)


def test_only_wanted_topics_are_kept(drive: Drive, tmp_path: Path) -> None:
    path = write_rosbag2(drive, tmp_path / "run", "mcap")
    wanted = WantedColumns(frozenset({"/odom:yaw", "/joint_states:position.left"}))
    found = read_recording(path, "run", wanted)
    assert set(found.column_names) == {"/odom:yaw", "/joint_states:position.left"}
    np.testing.assert_allclose(_column(found, "/odom:yaw"), drive.poses[3], atol=TRIGONOMETRY)


def test_streams_are_joined_by_interpolation(drive: Drive, tmp_path: Path) -> None:
    """On the poses' times, the wheels lie on the chords between their samples."""
    table = read_table(write_rosbag2(drive, tmp_path / "run", "mcap"), "run")
    wheel_ns, left, _ = drive.wheels
    pose_ns = drive.poses[0]
    expected = np.interp((pose_ns - wheel_ns[0]).astype(float), (wheel_ns - wheel_ns[0]).astype(float), left)
    np.testing.assert_allclose(table.columns["/joint_states:position.left"], expected * 2 * np.pi / 4096, rtol=1e-12)


def test_real_containers_are_read(shared_data: Path) -> None:
    samples = shared_data / "rosbag2_samples"
    for name in ("mcap_cdr_test", "sqlite3_cdr_test", "mcap_wbag"):
        found = read_recording(samples / name, name)
        assert "does not read" in found.notes[0].text
    pose, wheels = sorted(
        read_recording(shared_data / "mecanum_optitrack" / "bag1.bag", "bag1").streams, key=lambda one: one.name
    )
    assert (len(wheels), len(pose)) == (2871, 9924)


@pytest.mark.parametrize("name", ["mcap_wrong_rmw_test", "mcap_wrong_rmw_test/wrong_rmw_test_0.mcap"])
def test_an_unsupported_encoding_is_refused_in_one_line(name: str, shared_data: Path) -> None:
    with pytest.raises(BadFileError, match=r"encoding 'wrong_format'.*'cdr'.*ros2 bag convert"):
        read_recording(shared_data / "rosbag2_samples" / name, name)


@pytest.mark.parametrize("kind", ["ros1", "sqlite3 file", "mcap file"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_cut_file_is_one_line_that_says_what_to_do(kind: str, share: float, drive: Drive, tmp_path: Path) -> None:
    path = WRITERS[kind](drive, tmp_path)
    data = path.read_bytes()
    cut = tmp_path / f"cut{path.suffix}"
    cut.write_bytes(data[: int(share * len(data))])
    with pytest.raises(BadFileError, match="cut or damaged") as caught:
        read_recording(cut, "cut")
    assert "\n" not in str(caught.value)
    assert "copy it again" in str(caught.value)


def test_a_missing_extra_names_the_command(drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_rosbag1(drive, tmp_path / "run.bag")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(BadFileError, match=r"pip install 'calib\[ros\]'"):
        read_recording(path, "run")
