"""TUM trajectories: poses and times, exact to the nanosecond."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.campaign.readers import read_recording
from calib.campaign.readers.recording import decimal_ns
from calib.errors import BadFileError

TEXT = """# timestamp tx ty tz qx qy qz qw
1777888999.123456789 1.5 -2 0 0 0 0 1
1777888999.223456790 1.6 -2 0 0 0 0.7071067811865476 0.7071067811865476
1777888999.323456791 1.7 -2 0 0 0 1 0
1777888999.423456792 1.8 -2 0 0 0 -0.7071067811865476 0.7071067811865476
"""


def test_poses_and_times(tmp_path: Path) -> None:
    """Times to the nanosecond; yaw runs on over half a turn."""
    (tmp_path / "run.tum").write_text(TEXT)
    (stream,) = read_recording(tmp_path / "run.tum", "run").streams
    assert stream.time_ns is not None
    assert stream.time_ns.tolist() == [1777888999_123456789 + i * 100_000_001 for i in range(4)]
    np.testing.assert_allclose(stream.columns["yaw"], np.arange(4) * np.pi / 2, atol=1e-12)
    np.testing.assert_array_equal(stream.columns["x"], [1.5, 1.6, 1.7, 1.8])


def test_a_cut_line_is_named(tmp_path: Path) -> None:
    (tmp_path / "run.tum").write_text(TEXT[:-30])
    with pytest.raises(BadFileError, match="row 5: found 7 numbers"):
        read_recording(tmp_path / "run.tum", "run")


@given(st.integers(min_value=-(10**18), max_value=4 * 10**18))
def test_decimal_seconds_are_exact(nanoseconds: int) -> None:
    sign, rest = "-" if nanoseconds < 0 else "", abs(nanoseconds)
    assert decimal_ns(f"{sign}{rest // 10**9}.{rest % 10**9:09d}") == nanoseconds
