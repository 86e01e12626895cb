"""A task done for every vehicle of a fleet, and what many vehicles have in common in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.errors import BadInputError
from calib.fleet.engines import run_tasks
from calib.fleet.findings import SharedCause, shared_causes
from calib.fleet.member_tasks import MEMBER_TASKS, MemberRecord, key_of
from calib.fleet.members import Member, labels_of, members_of
from calib.fleet.quantities import Quantities, quantities_of
from calib.fleet.run import Progress
from calib.fleet.store import Store, line_of

#: what a vehicle's task weighs beside the reading of one file: from ten times as long (a check) to a thousand times
WEIGHT: Final = 64


@dataclass(frozen=True, slots=True)
class Survey:
    """A task's records, by vehicle, and what they share; `quantities` where the task estimates some."""

    what: str
    records: tuple[MemberRecord, ...]
    shared: tuple[SharedCause, ...]
    n_done: int
    n_kept: int
    quantities: Quantities | None = None

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
        if self.quantities is not None:
            fleet |= self.quantities.to_dict()
        return {"format": "calib-fleet/1", "what": self.what, "vehicles": vehicles, "fleet": fleet}


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
    results = run_tasks(MEMBER_TASKS[what], todo, _given_up, _weight, workers=workers, scheduler=scheduler)
    with store.adding() as add:
        for number, record in enumerate(results, 1):
            add({record.name: line_of(record)})
            kept[record.name] = record
            if progress is not None:
                progress(number, len(todo))
    store.rewrite({name: line_of(record) for name, record in kept.items()})
    records = tuple(kept[member.vehicle] for member in members)
    labels = labels_of(folder, tuple(member.vehicle for member in members))
    shared = shared_causes(records, labels)
    return Survey(what, records, shared, len(todo), n_kept, _quantities(records, labels))


def _valid(member: Member, kept: Mapping[str, MemberRecord]) -> bool:
    """Return whether a vehicle's record is there and its files are unchanged."""
    record = kept.get(member.vehicle)
    try:
        return record is not None and record.key != "" and record.key == key_of(member)
    except OSError:
        return False


def _weight(_member: Member) -> int:
    return WEIGHT


def _given_up(member: Member, why: str) -> MemberRecord:
    return MemberRecord(member.vehicle, "", why=why)


def _quantities(records: Sequence[MemberRecord], labels: Mapping[str, Mapping[str, str]]) -> Quantities | None:
    """Return what the fleet shows in the vehicles' estimates; None where the task makes none."""
    done = [record for record in records if "estimates" in record.values]
    if not done:
        return None
    names = list(dict.fromkeys(name for record in done for name in record.values["estimates"]))
    table = {
        key: {
            name: np.array([record.values["estimates"].get(name, {}).get(key, np.nan) for record in done])
            for name in names
        }
        for key in ("value", "sd")
    }
    return quantities_of([record.name for record in done], table["value"], table["sd"], labels)
