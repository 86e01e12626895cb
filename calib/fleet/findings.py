"""What many vehicles share: findings by name, and places on a common floor that several vehicles name alike."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from calib.arrays import BoolArray
from calib.fleet.member_tasks import MemberRecord
from calib.fleet.random_effects import false_discovery

#: fewest vehicles that share a cause before it is said of them together
FEWEST: Final = 3


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
        return {
            "what": self.what,
            "label": self.label,
            "value": self.value,
            "n_showing": self.n_showing,
            "n_vehicles": self.n_vehicles,
            "p_value": self.p_value,
            "sentence": self.sentence,
        }


def shared_causes(records: Sequence[MemberRecord], labels: Mapping[str, Mapping[str, str]]) -> tuple[SharedCause, ...]:
    """Return what many vehicles share, the whole fleet first, then labels that stand out (Fisher's exact test).

    Parameters
    ----------
    records : sequence of MemberRecord
        Of all vehicles; those that failed are left out.
    labels : mapping of str to mapping of str to str
        For each kind of label, that of each vehicle.
    """
    done = [record for record in records if record.status == "done"]
    names = [record.name for record in done]
    findings = _findings(done)
    counted = Counter(what for found in findings for what in found)
    whole = [SharedCause(what, "", "", count, len(done)) for what, count in counted.most_common() if count >= FEWEST]
    by_label: list[SharedCause] = []
    for what, count in sorted(counted.items()):
        if count < FEWEST:
            continue
        shows = np.array([what in found for found in findings])
        for label, of_vehicle in sorted(labels.items()):
            mine = np.array([of_vehicle.get(name, "") for name in names])
            values = np.unique(mine[mine != ""])
            by_label += [_compared(what, label, str(value), shows, mine == value) for value in values]
    stands = false_discovery(np.array([cause.p_value for cause in by_label])) if by_label else ()
    special = [cause for cause, stand in zip(by_label, stands, strict=True) if stand]
    return (*whole, *sorted(special, key=lambda cause: (cause.p_value, cause.what, cause.value)))


def _findings(records: Sequence[MemberRecord]) -> list[set[str]]:
    """Return what each vehicle's record names: causes of a diagnosis, codes of a check or of gross faults."""
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


def _places(records: Sequence[MemberRecord]) -> dict[str, list[tuple[float, str]]]:
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
        while left.sum() >= FEWEST:
            near = np.abs(x[:, None] - x) <= size[:, None]
            near &= left
            middle = int(np.argmax(np.where(left, near.sum(axis=1), 0)))
            if near[middle].sum() < FEWEST:
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
