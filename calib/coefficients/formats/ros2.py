"""The coefficients as ROS 2 controller parameters: one YAML a load point.

The controllers read their geometry once, when they are configured, so a file holds for one load. Each is an overlay:
give it after the vehicle's own parameter file, which names the joints.
"""

from __future__ import annotations

import re
from typing import Final

from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats.ros2_controllers import CONTROLLERS, OF_DRIVE, OF_FRONT
from calib.coefficients.loads import Artifact, ExportOptions, LoadPair, accepted_lines, ascii_line, default_loads
from calib.errors import BadInputError

INDENT: Final = " " * 4


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
        text = "\n".join([*_head(file, pair), *_blocks(file, pair, controllers, options)])
        artifact = Artifact(_name(pair), f"{text}\n".encode())
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


def _blocks(file: CoefficientFile, pair: LoadPair, controllers: tuple[str, ...], options: ExportOptions) -> list[str]:
    return [
        line
        for name in controllers
        for line in (
            f"{name}:",
            "  ros__parameters:",
            *(INDENT + parameter for parameter in CONTROLLERS[name](file, pair, options)),
        )
    ]
