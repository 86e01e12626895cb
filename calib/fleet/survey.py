"""A task done for every vehicle of a fleet, and what many vehicles have in common in it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.errors import BadInputError
from calib.fleet.engines import run_tasks
from calib.fleet.member_tasks import MEMBER_TASKS, MemberRecord, key_of
from calib.fleet.members import Member, labels_of, members_of
from calib.fleet.random_effects import false_discovery
from calib.fleet.run import Progress
from calib.fleet.store import Store

__all__ = ["SharedCause", "Survey", "survey_fleet"]

#: fewest vehicles that share a cause before it is said of them together
FEWEST = 3


@dataclass(frozen=True, slots=True)
class SharedCause:
    """A finding that many vehicles share, of the whole fleet or of those with one label.

    Parameters
    ----------
    what : str
        Effect of a diagnosis, or code of a check.
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


@dataclass(frozen=True, slots=True)
class Survey:
    """A task's records, by vehicle, and what they share."""

    what: str
    records: tuple[MemberRecord, ...]
    shared: tuple[SharedCause, ...]
    n_done: int
    n_kept: int

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values: ``vehicles``, one each, and ``fleet``."""
        vehicles = [
            {"id": record.name, "status": record.status, **record.values, "why": record.why} for record in self.records
        ]
        failed = sum(record.status == "failed" for record in self.records)
        fleet = {
            "n_vehicles": len(self.records),
            "n_failed": failed,
            "shared": [cause.to_dict() for cause in self.shared],
        }
        return {"format": "calib-fleet/1", "what": self.what, "vehicles": vehicles, "fleet": fleet}

    def summary(self) -> str:
        """Return the survey in a few lines of text."""
        failed = [record for record in self.records if record.status == "failed"]
        lines = [f"{self.what}: {len(self.records) - len(failed)} of {len(self.records)} vehicles done"]
        lines += [f"  {cause.sentence}" for cause in self.shared]
        lines += [f"  failed {record.name}: {record.why}" for record in failed]
        return "\n".join(lines)


def survey_fleet(
    folder: Path,
    into: Path,
    what: str,
    *,
    workers: int = 1,
    scheduler: str = "",
    progress: Progress | None = None,
) -> Survey:
    """Do a task for every vehicle.

    Parameters
    ----------
    folder, into, workers, scheduler, progress
        As in `calib.fleet.run.fit_fleet`.
    what : str
        One of `calib.fleet.member_tasks.MEMBER_TASKS`.

    Returns
    -------
    Survey
        The same whatever the engine, the number of workers and the order.

    Raises
    ------
    BadInputError
        Where the task is not known.
    """
    if what not in MEMBER_TASKS:
        raise BadInputError(f"what: found {what!r}; expected fit or one of {', '.join(MEMBER_TASKS)}; choose one")
    members = members_of(folder)
    store = Store(Path(into) / f"{what}.jsonl", MemberRecord.from_dict)
    before = store.read()
    kept = {member.vehicle: before[member.vehicle] for member in members if _valid(member, before)}
    todo = [member for member in members if member.vehicle not in kept]
    n_kept = len(kept)
    results = run_tasks(MEMBER_TASKS[what], todo, _given_up, workers=workers, scheduler=scheduler)
    for number, record in enumerate(results, 1):
        store.append(record)
        kept[record.name] = record
        if progress is not None:
            progress(number, len(todo))
    store.rewrite(kept.values())
    records = tuple(kept[member.vehicle] for member in members)
    labels = labels_of(folder, tuple(member.vehicle for member in members))
    return Survey(what, records, _shared(records, labels), len(todo), n_kept)


def _valid(member: Member, kept: Mapping[str, MemberRecord]) -> bool:
    """Return whether a vehicle's record is there and its files are unchanged."""
    record = kept.get(member.vehicle)
    try:
        return record is not None and record.key != "" and record.key == key_of(member)
    except OSError:
        return False


def _given_up(member: Member, why: str) -> MemberRecord:
    return MemberRecord(member.vehicle, "", why=why)


def _findings(record: MemberRecord) -> set[str]:
    """Return what a vehicle's record names: causes of a diagnosis, codes of a check."""
    values = record.values
    causes = {str(cause["effect"]) for cause in values.get("causes", ())}
    return causes | {str(code) for level in ("wrong", "suspicious") for code in values.get(level, ())}


def _shared(records: Sequence[MemberRecord], labels: Mapping[str, Mapping[str, str]]) -> tuple[SharedCause, ...]:
    """Return what many vehicles share, the whole fleet first, then labels that stand out (Fisher's exact test)."""
    done = [record for record in records if record.status == "done"]
    names = [record.name for record in done]
    findings = [_findings(record) for record in done]
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


def _compared(what: str, label: str, value: str, shows: Any, inside: Any) -> SharedCause:
    from scipy.stats import fisher_exact

    table = [
        [int((shows & inside).sum()), int((~shows & inside).sum())],
        [int((shows & ~inside).sum()), int((~shows & ~inside).sum())],
    ]
    p_value = float(fisher_exact(table, alternative="greater").pvalue)
    return SharedCause(what, label, value, table[0][0], int(inside.sum()), p_value)
