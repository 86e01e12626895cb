"""The steering angle that the rear wheels' turn tells: of each run, however many others there are.

Squares of all ways driven, counted on from run to run, once left nothing of the difference between two steps: in a
campaign of a thousand runs the angle in turns was twice as wrong as in one of a hundred.
"""

from __future__ import annotations

import numpy as np

from calib.gap.effects.steering import _wheel_rad, steer_rad
from tests.gap.effects.making import ROUTE, Run, situation

#: rounding of sums of squares over some runs
ROUNDING_RAD = 1e-6


def test_the_angle_of_a_bend_is_the_same_among_many_runs() -> None:
    """The last of 3,000 long runs against the first."""
    longer = [(10.0 * length_m, curvature / 10.0) for length_m, curvature in ROUTE]
    alone, among = (situation([Run(longer, steps=100) for _ in range(count)]) for count in (1, 3000))
    angle = _wheel_rad(alone, steer_rad(alone))
    steered = np.abs(angle) > 0.01
    assert steered.sum() > 20
    np.testing.assert_allclose(_wheel_rad(among, steer_rad(among))[-len(angle) :], angle, rtol=0, atol=ROUNDING_RAD)
