"""The recording holds what the diagnosis compared, read by another library, its messages taken apart by hand."""

from __future__ import annotations

import io
import struct
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from calib.campaign.model import Campaign
from calib.cli.main import run
from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.observations.from_campaign import measured_poses, observations_of
from calib.reporting.exports import mcap_paths
from tests.real import recordings

Diagnosed = Callable[[str], tuple[Campaign, Diagnosis]]
#: bytes of the head of a CDR message, little endian
HEAD = 4


def _text(data: bytes, at: int) -> tuple[str, int]:
    at += -at % 4
    (size,) = struct.unpack_from("<I", data, at)
    return data[at + 4 : at + 3 + size].decode(), at + 4 + size


def _pose(data: bytes, at: int) -> tuple[tuple[float, float, float], int]:
    """Read stamp, frame, position and quaternion of a PoseStamped that begins at `at` behind the head."""
    at += -at % 4
    _, at = _text(data, at + 8)
    at += -at % 8
    x, y, _, _, _, sine, cosine = struct.unpack_from("<7d", data, at)
    return (x, y, 2.0 * np.arctan2(sine, cosine)), at + 56


def _path(data: bytes) -> np.ndarray:
    body = data[HEAD:]
    frame, at = _text(body, 8)
    assert frame == "start"
    at += -at % 4
    (count,) = struct.unpack_from("<I", body, at)
    at += 4
    poses = []
    for _ in range(count):
        pose, at = _pose(body, at)
        poses.append(pose)
    return np.array(poses)


def _messages(data: bytes) -> dict[str, list[tuple[int, bytes]]]:
    found: dict[str, list[tuple[int, bytes]]] = defaultdict(list)
    last = 0
    for _, channel, message in make_reader(io.BytesIO(data)).iter_messages():
        assert message.log_time >= last
        last = message.log_time
        found[channel.topic].append((message.log_time, message.data))
    return found


def test_paths_gap_and_noise_of_every_run(diagnosed_sample: Diagnosed) -> None:
    campaign, diagnosis = diagnosed_sample("yard")
    found = _messages(mcap_paths.recording(mcap_paths.shown_runs(campaign, diagnosis)))
    n = len(diagnosis.observations)
    for name, ends in (("simulated", diagnosis.nominal.end), ("corrected", diagnosis.fitted.path.end)):
        paths = [_path(data) for _, data in found[f"/{name}/path"]]
        assert len(paths) == n
        for path, end in zip(paths, ends, strict=True):
            assert path[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
            turned = (path[-1, 2] - end[2] + np.pi) % (2 * np.pi) - np.pi
            assert [*path[-1, :2], turned] == pytest.approx([*end[:2], 0.0], abs=1e-9)
    for name, values in (
        ("gap", diagnosis.arrays.held_out.before),
        ("gap_corrected", diagnosis.arrays.held_out.after),
        ("noise", diagnosis.arrays.held_out.floor),
    ):
        numbers = [struct.unpack_from("<d", data, HEAD)[0] for _, data in found[f"/{name}/heading_rad"]]
        assert numbers == values[:, 3].tolist()
    labels = [_text(data[HEAD:], _text(data[HEAD:], 12)[1])[0] for _, data in found["/run"]]
    assert len(labels) == n
    assert all(str(name) in label for name, label in zip(diagnosis.observations.labels["run_id"], labels, strict=False))


def test_the_same_diagnosis_gives_the_same_bytes(diagnosed_sample: Diagnosed) -> None:
    campaign, diagnosis = diagnosed_sample("yard")
    first, second = (mcap_paths.recording(mcap_paths.shown_runs(campaign, diagnosis)) for _ in range(2))
    assert first == second


def test_measured_paths_of_real_recordings_end_where_they_were_measured(shared_data: Path) -> None:
    """Runs and windows alike: the last pose by the reference is the end that the diagnosis judges."""
    campaign = recordings.optiodom_differential(shared_data)
    observations = observations_of(campaign)
    compared = 0
    for number, measured in enumerate(measured_poses(campaign, observations)):
        if measured is None:
            continue
        times, poses = measured
        end = mcap_paths.relative_pose(poses[0], poses[-1])
        # the start frame of these recordings is zero to a hundredth of a millimetre
        assert end[:2] == pytest.approx(observations.measured[number, 1:3], abs=2e-5)
        assert (np.diff(times) > 0).all()
        compared += 1
    assert compared > 90


def test_a_result_folder_and_standard_output_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sample = str(Path(__file__).parents[3] / "sample_runs" / "corridor")
    assert run(["export", sample, "--to", "mcap"]) == 2
    assert "mcap is no text; give --output" in capsys.readouterr().err.replace("\n", " ")
    assert run(["fit", sample, "--into", str(tmp_path / "result")]) == 0
    assert run(["export", str(tmp_path / "result"), "--to", "mcap", "--output", str(tmp_path / "x.mcap")]) == 2
    assert "expected a campaign folder" in capsys.readouterr().err.replace("\n", " ")
    assert not (tmp_path / "x.mcap").exists()
