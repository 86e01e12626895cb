"""The pieces of a geometry's result: a parameter, a route, a recording left out, a path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from calib.arrays import FloatArray

#: residual channels and their units
CHANNELS: Final = ("x_m", "y_m", "theta_rad")


@dataclass(frozen=True, slots=True)
class Estimate:
    """One parameter: nominal value, estimate, sd, 95 % interval, degrees of freedom of what runs say."""

    name: str
    nominal: float
    value: float
    std: float
    ci95: tuple[float, float]
    dof: float

    def to_dict(self) -> dict[str, Any]:
        """Return the estimate as plain values."""
        return {
            "value": self.value,
            "sd": self.std,
            "ci95": list(self.ci95),
            "dof": self.dof,
            "nominal": self.nominal,
        }


@dataclass(frozen=True, slots=True)
class RouteResidual:
    """Residuals of one kind of route: root mean squares before and after, and what is left on average.

    Each triple is along, across (m) and in heading (rad).
    """

    kind: str
    n: int
    before_rms: tuple[float, float, float]
    after_rms: tuple[float, float, float]
    after_mean: tuple[float, float, float]

    def to_dict(self) -> dict[str, Any]:
        """Return the row as plain values."""
        return {
            "kind": self.kind,
            "n": self.n,
            "before_rms": dict(zip(CHANNELS, self.before_rms, strict=True)),
            "after_rms": dict(zip(CHANNELS, self.after_rms, strict=True)),
            "after_mean": dict(zip(CHANNELS, self.after_mean, strict=True)),
        }


@dataclass(frozen=True, slots=True)
class Transfer:
    """End position error of runs that were left out of the estimate, before and after."""

    left_out: str
    n: int
    before_rms_m: float
    after_rms_m: float


@dataclass(frozen=True, slots=True, eq=False)
class RunPath:
    """One run: its path by nominal and calibrated odometry and by the reference, in its own start frame."""

    #: labels
    run_id: str
    kind: str
    #: x and y in m, shape (n_samples, 2)
    before: FloatArray
    after: FloatArray
    #: along the way, or the end pose alone, shape (n_poses, 2)
    reference: FloatArray
