"""The coefficients as ROS 2 controller parameters: one YAML a load point.

The controllers read their geometry once, when they are configured, so a file holds for one load. Each is an overlay:
give it after the vehicle's own parameter file, which names the joints. A controller is a name in `CONTROLLERS` and a
branch of ``ros2.yaml.j2``.
"""

from __future__ import annotations

import re
from typing import Final

from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import (
    Artifact,
    ExportOptions,
    LoadPair,
    default_loads,
    left_out_lines,
    radii_m,
    rendered,
    ros2_variances,
    within_N,
)
from calib.errors import BadInputError, RefusedError

#: parameters that are the track, or make it
TRACKS: Final = ("track_m", "half_length_plus_half_width_m")
_MECANUM: Final = "mecanum_drive_controller"
CONTROLLERS: Final = (
    "diff_drive_controller",
    "tricycle_controller",
    "tricycle_steering_controller",
    _MECANUM,
    "bicycle_steering_controller",
    "ackermann_steering_controller",
)
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


def render(file: CoefficientFile, options: ExportOptions) -> tuple[Artifact, ...]:
    """Return one YAML a load point, with the controllers of the vehicle's drive or those chosen.

    Raises BadInputError where there is no such controller; RefusedError where a load lies outside the valid range and
    the file says refuse, or a controller has no parameter for what is chosen.
    """
    together = file.joint_geometry
    steered = together is not None and together.source == "front"
    controllers = options.controllers or (OF_FRONT if steered else OF_DRIVE[file.geometry.drive])
    unknown = [name for name in controllers if name not in CONTROLLERS]
    if unknown:
        raise BadInputError(
            f"controller: found {unknown[0]!r}; expected one of {', '.join(CONTROLLERS)}; choose one of them"
        )
    values = {
        "file": file,
        "options": options,
        "controllers": controllers,
        "calibrated": together is not None and any(entry.first in TRACKS for entry in together.covariance),
        "known": file.together,
        "left_out": left_out_lines(file, "file"),
        "at": ros2_variances,
    }
    artifacts: dict[str, Artifact] = {}
    for pair in options.loads or default_loads(file):
        left, right = radii_m(file, pair)
        if _MECANUM in controllers and (options.open_loop or not options.position_feedback):
            raise RefusedError(
                f"{_MECANUM}: found open_loop or position_feedback chosen; expected neither, since this "
                "controller has no such parameter; leave them out"
            )
        used = within_N(file, pair)
        data = rendered("ros2.yaml.j2", pair=pair, left=left, right=right, used=used, **values)
        artifacts.setdefault(_name(pair), Artifact(_name(pair), data))
    return tuple(artifacts.values())


def _name(pair: LoadPair) -> str:
    text = f"{pair.left_N:.6g}N" if pair.left_N == pair.right_N else f"L{pair.left_N:.6g}N_R{pair.right_N:.6g}N"
    return f"controllers_{re.sub('[^0-9A-Za-z_.]', '_', text)}.yaml"
