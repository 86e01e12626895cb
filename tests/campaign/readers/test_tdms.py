"""TDMS files give back channels, properties of three levels, and the times that their waveform properties stand for."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.readers import read_recording
from calib.errors import BadFileError
from tests.campaign.readers.recordings import EPOCH_NS, Drive, weave, write_tdms

#: the format's start times are written to the microsecond here
MICROSECOND_NS = 1000
SAMPLES = {1: (3, 3), 2: (6, 6), 3: (9, 9), 4: (12, 12, 5), 5: (15, 39, 10), 6: (18, 39, 15)}


@pytest.fixture
def drive() -> Drive:
    return weave(4.0)


def test_channels_and_their_clock(drive: Drive, tmp_path: Path) -> None:
    """Start + offset + i * increment, to the nanosecond."""
    found = read_recording(write_tdms(drive, tmp_path / "run.tdms"), "run")
    encoder, laser = found.streams
    np.testing.assert_array_equal(encoder.columns["Encoder/left"], drive.wheels[1])
    np.testing.assert_array_equal(laser.columns["Laser/distance"], drive.range_m[1])
    assert laser.units == {"Laser/distance": "m"}
    for stream, times in ((encoder, drive.wheels[0]), (laser, drive.range_m[0])):
        assert stream.time_ns is not None
        late = stream.time_ns - times
        assert np.ptp(late) <= 1
        assert abs(int(late[0])) < MICROSECOND_NS
    assert int(encoder.time_ns[0]) == EPOCH_NS // 1000 * 1000


def test_properties_of_three_levels(drive: Drive, tmp_path: Path) -> None:
    found = read_recording(write_tdms(drive, tmp_path / "run.tdms"), "run")
    assert found.properties["/: operator"] == "M. Weber"
    assert found.properties["Encoder: card"] == "PXIe-6614"
    assert found.properties["Laser/distance: unit_string"] == "m"


@pytest.mark.parametrize("step", SAMPLES)
def test_the_formats_own_examples(step: int, shared_data: Path) -> None:
    """Channel lengths after each step of the format's description; channels of one length share a stream."""
    name = f"IncrementalMetaInformationExample_step{step}.tdms"
    found = read_recording(shared_data / "tdms_samples" / name, name)
    lengths = {column: len(stream) for stream in found.streams for column in stream.columns}
    expected = dict(zip(("group/channel1", "group/channel2", "group/voltage"), SAMPLES[step], strict=False))
    assert lengths == expected
    assert found.properties["group/channel1: prop"] == ("valid" if step < 3 else "error")


@pytest.mark.parametrize("share", [0.0, 0.02, 0.6, 0.999])
def test_a_cut_file_is_one_line(share: float, drive: Drive, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = write_tdms(drive, tmp_path / "run.tdms")
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(BadFileError, match="cut or damaged"):
        read_recording(path, "run")
    assert capfd.readouterr() == ("", "")


def test_a_missing_extra_names_the_command(drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_tdms(drive, tmp_path / "run.tdms")
    monkeypatch.setitem(sys.modules, "nptdms", None)
    with pytest.raises(BadFileError, match=r"pip install 'calib\[tdms\]'"):
        read_recording(path, "run")
