"""The record of a vehicle: both wheels' laws from the sums of its files, and their drift."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, Final

import numpy as np

from calib.fleet.order import WheelSums, widened
from calib.radius.sessions import SessionSums, line_from_sums

WHEELS: Final = ("left", "right")
COVERAGE: Final = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class PartSums:
    """The runs of one file as sums.

    Parameters
    ----------
    name : str
        Of the file.
    key : str
        By which the file is known again.
    reference_load_N, radius_m : float
        From which loads and radii are counted; the model's reference load, the nominal radius.
    left, right : WheelSums or None
        None where `why` says what is wrong.
    why : str
        One line; empty where the file could be used.
    """

    name: str
    key: str
    reference_load_N: float
    radius_m: float
    left: WheelSums | None
    right: WheelSums | None
    why: str = ""

    @staticmethod
    def from_dict(value: Mapping[str, Any]) -> PartSums:
        """Return what was kept."""
        return PartSums(**{**value, **{side: value[side] and WheelSums.from_dict(value[side]) for side in WHEELS}})


@dataclass(frozen=True)
class Drift:
    """Change of a wheel's radius with time, from session means.

    Parameters
    ----------
    per_day_m, std_m : float
        Slope against the day, and its standard uncertainty.
    dof : float
        Degrees of freedom.
    last_day : float
        Of the latest session.
    """

    per_day_m: float
    std_m: float
    dof: float
    last_day: float


@dataclass(frozen=True)
class WheelLine:
    """A wheel's law.

    Parameters
    ----------
    radius_ref_m, slope_m_per_N : float
        Effective radius at the reference load, and its change with load.
    radius_std_m, slope_std_m_per_N : float
        Standard uncertainties.
    radius_ci95_m, slope_ci95_m_per_N : tuple of float
        95 % intervals, as `calib fit` takes them from sessions and runs.
    run_std_m : float
        Scatter of a run.
    autocorrelation : float
        Of runs that follow each other, by which the intervals are widened; 0 where none is significant.
    drift : Drift or None
        None where the sessions have no day, or are fewer than four.
    """

    radius_ref_m: float
    slope_m_per_N: float
    radius_std_m: float
    slope_std_m_per_N: float
    radius_ci95_m: tuple[float, float]
    slope_ci95_m_per_N: tuple[float, float]
    run_std_m: float
    autocorrelation: float
    drift: Drift | None


@dataclass(frozen=True)
class VehicleRecord:
    """What is known of one vehicle; `why` says in one line what went wrong where `left` and `right` are None."""

    vehicle: str
    n_runs: int
    reference_load_N: float
    left: WheelLine | None
    right: WheelLine | None
    why: str = ""

    @property
    def status(self) -> str:
        """``fitted`` or ``failed``."""
        return "failed" if self.left is None or self.right is None else "fitted"

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        values: dict[str, Any] = {"id": self.vehicle, "status": self.status, "n_runs": self.n_runs, "why": self.why}
        for side, line in zip(WHEELS, (self.left, self.right), strict=True):
            if line is None:
                continue
            values[f"radius_{side}_m"] = line.radius_ref_m
            values[f"radius_{side}_ci95_m"] = list(line.radius_ci95_m)
            values[f"slope_{side}_m_per_N"] = line.slope_m_per_N
            values[f"slope_{side}_ci95_m_per_N"] = list(line.slope_ci95_m_per_N)
            values[f"autocorrelation_{side}"] = line.autocorrelation
            values[f"drift_{side}_m_per_day"] = None if line.drift is None else line.drift.per_day_m
        return values


def record_of(vehicle: str, parts: Sequence[PartSums]) -> VehicleRecord:
    """Return a vehicle's record from the sums of its files.

    Parameters
    ----------
    vehicle : str
        Its id.
    parts : sequence of PartSums
        In the order of their names, so that the sums do not depend on who read what first.

    Returns
    -------
    VehicleRecord
        Failed where a file could not be used, files count from different origins, or the runs carry no line.
    """
    parts = sorted(parts, key=lambda part: part.name)
    wrong = next((part.why for part in parts if part.why), "" if parts else "it has no file of journeys")
    origins = {(part.reference_load_N, part.radius_m) for part in parts}
    if not wrong and len(origins) > 1:
        wrong = "its files have different reference loads or nominal radii; expected one campaign.toml for all"
    if wrong:
        return VehicleRecord(vehicle, 0, 0.0, None, None, wrong)
    reference, nominal = next(iter(origins))
    sums = [reduce(WheelSums.added, (getattr(part, side) for part in parts)) for side in WHEELS]
    n_runs = int(sums[0].runs.n_runs)
    left, right = (_line(of_side, nominal) for of_side in sums)
    if left is None or right is None:
        why = f"{n_runs} runs carry no line; expected three or more, at two loads or more"
        return VehicleRecord(vehicle, n_runs, reference, None, None, why)
    return VehicleRecord(vehicle, n_runs, reference, left, right)


def _line(sums: WheelSums, nominal_m: float) -> WheelLine | None:
    estimate = line_from_sums(sums.runs)
    if estimate is None:
        return None
    estimate, autocorrelation = widened(estimate, sums)
    radius, slope = (float(value) for value in estimate.coefficients)
    half_radius, half_slope = (float(value) for value in estimate.half_width(np.eye(2), COVERAGE))
    std = np.sqrt(np.diag(estimate.covariance))
    return WheelLine(
        radius_ref_m=nominal_m + radius,
        slope_m_per_N=slope,
        radius_std_m=float(std[0]),
        slope_std_m_per_N=float(std[1]),
        radius_ci95_m=(nominal_m + radius - half_radius, nominal_m + radius + half_radius),
        slope_ci95_m_per_N=(slope - half_slope, slope + half_slope),
        run_std_m=float(np.sqrt(estimate.run_variance)),
        autocorrelation=autocorrelation,
        drift=_drift(sums.runs, slope),
    )


def _drift(sums: SessionSums, slope: float) -> Drift | None:
    """Return the drift of session means, what the law says of their loads removed; sessions scatter freely."""
    x, y, day = sums.means.T
    if len(day) < 4 or np.ptp(day) <= 0:
        return None
    weight = 1.0 / (1.0 + 1.0 / sums.table[:, 0])
    level = y - slope * x
    day_away = day - weight @ day / weight.sum()
    info = float(weight @ day_away**2)
    rate = float(weight @ (day_away * level)) / info
    residuals = level - weight @ level / weight.sum() - rate * day_away
    dof = len(day) - 2.0
    variance = float(weight @ residuals**2) / dof / info
    return Drift(rate, float(np.sqrt(variance)), dof, float(day.max()))
