"""The coefficients as ROS 2 controller parameters: one YAML a load point.

The controllers read their geometry once, when they are configured, so a file holds for one load. Each is an overlay:
give it after the vehicle's own parameter file, which names the joints. A controller is one function and one line in
`CONTROLLERS`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import (
    Artifact,
    ExportOptions,
    LoadPair,
    ascii_line,
    default_loads,
    left_out_lines,
    number,
    radii_m,
    within_N,
)
from calib.coefficients.formats.ros2_variances import (
    PATH_M,
    SPEED_MPS,
    TURN_RAD,
    TURN_RATE_RADPS,
    WINDOW_S,
    Diagonals,
    mecanum_diagonals,
    rear_diagonals,
    steered_diagonals,
)
from calib.errors import BadInputError, RefusedError
from calib.kinematics.drives import STEERING_SCALE

#: of a controller's parameters in the YAML
INDENT: Final = " " * 4
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
    left, right = radii_m(file, pair)
    laws, used = (file.law.left, file.law.right), within_N(file, pair)
    std_left, std_right = (float(law.mean_std_m(load)) for law, load in zip(laws, used, strict=True))
    lines = [
        f"load point: left {pair.left_N:.3f} N, right {pair.right_N:.3f} N"
        + (f" ({ascii_line(pair.name)})" if pair.name else "")
    ]
    if any(law.slope_m_per_N for law in laws):
        lines += [
            "The controllers read the geometry once, when configured: these numbers hold for this load alone.",
            "For a load that changes while driving use the load law itself (calib export --to c or json).",
        ]
    else:
        lines.append("The radii do not follow the load: no other loads were driven.")
    lines += [
        f"campaign: {ascii_line(file.name)}; created: {file.created or 'no date given'}",
        f"coefficient file: {file.checksum}",
    ]
    if file.simulated:
        lines.append("SIMULATED DATA: a program made the measurements behind these numbers")
    if used != (pair.left_N, pair.right_N):
        lines.append("CLAMPED: this load was not measured; the radius is that at the nearest measured load")
    lines += [
        *left_out_lines(file, "file"),
        f"effective radii: left {left:.9f} m, right {right:.9f} m; standard uncertainty of the law: "
        f"{std_left:.2g} m and {std_right:.2g} m",
        "Overlay: pass it after the parameter file that names joints and limits. If a controller was loaded under",
        "another name, rename its root key.",
    ]
    return [f"# {line}" for line in lines]


def _diff_drive(file: CoefficientFile, pair: LoadPair, options: ExportOptions) -> list[str]:
    """Two wheels on an axle, each with its own radius."""
    left, right = radii_m(file, pair)
    nominal = file.vehicle.wheel_radius.value
    return [
        _separation(file),
        f"wheel_separation: {number(file.vehicle.track.value)}",
        f"wheel_radius: {number(nominal)}",
        "wheel_separation_multiplier: 1.0",
        f"left_wheel_radius_multiplier: {number(left / nominal)}",
        f"right_wheel_radius_multiplier: {number(right / nominal)}",
        *_odometry(file, options, rear_diagonals(file, pair)),
    ]


def _tricycle(file: CoefficientFile, pair: LoadPair, options: ExportOptions) -> list[str]:
    """Drive and steer the front wheel; the controller has no multipliers and reads the traction joint's velocity."""
    nominal = file.vehicle.front_wheel_radius
    if "front_radius_m" in file.together:
        radius = [*_steering_remark(file), f"wheel_radius: {number(file.together['front_radius_m'])}"]
    elif nominal is not None:
        radius = ["# NOT calibrated: the front wheel's nominal radius", f"wheel_radius: {number(nominal.value)}"]
    else:
        radius = ["# wheel_radius is that of the front traction wheel, which was not stated or measured: unchanged"]
    return [
        *radius,
        f"wheelbase: {number(file.vehicle.wheelbase.value)}",
        f"open_loop: {str(options.open_loop).lower()}",
        *_variances(steered_diagonals(file, pair, traction="front")),
    ]


def _tricycle_steering(file: CoefficientFile, pair: LoadPair, options: ExportOptions) -> list[str]:
    """Two rear wheels that drive, a front wheel that steers."""
    left, right = radii_m(file, pair)
    return [
        f"# one radius for both rear wheels, their mean: the ratio right/left of {right / left:.9f} is lost here",
        f"traction_wheels_radius: {number(0.5 * (left + right))}",
        *_steered(file, options, steered_diagonals(file, pair, traction="rear"), track=True),
    ]


def _bicycle_steering(file: CoefficientFile, pair: LoadPair, options: ExportOptions) -> list[str]:
    """One wheel behind that drives, one in front that steers: what a counted shaft and a steering angle are."""
    return [
        *_steering_remark(file),
        f"traction_wheel_radius: {number(_shaft_radius_m(file))}",
        *_steered(file, options, steered_diagonals(file, pair, traction="shaft"), track=False),
    ]


def _ackermann_steering(file: CoefficientFile, pair: LoadPair, options: ExportOptions) -> list[str]:
    """Two wheels behind that drive, two in front that steer."""
    return [
        *_steering_remark(file),
        f"traction_wheels_radius: {number(_shaft_radius_m(file))}",
        *_steered(file, options, steered_diagonals(file, pair, traction="shaft"), track=True),
    ]


def _steered(file: CoefficientFile, options: ExportOptions, diagonals: Diagonals, *, track: bool) -> list[str]:
    """Return track, wheelbase and odometry of a steering controller."""
    width = [_separation(file), f"traction_track_width: {number(file.vehicle.track.value)}"] if track else []
    wheelbase = f"wheelbase: {number(file.vehicle.wheelbase.value)}"
    return [*width, wheelbase, *_odometry(file, options, diagonals)]


def _shaft_radius_m(file: CoefficientFile) -> float:
    return file.together.get("rear_radius_m", file.wheels.left.radius_ref.value)


def _steering_remark(file: CoefficientFile) -> list[str]:
    """Return the correction of the steering angle, for which no controller has a key; nothing where none is known."""
    if STEERING_SCALE not in file.together:
        return []
    return [
        f"# true steering angle = {file.together[STEERING_SCALE]:.6f} times the reading "
        f"{file.together['steering_zero_rad']:+.6f} rad:",
        "# correct it in the driver of the steering joint, this controller has no key for it",
    ]


def _mecanum(file: CoefficientFile, pair: LoadPair, options: ExportOptions) -> list[str]:
    """Four wheels with rollers, one radius; the controller knows neither multipliers nor open loop."""
    left, right = radii_m(file, pair)
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
    "bicycle_steering_controller": _bicycle_steering,
    "ackermann_steering_controller": _ackermann_steering,
}

#: drive -> its controllers. A tricycle's free rear wheels are read as a differential drive's; which of the two
#: tricycle controllers applies depends on which wheels have the motors
OF_DRIVE: Final[dict[str, tuple[str, ...]]] = {
    "tricycle": ("diff_drive_controller", "tricycle_controller", "tricycle_steering_controller"),
    "differential": ("diff_drive_controller",),
    "mecanum": ("mecanum_drive_controller",),
    "ackermann": ("bicycle_steering_controller", "ackermann_steering_controller"),
    "skid": ("diff_drive_controller",),
}
#: where the front wheel alone drives the odometry, rear wheels were not measured
OF_FRONT: Final = ("tricycle_controller",)


def _odometry(file: CoefficientFile, options: ExportOptions, diagonals: Diagonals) -> list[str]:
    """Return what the odometry runs on, from which counts, and its variances."""
    left, right, bits = file.encoder.si().values()
    wrap = "" if bits is None else f"; it unwraps the counters of {bits:g} bits"
    what = "angles in rad" if options.position_feedback else "angular velocities in rad/s"
    return [
        f"# encoders: the driver of the joints gives {what}, {left:g} counts a turn left, {right:g} right{wrap}",
        f"position_feedback: {str(options.position_feedback).lower()}",
        f"open_loop: {str(options.open_loop).lower()}",
        *_variances(diagonals),
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


def _variances(diagonals: Diagonals) -> list[str]:
    """Return both diagonals, with what they hold for."""
    lines = [
        f"# variances after {PATH_M:g} m straight and {TURN_RAD:.4g} rad of turning; they grow, the controller holds "
        "them",
        f"pose_covariance_diagonal: {_array(diagonals.pose)}",
        f"# variances at {SPEED_MPS:g} m/s and {TURN_RATE_RADPS:g} rad/s, over {WINDOW_S:g} s",
        f"twist_covariance_diagonal: {_array(diagonals.twist)}",
    ]
    if diagonals.assumed:
        lines.insert(0, f"# uncertainty assumed, since not calibrated: {', '.join(diagonals.assumed)}")
    return lines


def _array(values: tuple[float, ...]) -> str:
    """Return an array of doubles, rounded to six digits, more than a variance is known to."""
    return f"[{', '.join(number(float(f'{value:.6g}')) for value in values)}]"
