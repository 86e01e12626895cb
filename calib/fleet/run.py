"""A fleet from folder to view: what changed is read, sums are added, and the view is made anew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calib.fleet.engines import engine
from calib.fleet.members import Member, Part, labels_of, members_of
from calib.fleet.part_sums import PartSums, sums_of_parts
from calib.fleet.store import SUMS, Store
from calib.fleet.vehicle import VehicleRecord, VehicleSums, records_of
from calib.fleet.view import FleetView, view_of

__all__ = ["Fleet", "fit_fleet"]

#: called with the number of files done and the number to do
Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Fleet:
    """A fleet's vehicles and view.

    Parameters
    ----------
    records : tuple of VehicleRecord
        By vehicle id.
    view : FleetView
        Of all of them.
    n_read, n_kept : int
        Files read now, and files whose sums were kept from before.
    """

    records: tuple[VehicleRecord, ...]
    view: FleetView
    n_read: int
    n_kept: int

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values: ``vehicles``, one each, and ``fleet``."""
        outliers = {outlier.vehicle: outlier.why for outlier in self.view.outliers}
        vehicles = []
        for record in self.records:
            values = record.to_dict()
            values["outlier"] = record.vehicle in outliers
            values["why"] = values["why"] or outliers.get(record.vehicle, "")
            vehicles.append(values)
        return {"format": "calib-fleet/1", "vehicles": vehicles, "fleet": self.view.to_dict()}


def fit_fleet(
    folder: Path,
    into: Path,
    *,
    workers: int = 1,
    scheduler: str = "",
    progress: Progress | None = None,
) -> Fleet:
    """Fit every vehicle of a fleet.

    Parameters
    ----------
    folder : Path
        See `calib.fleet.members.members_of`.
    into : Path
        Result folder; holds the sums of what was read, so that only new or changed files are read the next time and an
        interrupted run goes on where it was.
    workers : int
        Processes of this machine.
    scheduler : str
        Address of a Dask scheduler, in place of `workers`.
    progress : callable, optional
        Called as files are done.

    Returns
    -------
    Fleet
        The same whatever the engine, the number of workers and the order.
    """
    members = members_of(folder)
    store = Store(Path(into) / SUMS, PartSums.from_dict)
    kept = _still_valid(members, store.read())
    todo = [part for member in members for part in member.parts if part.name not in kept]
    n_kept = len(kept)
    with engine(workers, scheduler) as opened:
        for number, part in enumerate(opened.run(sums_of_parts, todo, _given_up), 1):
            store.append(part)
            kept[part.name] = part
            if progress is not None:
                progress(number, len(todo))
        store.rewrite(kept.values())
        whole = [VehicleSums(member.vehicle, tuple(kept[part.name] for part in member.parts)) for member in members]
        by_vehicle = {record.vehicle: record for record in opened.run(records_of, whole, _no_record)}
    records = tuple(by_vehicle[member.vehicle] for member in members)
    labels = labels_of(folder, tuple(member.vehicle for member in members))
    return Fleet(records, view_of(records, labels), len(todo), n_kept)


def _still_valid(members: tuple[Member, ...], kept: dict[str, PartSums]) -> dict[str, PartSums]:
    """Return the kept sums whose files are there and unchanged."""
    valid = {}
    for member in members:
        for part in member.parts:
            have = kept.get(part.name)
            if have is not None and have.key and part.path.exists() and have.key == part.key:
                valid[part.name] = have
    return valid


def _given_up(part: Part, why: str) -> PartSums:
    return PartSums(part.name, "", 0.0, 0.0, None, None, why)


def _no_record(sums: VehicleSums, why: str) -> VehicleRecord:
    return VehicleRecord(sums.vehicle, 0, 0.0, None, None, why)
