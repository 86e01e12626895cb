"""Odometry on the vehicle: coefficient file, wheel loads and counts in; pose and covariance out.

The folder stands alone: standard library only, nothing of the rest of the package, and it may be copied to a vehicle
under any name. Example::

    odometer = Odometer.from_file("coefficients.json")
    odometer.set_payload(120.0, 0.45, 0.02)
    status = odometer.feed(counts_left, counts_right, t_s)
    pose = odometer.pose
"""

from .coefficients import CoefficientError, Coefficients, WheelCoefficients  # noqa: TID252 the folder may be renamed
from .effects import Effects, Motion, Run  # noqa: TID252
from .odometer import Odometer, OdometerFault, Pose, Status  # noqa: TID252

__all__ = [
    "CoefficientError", "Coefficients", "Effects", "Motion", "Odometer", "OdometerFault", "Pose", "Run", "Status",
    "WheelCoefficients",
]  # fmt: skip
