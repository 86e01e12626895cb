"""The turn by a front wheel whose angle is sampled: neither too large nor too small, by either axle's speed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, Final

import numpy as np
import pytest

from calib.gap.observations import Observations
from calib.types import FloatArray

#: a corner of a quarter turn: speed, radius and wheelbase, and the way over which the curvature rises and falls
SPEED_MPS, RADIUS_M, WHEELBASE_M, RAMP_M = 0.8, 1.0, 1.0, 0.4
#: corners driven, each sampled from another moment on
CORNERS: Final = 200
#: bias in parts of what the mean of the ends alone is off by, rad: a tenth of it, and three standard errors
LEFT: Final = 0.1


def _corner(by_front: bool) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return times, ways of the front wheel, curvatures and headings along a corner, in half millimetres."""
    step = 5e-4
    bend = [1.0, RAMP_M, 0.5 * np.pi * RADIUS_M - RAMP_M, RAMP_M]
    way = np.arange(0.0, sum(bend) + 1.0, step)
    curvature = np.interp(way, np.cumsum(bend), [0.0, 1.0 / RADIUS_M, 1.0 / RADIUS_M, 0.0])
    middle = 0.5 * (curvature[1:] + curvature[:-1])
    longer = np.hypot(1.0, WHEELBASE_M * middle)
    steps = (step / SPEED_MPS * (longer if by_front else 1.0), step * longer, step * middle)
    time_s, front_m, heading = (np.concatenate([[0.0], np.cumsum(part + np.zeros_like(middle))]) for part in steps)
    return time_s, front_m, curvature, heading


@pytest.mark.parametrize("by_front", [False, True], ids=["rear axle", "front wheel"])
@pytest.mark.parametrize("rate_hz", [10.0, 20.0])
def test_a_sampled_angle_turns_by_what_was_driven(by_front: bool, rate_hz: float) -> None:
    """The mean of the ends alone is off by 1.3 mrad a corner at 10 Hz where the rear axle keeps its speed."""
    rng = np.random.default_rng(3)
    time_s, front_m, curvature, heading = _corner(by_front)
    errors = []
    for _ in range(CORNERS):
        at_s = np.arange(rng.uniform(0.0, 1.0 / rate_hz), time_s[-1], 1.0 / rate_hz)
        angle = np.arctan(WHEELBASE_M * np.interp(at_s, time_s, curvature))
        rolled = np.diff(np.interp(at_s, time_s, front_m))
        log: Any = SimpleNamespace(
            steer_rad=0.5 * (angle[:-1] + angle[1:]),
            steer_change_rad=np.diff(angle),
            front_roll_rad=rolled,
            duration_s=np.diff(at_s),
            starts=np.array([0, len(rolled)]),
        )
        turned = float(np.diff(np.interp(at_s[[0, -1]], time_s, heading))[0])
        ends = 0.5 * (np.sin(angle[:-1]) + np.sin(angle[1:]))
        errors.append([(rolled @ sine) / WHEELBASE_M - turned for sine in (Observations._over_way(log, np.sin), ends)])
    (bias, plain), (standard_error, _) = np.mean(errors, axis=0), np.std(errors, axis=0) / np.sqrt(CORNERS)
    assert abs(bias) < LEFT * abs(plain) + 3.0 * standard_error
    assert by_front or abs(plain) > 10.0 * standard_error
