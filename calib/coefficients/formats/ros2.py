"""The coefficients as ROS 2 controller parameters: one YAML a load point.

The controllers read their geometry once, when they are configured, so a file holds for one load. Each is an overlay:
give it after the vehicle's own parameter file, which names the joints.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from calib.coefficients.file import CoefficientFile
from calib.coefficients.loads import Artifact, LoadPair, ascii_line, default_loads, number
from calib.geometry.drives import STEERING_SCALE
from calib.radius.law import RadiusLaw

__all__ = ["render"]

#: way after which the variances of the pose are stated
WAY_M: Final = 10.0
#: variances of height, roll and pitch, which odometry in the plane knows nothing of
UNSEEN: Final = (1e6, 1e6, 1e6)


def render(file: CoefficientFile, loads: Sequence[LoadPair]) -> tuple[Artifact, ...]:
    """Return one YAML a load point.

    Raises
    ------
    RefusedError
        Where a load lies outside the valid range and the file says refuse.
    """
    artifacts: dict[str, Artifact] = {}
    for pair in loads or default_loads(file):
        artifact = _one(file, pair)
        artifacts.setdefault(artifact.name, artifact)
    return tuple(artifacts.values())


def _one(file: CoefficientFile, pair: LoadPair) -> Artifact:
    left, right = (float(radius) for radius in file.radius_m(pair.left_N, pair.right_N))
    law, nominal, track = file.law, file.vehicle.wheel_radius.value, number(file.vehicle.track.value)
    clamped = any(
        not wheel.load_min_N <= load <= wheel.load_max_N
        for wheel, load in ((law.left, pair.left_N), (law.right, pair.right_N))
    )
    lines = [
        f"# load point: left {pair.left_N:.3f} N, right {pair.right_N:.3f} N"
        + (f" ({ascii_line(pair.name)})" if pair.name else ""),
        "# The controllers read the geometry only when they are configured: these numbers hold for this load alone.",
        "# For a load that changes while driving use the load law itself (calib export --to c or json).",
        f"# campaign: {ascii_line(file.name)}; created: {file.created or 'no date given'}",
        f"# coefficient file: {file.checksum}",
    ]
    if file.simulated:
        lines.append("# SIMULATED DATA: a program made the measurements behind these numbers")
    if clamped:
        lines.append("# CLAMPED: this load was not measured; the radius is that at the nearest measured load")
    lines += [
        f"# NOT in this file: effect {ascii_line(effect.effect)} of the simulator's model" for effect in file.effects
    ]
    lines += [
        f"# effective radii: left {left:.9f} m, right {right:.9f} m; standard uncertainty of the law: "
        f"{float(law.left.mean_std_m(pair.left_N)):.2g} m and {float(law.right.mean_std_m(pair.right_N)):.2g} m",
        "# Overlay: pass it after the parameter file that names joints and limits. If a controller was loaded under",
        "# another name, rename its root key.",
        "diff_drive_controller:",
        "  ros__parameters:",
        *_separation(file),
        f"    wheel_separation: {track}",
        f"    wheel_radius: {number(nominal)}",
        "    wheel_separation_multiplier: 1.0",
        f"    left_wheel_radius_multiplier: {number(left / nominal)}",
        f"    right_wheel_radius_multiplier: {number(right / nominal)}",
        *_covariance(file, pair),
        "tricycle_controller:",
        "  ros__parameters:",
        *_front(file),
        f"    wheelbase: {number(file.vehicle.wheelbase.value)}",
        "tricycle_steering_controller:",
        "  ros__parameters:",
        f"    # one radius for both rear wheels, their mean: the ratio right/left of {right / left:.9f} is lost here",
        f"    traction_wheels_radius: {number(0.5 * (left + right))}",
        f"    traction_track_width: {track}",
        f"    wheelbase: {number(file.vehicle.wheelbase.value)}",
    ]
    text = f"{pair.left_N:.6g}N" if pair.left_N == pair.right_N else f"L{pair.left_N:.6g}N_R{pair.right_N:.6g}N"
    name = f"controllers_{re.sub('[^0-9A-Za-z_.]', '_', text)}.yaml"
    return Artifact(name, ("\n".join(lines) + "\n").encode("utf-8"))


def _separation(file: CoefficientFile) -> list[str]:
    """Return what is to be said of the track: calibrated or nominal."""
    together = file.joint_geometry
    if together is not None and any(entry.first in _TRACKS for entry in together.covariance):
        return [f"    # calibrated: standard uncertainty {file.vehicle.track_std.value:.2g} m"]
    return ["    # NOT calibrated: the nominal track ('calib geometry' estimates it from end poses)"]


#: parameters that are the track, or make it
_TRACKS: Final = ("track_m", "half_length_plus_half_width_m")


def _front(file: CoefficientFile) -> list[str]:
    """Return the front wheel's radius where it was estimated, and the steering, which the controller has no key for."""
    together = file.joint_geometry
    if together is None or "front_radius_m" not in together.parameters:
        text = "wheel_radius is that of the front traction wheel, which this campaign does not measure: left as it is"
        return [f"    # {text}"]
    values = {name: quantity.value for name, quantity in together.parameters.items()}
    scale, zero = values[STEERING_SCALE], values["steering_zero_rad"]
    return [
        f"    # true steering angle = {scale:.6f} times the reading {zero:+.6f} rad:",
        "    # correct it in the driver of the steering joint, this controller has no key for it",
        f"    wheel_radius: {number(values['front_radius_m'])}",
    ]


def _covariance(file: CoefficientFile, pair: LoadPair) -> list[str]:
    """Return the diagonals of the odometry's covariance, from the laws, the track and the random walks.

    On a straight of `WAY_M`: an error of the mean radius stretches it, one of the radii's difference turns it steadily,
    a random walk of heading adds a third of its cube across.
    """
    law, track = file.law, file.vehicle.track.value
    left, right = (float(side.mean_std_m(load)) for side, load in ((law.left, pair.left_N), (law.right, pair.right_N)))
    cross = _cross(law, pair)
    radius = 0.5 * (float(law.left.radius_m(pair.left_N)) + float(law.right.radius_m(pair.right_N)))
    along, heading = file.noise.along.value**2, file.noise.heading.value**2
    stretch = 0.25 * (left**2 + right**2 + 2.0 * cross) / radius**2
    bend = max(left**2 + right**2 - 2.0 * cross, 0.0) / (radius * track) ** 2
    x = WAY_M**2 * stretch + WAY_M * along
    yaw = WAY_M**2 * bend + WAY_M * heading
    y = 0.25 * WAY_M**4 * bend + WAY_M**3 / 3.0 * heading
    return [
        f"    # variances after {WAY_M:g} m straight ahead; they grow with the way, the controller holds them constant",
        f"    pose_covariance_diagonal: [{', '.join(number(value) for value in (x, y, *UNSEEN, yaw))}]",
        "    # variances at 1 m/s over one second, straight ahead",
        "    twist_covariance_diagonal: "
        f"[{', '.join(number(value) for value in (stretch + along, along, *UNSEEN, bend + heading))}]",
    ]


def _cross(law: RadiusLaw, pair: LoadPair) -> float:
    """Return the covariance of the left and the right radius at a load point."""
    if law.joint is None:
        return 0.0
    at_left = (1.0, pair.left_N - law.left.reference_load_N)
    at_right = (1.0, pair.right_N - law.right.reference_load_N)
    return sum(
        one * other * float(law.joint[row, 2 + column])
        for row, one in enumerate(at_left)
        for column, other in enumerate(at_right)
    )
