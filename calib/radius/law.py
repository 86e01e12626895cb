"""The radius law of a wheel: effective radius against load, with its covariance and valid range."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray

#: order of the joint covariance of both wheels' laws and the track
JOINT: Final = ("radius_left_m", "slope_left_m_per_N", "radius_right_m", "slope_right_m_per_N", "track_m")


@dataclass(frozen=True, slots=True, eq=False)
class WheelLaw:
    """Linear law of one wheel, r_e(F) = radius_ref + slope (F - reference_load).

    The sign of the slope is data: bonded solid rubber can do either.
    """

    #: load on which the coefficients are centred
    reference_load_N: float
    #: effective radius at the reference load
    radius_ref_m: float
    #: change of the radius with load; 0 in a reduced model
    slope_m_per_N: float
    #: covariance of (radius_ref_m, slope_m_per_N), shape (2, 2)
    covariance: FloatArray
    #: degrees of freedom of that covariance
    dof: float
    #: standard deviation of a single run about the law
    residual_std_m: float
    #: loads that were measured; outside them the law extrapolates
    load_min_N: float
    load_max_N: float
    #: runs behind it
    n_runs: int

    def radius_m(self, load_N: npt.ArrayLike) -> FloatArray:
        """Return the effective radius at `load_N` (any shape), same shape, in m."""
        offset = np.asarray(load_N, dtype=np.float64) - self.reference_load_N
        return np.asarray(self.radius_ref_m + self.slope_m_per_N * offset)

    def mean_std_m(self, load_N: npt.ArrayLike) -> FloatArray:
        """Return the standard uncertainty of the mean radius at `load_N` (any shape), same shape, in m."""
        offset = np.asarray(load_N, dtype=np.float64) - self.reference_load_N
        variance = self.covariance[0, 0] + 2 * offset * self.covariance[0, 1] + offset**2 * self.covariance[1, 1]
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def prediction_std_m(self, load_N: npt.ArrayLike) -> FloatArray:
        """Return the standard uncertainty of a single run's radius at `load_N` (any shape), same shape, in m."""
        return np.asarray(np.hypot(self.mean_std_m(load_N), self.residual_std_m))


@dataclass(frozen=True, slots=True, eq=False)
class RadiusLaw:
    """The laws of both rear wheels."""

    left: WheelLaw
    right: WheelLaw
    #: covariance of `JOINT`, where wheels and track were fitted together; None: the wheels are independent, shape (5,
    #: 5)
    joint: FloatArray | None = None
