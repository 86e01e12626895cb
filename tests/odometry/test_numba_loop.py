"""Machine code draws the same exact arcs as the arrays do."""

from __future__ import annotations

import numpy as np
import pytest

from calib.odometry import integrate, is_installed
from calib.odometry.poses import Poses
from calib.types import FloatArray

pytestmark = pytest.mark.skipif(not is_installed(), reason="needs numba (extra fast)")


SAME_M = 1e-9  # promised; sums of some hundred metres in another order
TRACK_M = 0.7


def steps(n: int, turn: float) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(2)
    return 0.02 + turn * rng.standard_normal(n), 0.02 + turn * rng.standard_normal(n)


def close(a: Poses, b: Poses) -> None:
    np.testing.assert_allclose(a.stacked(), b.stacked(), rtol=0.0, atol=SAME_M)


@pytest.mark.parametrize("turn", [0.0, 1e-5, 1e-3, 0.05, 1.0])
def test_one_log(turn: float) -> None:
    """Both sides of the limit up to which a series gives sine and cosine, and the standstill."""
    left, right = steps(20_000, turn)
    left[5000:5100] = right[5000:5100] = 0.0
    arguments = {"start": (3.0, -2.0, 0.4)}
    close(
        integrate(left, right, TRACK_M, compiled=True, **arguments),  # type: ignore[arg-type]
        integrate(left, right, TRACK_M, compiled=False, **arguments),  # type: ignore[arg-type]
    )


def test_runs_of_any_length_with_a_track_of_their_own() -> None:
    lengths = [0, 3, 1, 0, 64, 65, 5000, 63, 128, 0]
    offsets = np.concatenate(([0], np.cumsum(lengths)))
    left, right = steps(offsets[-1], 1e-3)
    arguments = {
        "offsets": offsets,
        "start": np.random.default_rng(1).standard_normal((len(lengths), 3)),
    }
    track = np.linspace(0.6, 0.8, offsets[-1])
    close(
        integrate(left, right, track, compiled=True, **arguments),  # type: ignore[arg-type]
        integrate(left, right, track, compiled=False, **arguments),  # type: ignore[arg-type]
    )


def test_a_circle_closes() -> None:
    """A thousand laps of 10 m circumference in a million steps."""
    n, laps = 1_000_000, 1000
    step, turn = laps * 10.0 / n, laps * 2 * np.pi / n
    made = integrate(
        np.full(n, step - 0.5 * TRACK_M * turn), np.full(n, step + 0.5 * TRACK_M * turn), TRACK_M, compiled=True
    )
    assert abs(float(made.theta_rad[-1]) - laps * 2 * np.pi) < SAME_M
    assert float(np.hypot(made.x_m[-1], made.y_m[-1])) < 1e-8  # the input's rounding: 1e-16 of 1e4 m over the track


def test_input_that_may_not_be_written_to() -> None:
    """As a memory-mapped log is."""
    left, right = steps(1000, 1e-3)
    whole = integrate(left, right, TRACK_M, compiled=True)
    left.flags.writeable = right.flags.writeable = False
    np.testing.assert_array_equal(integrate(left, right, TRACK_M, compiled=True).stacked(), whole.stacked())


def test_no_steps() -> None:
    assert integrate([], [], TRACK_M, compiled=True).shape == (0,)


def test_a_reading_that_is_not_a_number_spoils_its_own_run_from_there_on() -> None:
    left, right = (part.reshape(4, 64) for part in steps(256, 1e-3))
    broken = left.copy()
    broken[1, 10] = np.nan
    made, whole = (integrate(part, right, TRACK_M, compiled=True) for part in (broken, left))
    spoilt = np.zeros((4, 64), dtype=bool)
    spoilt[1, 10:] = True
    assert (np.isnan(made.stacked()).all(axis=-1) == spoilt).all()
    np.testing.assert_array_equal(made.stacked()[~spoilt], whole.stacked()[~spoilt])
