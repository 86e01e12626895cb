"""Kinematics of the wheels: slip and effective radius, front wheel against rear wheels, the errors E_r and E_b."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray

__all__ = [
    "axle_motion",
    "distance_m",
    "effective_radius_m",
    "front_from_axle",
    "front_to_axle",
    "radius_error",
    "slip",
    "slip_from_speed",
    "track_error",
    "wheel_motion",
]


def _array(value: npt.ArrayLike) -> FloatArray:
    return np.asarray(value, dtype=np.float64)


def slip_from_speed(speed_mps: npt.ArrayLike, turning_rad_per_s: npt.ArrayLike, free_radius_m: float) -> FloatArray:
    """Return the slip of a wheel from the speed of its centre and its own turning (Eq. 3).

    Parameters
    ----------
    speed_mps, turning_rad_per_s : array_like of float
        Speed of the wheel's centre and angular speed, shapes that broadcast; NaN results where the speed is 0.
    free_radius_m : float
        Radius of the unloaded wheel.
    """
    speed = _array(speed_mps)
    with np.errstate(divide="ignore", invalid="ignore"):
        made = -(speed - _array(turning_rad_per_s) * free_radius_m) / speed
    return np.asarray(np.where(speed == 0.0, np.nan, made))


def slip(free_radius_m: npt.ArrayLike, effective_radius_m: npt.ArrayLike) -> FloatArray:
    """Return the slip of a wheel from its free and its effective radius (Eq. 4), in [-1, 0] under braking."""
    return np.asarray(_array(free_radius_m) / _array(effective_radius_m) - 1.0)


def distance_m(effective_radius_m: npt.ArrayLike, revolutions: npt.ArrayLike) -> FloatArray:
    """Return the distance of a wheel of an effective radius in m after some revolutions (Eq. 5)."""
    return np.asarray(2 * np.pi * _array(effective_radius_m) * _array(revolutions))


def effective_radius_m(distance_m: npt.ArrayLike, revolutions: npt.ArrayLike) -> FloatArray:
    """Return the effective radius from a distance in m and the revolutions over it (Eq. 6)."""
    return np.asarray(_array(distance_m) / (2 * np.pi * _array(revolutions)))


def axle_motion(
    left_mps: npt.ArrayLike, right_mps: npt.ArrayLike, track_m: npt.ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return speed and yaw rate of the axle's middle from the speeds of the rear wheels (Eqs 8 and 9)."""
    left, right = _array(left_mps), _array(right_mps)
    return np.asarray(0.5 * (right + left)), np.asarray((right - left) / _array(track_m))


def wheel_motion(
    speed_mps: npt.ArrayLike, yaw_rad_per_s: npt.ArrayLike, track_m: npt.ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return the speeds of the left and right rear wheel: the inverse of `axle_motion`."""
    speed, half = _array(speed_mps), 0.5 * _array(track_m) * _array(yaw_rad_per_s)
    return np.asarray(speed - half), np.asarray(speed + half)


def front_to_axle(
    front_turning_rad_per_s: npt.ArrayLike, steer_rad: npt.ArrayLike, front_radius_m: float, wheelbase_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return speed and yaw rate of the axle's middle from the front wheel's turning and steering (Eqs 12 to 14)."""
    front, steer = _array(front_turning_rad_per_s) * front_radius_m, _array(steer_rad)
    return np.asarray(front * np.cos(steer)), np.asarray(front * np.sin(steer) / wheelbase_m)


def front_from_axle(
    speed_mps: npt.ArrayLike, yaw_rad_per_s: npt.ArrayLike, front_radius_m: float, wheelbase_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return turning in rad/s and steering in rad of the front wheel for a motion of the axle: Eqs 12 to 14 inverted.

    The wheel is steered within 90 degrees either side; it turns backwards where the axle goes backwards. Where the axle
    turns on the spot it stands at 90 degrees on the side of the turn.
    """
    # 0 is added because -0 would be an angle of pi
    speed, across = _array(speed_mps) + 0.0, _array(yaw_rad_per_s) * wheelbase_m + 0.0
    backwards = np.where(speed < 0.0, -1.0, 1.0)
    return (
        np.asarray(backwards * np.hypot(speed, across) / front_radius_m),
        np.asarray(np.arctan2(backwards * across, backwards * speed)),
    )


def radius_error(radius_right_m: npt.ArrayLike, radius_left_m: npt.ArrayLike) -> FloatArray:
    """Return E_r, the right radius over the left one (Eq. 15)."""
    return np.asarray(_array(radius_right_m) / _array(radius_left_m))


def track_error(track_m: npt.ArrayLike, nominal_track_m: npt.ArrayLike) -> FloatArray:
    """Return E_b, the actual track over the nominal one (Eq. 16)."""
    return np.asarray(_array(track_m) / _array(nominal_track_m))
