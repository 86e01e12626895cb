"""Drives: how wheels move the body, derivatives by each parameter, the integrated path."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from itertools import compress
from typing import Final

import numpy as np

from calib.campaign.settings import Reference
from calib.campaign.wheels import lengthening
from calib.types import BoolArray, FloatArray, IntArray, in_frame

#: on the true turn
GYRO_SCALE: Final = "gyro_scale"
#: by makers of gyros of moderate price
GYRO_SCALE_STD: Final = 0.01

#: first random walks of heading and distance, per metre
WALKS: Final = (2.5e-7, 2.5e-7)

#: of scale, lever arm, angle and delay from the settings
SENSOR_STD: Final = {
    GYRO_SCALE: GYRO_SCALE_STD,
    "sensor_x_m": 0.2,
    "sensor_y_m": 0.2,
    "sensor_yaw_rad": 0.5,
    "delay_s": 0.2,
}
#: the gyro's scale, the sensor's pose on the vehicle, and the lag of its stamps behind the encoders'
SENSOR: Final = tuple(SENSOR_STD)


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter; its name ends in its unit."""

    #: for example ``track_m``
    name: str
    nominal: float
    #: standard deviation of the true value about the nominal one; data that do not do clearly better leave it
    #: undetermined
    prior_std: float


#: and factor on the sensor's angle
STEERING_ZERO: Final = "steering_zero_rad"
STEERING_SCALE: Final = "steering_scale"
STEERING: Final = (Parameter(STEERING_ZERO, 0.0, 0.1), Parameter(STEERING_SCALE, 1.0, 0.1))


#: of a nominal mean radius, relative: what wear, load and a tape leave
NOMINAL_STD: Final = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Parameters:
    """Parameters in a fixed order."""

    #: of drive and sensor
    items: tuple[Parameter, ...]
    #: estimated; the others stay nominal, shape (n_parameters,)
    free: BoolArray
    #: nominal values count as measurements, for runs that leave a parameter open
    pulled: bool = False

    @staticmethod
    def of(items: Sequence[Parameter], free: Iterable[str]) -> "Parameters":
        """Return parameters, estimated where named in `free`."""
        return Parameters(tuple(items), np.isin([item.name for item in items], list(free)))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        return tuple(item.name for item in self.items)

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the parameters that are estimated."""
        return tuple(compress(self.names, self.free))

    @property
    def nominal(self) -> FloatArray:
        """Nominal values, shape (n_parameters,)."""
        return np.array([item.nominal for item in self.items])

    @property
    def prior_std(self) -> FloatArray:
        """Spread of what is possible, shape (n_parameters,)."""
        return np.array([item.prior_std for item in self.items])

    @property
    def pull(self) -> FloatArray:
        """What nominal values say of free parameters over their spreads: unit rows, shape (n_rows, n_free).

        Each parameter is within its spread, and the mean radius within `NOMINAL_STD`.
        """
        if not self.pulled:
            return np.zeros((0, self.free.sum()))
        spread = self.prior_std[self.free]
        radii = np.array(["radius" in name for name in self.free_names])
        mean = np.where(radii, spread, 0.0) / max(NOMINAL_STD * float(self.nominal[self.free] @ radii), 1e-300)
        return np.vstack([np.eye(len(spread)), mean])


def parameters_of(drive: "Drive", reference: Reference) -> tuple[Parameter, ...]:
    """Return the parameters of a drive, then those of the reference's sensor at its stated place."""
    place = (1.0, reference.sensor_x_m, reference.sensor_y_m, reference.sensor_yaw_rad, 0.0)
    return (*drive.parameters, *map(Parameter, SENSOR, place, SENSOR_STD.values()))


def first_scales(reference: Reference) -> FloatArray:
    """Return the noise components' variances to begin with, as ordered in `calib.kinematics.solve`."""
    return np.array([reference.sigma_xy_m**2, reference.sigma_theta_rad**2, *WALKS])


def nominal_values(drive: "Drive") -> FloatArray:
    """Return a drive's nominal values, then those of a sensor where the settings' defaults have it."""
    return np.array([item.nominal for item in parameters_of(drive, Reference())])


def nominal_motion(drive: "Drive", steps: "Steps") -> FloatArray:
    """Return the way ahead, to the left and the turn in each step by the nominal values of a drive, (3, n_samples)."""
    return drive.motion(np.array([item.nominal for item in drive.parameters]), steps).body


#: relative, about the nominal length
LENGTH_STD: Final = 0.10
#: of the radius' relative change with load: 1 % per kN
SLOPE_STD_PER_N: Final = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Steps:
    """What the wheels did from sample to sample, all runs laid end to end."""

    #: angle that each wheel turned since the sample before; 0 at the first sample of a run, shape (n_wheels, n_samples)
    turned_rad: FloatArray
    #: by the sensor, in the middle of the step, shape (n_samples,)
    steer_rad: FloatArray | None = None
    #: left and right, from the reference load, shape (2, n_samples)
    load_offset_N: FloatArray | None = None
    #: speed of a counted drive shaft by the nominal radius, shape (n_samples,)
    speed_mps: FloatArray | None = None
    #: slip to the left, shape (n_samples,)
    aside_m: FloatArray | float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Motion of the body in each step, in its own frame."""

    #: forward and to the left in m, and turn in rad, shape (3, n_samples)
    body: FloatArray
    #: makes its derivatives, shape (n_parameters, 3, n_samples): most predictions do without
    by_parameter: Callable[[], FloatArray]


def lengths_of(drive: "Drive") -> tuple[Parameter, ...]:
    """Return a parameter for each length of a drive, a field in ``_m``, within `LENGTH_STD`."""
    lengths = {part.name: getattr(drive, part.name) for part in fields(drive) if part.name.endswith("_m")}
    return tuple(Parameter(name, nominal, LENGTH_STD * nominal) for name, nominal in lengths.items())


@dataclass(frozen=True, slots=True)
class Differential:
    """Two wheels with encoders on one axle: of a tricycle, or a differential drive.

    With loads, the radius of each wheel is radius + slope (load - reference load).
    """

    radius_left_m: float
    radius_right_m: float
    track_m: float
    slopes: bool = False
    slope_left_m_per_N: float = 0.0
    slope_right_m_per_N: float = 0.0

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Radii, track and, with loads, the slopes of the radii."""
        slopes = (
            Parameter("slope_left_m_per_N", self.slope_left_m_per_N, SLOPE_STD_PER_N * self.radius_left_m),
            Parameter("slope_right_m_per_N", self.slope_right_m_per_N, SLOPE_STD_PER_N * self.radius_right_m),
        )
        return (*lengths_of(self), *(slopes if self.slopes else ()))

    def motion(self, values: FloatArray, steps: Steps) -> Motion:
        """Return the motion of the axle's middle (Eqs 8 and 9)."""
        phi, track, loads = steps.turned_rad, values[2], steps.load_offset_N if self.slopes else None
        radius = values[:2, None] + (0.0 if loads is None else values[3:, None] * loads)
        left, right = radius * phi
        turn = (right - left) / track

        def derivative() -> FloatArray:
            by_travel = np.array([[[0.5], [0.0], [-1.0 / track]], [[0.5], [0.0], [1.0 / track]]])
            by = np.zeros((len(values), 3, len(turn)))
            by[:2] = by_travel * phi[:, None]
            by[2, 2] = -turn / track
            if loads is not None:
                by[3:] = by_travel * (phi * loads)[:, None]
            return by

        return Motion(np.stack([0.5 * (left + right), np.zeros_like(turn), turn]), derivative)


@dataclass(frozen=True, slots=True)
class FrontWheel:
    """A steered front wheel with encoder; the true steering angle is scale times the sensor's, plus zero."""

    front_radius_m: float
    wheelbase_m: float

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Front radius, wheelbase, zero and scale of the steering angle."""
        return (*lengths_of(self), *STEERING)

    def motion(self, values: FloatArray, steps: Steps) -> Motion:
        """Return the motion of the rear axle's middle (Eqs 12 to 14)."""
        radius, wheelbase, zero, scale = values
        phi, steer = steps.turned_rad[0], np.asarray(steps.steer_rad)
        angle = scale * steer + zero
        cosine, sine = np.cos(angle), np.sin(angle)
        travel = radius * phi

        def derivative() -> FloatArray:
            by = np.zeros((4, 3, len(travel)))
            by[0, 0], by[0, 2] = phi * cosine, phi * sine / wheelbase
            by[1, 2] = -travel * sine / wheelbase**2
            by[2, 0], by[2, 2] = -travel * sine, travel * cosine / wheelbase
            by[3] = by[2] * steer
            return by

        return Motion(np.stack([travel * cosine, np.zeros_like(travel), travel * sine / wheelbase]), derivative)


@dataclass(frozen=True, slots=True)
class Mecanum:
    """Four wheels with rollers at 45 degrees: front left, front right, rear left, rear right; one radius for all."""

    wheel_radius_m: float
    half_length_plus_half_width_m: float

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Radius, and half the wheelbase plus half the track."""
        return lengths_of(self)

    def motion(self, values: FloatArray, steps: Steps) -> Motion:
        """Return the motion of the middle between the four wheels."""
        radius, arm = values
        front_left, front_right, rear_left, rear_right = steps.turned_rad
        forward = 0.25 * (front_left + front_right + rear_left + rear_right)
        left = 0.25 * (-front_left + front_right + rear_left - rear_right)
        turn = 0.25 * (-front_left + front_right - rear_left + rear_right)
        body = np.stack([forward, left, turn / arm])

        def derivative() -> FloatArray:
            by_arm = np.zeros_like(body)
            by_arm[2] = -radius * turn / arm**2
            return np.stack([body, by_arm])

        return Motion(radius * body, derivative)


#: the curvature is tan(angle) / (L (1 + understeer v^2)); see `lengthening`
UNDERSTEER: Final = "understeer_s2_per_m2"
#: the rear axle moves at the angle -side_slip v^2 curvature to its heading
SIDE_SLIP: Final = "side_slip_s2_per_m"
#: rubber on a smooth floor gives way by some hundredths of a radian at 1 m/s^2: 0.01 s^2/m
UNDERSTEER_STD: Final = 0.05
SIDE_SLIP_STD: Final = 0.02
#: turns below this lateral acceleration slip by four milliradians, or ten, which ends do not tell from wheelbase and
#: steering scale
SLIPS_MPS2, SLIPS_AT_ENDS_MPS2 = 0.2, 0.5
#: share of turning that may stay below
OFTEN: Final = 0.9


@dataclass(frozen=True, slots=True)
class RearShaft:
    """A counted rear axle and steered front wheels; the true angle is scale times the sensor's, plus zero."""

    rear_radius_m: float
    wheelbase_m: float
    #: understeer and side slip are parameters
    slips: bool = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Rear radius, wheelbase, steering zero and scale; in fast turns understeer and side slip."""
        slips = (Parameter(UNDERSTEER, 0.0, UNDERSTEER_STD), Parameter(SIDE_SLIP, 0.0, SIDE_SLIP_STD))
        return (*lengths_of(self), *STEERING, *(slips if self.slips else ()))

    def motion(self, values: FloatArray, steps: Steps) -> Motion:
        """Return the rear axle's motion: ahead what the wheels roll, curvature tan(angle) / L."""
        radius, wheelbase, zero, scale = values[:4]
        understeer, side_slip = values[4:] if self.slips else (0.0, 0.0)
        phi, steer, square = steps.turned_rad[0], np.asarray(steps.steer_rad), np.square(np.asarray(steps.speed_mps))
        tangent = np.tan(scale * steer + zero)
        travel = radius * phi
        longer = wheelbase * lengthening(understeer * square)
        turn = travel * tangent / longer

        def derivative() -> FloatArray:
            by = np.zeros((len(values), 3, len(travel)))
            by[0, 0], by[0, 2] = phi, phi * tangent / longer
            by[1, 2] = -turn / wheelbase
            by[2, 2] = travel * (1.0 + tangent**2) / longer
            by[3, 2] = by[2, 2] * steer
            if self.slips:
                by[4, 2] = -turn * square / (1.0 + np.abs(understeer * square))
                by[:, 1] = -side_slip * square * by[:, 2]
                by[5, 1] = -square * turn
            return by

        return Motion(np.stack([travel, -side_slip * square * turn, turn]), derivative)


def rear_shaft(radius_m: float, wheelbase_m: float, steps: Steps, least_mps2: float = SLIPS_MPS2) -> RearShaft:
    """Return the nominal drive; slip is estimated where fast turns show it."""
    speed_mps, steer_rad = np.asarray(steps.speed_mps), np.asarray(steps.steer_rad)
    turn = np.abs(steps.turned_rad[0] * np.tan(steer_rad))
    fast = np.square(speed_mps) * np.abs(np.tan(steer_rad)) > least_mps2 * wheelbase_m
    return RearShaft(radius_m, wheelbase_m, bool(turn[fast].sum() > (1.0 - OFTEN) * turn.sum()))


#: has its parameters with their nominal values, and the motion of the body at values of these, shape (n_parameters,)
Drive = Differential | FrontWheel | Mecanum | RearShaft


#: half turn of a step below which the derivative of sin(h)/h is its series; of all steps, where five terms are exact
SMALL_RAD, SHORT_RAD = 1e-4, 0.1


def _bend_of_chord(half: FloatArray) -> FloatArray:
    # derivative of sin(h)/h
    if np.abs(half).max(initial=0.0) >= SHORT_RAD:
        near = np.abs(half) < SMALL_RAD
        return np.where(near, -half / 3.0, (np.cos(half) - np.sinc(half / np.pi)) / np.where(near, 1.0, half))
    total, square = np.ones_like(half), half * half
    for divisor in (88.0, 54.0, 28.0, 10.0):
        total *= square
        total *= -1.0 / divisor
        total += 1.0
    return -half / 3.0 * total


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Poses at the samples; runs continue one another."""

    #: x and y in m, heading in rad, shape (3, n_samples)
    pose: FloatArray
    #: its steps
    motion: Motion
    #: cosine and sine of the heading in the middle of each step, shape (2, n_samples)
    middle: FloatArray

    def by_parameter(self, at: IntArray) -> FloatArray:
        """Return derivatives of the poses `at` samples, ascending, shape (n_parameters, 3, len(at))."""
        (x, y, _), (forward, left, turn) = self.pose, self.motion.body
        cosine, sine = self.middle
        along_x, along_y = forward * cosine - left * sine, forward * sine + left * cosine
        ratio, bend = np.sinc(0.5 * turn / np.pi), 0.5 * _bend_of_chord(0.5 * turn)
        # by parts, from the end: a turn takes all later chords along
        half_ratio = 0.5 * ratio
        by_turn_x, by_turn_y = bend * along_x - half_ratio * along_y + y, bend * along_y + half_ratio * along_x - x
        cosine, sine = ratio * cosine, ratio * sine
        first = np.append(0, at[:-1] + 1)

        def until(values: FloatArray) -> FloatArray:
            return np.cumsum(np.add.reduceat(values[: at[-1] + 1], first))

        by_motion = self.motion.by_parameter()
        by_parameter = np.empty((len(by_motion), 3, len(at)))
        for (d_forward, d_left, d_turn), (d_x, d_y, d_theta) in zip(by_motion, by_parameter, strict=True):
            step_x, step_y = by_turn_x * d_turn + cosine * d_forward, by_turn_y * d_turn + sine * d_forward
            if d_left.any():
                step_x, step_y = step_x - sine * d_left, step_y + cosine * d_left
            d_theta[:] = until(d_turn)
            d_x[:], d_y[:] = until(step_x) - y[at] * d_theta, until(step_y) + x[at] * d_theta
        return by_parameter


def integrate_motion(motion: Motion) -> Path:
    """Integrate steps of constant twist: each is the chord of its arc, at the heading in its middle."""
    forward, left, turn = motion.body
    half, theta = 0.5 * turn, np.cumsum(turn)
    middle = theta - half
    cosine, sine, ratio = np.cos(middle), np.sin(middle), np.sinc(half / np.pi)
    x, y = (forward * cosine - left * sine) * ratio, (forward * sine + left * cosine) * ratio
    return Path(np.stack([np.cumsum(x), np.cumsum(y), theta]), motion, np.stack([cosine, sine]))


def moved_between(pose: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return displacements from poses `first` to poses `last` in the frames of the former, shape (n, 3)."""
    return in_frame(pose[:, last] - pose[:, first], pose[2, first])
