"""The vehicle's own controller: it sees quantised counters and nothing of the true pose."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tests.plant.contact.routes import Route, speed_profile

__all__ = ["Belief", "Driver"]

_STEER_LIMIT_RAD = math.radians(75.0)
_STEER_RATE_RADPS = math.radians(90.0)
_CREEP_MPS = 0.02
#: the steering is set for the point that the vehicle reaches when the steering has followed
_PREVIEW_S = 0.08
_GAIN_PER_M = 1.2


@dataclass(frozen=True, slots=True)
class Belief:
    """What the vehicle believes of itself: rear radii at the load it was told, track, wheelbase, front radius."""

    radius_left_m: float
    radius_right_m: float
    track_m: float
    wheelbase_m: float
    radius_front_m: float


class Driver:
    """Follow a route by odometry from the rear counters alone.

    Parameters
    ----------
    path : Route
        Where to go.
    belief : Belief
        Radii and track for the odometry.
    counts_per_rev : float
        Of the rear encoders.
    speed_mps, curve_speed_mps, acceleration_mps2 : float
        See `speed_profile`.
    """

    def __init__(
        self,
        path: Route,
        belief: Belief,
        *,
        counts_per_rev: float,
        speed_mps: float,
        curve_speed_mps: float,
        acceleration_mps2: float,
    ) -> None:
        profile = speed_profile(
            path, speed_mps=speed_mps, curve_speed_mps=curve_speed_mps, acceleration_mps2=acceleration_mps2
        )
        # Plain lists: the loop reads single samples, which numpy is slow at.
        self._x, self._y, self._theta = path.x_m.tolist(), path.y_m.tolist(), path.theta_rad.tolist()
        self._bend, self._speed = path.curvature_per_m.tolist(), profile.tolist()
        self._length, self._spacing = float(path.s_m[-1]), float(path.s_m[1] - path.s_m[0])
        self._belief = belief
        self._per_count = 2.0 * math.pi / counts_per_rev
        self._acceleration = acceleration_mps2
        self._left = self._right = 0
        self._pose = np.zeros(3).tolist()
        self._s = 0.0
        self._steer = 0.0
        self._target = 0.0
        self.arrived = False

    def command(self, left: int, right: int, dt_s: float) -> tuple[float, float]:
        """Return steering angle (rad) and speed of the front wheel (rad/s) for the counters read now.

        Parameters
        ----------
        left, right : int
            Counts since the start.
        dt_s : float
            Time since the last call.
        """
        believed = self._belief
        step_left = believed.radius_left_m * self._per_count * (left - self._left)
        step_right = believed.radius_right_m * self._per_count * (right - self._right)
        self._left, self._right = left, right
        turn, step = (step_right - step_left) / believed.track_m, 0.5 * (step_left + step_right)
        x, y, theta = self._pose
        middle = theta + 0.5 * turn
        x, y, theta = x + step * math.cos(middle), y + step * math.sin(middle), theta + turn
        self._pose = [x, y, theta]

        at = min(int(self._s / self._spacing), len(self._x) - 1)
        cos, sin = math.cos(self._theta[at]), math.sin(self._theta[at])
        lateral = -sin * (x - self._x[at]) + cos * (y - self._y[at])
        along = cos * (x - self._x[at]) + sin * (y - self._y[at])
        self._s = max(self._s, at * self._spacing + along / max(0.2, 1.0 - self._bend[at] * lateral))
        off = theta - self._theta[at] - self._bend[at] * along

        if self._s >= self._length:
            self.arrived = True
        if self.arrived:
            self._target = 0.0
        else:
            allowed = max(self._speed[min(at + 1, len(self._speed) - 1)], _CREEP_MPS)
            self._target = min(allowed, self._target + self._acceleration * dt_s)
        ahead = min(int((self._s + self._target * _PREVIEW_S) / self._spacing), len(self._bend) - 1)
        bend = self._bend[ahead] - _GAIN_PER_M**2 * lateral - 2.0 * _GAIN_PER_M * off
        wanted = math.atan(believed.wheelbase_m * bend)
        if not self.arrived:
            wanted = max(-_STEER_LIMIT_RAD, min(_STEER_LIMIT_RAD, wanted))
            most = _STEER_RATE_RADPS * dt_s
            self._steer += max(-most, min(most, wanted - self._steer))
        return self._steer, self._target / (math.cos(self._steer) * believed.radius_front_m)
