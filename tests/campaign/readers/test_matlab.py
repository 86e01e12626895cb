"""MATLAB files: numbers are taken, objects are never loaded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from calib.campaign.readers import read_recording
from calib.errors import BadFileError


def test_variables_of_one_length_are_one_stream(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    time = np.arange(50) * 0.1
    scipy.io.savemat(
        path,
        {
            "t": time[:, None],
            "pose": np.outer(time, [1.0, 2.0, 3.0]),
            "wall": 4.4,
            "log": {"left": time * 7},
            "n": [1, 2],
        },
    )
    found = read_recording(path, "run")
    assert {name: len(one) for one in found.streams for name in one.columns} == {
        "t": 50,
        "pose[0]": 50,
        "pose[1]": 50,
        "pose[2]": 50,
        "log.left": 50,
        "n": 2,
    }
    assert found.properties == {"wall": "4.4"}
    stream = found.stream_of("pose[2]")
    assert stream is not None
    np.testing.assert_array_equal(stream.columns["pose[2]"], 3.0 * time)


def test_arrays_of_objects_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    cells = np.empty(2, dtype=object)
    cells[:] = [np.arange(3.0), "text"]
    scipy.io.savemat(path, {"data": cells})
    with pytest.raises(BadFileError, match=r"arrays of objects: data \(cell\).*save the numbers themselves"):
        read_recording(path, "run")
    scipy.io.savemat(path, {"data": cells, "t": np.arange(4.0)})
    assert read_recording(path, "run").column_names == ("t",)
    with pytest.raises(BadFileError, match="arrays of objects"):
        read_recording(path, "run", lambda name: name == "data")


def test_a_real_file(shared_data: Path) -> None:
    found = read_recording(shared_data / "straightline_laser" / "dataset1.mat", "dataset1")
    assert {name: len(one) for one in found.streams for name in one.columns} == dict.fromkeys("rtv", 12709) | {
        "x_true": 12709
    }
    assert float(found.properties["l"]) == pytest.approx(4.42848, abs=5e-6)


@pytest.mark.parametrize("data", [b"", b"MATLAB 5.0 MAT-file" + b" " * 109, b"\x00" * 300, b"noise" * 100])
def test_damage_is_one_line(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    path.write_bytes(data)
    try:
        assert not read_recording(path, "run").streams
    except BadFileError as error:
        assert "\n" not in str(error)


def test_a_file_of_version_7_3_says_how_to_save_it(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + b"\x89HDF\r\n\x1a\n" + b"\x00" * 400)
    with pytest.raises(BadFileError, match="-v7"):
        read_recording(path, "run")


def test_damaged_files_end_in_words_and_never_in_the_reader(tmp_path: Path) -> None:
    """Any byte of the tags and flags changed: an answer or one line, in this very process."""
    rng = np.random.default_rng(4)
    path = tmp_path / "run.mat"
    time = np.arange(20) * 0.1
    scipy.io.savemat(path, {"t": time[:, None], "log": {"left": time}, "s": "text", "n": np.array([[1, 2]])})
    sound = path.read_bytes()
    for _ in range(400):
        changed = bytearray(sound)
        for place in rng.integers(128, len(sound), rng.integers(1, 4)):
            changed[place] = rng.choice([0, 1, 14, 15, 128, 255])
        path.write_bytes(changed)
        try:
            read_recording(path, "run")
        except BadFileError as error:
            assert "cut or damaged" in str(error) or "arrays of objects" in str(error)


def test_a_missing_imaginary_part_is_named(tmp_path: Path) -> None:
    """The flag of complex numbers set on real ones: the reader would go past the end."""
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"t": np.arange(5.0)})
    changed = bytearray(path.read_bytes())
    changed[128 + 17] |= 0x08
    path.write_bytes(changed)
    with pytest.raises(BadFileError, match=r"class 6 with 4 of 5 elements"):
        read_recording(path, "run")
