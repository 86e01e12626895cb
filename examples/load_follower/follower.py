"""Odometry whose wheel radii follow the measured wheel loads: the core of the node, without ROS.

Loads and joint angles come in with their times, odometry goes out. Everything that has to be right is here or in
`calib.runtime`, and tested without ROS; `node.py` only moves messages.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from calib.runtime import Odometer, OdometerFault, Pose, Status

__all__ = ["LoadFollower", "Odometry", "quaternion_zw"]

TURN_RAD = 2.0 * math.pi
#: variance of what odometry in the plane does not see: height, roll and pitch
UNSEEN = 1e6


@dataclass(frozen=True, slots=True)
class Odometry:
    """What a sample of the joints yields.

    `pose_covariance` and `twist_covariance` are 6 x 6, row by row, in the order x, y, z, roll, pitch, yaw that ROS
    uses. `loads_are_old` where no load came for longer than the follower waits: the last one holds on. `interrupted`
    where motion was given up since the start; `clamped` where the load is beyond those measured.
    """

    t_s: float
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    yaw_rate_radps: float
    pose_covariance: tuple[float, ...]
    twist_covariance: tuple[float, ...]
    radii_m: tuple[float, float]
    loads_are_old: bool
    interrupted: bool
    clamped: bool


class LoadFollower:
    """Odometry that follows the load.

    Parameters
    ----------
    odometer : Odometer
        Of the vehicle's coefficient file.
    settling_s : float
        Time constant by which measured loads are smoothed: load cells swing when the vehicle brakes, tyres do not.
        0 takes them as they come.
    load_timeout_s : float
        Silence of the load sensor after which the odometry says that its loads are old.
    give_up_s : float
        How long samples may be implausible before the motion in between is given up.
    """

    def __init__(
        self, odometer: Odometer, *, settling_s: float = 1.0, load_timeout_s: float = 2.0, give_up_s: float = 1.0
    ) -> None:
        self._odometer = odometer
        self._settling_s = settling_s
        self._load_timeout_s = load_timeout_s
        self._give_up_s = give_up_s
        self._loads_N: tuple[float, float] | None = None
        self._loads_t_s = -math.inf
        self._before: Pose | None = None
        self._faulty_since_s: float | None = None
        self.status = Status.NO_LOAD

    @property
    def loads_N(self) -> tuple[float, float] | None:
        """Smoothed loads (left, right) that the radii belong to; None before the first."""
        return self._loads_N

    def feed_loads(self, left_N: float, right_N: float, t_s: float) -> Status:
        """Take measured wheel loads; from the next sample of the joints on their radii hold.

        A load that the coefficient file refuses stops the odometry until one comes that it takes; it is no part of
        the smoothed one.
        """
        if not (math.isfinite(left_N) and math.isfinite(right_N) and math.isfinite(t_s)):
            return Status.NOT_FINITE
        try:
            self._odometer.set_wheel_loads(left_N, right_N)
            if self._loads_N is not None and self._settling_s > 0.0:
                weight = -math.expm1(-max(t_s - self._loads_t_s, 0.0) / self._settling_s)
                left, right = self._loads_N
                left_N, right_N = left + weight * (left_N - left), right + weight * (right_N - right)
                self._odometer.set_wheel_loads(left_N, right_N)
        except OdometerFault as fault:
            self.status = fault.status
            return fault.status
        self._loads_N = left_N, right_N
        self._loads_t_s = max(t_s, self._loads_t_s)
        return Status.OK

    def feed_joints(
        self, names: Sequence[str], positions_rad: Sequence[float], joints: tuple[str, str], t_s: float
    ) -> Odometry | None:
        """Take a message of joint positions; None where it has not both `joints` (left, right), or is refused."""
        if not set(joints) <= set(names) or len(positions_rad) != len(names):
            return None
        left, right = (positions_rad[names.index(joint)] for joint in joints)
        return self.feed_angles(left, right, t_s)

    def feed_angles(self, left_rad: float, right_rad: float, t_s: float) -> Odometry | None:
        """Take the wheels' angles; None where the sample is refused: `status` then says why."""
        wheels = self._odometer.coefficients
        counts_left = left_rad / TURN_RAD * wheels.left.counts_per_rev
        counts_right = right_rad / TURN_RAD * wheels.right.counts_per_rev
        self.status = self._odometer.feed(counts_left, counts_right, t_s)
        if self.status is not Status.OK:
            self._bear_with(t_s)
            return None
        self._faulty_since_s = None
        before, self._before = self._before, self._odometer.pose
        return self._odometry(before or self._before, self._before, t_s)

    def _bear_with(self, t_s: float) -> None:
        """Give the motion up where samples stay implausible; a single stray one costs nothing."""
        if self.status not in (Status.JUMP, Status.STALE, Status.TIME_BACKWARDS):
            return
        if self._faulty_since_s is None:
            self._faulty_since_s = t_s
        # a clock that was set back is waited for no longer than one that runs
        if abs(t_s - self._faulty_since_s) >= self._give_up_s:
            self._odometer.rebase()
            self._before = self._faulty_since_s = None

    def _odometry(self, before: Pose, now: Pose, t_s: float) -> Odometry:
        period_s = t_s - before.t_s if before.t_s is not None else 0.0
        middle = 0.5 * (before.theta_rad + now.theta_rad)
        along = (now.x_m - before.x_m) * math.cos(middle) + (now.y_m - before.y_m) * math.sin(middle)
        turn = now.theta_rad - before.theta_rad
        speed, rate = (along / period_s, turn / period_s) if period_s > 0.0 else (0.0, 0.0)
        xx, xy, xt = self._odometer.covariance[0]
        _, yy, yt = self._odometer.covariance[1]
        tt = self._odometer.covariance[2][2]
        return Odometry(
            t_s=t_s,
            x_m=now.x_m,
            y_m=now.y_m,
            yaw_rad=now.theta_rad,
            speed_mps=speed,
            yaw_rate_radps=rate,
            pose_covariance=_six_by_six({(0, 0): xx, (0, 1): xy, (0, 5): xt, (1, 1): yy, (1, 5): yt, (5, 5): tt}),
            twist_covariance=_six_by_six(self._twist_variances(speed, rate, period_s)),
            radii_m=self._odometer.radii_m,
            loads_are_old=t_s - self._loads_t_s > self._load_timeout_s,
            interrupted=now.interrupted,
            clamped=now.clamped,
        )

    def _twist_variances(self, speed: float, rate: float, period_s: float) -> dict[tuple[int, int], float]:
        """Return variances of speed and yaw rate: the radii, the track, the random walk and two readings of counts."""
        c = self._odometer.coefficients
        if period_s <= 0.0 or self._loads_N is None:
            return {(0, 0): UNSEEN, (1, 1): UNSEEN, (5, 5): UNSEEN}
        walked = abs(speed) / period_s
        forward, turning = c.along_m_per_sqrt_m**2 * walked, c.heading_rad_per_sqrt_m**2 * walked
        wheels = zip((c.left, c.right), self._odometer.radii_m, self._loads_N, (-1.0, 1.0), strict=True)
        for wheel, radius, load, side in wheels:
            offset = min(max(load, wheel.load_min_N), wheel.load_max_N) - wheel.reference_load_N
            law = wheel.variance_radius_ref_m2 + offset * (
                2.0 * wheel.covariance_m2_per_N + offset * wheel.variance_slope_m2_per_N2
            )
            travel_rate = speed + side * 0.5 * c.track_m * rate
            count = TURN_RAD * radius / wheel.counts_per_rev * c.count_std / period_s
            variance = law * (travel_rate / radius) ** 2 + 2.0 * count**2
            forward += 0.25 * variance
            turning += variance / c.track_m**2
        turning += (rate * c.track_std_m / c.track_m) ** 2
        return {(0, 0): forward, (1, 1): c.along_m_per_sqrt_m**2 * walked, (5, 5): turning}


def quaternion_zw(yaw_rad: float) -> tuple[float, float]:
    """Return z and w of the quaternion of a turn about the vertical; x and y are zero."""
    return math.sin(0.5 * yaw_rad), math.cos(0.5 * yaw_rad)


def _six_by_six(entries: dict[tuple[int, int], float]) -> tuple[float, ...]:
    """Return a symmetric 6 x 6 matrix row by row, with `UNSEEN` for height, roll and pitch."""
    cells = [0.0] * 36
    for unseen in (2, 3, 4):
        cells[7 * unseen] = UNSEEN
    for (row, column), value in entries.items():
        cells[6 * row + column] = cells[6 * column + row] = value
    return tuple(cells)
