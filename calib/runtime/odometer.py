"""Pose and covariance from counts, with radii that follow the wheel loads.

Step. With travels l, r of the wheels, s = (l + r)/2, d = (r - l)/b, u = d/2, m = theta + u:
``x += s sinc(u) cos m``, ``y += s sinc(u) sin m``, ``theta += d``, sinc(u) = sin(u)/u: the exact arc.

Covariance. P = J C J' + R + Q, where

- J (3 x 5) is the derivative of the pose by (radius_ref_l, slope_l, radius_ref_r, slope_r, b), carried along the path
  by J <- F J + G, F and G the derivatives of a step by pose and by parameter; C is the covariance of laws and track.
- R <- F R F' + (|s| + 0.1 m |d|) (along^2 a a' + heading^2 h h'), a and h the derivatives of a step by s and by d: a
  random walk, also of a turn on the spot.
- Q: the uncertainty of one reading of each encoder, once at the first sample (carried along in R) and once at the last.

Faults. A refused sample changes nothing: the next is measured against the last good counts. A fault thus lasts until a
plausible sample comes, or until `rebase` gives the motion in between up.
"""

import enum
import math
from dataclasses import dataclass
from pathlib import Path

from .coefficients import CoefficientError, Coefficients, WheelCoefficients  # noqa: TID252 the folder may be renamed

__all__ = ["Odometer", "OdometerFault", "Pose", "Status"]

#: way that a radian of turning counts as in the random walk and its estimate
_WAY_PER_RAD_M = 0.1


class Status(enum.IntEnum):
    """What became of the last call; the codes are those of the C header."""

    OK = 0
    NO_LOAD = 1
    LOAD_OUT_OF_RANGE = 2
    NOT_FINITE = 3
    JUMP = 4
    STALE = 5
    TIME_BACKWARDS = 6
    BAD_ARGUMENT = 7
    WHEEL_LIFTS = 8
    OVERLOAD = 9


_TEXTS = {
    Status.OK: "fine",
    Status.NO_LOAD: "no valid wheel loads are set",
    Status.LOAD_OUT_OF_RANGE: "wheel load outside the range in which the law holds",
    Status.NOT_FINITE: "a value is NaN or infinite",
    Status.JUMP: "counts moved further than a plausible step",
    Status.STALE: "too long since the last good sample",
    Status.TIME_BACKWARDS: "time did not advance",
    Status.BAD_ARGUMENT: "no number, no name of the load table, or a payload without its place",
    Status.WHEEL_LIFTS: "a wheel would lift under this payload",
    Status.OVERLOAD: "a wheel would carry more than is permitted",
}


class OdometerFault(RuntimeError):
    """A refused load or sample; `status` is its code, the pose is still the last good one."""

    def __init__(self, status: Status) -> None:
        super().__init__(f"{status.name}: {_TEXTS[status]}")
        self.status = status


@dataclass(frozen=True, slots=True)
class Pose:
    """Last good pose.

    `x_m`, `y_m`, `theta_rad` (not wrapped); `distance_m` driven, back and forth both counted; `t_s` of the last good
    sample; `status` of the last call; `clamped` where a load was outside the valid range and the file says clamp;
    `interrupted` where motion was given up since the last reset.
    """

    x_m: float
    y_m: float
    theta_rad: float
    distance_m: float
    t_s: float | None
    status: Status
    clamped: bool
    interrupted: bool


class Odometer:
    """Odometry of one vehicle.

    Parameters
    ----------
    coefficients : Coefficients
        What `Coefficients.read` returns.
    band : {"prediction", "mean"}, optional
        Whether the covariance also holds the scatter of single runs about the law, as that of a journey does, or the
        uncertainty of the law alone; the default is that of a journey where the file has the scatter.
    max_step_m, max_gap_s : float, optional
        Limits of a plausible sample, in place of the file's.
    """

    def __init__(
        self,
        coefficients: Coefficients,
        *,
        band: str | None = None,
        max_step_m: float | None = None,
        max_gap_s: float | None = None,
    ) -> None:
        scatters = coefficients.left.residual_std_m > 0.0
        band = band or ("prediction" if scatters else "mean")
        if band not in ("mean", "prediction")[: 1 + scatters]:
            alternative = "'prediction'" if scatters else "a file with the scatter of single runs"
            raise CoefficientError(f"band: found {band!r}; expected 'mean' or {alternative}")
        self.coefficients = coefficients
        self._band = band
        self._max_step_m = coefficients.max_step_m if max_step_m is None else max_step_m
        self._max_gap_s = coefficients.max_gap_s if max_gap_s is None else max_gap_s
        self._radii: tuple[float, float] | None = None
        self._last_radii = (0.0, 0.0)
        self._offsets = (0.0, 0.0)
        self._clamped = False
        self._load_fault = Status.NO_LOAD
        self.reset()

    @classmethod
    def from_file(cls, path: str | Path, *, band: str | None = None) -> "Odometer":
        """Return the odometer of the coefficient file at `path`."""
        return cls(Coefficients.read(path), band=band)

    def reset(self, x_m: float = 0.0, y_m: float = 0.0, theta_rad: float = 0.0) -> None:
        """Start anew at a pose known exactly; wheel loads stay, the next sample is the first."""
        if not all(map(math.isfinite, (x_m, y_m, theta_rad))):
            raise OdometerFault(Status.NOT_FINITE)
        self._x, self._y, self._theta, self._distance = float(x_m), float(y_m), float(theta_rad), 0.0
        self._counts: tuple[float, float] | None = None
        self._t: float | None = None
        self._jacobian = [[0.0] * 5 for _ in range(3)]
        self._random = [0.0] * 6  # xx, xy, xt, yy, yt, tt
        self._interrupted = False
        self._status = Status.OK if self._radii else self._load_fault

    def rebase(self) -> None:
        """Give up the motion since the last good sample; the pose goes on."""
        if self._counts is not None:
            self._interrupted = True
        self._counts = self._t = None

    @property
    def status(self) -> Status:
        """What became of the last call."""
        return self._status

    @property
    def radii_m(self) -> tuple[float, float]:
        """Radii (left, right) in force; raises `OdometerFault` where no valid loads are set."""
        if self._radii is None:
            raise OdometerFault(self._load_fault)
        return self._radii

    @property
    def pose(self) -> Pose:
        """The last good pose."""
        return Pose(
            self._x, self._y, self._theta, self._distance, self._t, self._status, self._clamped, self._interrupted
        )

    @property
    def covariance(self) -> list[list[float]]:
        """Covariance (3 x 3) of x in m, y in m and theta in rad at the last good pose."""
        xx, xy, xt, yy, yt, tt = (a + b for a, b in zip(self._random, self._reading(), strict=True))
        total = [[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]]
        parameters = self._parameter_covariance()
        for i in range(3):
            for j in range(i, 3):
                part = sum(
                    self._jacobian[i][p] * value * self._jacobian[j][q] for p, q, value in parameters if value != 0.0
                )
                total[i][j] += part
                if i != j:
                    total[j][i] += part
        return total

    def set_wheel_loads(self, left_N: float, right_N: float) -> None:
        """Set the loads of the rear wheels; from the next sample on their radii hold.

        Raises OdometerFault where a load is not finite, or outside the valid range and either the file says refuse or
        no wheel can carry it; samples are then refused.
        """
        loads = self._finite(left_N, right_N)
        wheels = (self.coefficients.left, self.coefficients.right)
        used = [min(max(load, w.load_min_N), w.load_max_N) for load, w in zip(loads, wheels, strict=True)]
        self._clamped = tuple(used) != loads
        if not self.coefficients.takes(loads, used):
            self._clamped = False
            raise self._refuse_load(Status.LOAD_OUT_OF_RANGE)
        self._radii = self._last_radii = (wheels[0].radius_m(used[0]), wheels[1].radius_m(used[1]))
        self._offsets = (used[0] - wheels[0].reference_load_N, used[1] - wheels[1].reference_load_N)
        self._status = Status.OK

    def set_payload(
        self, payload_kg: float, payload_x_m: float | None = None, payload_y_m: float | None = None
    ) -> None:
        """Set the wheel loads from a payload and its centre of mass, none of 0 kg; see `set_wheel_loads`.

        Raises OdometerFault also where a wheel would lift or carry too much.
        """
        mass, x, y = self._finite(payload_kg, payload_x_m or 0.0, payload_y_m or 0.0)
        if mass < 0.0 or (mass and None in (payload_x_m, payload_y_m)):
            raise self._refuse_load(Status.BAD_ARGUMENT)
        loads = self.coefficients.wheel_loads_N(mass, x, y)
        if min(loads) <= 0.0:
            raise self._refuse_load(Status.WHEEL_LIFTS)
        if max(loads) > self.coefficients.max_wheel_load_N:
            raise self._refuse_load(Status.OVERLOAD)
        self.set_wheel_loads(loads[0], loads[1])

    def set_load_point(self, name: str) -> None:
        """Set the wheel loads of a line of the load table; see `set_wheel_loads`."""
        loads = self.coefficients.load_table.get(name)
        if loads is None:
            self._radii, self._clamped = None, False
            raise self._refuse_load(Status.BAD_ARGUMENT)
        self.set_wheel_loads(*loads)

    def update(self, counts_left: float, counts_right: float, t_s: float | None = None) -> Pose:
        """Feed a sample and return the pose; like `feed`, but a fault raises `OdometerFault`."""
        status = self.feed(counts_left, counts_right, t_s)
        if status is not Status.OK:
            raise OdometerFault(status)
        return self.pose

    def feed(self, counts_left: float, counts_right: float, t_s: float | None = None) -> Status:
        """Feed the encoders' counters and return what became of it; never raises.

        Parameters
        ----------
        counts_left, counts_right : int or float
            Counters as read; wraps are undone where the file states the counters' width.
        t_s : float, optional
            Time of the sample; without it gaps in time are not seen.
        """
        self._status = self._feed(counts_left, counts_right, t_s)
        return self._status

    def _feed(self, counts_left: float, counts_right: float, t_s: float | None) -> Status:
        if self._radii is None:
            return self._load_fault
        try:
            if not (math.isfinite(counts_left) and math.isfinite(counts_right)):
                return Status.NOT_FINITE
            if t_s is not None and not math.isfinite(t_s):
                return Status.NOT_FINITE
            counts_left, counts_right = _count(counts_left), _count(counts_right)
        except (TypeError, ValueError, OverflowError):
            return Status.BAD_ARGUMENT
        if self._counts is None:
            self._counts, self._t = (counts_left, counts_right), t_s
            self._random = [a + b for a, b in zip(self._random, self._reading(), strict=True)]
            return Status.OK
        if t_s is not None and self._t is not None:
            if t_s <= self._t:
                return Status.TIME_BACKWARDS
            if t_s - self._t > self._max_gap_s:
                return Status.STALE
        delta_left = self._difference(counts_left, self._counts[0])
        delta_right = self._difference(counts_right, self._counts[1])
        turn_left = 2.0 * math.pi * delta_left / self.coefficients.left.counts_per_rev
        turn_right = 2.0 * math.pi * delta_right / self.coefficients.right.counts_per_rev
        radius_left, radius_right = self._radii
        if not max(abs(turn_left * radius_left), abs(turn_right * radius_right)) <= self._max_step_m:
            return Status.JUMP
        self._step(turn_left, turn_right, radius_left, radius_right)
        self._counts, self._t = (counts_left, counts_right), t_s
        return Status.OK

    def _difference(self, now: float, before: float) -> float:
        if self.coefficients.wrap_bits is None:
            return now - before
        span = 1 << self.coefficients.wrap_bits
        delta = (now - before) % span
        return delta - span if delta >= span / 2 else delta

    def _step(self, turn_left: float, turn_right: float, radius_left: float, radius_right: float) -> None:
        c = self.coefficients
        track = c.track_m
        travel_left, travel_right = turn_left * radius_left, turn_right * radius_right
        s = 0.5 * (travel_right + travel_left)
        d = (travel_right - travel_left) / track
        u = 0.5 * d
        sinc, slope = _sinc(u)
        middle = self._theta + u
        cos, sin = math.cos(middle), math.sin(middle)
        dx, dy = s * sinc * cos, s * sinc * sin
        bend = 0.5 * s * slope
        by_s = (sinc * cos, sinc * sin, 0.0)
        by_d = (bend * cos - 0.5 * dy, bend * sin + 0.5 * dx, 1.0)

        jx, jy, jt = self._jacobian
        offset_left, offset_right = self._offsets
        half_left, half_right = 0.5 * turn_left, 0.5 * turn_right
        yaw_left, yaw_right = -turn_left / track, turn_right / track
        # change of s and of d with each parameter, in the order of J
        rates = (
            (half_left, yaw_left),
            (half_left * offset_left, yaw_left * offset_left),
            (half_right, yaw_right),
            (half_right * offset_right, yaw_right * offset_right),
            (0.0, -d / track),
        )
        for p, (rate_s, rate_d) in enumerate(rates):
            jx[p] += by_s[0] * rate_s + by_d[0] * rate_d - dy * jt[p]
            jy[p] += by_s[1] * rate_s + by_d[1] * rate_d + dx * jt[p]
            jt[p] += rate_d

        xx, xy, xt, yy, yt, tt = self._random
        way = abs(s) + _WAY_PER_RAD_M * abs(d)
        along, heading = c.along_m_per_sqrt_m**2 * way, c.heading_rad_per_sqrt_m**2 * way
        self._random = [
            xx - 2.0 * dy * xt + dy * dy * tt + along * by_s[0] ** 2 + heading * by_d[0] ** 2,
            xy + dx * xt - dy * yt - dx * dy * tt + along * by_s[0] * by_s[1] + heading * by_d[0] * by_d[1],
            xt - dy * tt + heading * by_d[0],
            yy + 2.0 * dx * yt + dx * dx * tt + along * by_s[1] ** 2 + heading * by_d[1] ** 2,
            yt + dx * tt + heading * by_d[1],
            tt + heading,
        ]
        self._x += dx
        self._y += dy
        self._theta += d
        self._distance += abs(s)

    def _reading(self) -> list[float]:
        if self._counts is None:
            return [0.0] * 6
        c = self.coefficients
        left = (2.0 * math.pi * self._last_radii[0] / c.left.counts_per_rev * c.count_std) ** 2
        right = (2.0 * math.pi * self._last_radii[1] / c.right.counts_per_rev * c.count_std) ** 2
        along, heading, both = 0.25 * (left + right), (left + right) / c.track_m**2, 0.5 * (right - left) / c.track_m
        cos, sin = math.cos(self._theta), math.sin(self._theta)
        return [along * cos * cos, along * cos * sin, both * cos, along * sin * sin, both * sin, heading]

    def _parameter_covariance(self) -> list[tuple[int, int, float]]:
        entries = [(4, 4, self.coefficients.track_std_m**2)]
        wheels: tuple[tuple[int, WheelCoefficients], ...] = ((0, self.coefficients.left), (2, self.coefficients.right))
        for first, wheel in wheels:
            scatter = wheel.residual_std_m**2 if self._band == "prediction" else 0.0
            entries += [
                (first, first, wheel.variance_radius_ref_m2 + scatter),
                (first, first + 1, wheel.covariance_m2_per_N),
                (first + 1, first, wheel.covariance_m2_per_N),
                (first + 1, first + 1, wheel.variance_slope_m2_per_N2),
            ]
        shared = ((0, 2, self.coefficients.run_covariance_m2),) * (self._band == "prediction")
        for one, other, value in (*self.coefficients.cross_covariance, *shared):
            entries += [(one, other, value), (other, one, value)]
        return entries

    def _finite(self, *values: float) -> tuple[float, ...]:
        self._radii, self._clamped = None, False
        try:
            # refuses texts, which float() reads
            finite, numbers = all(map(math.isfinite, values)), tuple(map(float, values))
        except (TypeError, ValueError, OverflowError):
            raise self._refuse_load(Status.BAD_ARGUMENT) from None
        if not finite:
            raise self._refuse_load(Status.NOT_FINITE)
        return numbers

    def _refuse_load(self, status: Status) -> OdometerFault:
        self._load_fault = self._status = status
        return OdometerFault(status)


def _count(value: float) -> float:
    whole = int(value)
    return whole if whole == value else float(value)


def _sinc(u: float) -> tuple[float, float]:
    if abs(u) < 1e-2:
        v = u * u
        return 1.0 - v / 6.0 * (1.0 - v / 20.0 * (1.0 - v / 42.0)), -u / 3.0 * (1.0 - v / 10.0 * (1.0 - v / 28.0))
    sin = math.sin(u)
    return sin / u, (u * math.cos(u) - sin) / (u * u)
