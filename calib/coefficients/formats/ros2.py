"""The coefficients as ROS 2 controller parameters: one YAML a load point.

The controllers read their geometry once, so a file holds for one load; it is an overlay of the vehicle's own parameter
file, which names the joints. A controller is a name in `CONTROLLERS` and a branch of ``ros2.yaml.j2``.

They hold constant diagonals of the covariance. Pose: after `PATH_M` straight ahead and `TURN_RAD` of turning, the
mean of left and right turns. An error of the mean radius stretches the path; one that turns the vehicle steadily (the
radii's difference, a steering zero) bends it: heading L, across L^2 / 2. A random walk of heading with variance h^2 a
metre adds L h^2 to heading and L^3 h^2 / 3 across. Each encoder is read once at either end; the quantisation of the
first reading turns all that follows. Twist: at `SPEED_MPS` and `TURN_RATE_RADPS`, taken over `WINDOW_S`.
"""

from __future__ import annotations

import math
import re
import sys
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.coefficients import formats
from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import Artifact, LoadPair, default_loads, left_out_lines, radii_m, rendered, within_N
from calib.errors import BadInputError, RefusedError
from calib.kinematics.drives import STEERING_SCALE
from calib.types import FloatArray

#: parameters that are the track, or make it
TRACKS: Final = ("track_m", "half_length_plus_half_width_m")
_MECANUM: Final = "mecanum_drive_controller"
CONTROLLERS: Final = (
    "diff_drive_controller", "tricycle_controller", "tricycle_steering_controller", _MECANUM,
    "bicycle_steering_controller", "ackermann_steering_controller",
)  # fmt: skip
#: drive -> its controllers. A tricycle's free rear wheels are read as a differential drive's; which of the two
#: tricycle controllers applies depends on which wheels have the motors
OF_DRIVE: Final[dict[str, tuple[str, ...]]] = {
    "tricycle": ("diff_drive_controller", "tricycle_controller", "tricycle_steering_controller"),
    "differential": ("diff_drive_controller",),
    "mecanum": (_MECANUM,),
    "ackermann": ("bicycle_steering_controller", "ackermann_steering_controller"),
    "skid": ("diff_drive_controller",),
}
#: where the front wheel alone drives the odometry, rear wheels were not measured
OF_FRONT: Final = ("tricycle_controller",)


def render(file: CoefficientFile, options: formats.ExportOptions) -> tuple[Artifact, ...]:
    """Return one YAML a load point, with the controllers of the vehicle's drive or those chosen."""
    together = file.joint_geometry
    steered = together is not None and together.source == "front"
    controllers = options.controllers or (OF_FRONT if steered else OF_DRIVE[file.geometry.drive])
    unknown = [name for name in controllers if name not in CONTROLLERS]
    if unknown:
        found = f"controller: found {unknown[0]!r}"
        raise BadInputError(f"{found}; expected one of {', '.join(CONTROLLERS)}; choose one of them")
    values = {
        "file": file,
        "options": options,
        "controllers": controllers,
        "calibrated": together is not None and any(entry.first in TRACKS for entry in together.covariance),
        "known": file.together,
        "left_out": left_out_lines(file, "file"),
        "at": sys.modules[__name__],
    }
    artifacts: dict[str, Artifact] = {}
    for pair in options.loads or default_loads(file):
        left, right = radii_m(file, pair)
        if _MECANUM in controllers and (options.open_loop or not options.position_feedback):
            raise RefusedError(
                f"{_MECANUM}: found open_loop or position_feedback chosen; expected neither, since this "
                "controller has no such parameter; leave them out"
            )
        data = rendered("ros2.yaml.j2", pair=pair, left=left, right=right, used=within_N(file, pair), **values)
        artifacts.setdefault(_name(pair), Artifact(_name(pair), data))
    return tuple(artifacts.values())


def _name(pair: LoadPair) -> str:
    text = f"{pair.left_N:.6g}N" if pair.left_N == pair.right_N else f"L{pair.left_N:.6g}N_R{pair.right_N:.6g}N"
    return f"controllers_{re.sub('[^0-9A-Za-z_.]', '_', text)}.yaml"


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


@dataclass(frozen=True, slots=True)
class Diagonals:
    """Variances of x, y, z, roll, pitch and yaw."""

    #: in m^2 and rad^2, and in (m/s)^2 and (rad/s)^2
    pose: tuple[float, ...]
    twist: tuple[float, ...]
    #: parameters that were not calibrated: their uncertainty is assumed
    assumed: tuple[str, ...] = ()


def rear_diagonals(file: CoefficientFile, pair: LoadPair) -> Diagonals:
    """Return the diagonals of odometry from two wheels on an axle at a load point, or the nearest valid one."""
    law, track = file.law, file.vehicle.track.value
    loads = within_N(file, pair)
    radius = np.array([float(law.left.radius_m(loads[0])), float(law.right.radius_m(loads[1]))])
    left, right = 1.0 / radius
    # change of path per metre, of heading per metre, and of heading per radian, by radii and track
    path = [0.5 * left, 0.5 * right]
    rates = np.array([[*path, 0.0], [-left / track, right / track, 0.0], [*path, -1.0 / track]])
    per_rev = np.array(list(file.encoder.si("counts_per_rev_left", "counts_per_rev_right").values()))
    count = (2.0 * math.pi * radius / per_rev * file.noise.count_std.value) ** 2
    reading = (0.25 * float(count.sum()), float(count.sum()) / track**2)
    return _diagonals(file, rates, law.covariance_at(loads, file.vehicle.track_std.value), reading)


def steered_diagonals(file: CoefficientFile, pair: LoadPair, *, traction: str) -> Diagonals:
    """Return the diagonals of odometry from the steering, assumed where the geometry lacks it, and traction wheels.

    `traction` ({"front", "rear", "shaft"}): what turning is measured: front wheel, rear wheels, or drive shaft behind.
    """
    shaft = traction == "shaft"
    names = ("rear_radius_m" if shaft else "front_radius_m", "wheelbase_m", "steering_zero_rad", STEERING_SCALE)
    wheelbase = file.vehicle.wheelbase.value
    front = file.wheels.left.radius_ref.value if shaft else file.geometry.front_radius_m
    usual = (LENGTH_STD * front, LENGTH_STD * wheelbase, STEERING_ZERO_STD_RAD, STEERING_SCALE_STD)
    covariance, assumed = _known(file, names, usual)
    travel = 0.0 if traction == "rear" else 1.0 / front
    # turn in proportion to tan(angle) behind, to sin(angle) of the front wheel's own way
    by_angle = (math.tan(STEERING_RAD) + 1.0 / math.tan(STEERING_RAD)) if shaft else 1.0 / math.tan(STEERING_RAD)
    if traction == "rear":
        assumed = tuple(name for name in assumed if name != names[0])
    rates = np.array(
        [
            [travel, 0.0, 0.0, 0.0],
            [0.0, 0.0, 1.0 / wheelbase, 0.0],
            [travel, -1.0 / wheelbase, by_angle, STEERING_RAD * by_angle],
        ]
    )
    steered = _diagonals(file, rates, covariance)
    if traction != "rear":
        return replace(steered, assumed=assumed)
    rear = rear_diagonals(file, pair)
    return Diagonals((rear.pose[0], *steered.pose[1:]), (rear.twist[0], *steered.twist[1:]), assumed)


def mecanum_diagonals(file: CoefficientFile) -> Diagonals:
    """Return the diagonals of odometry from four wheels with rollers."""
    arm, radius = 0.5 * file.vehicle.track.value, file.wheels.left.radius_ref.value
    names = ("wheel_radius_m", "half_length_plus_half_width_m")
    covariance, assumed = _known(file, names, (LENGTH_STD * radius, LENGTH_STD * arm))
    rates = np.array([[1.0 / radius, 0.0], [0.0, 0.0], [1.0 / radius, -1.0 / arm]])
    return replace(_diagonals(file, rates, covariance), assumed=assumed)


def _diagonals(
    file: CoefficientFile, rates: FloatArray, covariance: FloatArray, reading: tuple[float, float] = (0.0, 0.0)
) -> Diagonals:
    """Return the diagonals from the change of path and heading by each parameter; see the head of this file.

    `reading`: variances of path in m^2 and heading in rad^2 by reading each encoder once.
    """
    of_path, of_heading = reading
    stretch, bend, turn = (float(variance) for variance in np.einsum("ij,jk,ik->i", rates, covariance, rates))
    along, heading = file.noise.along.value**2, file.noise.heading.value**2
    pose = (
        PATH_M**2 * stretch + PATH_M * along + 2.0 * of_path,
        0.25 * PATH_M**4 * bend + PATH_M**3 / 3.0 * heading + PATH_M**2 * of_heading,
        *UNSEEN,
        PATH_M**2 * bend + TURN_RAD**2 * turn + PATH_M * heading + 2.0 * of_heading,
    )
    walked = SPEED_MPS / WINDOW_S
    twist = (
        SPEED_MPS**2 * stretch + walked * along + 2.0 * of_path / WINDOW_S**2,
        # lateral speed is taken as zero, its random walk as that of the path
        walked * along,
        *UNSEEN,
        SPEED_MPS**2 * bend + TURN_RATE_RADPS**2 * turn + walked * heading + 2.0 * of_heading / WINDOW_S**2,
    )
    return Diagonals(pose, twist)


def _known(
    file: CoefficientFile, names: tuple[str, ...], assumed_std: tuple[float, ...]
) -> tuple[FloatArray, tuple[str, ...]]:
    covariance = np.diag(np.square(assumed_std))
    together = file.joint_geometry
    entries = [] if together is None else [e for e in together.covariance if e.first in names and e.second in names]
    determined = {entry.first for entry in entries if entry.first == entry.second}
    for entry in entries:
        row, column = names.index(entry.first), names.index(entry.second)
        covariance[row, column] = covariance[column, row] = entry.covariance.value
    return covariance, tuple(name for name in names if name not in determined)
