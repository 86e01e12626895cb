"""Slip, effective radius, and the front wheel against the rear wheels."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from calib import kinematics

ROUNDING = 1e-12  # a handful of operations in double precision


def test_a_free_rolling_wheel_at_its_free_radius_does_not_slip() -> None:
    assert float(kinematics.slip(0.1, 0.1)) == 0.0


def test_braking_slip_runs_from_0_to_minus_1() -> None:
    """As the wheel comes to a stand the effective radius goes from the free radius to infinity."""
    values = kinematics.slip(0.1, [0.1, 0.2, 1e12])
    np.testing.assert_allclose(values, [0.0, -0.5, -1.0], rtol=0.0, atol=1e-9)
    assert float(kinematics.slip_from_speed(1.0, 0.0, 0.1)) == -1.0


@given(st.floats(0.05, 1.0), st.floats(0.9, 1.1), st.floats(0.01, 20.0))
def test_slip_from_speeds_and_from_radii_agree(free: float, ratio: float, turning: float) -> None:
    """Eq. 4 is Eq. 3 with v = r_e omega."""
    effective = free * ratio
    by_speed = kinematics.slip_from_speed(effective * turning, turning, free)
    np.testing.assert_allclose(by_speed, kinematics.slip(free, effective), rtol=0.0, atol=ROUNDING)


def test_a_standing_vehicle_has_no_slip_value() -> None:
    assert math.isnan(float(kinematics.slip_from_speed(0.0, 1.0, 0.1)))


def test_effective_radius_undoes_the_distance() -> None:
    assert float(kinematics.effective_radius_m(2 * math.pi, 10.0)) == pytest.approx(0.1, rel=ROUNDING)
    assert float(kinematics.distance_m(0.1, 10.0)) == pytest.approx(2 * math.pi, rel=ROUNDING)


@given(st.floats(-2.0, 2.0), st.floats(-1.0, 1.0), st.floats(0.05, 0.5), st.floats(0.3, 3.0))
@example(-0.0, 0.0, 0.1, 1.0)
@example(-1.0, -0.0, 0.1, 1.0)
def test_front_wheel_and_axle_say_the_same_motion(speed: float, yaw: float, radius: float, wheelbase: float) -> None:
    turning, steer = kinematics.front_from_axle(speed, yaw, radius, wheelbase)
    back = kinematics.front_to_axle(turning, steer, radius, wheelbase)
    np.testing.assert_allclose(back, (speed, yaw), rtol=0.0, atol=1e-10)
    assert abs(float(steer)) <= math.pi / 2 + ROUNDING


def test_steering_angle_of_a_circle_is_that_of_its_geometry() -> None:
    """tan(alpha) = wheelbase / radius for the axle's middle on a circle."""
    _, steer = kinematics.front_from_axle(0.5, 0.5 / 3.0, 0.1, 1.0)
    assert math.tan(float(steer)) == pytest.approx(1.0 / 3.0, rel=ROUNDING)


@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(0.3, 2.0))
def test_wheel_speeds_and_axle_motion_are_inverses(left: float, right: float, track: float) -> None:
    speed, yaw = kinematics.axle_motion(left, right, track)
    np.testing.assert_allclose(kinematics.wheel_motion(speed, yaw, track), (left, right), rtol=0.0, atol=ROUNDING)


def test_errors_of_radius_and_track_are_right_over_left_and_actual_over_nominal() -> None:
    assert float(kinematics.radius_error(0.099, 0.1)) == pytest.approx(0.99)
    assert float(kinematics.track_error(0.7021, 0.7)) == pytest.approx(1.003)
