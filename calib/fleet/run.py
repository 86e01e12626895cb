"""A fleet from folder to view: what changed is read, sums are added, and the view is made anew."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calib.fleet.members import Member, labels_of, members_of
from calib.fleet.reading import PieceDone, do_pieces, given_up, pieces_of
from calib.fleet.store import SUMS, Keys, Store, line_of
from calib.fleet.vehicle import PartSums, VehicleRecord
from calib.fleet.view import FleetView, view_of
from calib.fleet.workers import Engine, engine
from calib.result import plain

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
        return {"format": "calib-fleet/1", "vehicles": vehicles, "fleet": plain(self.view)}


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
        The same for any engine, number of workers and order.
    """
    store = Store(Path(into) / SUMS, PartSums.from_dict)
    # workers start while this process lists the files
    with engine(workers, scheduler) as opened:
        members = members_of(folder)
        kept, keys = store.read(), Keys()
        parts = [part for member in members for part in member.parts]
        lines = {part.name: line_of(kept[part.name]) for part in parts if keys.hold(kept.get(part.name), part)}
        n_kept, n_new = len(lines), len(parts) - len(lines)
        records: dict[str, VehicleRecord] = {}
        with store.adding() as add:
            for done in _done(opened, members, lines):
                add(done.lines)
                lines |= done.lines
                if done.record is not None:
                    records[done.record.vehicle] = done.record
                if progress is not None and done.lines:
                    progress(len(lines) - n_kept, n_new)
        store.rewrite(lines)
    by_id = tuple(records[member.vehicle] for member in members)
    return Fleet(by_id, view_of(by_id, labels_of(folder, members)), n_new, n_kept)


def _done(opened: Engine, members: tuple[Member, ...], lines: Mapping[str, str]) -> Iterator[PieceDone]:
    """Yield what comes of the pieces; `lines` grows meanwhile; vehicles of many new files have their record last."""
    before = dict(lines)
    pieces = [piece for member in members for piece in pieces_of(member, before)]
    yield from opened.run(do_pieces, pieces, given_up, len)
    in_parts = {piece.vehicle for piece in pieces if not piece.whole}
    rest = [piece for member in members if member.vehicle in in_parts for piece in pieces_of(member, lines)]
    yield from opened.run(do_pieces, rest, given_up, len)
