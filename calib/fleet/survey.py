"""A task for every vehicle of a fleet (check, geometry, diagnosis), and what many vehicles have in common in it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.documents import plain, plain_fields
from calib.errors import BadInputError, CalibError, RefusedError
from calib.fleet.comparison import Labels, Quantities, SharedCause, VehicleResult, quantities_of, shared_causes
from calib.fleet.run import campaign_of
from calib.fleet.store import Kept, Keys, Member, labels_of, members_of, one_line, renewed
from calib.fleet.workers import engine
from calib.types import Progress, silent

#: what a vehicle's task weighs beside the reading of one file: from ten times as long (a check) to a thousand times
WEIGHT: Final = 64


@dataclass(frozen=True, slots=True)
class Survey:
    """A task's records, by vehicle, and what they share; `quantities` where the task estimates some."""

    what: str
    records: tuple[VehicleResult, ...]
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
        fleet = {"n_vehicles": len(self.records), "n_failed": failed, "shared": plain(self.shared)}
        fleet |= {} if self.quantities is None else plain(self.quantities)
        return {"format": "calib-fleet/1", "what": self.what, "vehicles": vehicles, "fleet": fleet}


def survey_fleet(
    folder: Path, into: Path, what: str, *, workers: int = 1, scheduler: str = "", progress: Progress = silent
) -> Survey:
    """Do a task for every vehicle.

    The result is the same for any engine, number of workers and order.

    Raises BadInputError where the task is not known.

    Parameters
    ----------
    folder, into, workers, scheduler, progress
        As in `calib.fleet.run.fit_fleet`.
    what
        One of `TASKS`.
    """
    if what not in TASKS:
        raise BadInputError(f"what: found {what!r}; expected fit or one of {', '.join(TASKS)}; choose one")
    members = {member.vehicle: member for member in members_of(folder)}
    with engine(workers, scheduler) as opened:
        path, task = into / f"{what}.jsonl", partial(_results, what)
        kept, n_new = renewed(
            path,
            members,
            opened,
            task,
            lambda member, why: Kept.of(VehicleResult(member.vehicle, "", why=why)),
            progress,
            "vehicles",
            lambda _member: WEIGHT,
        )
    records = tuple(VehicleResult(**kept[name].values()) for name in members)
    labels = labels_of(folder, tuple(members.values()))
    shared = shared_causes(records, labels)
    return Survey(what, records, shared, n_new, len(members) - n_new, _quantities(records, labels))


def _results(what: str, members: Sequence[Member]) -> list[Kept]:
    """Do a task for some vehicles; never raises for bad input: what is wrong is in the result."""
    results, keys = [], Keys()
    for member in members:
        key = ""
        try:
            key = keys.of(member)
            results.append(VehicleResult(member.vehicle, key, TASKS[what](member)))
        except (CalibError, OSError) as error:
            results.append(VehicleResult(member.vehicle, key, why=one_line(error)))
    return [Kept.of(result) for result in results]


def _quantities(records: Sequence[VehicleResult], labels: Labels) -> Quantities | None:
    """Return what the fleet shows in the vehicles' estimates; None where the task makes none."""
    done = [record for record in records if "estimates" in record.values]
    if not done:
        return None
    estimates = [record.values["estimates"] for record in done]
    names = list(dict.fromkeys(name for one in estimates for name in one))
    values, std = (
        {name: np.array([one.get(name, {}).get(key, np.nan) for one in estimates]) for name in names}
        for key in ("value", "sd")
    )
    return quantities_of([record.name for record in done], values, std, labels)


def _campaign(member: Member, *, lenient: bool = False) -> Campaign:
    if len(member.parts) != 1:
        raise RefusedError(
            f"{member.vehicle}: found {len(member.parts)} files of journeys; expected one for this task; "
            "put a vehicle's journeys into one campaign folder"
        )
    return campaign_of(member.parts[0], lenient=lenient)


def _check(member: Member) -> dict[str, object]:
    from calib.campaign.check import check_campaign

    report = check_campaign(_campaign(member, lenient=True))
    return {
        "sound": report.sound,
        "wrong": [note.code for note in report.wrong],
        "suspicious": [note.code for note in report.suspicious],
    }


def _diagnose(member: Member) -> dict[str, object]:
    from calib.gap.diagnose import diagnose_in_full

    verdict = diagnose_in_full(_campaign(member), plan=False)
    causes = []
    for cause in verdict.causes:
        place = {key: cause.settings[key] for key in ("x_m", "size_m") if key in cause.settings}
        causes.append({"effect": cause.effect, "probability": cause.probability} | (place if len(place) == 2 else {}))
    return {"verdict": str(verdict.kind), "sentence": verdict.sentence, "causes": causes}


def _geometry(member: Member) -> dict[str, object]:
    from calib.kinematics.estimate import estimate_geometry

    geometry = estimate_geometry(_campaign(member))
    return {
        "passed": geometry.passed,
        "using": geometry.using,
        "estimates": {estimate.name: plain_fields(estimate) for estimate in geometry.estimates},
        "undetermined": list(geometry.undetermined),
        "wrong": [fault.code for fault in geometry.faults],
    }


#: task -> function of a vehicle; a new task is a function and a line here
TASKS: Final[dict[str, Callable[[Member], dict[str, object]]]] = {
    "check": _check,
    "geometry": _geometry,
    "diagnose": _diagnose,
}
