"""The coefficients as ROS 2 controller parameters: one YAML a load point.

The controllers read their geometry once, when they are configured, so a file holds for one load. Each is an overlay:
give it after the vehicle's own parameter file, which names the joints. A controller is one function and one line in
`CONTROLLERS`.

The controllers hold the diagonals of the odometry's covariance constant. Pose: after `PATH_M` straight ahead and
`TURN_RAD` of turning, the mean of left and right turns. An error of the mean radius stretches the path; one that turns
the vehicle steadily (the radii's difference, a steering zero) bends it: heading L, across L^2 / 2. A random walk of
heading with variance h^2 a metre adds L h^2 to heading and L^3 h^2 / 3 across. Each encoder is read once at either end;
the quantisation of the first reading turns all that follows. Twist: at `SPEED_MPS` and `TURN_RATE_RADPS`, taken over
`WINDOW_S`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import (
    Artifact,
    ExportOptions,
    LoadPair,
    accepted_lines,
    ascii_line,
    default_loads,
    number,
)
from calib.errors import BadInputError, RefusedError
from calib.kinematics.drives import STEERING_SCALE
from calib.radius.law import WheelLaw
from calib.types import FloatArray

#: of a controller's parameters in the YAML
INDENT: Final = " " * 4
#: path and turning after which the variances of the pose are stated: an aisle and the corner at its end
PATH_M: Final = 10.0
TURN_RAD: Final = math.pi / 2.0
#: motion at which the variances of the twist are stated, and the window: ten samples at 100 Hz, the controllers' own
SPEED_MPS: Final = 1.0
TURN_RATE_RADPS: Final = 1.0
WINDOW_S: Final = 0.1
#: variances of height, roll and pitch, which odometry in the plane does not measure
UNSEEN: Final = (1e6, 1e6, 1e6)
#: standard uncertainties where nothing was calibrated: a length (relative), the steering's zero (one degree), its scale
LENGTH_STD: Final = 0.01
STEERING_ZERO_STD_RAD: Final = math.radians(1.0)
STEERING_SCALE_STD: Final = 0.01
#: steering angle of the turns
STEERING_RAD: Final = math.pi / 4.0
#: parameters that are the track, or make it
TRACKS: Final = ("track_m", "half_length_plus_half_width_m")


def render(file: CoefficientFile, options: ExportOptions) -> tuple[Artifact, ...]:
    """Return one YAML a load point, with the controllers of the vehicle's drive or those chosen.

    Raises BadInputError where there is no such controller; RefusedError where a load lies outside the valid range and
    the file says refuse.
    """
    together = file.joint_geometry
    steered = together is not None and together.source == "front"
    controllers = options.controllers or (OF_FRONT if steered else OF_DRIVE[file.geometry.drive])
    unknown = [name for name in controllers if name not in CONTROLLERS]
    if unknown:
        raise BadInputError(
            f"controller: found {unknown[0]!r}; expected one of {', '.join(CONTROLLERS)}; choose one of them"
        )
    artifacts: dict[str, Artifact] = {}
    for pair in options.loads or default_loads(file):
        lines = _head(file, pair)
        for name in controllers:
            parameters = CONTROLLERS[name](file, pair, options)
            lines += [f"{name}:", "  ros__parameters:", *(INDENT + line for line in parameters)]
        artifact = Artifact(_name(pair), "".join(f"{line}\n" for line in lines).encode())
        artifacts.setdefault(artifact.name, artifact)
    return tuple(artifacts.values())


def _name(pair: LoadPair) -> str:
    text = f"{pair.left_N:.6g}N" if pair.left_N == pair.right_N else f"L{pair.left_N:.6g}N_R{pair.right_N:.6g}N"
    return f"controllers_{re.sub('[^0-9A-Za-z_.]', '_', text)}.yaml"


def _head(file: CoefficientFile, pair: LoadPair) -> list[str]:
    """Return the comments: the load first, then where the numbers come from and what they leave out."""
    left, right = (float(radius) for radius in file.radius_m(pair.left_N, pair.right_N))
    wheels = ((file.law.left, pair.left_N), (file.law.right, pair.right_N))
    used = [min(max(load, law.load_min_N), law.load_max_N) for law, load in wheels]
    std_left, std_right = (float(law.mean_std_m(load)) for (law, _), load in zip(wheels, used, strict=True))
    lines = [
        f"# load point: left {pair.left_N:.3f} N, right {pair.right_N:.3f} N"
        + (f" ({ascii_line(pair.name)})" if pair.name else ""),
    ]
    if file.law.left.slope_m_per_N == 0.0 and file.law.right.slope_m_per_N == 0.0:
        lines.append("# The radii do not follow the load: no other loads were driven.")
    else:
        lines += [
            "# The controllers read the geometry once, when configured: these numbers hold for this load alone.",
            "# For a load that changes while driving use the load law itself (calib export --to c or json).",
        ]
    lines += [
        f"# campaign: {ascii_line(file.name)}; created: {file.created or 'no date given'}",
        f"# coefficient file: {file.checksum}",
    ]
    if file.simulated:
        lines.append("# SIMULATED DATA: a program made the measurements behind these numbers")
    if used != [pair.left_N, pair.right_N]:
        lines.append("# CLAMPED: this load was not measured; the radius is that at the nearest measured load")
    lines += [
        f"# NOT in this file: effect {ascii_line(effect.effect)} of the simulator's model" for effect in file.effects
    ]
    return [
        *lines,
        *(f"# {line}" for line in accepted_lines(file)),
        f"# effective radii: left {left:.9f} m, right {right:.9f} m; standard uncertainty of the law: "
        f"{std_left:.2g} m and {std_right:.2g} m",
        "# Overlay: pass it after the parameter file that names joints and limits. If a controller was loaded under",
        "# another name, rename its root key.",
    ]


def _diff_drive(file: CoefficientFile, pair: LoadPair, options: ExportOptions) -> list[str]:
    """Two wheels on an axle, each with its own radius."""
    left, right = (float(radius) for radius in file.radius_m(pair.left_N, pair.right_N))
    nominal = file.vehicle.wheel_radius.value
    return [
        _separation(file),
        f"wheel_separation: {number(file.vehicle.track.value)}",
        f"wheel_radius: {number(nominal)}",
        "wheel_separation_multiplier: 1.0",
        f"left_wheel_radius_multiplier: {number(left / nominal)}",
        f"right_wheel_radius_multiplier: {number(right / nominal)}",
        *_feedback(file, options),
        f"open_loop: {str(options.open_loop).lower()}",
        *_variances(rear_diagonals(file, pair)),
    ]


def _tricycle(file: CoefficientFile, pair: LoadPair, options: ExportOptions) -> list[str]:
    """Drive and steer the front wheel; the controller has no multipliers and reads the traction joint's velocity."""
    return [
        *_front(file),
        f"wheelbase: {number(file.vehicle.wheelbase.value)}",
        f"open_loop: {str(options.open_loop).lower()}",
        *_variances(steered_diagonals(file, pair, traction="front")),
    ]


def _tricycle_steering(file: CoefficientFile, pair: LoadPair, options: ExportOptions) -> list[str]:
    """Two rear wheels that drive, a front wheel that steers."""
    left, right = (float(radius) for radius in file.radius_m(pair.left_N, pair.right_N))
    return [
        f"# one radius for both rear wheels, their mean: the ratio right/left of {right / left:.9f} is lost here",
        f"traction_wheels_radius: {number(0.5 * (left + right))}",
        _separation(file),
        f"traction_track_width: {number(file.vehicle.track.value)}",
        f"wheelbase: {number(file.vehicle.wheelbase.value)}",
        *_feedback(file, options),
        f"open_loop: {str(options.open_loop).lower()}",
        *_variances(steered_diagonals(file, pair, traction="rear")),
    ]


def _mecanum(file: CoefficientFile, pair: LoadPair, options: ExportOptions) -> list[str]:
    """Four wheels with rollers, one radius; the controller knows neither multipliers nor open loop."""
    left, right = (float(radius) for radius in file.radius_m(pair.left_N, pair.right_N))
    if options.open_loop or not options.position_feedback:
        raise RefusedError(
            "mecanum_drive_controller: found open_loop or position_feedback chosen; expected neither, since this "
            "controller has no such parameter; leave them out"
        )
    return [
        "kinematics:",
        f"  wheels_radius: {number(0.5 * (left + right))}",
        f"  {_separation(file)}",
        f"  sum_of_robot_center_projection_on_X_Y_axis: {number(0.5 * file.vehicle.track.value)}",
        *_variances(mecanum_diagonals(file)),
    ]


#: name of a controller -> the lines of its parameters
CONTROLLERS: Final[dict[str, Callable[[CoefficientFile, LoadPair, ExportOptions], list[str]]]] = {
    "diff_drive_controller": _diff_drive,
    "tricycle_controller": _tricycle,
    "tricycle_steering_controller": _tricycle_steering,
    "mecanum_drive_controller": _mecanum,
}

#: drive -> its controllers. A tricycle's free rear wheels are read as a differential drive's; which of the two
#: tricycle controllers applies depends on which wheels have the motors
OF_DRIVE: Final[dict[str, tuple[str, ...]]] = {
    "tricycle": ("diff_drive_controller", "tricycle_controller", "tricycle_steering_controller"),
    "differential": ("diff_drive_controller",),
    "mecanum": ("mecanum_drive_controller",),
}
#: where the front wheel alone drives the odometry, rear wheels were not measured
OF_FRONT: Final = ("tricycle_controller",)


def _feedback(file: CoefficientFile, options: ExportOptions) -> list[str]:
    """Return what the driver of the joints gives the controller, from which counts."""
    encoder = file.encoder
    counts = f"{encoder.counts_per_rev_left.value:g} counts a turn left, {encoder.counts_per_rev_right.value:g} right"
    bits = encoder.wrap_bits
    wrap = "" if bits is None else f"; it unwraps the counters of {bits.value:g} bits"
    what = "angles in rad" if options.position_feedback else "angular velocities in rad/s"
    return [
        f"# encoders: the driver of the joints gives {what}, {counts}{wrap}",
        f"position_feedback: {str(options.position_feedback).lower()}",
    ]


def _separation(file: CoefficientFile) -> str:
    """Return the comment on the track: calibrated or nominal."""
    together = file.joint_geometry
    if together is not None and any(entry.first in TRACKS for entry in together.covariance):
        return f"# calibrated: standard uncertainty of the track {file.vehicle.track_std.value:.2g} m"
    return (
        "# NOT calibrated: the nominal track ('calib geometry' estimates it from end poses), "
        f"taken to be within {file.vehicle.track_std.value:.2g} m"
    )


def _front(file: CoefficientFile) -> list[str]:
    """Return the front wheel's radius where it was estimated, and the steering, for which the controller has no key."""
    together = file.joint_geometry
    nominal = file.vehicle.front_wheel_radius
    if together is None or "front_radius_m" not in together.parameters:
        if nominal is not None:
            return ["# NOT calibrated: the front wheel's nominal radius", f"wheel_radius: {number(nominal.value)}"]
        return ["# wheel_radius is that of the front traction wheel, which was not stated or measured: unchanged"]
    values = together.values
    scale, zero = values[STEERING_SCALE], values["steering_zero_rad"]
    return [
        f"# true steering angle = {scale:.6f} times the reading {zero:+.6f} rad:",
        "# correct it in the driver of the steering joint, this controller has no key for it",
        f"wheel_radius: {number(values['front_radius_m'])}",
    ]


def _variances(diagonals: Diagonals) -> list[str]:
    """Return both diagonals, with what they hold for."""
    turn = f"{TURN_RAD:.4g} rad of turning"
    rate, window = f"{TURN_RATE_RADPS:g} rad/s", f"{WINDOW_S:g} s"
    lines = [
        f"# variances after {PATH_M:g} m straight and {turn}; they grow, the controller holds them",
        f"pose_covariance_diagonal: {_array(diagonals.pose)}",
        f"# variances at {SPEED_MPS:g} m/s and {rate}, over {window}",
        f"twist_covariance_diagonal: {_array(diagonals.twist)}",
    ]
    if diagonals.assumed:
        lines.insert(0, f"# uncertainty assumed, since not calibrated: {', '.join(diagonals.assumed)}")
    return lines


def _array(values: tuple[float, ...]) -> str:
    """Return an array of doubles, rounded to six digits, more than a variance is known to."""
    return f"[{', '.join(number(float(f'{value:.6g}')) for value in values)}]"


@dataclass(frozen=True, slots=True)
class Diagonals:
    """Variances of x, y, z, roll, pitch and yaw."""

    #: in m^2 and rad^2, and in (m/s)^2 and (rad/s)^2
    pose: tuple[float, ...]
    twist: tuple[float, ...]
    #: parameters that were not calibrated: their uncertainty is assumed
    assumed: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class _Reading:
    """Variances that reading each encoder once adds: to the path in m^2, to the heading in rad^2."""

    path: float = 0.0
    heading: float = 0.0


def rear_diagonals(file: CoefficientFile, pair: LoadPair) -> Diagonals:
    """Return the diagonals of odometry from two wheels on an axle, at a load point.

    `file`: laws, track and random walks; `pair`: loads of the wheels; beyond the valid range its end counts, as for the
    radius.
    """
    law, track = file.law, file.vehicle.track.value
    loads = (_within(law.left, pair.left_N), _within(law.right, pair.right_N))
    radius = np.array([float(law.left.radius_m(loads[0])), float(law.right.radius_m(loads[1]))])
    joint = np.zeros((5, 5))
    joint[:2, :2], joint[2:4, 2:4], joint[4, 4] = (
        law.left.covariance,
        law.right.covariance,
        file.vehicle.track_std.value**2,
    )
    if law.joint is not None:
        joint = law.joint
    at_load = np.zeros((3, 5))
    at_load[0, :2] = 1.0, loads[0] - law.left.reference_load_N
    at_load[1, 2:4] = 1.0, loads[1] - law.right.reference_load_N
    at_load[2, 4] = 1.0
    left, right = 1.0 / radius
    # change of path per metre, of heading per metre, and of heading per radian, by radii and track
    rates = np.array(
        [[0.5 * left, 0.5 * right, 0.0], [-left / track, right / track, 0.0], [0.5 * left, 0.5 * right, -1.0 / track]]
    )
    per_rev = np.array([file.encoder.counts_per_rev_left.value, file.encoder.counts_per_rev_right.value])
    count = (2.0 * math.pi * radius / per_rev * file.noise.count_std.value) ** 2
    reading = _Reading(path=0.25 * float(count.sum()), heading=float(count.sum()) / track**2)
    return _diagonals(file, rates, at_load @ joint @ at_load.T, reading)


def steered_diagonals(file: CoefficientFile, pair: LoadPair, *, traction: str) -> Diagonals:
    """Return the diagonals of odometry from the speed of the traction wheels and the steering angle.

    `file`: with the steering, where the geometry was estimated from the front wheel; else it is assumed; `pair`: loads
    of the rear wheels; `traction` ({"front", "rear"}): whether the front wheel's turning is measured, or that of the
    rear wheels.
    """
    names = ("front_radius_m", "wheelbase_m", "steering_zero_rad", STEERING_SCALE)
    wheelbase, front = file.vehicle.wheelbase.value, _front_radius(file)
    usual = (LENGTH_STD * front, LENGTH_STD * wheelbase, STEERING_ZERO_STD_RAD, STEERING_SCALE_STD)
    covariance, assumed = _known(file, names, usual)
    travel = 1.0 / front if traction == "front" else 0.0
    if traction == "rear":
        assumed = tuple(name for name in assumed if name != names[0])
    rates = np.array(
        [
            [travel, 0.0, 0.0, 0.0],
            [0.0, 0.0, 1.0 / wheelbase, 0.0],
            [travel, -1.0 / wheelbase, 1.0 / math.tan(STEERING_RAD), STEERING_RAD / math.tan(STEERING_RAD)],
        ]
    )
    steered = _diagonals(file, rates, covariance, _Reading())
    if traction == "front":
        return replace(steered, assumed=assumed)
    # path by the rear wheels, heading by the steering
    rear = rear_diagonals(file, pair)
    return Diagonals((rear.pose[0], *steered.pose[1:]), (rear.twist[0], *steered.twist[1:]), assumed)


def mecanum_diagonals(file: CoefficientFile) -> Diagonals:
    """Return the diagonals of odometry from four wheels with rollers."""
    arm, radius = 0.5 * file.vehicle.track.value, file.wheels.left.radius_ref.value
    names = ("wheel_radius_m", "half_length_plus_half_width_m")
    covariance, assumed = _known(file, names, (LENGTH_STD * radius, LENGTH_STD * arm))
    rates = np.array([[1.0 / radius, 0.0], [0.0, 0.0], [1.0 / radius, -1.0 / arm]])
    return replace(_diagonals(file, rates, covariance, _Reading()), assumed=assumed)


def _diagonals(file: CoefficientFile, rates: FloatArray, covariance: FloatArray, reading: _Reading) -> Diagonals:
    """Return the diagonals from the change of path and heading by each parameter; see the head of this file."""
    stretch, bend, turn = (float(variance) for variance in np.einsum("ij,jk,ik->i", rates, covariance, rates))
    along, heading = file.noise.along.value**2, file.noise.heading.value**2
    pose = (
        PATH_M**2 * stretch + PATH_M * along + 2.0 * reading.path,
        0.25 * PATH_M**4 * bend + PATH_M**3 / 3.0 * heading + PATH_M**2 * reading.heading,
        *UNSEEN,
        PATH_M**2 * bend + TURN_RAD**2 * turn + PATH_M * heading + 2.0 * reading.heading,
    )
    walked = SPEED_MPS / WINDOW_S
    twist = (
        SPEED_MPS**2 * stretch + walked * along + 2.0 * reading.path / WINDOW_S**2,
        # the odometry takes the lateral speed as zero; its random walk is taken to be that of the path
        walked * along,
        *UNSEEN,
        SPEED_MPS**2 * bend + TURN_RATE_RADPS**2 * turn + walked * heading + 2.0 * reading.heading / WINDOW_S**2,
    )
    return Diagonals(pose, twist)


def _known(
    file: CoefficientFile, names: tuple[str, ...], assumed_std: tuple[float, ...]
) -> tuple[FloatArray, tuple[str, ...]]:
    """Return the covariance of geometry parameters, assumed where not determined, and the names of those assumed."""
    covariance = np.diag(np.square(assumed_std))
    together = file.joint_geometry
    entries = [] if together is None else [e for e in together.covariance if e.first in names and e.second in names]
    determined = {entry.first for entry in entries if entry.first == entry.second}
    for entry in entries:
        row, column = names.index(entry.first), names.index(entry.second)
        covariance[row, column] = covariance[column, row] = entry.covariance.value
    return covariance, tuple(name for name in names if name not in determined)


def _front_radius(file: CoefficientFile) -> float:
    known = file.geometry.front_wheel_radius_m
    return file.vehicle.wheel_radius.value if known is None else known


def _within(law: WheelLaw, load_N: float) -> float:
    return min(max(load_N, law.load_min_N), law.load_max_N)
