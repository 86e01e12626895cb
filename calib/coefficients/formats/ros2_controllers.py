"""The parameters of each ROS 2 controller, as lines of YAML; a controller is one function and one line in its table."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import ros2_covariance as covariance
from calib.coefficients.loads import ExportOptions, LoadPair, number
from calib.errors import RefusedError
from calib.geometry.drives import STEERING_SCALE

#: parameters that are the track, or make it
TRACKS: Final = ("track_m", "half_length_plus_half_width_m")


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
        f"open_loop: {_flag(options.open_loop)}",
        *_variances(covariance.rear_diagonals(file, pair)),
    ]


def _tricycle(file: CoefficientFile, pair: LoadPair, options: ExportOptions) -> list[str]:
    """Drive and steer the front wheel; the controller has no multipliers and reads the traction joint's velocity."""
    return [
        *_front(file),
        f"wheelbase: {number(file.vehicle.wheelbase.value)}",
        f"open_loop: {_flag(options.open_loop)}",
        *_variances(covariance.steered_diagonals(file, pair, traction="front")),
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
        f"open_loop: {_flag(options.open_loop)}",
        *_variances(covariance.steered_diagonals(file, pair, traction="rear")),
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
        *_variances(covariance.mecanum_diagonals(file)),
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
#: where the front wheel alone drives the odometry, nothing was said of rear wheels
OF_FRONT: Final = ("tricycle_controller",)


def _flag(value: bool) -> str:
    return "true" if value else "false"


def _feedback(file: CoefficientFile, options: ExportOptions) -> list[str]:
    """Return what the encoders give the controller, and what the driver of the joints has to make of the counts."""
    encoder = file.encoder
    counts = f"{encoder.counts_per_rev_left.value:g} counts a turn left, {encoder.counts_per_rev_right.value:g} right"
    bits = encoder.wrap_bits
    wrap = "" if bits is None else f"; it unwraps the counters of {bits.value:g} bits"
    what = "angles in rad" if options.position_feedback else "angular velocities in rad/s"
    return [
        f"# encoders: the driver of the joints gives {what}, {counts}{wrap}",
        f"position_feedback: {_flag(options.position_feedback)}",
    ]


def _separation(file: CoefficientFile) -> str:
    """Return what is to be said of the track: calibrated or nominal."""
    together = file.joint_geometry
    if together is not None and any(entry.first in TRACKS for entry in together.covariance):
        return f"# calibrated: standard uncertainty of the track {file.vehicle.track_std.value:.2g} m"
    return (
        "# NOT calibrated: the nominal track ('calib geometry' estimates it from end poses), "
        f"taken to be within {file.vehicle.track_std.value:.2g} m"
    )


def _front(file: CoefficientFile) -> list[str]:
    """Return the front wheel's radius where it was estimated, and the steering, which the controller has no key for."""
    together = file.joint_geometry
    nominal = file.vehicle.front_wheel_radius
    if together is None or "front_radius_m" not in together.parameters:
        if nominal is not None:
            return ["# NOT calibrated: the front wheel's nominal radius", f"wheel_radius: {number(nominal.value)}"]
        return ["# wheel_radius is that of the front traction wheel, which nobody stated or measured: left as it is"]
    values = {name: quantity.value for name, quantity in together.parameters.items()}
    scale, zero = values[STEERING_SCALE], values["steering_zero_rad"]
    return [
        f"# true steering angle = {scale:.6f} times the reading {zero:+.6f} rad:",
        "# correct it in the driver of the steering joint, this controller has no key for it",
        f"wheel_radius: {number(values['front_radius_m'])}",
    ]


def _variances(diagonals: covariance.Diagonals) -> list[str]:
    """Return both diagonals, with what they hold for."""
    turn = f"{covariance.TURN_RAD:.4g} rad of turning"
    rate, window = f"{covariance.TURN_RATE_RADPS:g} rad/s", f"{covariance.WINDOW_S:g} s"
    lines = [
        f"# variances after {covariance.WAY_M:g} m straight and {turn}; they grow, the controller holds them",
        f"pose_covariance_diagonal: {_array(diagonals.pose)}",
        f"# variances at {covariance.SPEED_MPS:g} m/s and {rate}, over {window}",
        f"twist_covariance_diagonal: {_array(diagonals.twist)}",
    ]
    if diagonals.assumed:
        lines.insert(0, f"# uncertainty assumed, since not calibrated: {', '.join(diagonals.assumed)}")
    return lines


def _array(values: tuple[float, ...]) -> str:
    """Return an array of doubles, rounded to what a variance is known to and more."""
    return f"[{', '.join(number(float(f'{value:.6g}')) for value in values)}]"
