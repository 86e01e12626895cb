"""The fleet's view: how vehicles differ, which stand apart, which drift, and what many have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from calib.fleet.comparison import FEWEST_COMPARED
from calib.fleet.population import Population, any_false, difference_of, false_discovery, outlying, population
from calib.fleet.vehicle import WHEELS, VehicleRecord
from calib.result import plain_fields
from calib.types import FloatArray

#: relative change of a radius from which on a vehicle is due for recalibration: the share by which the deviation check
#: of a single radius is held (0.05 %), 5 mm over 10 m
DUE_RELATIVE: Final = 5e-4
_QUANTITIES: Final = tuple((side, kind) for side in WHEELS for kind in ("radius_ref_m", "slope_m_per_N"))


@dataclass(frozen=True, slots=True)
class Outlier:
    """A vehicle that stands apart: which wheel, which quantity, by how much."""

    vehicle: str = field(metadata={"json": "id"})
    wheel: str
    quantity: str
    value: float = field(metadata={"json": False})
    fleet_median: float = field(metadata={"json": False})
    z: float

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return plain_fields(self, why=self.why)

    @property
    def why(self) -> str:
        """What a person reads."""
        if self.quantity == "radius_ref_m":
            away = f"radius {1e3 * self.value:.3f} mm, {1e6 * (self.value - self.fleet_median):+.0f} um from the fleet"
        else:
            away = f"slope {1e9 * self.value:+.0f} nm/N, {1e9 * (self.value - self.fleet_median):+.0f} from the fleet"
        return f"{self.wheel} wheel: {away} ({abs(self.z):.1f} standard deviations)"


@dataclass(frozen=True, slots=True)
class DriftingVehicle:
    """A vehicle whose radius drifts: how fast, and the day on which it is due for recalibration.

    `per_day_m` and its 95 % half width; `due_day` counts as the journeys' days do.
    """

    vehicle: str = field(metadata={"json": "id"})
    wheel: str
    per_day_m: float
    half_width_m: float = field(metadata={"json": "half_width95_m"})
    due_day: float


@dataclass(frozen=True, slots=True)
class CommonCause:
    """What the vehicles of one label, or many of the fleet, have in common."""

    label: str
    value: str
    what: str
    n_showing: int
    n_vehicles: int
    size: float
    size_ci95: tuple[float, float]
    p_value: float

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return plain_fields(self, sentence=self.sentence)

    @property
    def sentence(self) -> str:
        """What a person reads."""
        return f"{self.n_showing} of {self.n_vehicles} vehicles with {self.label} {self.value}: {self.what}"


@dataclass(frozen=True, slots=True)
class FleetView:
    """What the fleet shows.

    Parameters
    ----------
    n_vehicles, n_fitted, n_failed : int
        Counts.
    populations : mapping of str to Population
        By quantity, for example ``slope_left_m_per_N``; without outliers and vehicles that drift, what a
        label's vehicles share taken off: it has its own line.
    outliers : tuple of Outlier
        One a vehicle: what is farthest off.
    drifting : tuple of DriftingVehicle
        Soonest due first.
    common : tuple of CommonCause
        Strongest first.
    """

    n_vehicles: int
    n_fitted: int
    n_failed: int
    populations: Mapping[str, Population]
    outliers: tuple[Outlier, ...]
    drifting: tuple[DriftingVehicle, ...]
    common: tuple[CommonCause, ...]


def view_of(records: Sequence[VehicleRecord], labels: Mapping[str, Mapping[str, str]] | None = None) -> FleetView:
    """Return the fleet's view of its vehicles.

    Parameters
    ----------
    records : sequence of VehicleRecord
        Of all vehicles.
    labels : mapping of str to mapping of str to str, optional
        For each column of ``vehicles.csv``, the label of each vehicle.

    Returns
    -------
    FleetView
    """
    fitted = sorted((record for record in records if record.status == "fitted"), key=lambda record: record.vehicle)
    values, std = _table(fitted)
    common = _common(fitted, values, labels or {})
    drifting = _drifting(fitted)
    # what drifts is named as drifting: where it has got to is not a second finding
    steady = {record.vehicle for record in fitted} - {one.vehicle for one in drifting}
    own = _without_common(fitted, values, common, labels or {})
    apart = _outliers(fitted, own, std)
    outliers = tuple(outlier for outlier in apart if outlier.vehicle in steady)
    left_out = {outlier.vehicle for outlier in apart} | {one.vehicle for one in drifting}
    keep = np.array([record.vehicle not in left_out for record in fitted], dtype=np.bool_)
    populations = {}
    for k, (side, kind) in enumerate(_QUANTITIES):
        found = population(own[keep, k], std[keep, k])
        if found is not None:
            stem, unit = kind.split("_", 1)
            populations[f"{stem}_{side}_{unit}"] = found
    return FleetView(
        n_vehicles=len(records),
        n_fitted=len(fitted),
        n_failed=len(records) - len(fitted),
        populations=populations,
        outliers=outliers,
        drifting=drifting,
        common=common,
    )


def _table(fitted: Sequence[VehicleRecord]) -> tuple[FloatArray, FloatArray]:
    """Return the quantities of each vehicle and their standard uncertainties, shape (n_vehicles, 4)."""
    values, std = np.zeros((len(fitted), len(_QUANTITIES))), np.zeros((len(fitted), len(_QUANTITIES)))
    for row, record in enumerate(fitted):
        for k, (side, kind) in enumerate(_QUANTITIES):
            line = getattr(record, side)
            values[row, k] = getattr(line, kind)
            std[row, k] = line.radius_std_m if kind == "radius_ref_m" else line.slope_std_m_per_N
    return values, std


def _outliers(fitted: Sequence[VehicleRecord], values: FloatArray, std: FloatArray) -> tuple[Outlier, ...]:
    if len(fitted) < FEWEST_COMPARED:
        return ()
    judged = [outlying(values[:, k], std[:, k]) for k in range(values.shape[1])]
    z, p_value = (np.stack(part, axis=1) for part in zip(*judged, strict=True))
    stands = false_discovery(p_value)
    outliers = []
    for row, record in enumerate(fitted):
        if not stands[row].any():
            continue
        k = int(np.argmax(np.abs(z[row])))
        side, kind = _QUANTITIES[k]
        value = getattr(getattr(record, side), kind)
        median = value - (values[row, k] - float(np.median(values[:, k])))
        outliers.append(Outlier(record.vehicle, side, kind, value, median, float(z[row, k])))
    return tuple(sorted(outliers, key=lambda one: (-abs(one.z), one.vehicle)))


def _drifting(fitted: Sequence[VehicleRecord]) -> tuple[DriftingVehicle, ...]:
    """Return the vehicles whose drift stands among all, and when each has drifted by the tolerance."""
    from scipy.special import stdtr, stdtrit

    lines = [(record, side, getattr(record, side).drift) for record in fitted for side in WHEELS]
    lines = [line for line in lines if line[2] is not None and line[2].std_m > 0]
    if not lines:
        return ()
    p = np.array([2.0 * stdtr(drift.dof, -abs(drift.per_day_m) / drift.std_m) for _, _, drift in lines])
    drifting: dict[str, DriftingVehicle] = {}
    for (record, side, drift), stands in zip(lines, any_false(p), strict=True):
        if not stands:
            continue
        radius = getattr(record, side).radius_ref_m
        due = drift.last_day + DUE_RELATIVE * radius / abs(drift.per_day_m)
        half = float(stdtrit(drift.dof, 0.975)) * drift.std_m
        new = DriftingVehicle(record.vehicle, side, drift.per_day_m, half, float(due))
        have = drifting.get(record.vehicle)
        if have is None or new.due_day < have.due_day:
            drifting[record.vehicle] = new
    return tuple(sorted(drifting.values(), key=lambda one: (one.due_day, one.vehicle)))


def _common(
    fitted: Sequence[VehicleRecord], values: FloatArray, labels: Mapping[str, Mapping[str, str]]
) -> tuple[CommonCause, ...]:
    """Return the labels whose vehicles differ from the others in a quantity (Welch's test on clipped values)."""
    candidates: list[tuple[CommonCause, float]] = []
    for label, of_vehicle in sorted(labels.items()):
        mine = np.array([of_vehicle.get(record.vehicle, "") for record in fitted])
        for value in np.unique(mine[mine != ""]):
            inside = mine == value
            if inside.sum() < FEWEST_COMPARED or (~inside).sum() < FEWEST_COMPARED or inside.sum() > (~inside).sum():
                # what the larger part has in common is the fleet's own
                continue
            for k, (side, kind) in enumerate(_QUANTITIES):
                found = difference_of(values[:, k], inside)
                what = f"{side} {kind.split('_', 1)[0]} {_amount(found.size, kind)} from the others'"
                cause = CommonCause(
                    label,
                    str(value),
                    what,
                    found.n_showing,
                    int(inside.sum()),
                    found.size,
                    found.ci95,
                    found.p_value,
                )
                candidates.append((cause, found.p_value))
    stands = any_false(np.array([p for _, p in candidates])) if candidates else ()
    return tuple(
        sorted(
            (cause for (cause, _), stand in zip(candidates, stands, strict=True) if stand),
            key=lambda cause: (cause.p_value, cause.label, cause.value, cause.what),
        )
    )


def _without_common(
    fitted: Sequence[VehicleRecord],
    values: FloatArray,
    common: Sequence[CommonCause],
    labels: Mapping[str, Mapping[str, str]],
) -> FloatArray:
    """Return the quantities with what a label's vehicles have in common taken out: the label's fault is not theirs."""
    values = values.copy()
    for k, (side, kind) in enumerate(_QUANTITIES):
        start = f"{side} {kind.split('_', 1)[0]} "
        strongest = next((cause for cause in common if cause.what.startswith(start)), None)
        if strongest is None:
            continue
        of_vehicle = labels[strongest.label]
        inside = np.array([of_vehicle.get(record.vehicle, "") == strongest.value for record in fitted])
        values[inside, k] -= strongest.size
    return values


def _amount(size: float, kind: str) -> str:
    return f"{1e6 * size:+.1f} um" if kind == "radius_ref_m" else f"{1e9 * size:+.1f} nm/N"
