"""TUM files: what is written is read back; what is broken is refused with its line."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from calib.errors import BadFileError, BadInputError
from calib.odometry.poses import Poses, read_tum, write_tum


def test_a_trajectory_survives_the_file(tmp_path: Path) -> None:
    n = 200
    t = np.arange(n) * 0.1
    poses = Poses(np.sin(t), 1e3 * np.cos(t), 0.9 * t)  # more than two turns
    path = write_tum(tmp_path / "a.tum", t, poses)
    times, back = read_tum(path)
    # times are kept to a nanosecond
    np.testing.assert_allclose(times, t, rtol=0.0, atol=5e-10)
    assert back.x_m.tolist() == poses.x_m.tolist()
    assert back.y_m.tolist() == poses.y_m.tolist()
    np.testing.assert_allclose(back.theta_rad, poses.theta_rad, rtol=0.0, atol=1e-13)


def test_lines_are_eight_numbers_with_unit_quaternions_about_the_vertical(tmp_path: Path) -> None:
    path = write_tum(tmp_path / "a.tum", [1.5], Poses.from_stacked([[2.0, 3.0, math.pi / 3]]))
    numbers = [float(part) for part in path.read_text().splitlines()[-1].split()]
    np.testing.assert_allclose(numbers, [1.5, 2.0, 3.0, 0.0, 0.0, 0.0, 0.5, math.sqrt(3) / 2], rtol=0.0, atol=1e-15)


def test_a_tilted_pose_gives_its_yaw(tmp_path: Path) -> None:
    """Rotation by 0.7 rad about z after 0.3 rad about x."""
    half, tilt = 0.35, 0.15
    q = (
        math.cos(half) * math.sin(tilt),
        math.sin(half) * math.sin(tilt),
        math.sin(half) * math.cos(tilt),
        math.cos(half) * math.cos(tilt),
    )
    path = tmp_path / "tilted.tum"
    path.write_text("0 1 2 3 " + " ".join(map(repr, q)) + "\n")
    _, poses = read_tum(path)
    assert float(poses.theta_rad[0]) == pytest.approx(0.7, abs=1e-12)


@pytest.mark.parametrize(
    ("line", "where"),
    [
        ("1 2 3", "row 3"),
        ("0 0 0 0 0 0 0 0", "zeros in pose 2"),
        ("0 0 0 0 0 0 nan 1", "row 3"),
        ("a b c d e f g h", "row 3"),
    ],
)
def test_broken_lines_are_refused_with_their_number(tmp_path: Path, line: str, where: str) -> None:
    path = tmp_path / "broken.tum"
    path.write_text(f"# comment\n0 0 0 0 0 0 0 1\n{line}\n")
    with pytest.raises(BadFileError, match=where):
        read_tum(path)


def test_nothing_is_overwritten_and_nothing_infinite_written(tmp_path: Path) -> None:
    path = write_tum(tmp_path / "a.tum", [0.0], Poses.from_stacked([[0.0, 0.0, 0.0]]))
    with pytest.raises(BadInputError, match="force=True"):
        write_tum(path, [0.0], Poses.from_stacked([[0.0, 0.0, 0.0]]))
    with pytest.raises(BadInputError, match="not finite"):
        write_tum(tmp_path / "b.tum", [0.0], Poses.from_stacked([[0.0, math.nan, 0.0]]))
    with pytest.raises(BadFileError, match="no pose"):
        path.write_text("# nothing\n")
        read_tum(path)
