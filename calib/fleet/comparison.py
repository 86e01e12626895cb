"""What many vehicles show together: spread of their quantities, vehicles apart, labels that differ, shared findings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from calib.fleet.population import (
    Difference,
    Population,
    any_false,
    difference_of,
    false_discovery,
    outlying,
    population,
)
from calib.fleet.store import VehicleResult
from calib.result import plain_fields
from calib.types import BoolArray, FloatArray

#: fewest vehicles that are judged against each other, and that a label must have in common
FEWEST_COMPARED: Final = 5
#: fewest vehicles that share a finding before it is reported of them together
FEWEST_SHARING: Final = 3


@dataclass(frozen=True, slots=True)
class QuantityOutlier:
    """A vehicle that stands apart in a quantity, `z` standard deviations from the fleet's mean."""

    vehicle: str = field(metadata={"json": "id"})
    quantity: str
    value: float
    fleet: float = field(metadata={"json": False})
    z: float

    @property
    def why(self) -> str:
        """What a person reads."""
        name, scale, unit = shown_quantity(self.quantity)
        away = f"{scale * self.value:.4g} {unit}, {scale * (self.value - self.fleet):+.3g} from the fleet"
        return f"{name}: {away} ({abs(self.z):.1f} standard deviations)"

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return plain_fields(self, why=self.why)


@dataclass(frozen=True, slots=True)
class LabelDifference:
    """A quantity in which the vehicles of a label differ from the others."""

    label: str
    value: str
    quantity: str
    n_vehicles: int
    difference: Difference = field(metadata={"json": False})

    @property
    def sentence(self) -> str:
        """What a person reads."""
        name, scale, unit = shown_quantity(self.quantity)
        by = f"{scale * self.difference.size:+.3g} {unit} from the others'"
        return f"{self.difference.n_showing} of {self.n_vehicles} vehicles with {self.label} {self.value}: {name} {by}"

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return plain_fields(self, **plain_fields(self.difference), sentence=self.sentence)


@dataclass(frozen=True, slots=True)
class Quantities:
    """What a fleet shows in its vehicles' quantities.

    Parameters
    ----------
    populations : mapping of str to Population
        By quantity; vehicles apart omitted, what a label's vehicles share taken off.
    outliers : tuple of QuantityOutlier
        One a vehicle: what is farthest off; farthest first.
    differences : tuple of LabelDifference
        Strongest first.
    """

    populations: Mapping[str, Population]
    outliers: tuple[QuantityOutlier, ...]
    differences: tuple[LabelDifference, ...] = field(metadata={"json": "common"})


def quantities_of(
    vehicles: Sequence[str],
    values: Mapping[str, FloatArray],
    std: Mapping[str, FloatArray],
    labels: Mapping[str, Mapping[str, str]],
) -> Quantities:
    """Return what a fleet shows in quantities that most of its vehicles have.

    Parameters
    ----------
    vehicles : sequence of str
        Ids.
    values, std : mapping of str to array of float, each shape (n_vehicles,)
        By quantity, NaN where a vehicle does not have it; `std` its standard uncertainty.
    labels : mapping of str to mapping of str to str
        For each kind of label, that of each vehicle.
    """
    names = [name for name, column in values.items() if np.isfinite(column).sum() >= FEWEST_COMPARED]
    differences = _differences(vehicles, {name: values[name] for name in names}, labels)
    own = {name: values[name].copy() for name in names}
    for difference in reversed(differences):
        inside = _with(vehicles, labels[difference.label], difference.value)
        own[difference.quantity][inside] = values[difference.quantity][inside] - difference.difference.size
    outliers = _apart(vehicles, own, values, std)
    usual = ~np.isin(vehicles, [outlier.vehicle for outlier in outliers])
    populations = {}
    for name in names:
        known = usual & np.isfinite(own[name])
        found = population(own[name][known], std[name][known])
        if found is not None:
            populations[name] = found
    return Quantities(populations, outliers, differences)


def _with(vehicles: Sequence[str], of_vehicle: Mapping[str, str], value: str) -> BoolArray:
    return np.array([of_vehicle.get(vehicle, "") == value for vehicle in vehicles], dtype=np.bool_)


def _differences(
    vehicles: Sequence[str], values: Mapping[str, FloatArray], labels: Mapping[str, Mapping[str, str]]
) -> tuple[LabelDifference, ...]:
    candidates = []
    for label, of_vehicle in sorted(labels.items()):
        for value in sorted({of_vehicle.get(vehicle, "") for vehicle in vehicles} - {""}):
            with_label = _with(vehicles, of_vehicle, value)
            for name, column in values.items():
                known = np.isfinite(column)
                inside = with_label[known]
                if min(inside.sum(), (~inside).sum()) < FEWEST_COMPARED or inside.sum() > (~inside).sum():
                    # what the larger part has in common is the fleet's own
                    continue
                difference = difference_of(column[known], inside)
                candidates.append(LabelDifference(label, value, name, int(inside.sum()), difference))
    stands = any_false(np.array([candidate.difference.p_value for candidate in candidates]))
    kept = [candidate for candidate, stand in zip(candidates, stands, strict=True) if stand]
    return tuple(sorted(kept, key=lambda one: (one.difference.p_value, one.label, one.value, one.quantity)))


def _apart(
    vehicles: Sequence[str],
    own: Mapping[str, FloatArray],
    values: Mapping[str, FloatArray],
    std: Mapping[str, FloatArray],
) -> tuple[QuantityOutlier, ...]:
    if not own:
        return ()
    names = list(own)
    z, p_value = np.zeros((len(vehicles), len(names))), np.full((len(vehicles), len(names)), np.nan)
    for k, name in enumerate(names):
        known = np.isfinite(own[name])
        z[known, k], p_value[known, k] = outlying(own[name][known], std[name][known])
    outliers = []
    for row in map(int, np.flatnonzero(false_discovery(p_value).any(axis=1))):
        k = int(np.argmax(np.abs(z[row])))
        name = names[k]
        value, shift = float(values[name][row]), float(values[name][row] - own[name][row])
        usual = float(np.nanmedian(own[name])) + shift
        outliers.append(QuantityOutlier(vehicles[row], name, value, usual, float(z[row, k])))
    return tuple(sorted(outliers, key=lambda one: (-abs(one.z), one.vehicle)))


def shown_quantity(quantity: str) -> tuple[str, float, str]:
    """Return a quantity's name for people, the factor to its unit there, and that unit."""
    for suffix, scale, unit in (("_m_per_N", 1e9, "nm/N"), ("_m", 1e3, "mm"), ("_rad", 1e3, "mrad"), ("_s", 1e3, "ms")):
        if quantity.endswith(suffix):
            return quantity.removesuffix(suffix).replace("_", " "), scale, unit
    return quantity.replace("_", " "), 1.0, ""


@dataclass(frozen=True, slots=True)
class SharedCause:
    """A finding that many vehicles share, of the whole fleet or of those with one label.

    Parameters
    ----------
    what : str
        Effect of a diagnosis, with its place where it has one, or code of a check.
    label, value : str
        Column of ``vehicles.csv`` and its value; both empty for the whole fleet.
    n_showing, n_vehicles : int
        How many of how many.
    p_value : float
        Of Fisher's exact test against the other vehicles; 1 for the whole fleet.
    """

    what: str
    label: str
    value: str
    n_showing: int
    n_vehicles: int
    p_value: float = 1.0

    @property
    def sentence(self) -> str:
        """What a person reads."""
        whose = f"vehicles with {self.label} {self.value}" if self.label else "vehicles"
        return f"{self.n_showing} of {self.n_vehicles} {whose}: {self.what}"

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return plain_fields(self, sentence=self.sentence)


def shared_causes(records: Sequence[VehicleResult], labels: Mapping[str, Mapping[str, str]]) -> tuple[SharedCause, ...]:
    """Return what many vehicles share, the whole fleet first, then labels that stand out (Fisher's exact test).

    Parameters
    ----------
    records : sequence of VehicleResult
        Of all vehicles; those that failed are omitted.
    labels : mapping of str to mapping of str to str
        For each kind of label, that of each vehicle.
    """
    done = [record for record in records if record.status == "done"]
    names = [record.name for record in done]
    findings = _findings(done)
    counted = Counter(what for found in findings for what in found)
    whole = [
        SharedCause(what, "", "", count, len(done)) for what, count in counted.most_common() if count >= FEWEST_SHARING
    ]
    by_label: list[SharedCause] = []
    for what, count in sorted(counted.items()):
        if count < FEWEST_SHARING:
            continue
        shows = np.array([what in found for found in findings])
        for label, of_vehicle in sorted(labels.items()):
            mine = np.array([of_vehicle.get(name, "") for name in names])
            values = np.unique(mine[mine != ""])
            by_label += [_compared(what, label, str(value), shows, mine == value) for value in values]
    stands = false_discovery(np.array([cause.p_value for cause in by_label])) if by_label else ()
    special = [cause for cause, stand in zip(by_label, stands, strict=True) if stand]
    return (*whole, *sorted(special, key=lambda cause: (cause.p_value, cause.what, cause.value)))


def _findings(records: Sequence[VehicleResult]) -> list[set[str]]:
    """Return what each vehicle's record names: causes of a diagnosis, codes of a check or of blunders."""
    places = _places(records)
    findings = []
    for record in records:
        values = record.values
        found = {str(code) for level in ("wrong", "suspicious") for code in values.get(level, ())}
        for cause in values.get("causes", ()):
            effect = str(cause["effect"])
            place = next((text for centre, text in places.get(effect, ()) if _within(cause, centre)), "")
            found.add(effect.replace("_", " ") + place if place else effect)
        findings.append(found)
    return findings


def _within(cause: Mapping[str, Any], centre: float) -> bool:
    return "x_m" in cause and abs(float(cause["x_m"]) - centre) <= float(cause["size_m"])


def _places(records: Sequence[VehicleResult]) -> dict[str, list[tuple[float, str]]]:
    """Return, for each effect that lies at a place, the places where several vehicles have it: x and its words.

    The floor is asked about in cells; one zone may show in neighbouring cells. Places are taken where most vehicles
    name them first, each with all that lie within a cell of it.
    """
    named: dict[str, list[tuple[float, float]]] = {}
    for record in records:
        for cause in record.values.get("causes", ()):
            if "x_m" in cause:
                named.setdefault(str(cause["effect"]), []).append((float(cause["x_m"]), float(cause["size_m"])))
    places: dict[str, list[tuple[float, str]]] = {}
    for effect, found in named.items():
        x, size = np.array(found).T
        left = np.ones(len(x), dtype=np.bool_)
        while left.sum() >= FEWEST_SHARING:
            near = np.abs(x[:, None] - x) <= size[:, None]
            near &= left
            middle = int(np.argmax(np.where(left, near.sum(axis=1), 0)))
            if near[middle].sum() < FEWEST_SHARING:
                break
            centre = float(x[middle])
            places.setdefault(effect, []).append((centre, f" at x = {centre:g} m"))
            left &= ~near[middle]
    return places


def _compared(what: str, label: str, value: str, shows: BoolArray, inside: BoolArray) -> SharedCause:
    from scipy.stats import fisher_exact

    table = [
        [int((shows & inside).sum()), int((~shows & inside).sum())],
        [int((shows & ~inside).sum()), int((~shows & ~inside).sum())],
    ]
    p_value = float(fisher_exact(table, alternative="greater").pvalue)
    return SharedCause(what, label, value, table[0][0], int(inside.sum()), p_value)
