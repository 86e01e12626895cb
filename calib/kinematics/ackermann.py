"""Ackermann drive: the way counted at the rear axle or drive shaft, the steering angle, and slip in fast turns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.campaign.wheels import lengthening
from calib.kinematics.drives import (
    STEERING_SCALE,
    STEERING_SCALE_STD,
    STEERING_ZERO_STD_RAD,
    Motion,
    Parameter,
    Steps,
    length_parameter,
)
from calib.types import FloatArray

#: the curvature is tan(angle) / (L (1 + understeer v^2)): front tyres slip more than rear ones; see `lengthening`
UNDERSTEER: Final = "understeer_s2_per_m2"
#: the rear axle moves at the angle -side_slip v^2 curvature to its heading
SIDE_SLIP: Final = "side_slip_s2_per_m"
#: rubber on a smooth floor gives way by some hundredths of a radian at 1 m/s^2: 0.01 s^2/m; spreads allow for several
UNDERSTEER_STD: Final = 0.05
SIDE_SLIP_STD: Final = 0.02
#: turns below this lateral acceleration make slip angles of a few milliradians at the most: nothing to estimate
SLIPS_MPS2: Final = 0.5
#: quantile of the lateral acceleration that has to reach it: not single samples
OFTEN: Final = 0.9


@dataclass(frozen=True, slots=True)
class RearShaft:
    """A counted rear axle and steered front wheels; the true angle is scale times the sensor's, plus zero."""

    rear_radius_m: float
    wheelbase_m: float
    #: whether understeer and side slip are parameters
    slips: bool = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Rear radius, wheelbase, zero and scale of the steering angle; in fast turns understeer and side slip."""
        rigid = (
            length_parameter("rear_radius_m", self.rear_radius_m),
            length_parameter("wheelbase_m", self.wheelbase_m),
            Parameter("steering_zero_rad", 0.0, STEERING_ZERO_STD_RAD),
            Parameter(STEERING_SCALE, 1.0, STEERING_SCALE_STD),
        )
        if not self.slips:
            return rigid
        return (*rigid, Parameter(UNDERSTEER, 0.0, UNDERSTEER_STD), Parameter(SIDE_SLIP, 0.0, SIDE_SLIP_STD))

    def motion(self, values: FloatArray, steps: Steps) -> Motion:
        """Return the motion of the rear axle's middle: ahead what the wheels roll, its curvature tan(angle) / L."""
        if steps.steer_rad is None or steps.speed_mps is None:
            raise ValueError("an Ackermann drive needs its steering angle and speed in every step")
        radius, wheelbase, zero, scale = values[:4]
        understeer, side_slip = values[4:] if self.slips else (0.0, 0.0)
        phi, square = steps.turned_rad[0], steps.speed_mps**2
        tangent = np.tan(scale * steps.steer_rad + zero)
        travel = radius * phi
        longer = wheelbase * lengthening(understeer * square)
        turn = travel * tangent / longer
        derivative = np.zeros((len(values), 3, len(travel)))
        derivative[0, 0], derivative[0, 2] = phi, phi * tangent / longer
        derivative[1, 2] = -turn / wheelbase
        derivative[2, 2] = travel * (1.0 + tangent**2) / longer
        derivative[3, 2] = derivative[2, 2] * steps.steer_rad
        if self.slips:
            over = understeer * square
            by_over = np.where(over >= 0.0, 1.0 / (1.0 + np.abs(over)), 1.0 / (1.0 - np.minimum(over, 0.0)))
            derivative[4, 2] = -turn * square * by_over
            derivative[:, 1] = -side_slip * square * derivative[:, 2]
            derivative[5, 1] = -square * turn
        return Motion(np.stack([travel, -side_slip * square * turn, turn]), derivative)


def rear_shaft(radius_m: float, wheelbase_m: float, steps: Steps) -> RearShaft:
    """Return the drive with its nominal values; slip is estimated where turns were fast enough to show it."""
    if steps.steer_rad is None or steps.speed_mps is None:
        return RearShaft(radius_m, wheelbase_m)
    lateral_mps2 = np.square(steps.speed_mps) * np.abs(np.tan(steps.steer_rad)) / wheelbase_m
    moving = lateral_mps2[np.abs(steps.turned_rad[0]) > 0.0]
    fast = len(moving) > 0 and float(np.quantile(moving, OFTEN)) > SLIPS_MPS2
    return RearShaft(radius_m, wheelbase_m, slips=fast)
