"""The coefficients as ROS 2 controller parameters: one YAML a load point.

The controllers read their geometry once, when they are configured, so a file holds for one load. Each is an overlay:
give it after the vehicle's own parameter file, which names the joints.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from calib.coefficients.file import CoefficientFile
from calib.coefficients.loads import Artifact, LoadPair, ascii_line, default_loads, number

__all__ = ["render"]


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
        f"    wheel_separation: {track}",
        f"    wheel_radius: {number(nominal)}",
        "    wheel_separation_multiplier: 1.0",
        f"    left_wheel_radius_multiplier: {number(left / nominal)}",
        f"    right_wheel_radius_multiplier: {number(right / nominal)}",
        "tricycle_controller:",
        "  ros__parameters:",
        "    # wheel_radius is that of the front traction wheel, which this campaign does not measure: left as it is",
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
