"""Quantities of many vehicles with their uncertainties: spread, vehicles apart, and what those of a label share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.fleet.random_effects import Population, any_false, false_discovery, outlying, population

#: fewest vehicles that are judged against each other, and that a label must have in common
FEWEST: Final = 5


@dataclass(frozen=True, slots=True)
class Difference:
    """What the vehicles of a label have more than the others: size, its interval, Welch's p, how many show it."""

    size: float
    ci95: tuple[float, float]
    p_value: float
    n_showing: int


def difference_of(values: FloatArray, inside: BoolArray) -> Difference:
    """Compare the vehicles of a label with the others (Welch's test on values drawn in towards their median).

    Parameters
    ----------
    values : array of float, shape (n_vehicles,)
        A quantity.
    inside : array of bool, shape (n_vehicles,)
        Which vehicles have the label.
    """
    clipped = _clipped(values, inside)
    size, half, p_value = _welch(clipped[inside], clipped[~inside])
    away = values[inside] - float(np.median(values[~inside]))
    showing = int((np.sign(size) * away > 0.5 * abs(size)).sum())
    return Difference(size, (size - half, size + half), p_value, showing)


def _welch(one: FloatArray, other: FloatArray) -> tuple[float, float, float]:
    """Return the difference of two means, half its 95 % interval, and Welch's p.

    By hand, because `scipy.stats` takes longer to import than the view of 2,000 vehicles takes to make.
    """
    from scipy.special import stdtr, stdtrit

    with np.errstate(divide="ignore", invalid="ignore"):
        variances = np.array([part.var(ddof=1) / len(part) for part in (one, other)])
        total = variances.sum()
        dof = total**2 / np.sum(variances**2 / (np.array([len(one), len(other)]) - 1))
        size = one.mean() - other.mean()
        p_value = 2.0 * stdtr(dof, -np.abs(size / np.sqrt(total)))
        half = stdtrit(dof, 0.975) * np.sqrt(total)
    return float(size), float(half), float(p_value)


def _clipped(values: FloatArray, inside: BoolArray) -> FloatArray:
    """Return values with those far from their side's median drawn in, so that no vehicle speaks for all."""
    clipped = values.copy()
    for part in (inside, ~inside):
        median = float(np.median(values[part]))
        width = 4.0 * max(float(np.median(np.abs(values[part] - median))), 1e-300)
        clipped[part] = np.clip(values[part], median - width, median + width)
    return clipped


@dataclass(frozen=True, slots=True)
class QuantityOutlier:
    """A vehicle that stands apart in a quantity, `z` standard deviations from the fleet's mean."""

    vehicle: str
    quantity: str
    value: float
    fleet: float
    z: float

    @property
    def why(self) -> str:
        """What a person reads."""
        name, scale, unit = shown_quantity(self.quantity)
        away = f"{scale * self.value:.4g} {unit}, {scale * (self.value - self.fleet):+.3g} from the fleet"
        return f"{name}: {away} ({abs(self.z):.1f} standard deviations)"

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {"id": self.vehicle, "quantity": self.quantity, "value": self.value, "z": self.z, "why": self.why}


@dataclass(frozen=True, slots=True)
class LabelDifference:
    """A quantity in which the vehicles of a label differ from the others."""

    label: str
    value: str
    quantity: str
    n_vehicles: int
    difference: Difference

    @property
    def sentence(self) -> str:
        """What a person reads."""
        name, scale, unit = shown_quantity(self.quantity)
        by = f"{scale * self.difference.size:+.3g} {unit} from the others'"
        return f"{self.difference.n_showing} of {self.n_vehicles} vehicles with {self.label} {self.value}: {name} {by}"

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {
            "label": self.label,
            "value": self.value,
            "quantity": self.quantity,
            "n_showing": self.difference.n_showing,
            "n_vehicles": self.n_vehicles,
            "size": self.difference.size,
            "size_ci95": list(self.difference.ci95),
            "p_value": self.difference.p_value,
            "sentence": self.sentence,
        }


@dataclass(frozen=True, slots=True)
class Quantities:
    """What a fleet shows in its vehicles' quantities.

    Parameters
    ----------
    populations : mapping of str to Population
        By quantity; vehicles apart left out, what a label's vehicles share taken off.
    outliers : tuple of QuantityOutlier
        One a vehicle: what is farthest off; farthest first.
    differences : tuple of LabelDifference
        Strongest first.
    """

    populations: Mapping[str, Population]
    outliers: tuple[QuantityOutlier, ...]
    differences: tuple[LabelDifference, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {
            "populations": {name: found.to_dict() for name, found in self.populations.items()},
            "outliers": [outlier.to_dict() for outlier in self.outliers],
            "common": [difference.to_dict() for difference in self.differences],
        }


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
    names = [name for name, column in values.items() if np.isfinite(column).sum() >= FEWEST]
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
                if min(inside.sum(), (~inside).sum()) < FEWEST or inside.sum() > (~inside).sum():
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
