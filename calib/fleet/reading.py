"""Reading a fleet: files of runs to sums by session, and a vehicle's record where all its files are read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign.model import Border, Campaign, Logs
from calib.campaign.read import loads_from_payload, read_campaign
from calib.campaign.readers import read_table
from calib.campaign.runs_file import run_table
from calib.campaign.settings_file import Settings, read_settings
from calib.errors import CalibError
from calib.fleet.members import Member, Part, one_line
from calib.fleet.order import WheelSums
from calib.fleet.store import Keys, line_of, unsealed
from calib.fleet.vehicle import PartSums, VehicleRecord, record_of
from calib.radius.effective import effective_radii
from calib.types import FloatArray, StrArray

#: column of the run table that gives the day of a run; any origin
DAY: Final = "day"
#: files of a vehicle that are read in one piece; the record of one that has more new ones is a piece of its own
MOST_FILES: Final = 64


def sums_of_parts(parts: Sequence[Part]) -> list[PartSums]:
    """Read files of journeys and add the runs of each up by session; settings that several share are read once.

    Never raises for bad input: what is wrong is in `why`, so that one vehicle's data never stop the fleet.
    """
    settings: dict[Path, Settings] = {}
    keys = Keys()
    return [_sums_of_part(part, settings, keys) for part in parts]


def _sums_of_part(part: Part, settings: dict[Path, Settings], keys: Keys) -> PartSums:
    key = ""
    try:
        key = keys.of(part)
        campaign = campaign_of(part, settings)
        radii = effective_radii(campaign)
    except (CalibError, OSError) as error:
        return PartSums(part.name, key, 0.0, 0.0, None, None, one_line(error))
    day = _days(campaign, radii.run_id, part)
    reference, nominal = campaign.model.reference_load_N, campaign.vehicle.wheel_radius_m
    session = np.where(radii.session == "", part.name, radii.session)
    left = WheelSums.from_runs(session, radii.load_left_N - reference, radii.radius_left_m - nominal, day)
    right = WheelSums.from_runs(session, radii.load_right_N - reference, radii.radius_right_m - nominal, day)
    return PartSums(part.name, key, reference, nominal, left, right)


def campaign_of(part: Part, settings: dict[Path, Settings] | None = None) -> Campaign:
    """Return the campaign of a file of journeys; tables of a dataset take the fleet's settings and have no logs.

    `settings`: those read before, by folder; those read now are added. Raises CalibError where it cannot be used.
    """
    if part.path.parent == part.settings:
        return read_campaign(part.settings)
    known = {} if settings is None else settings
    if part.settings not in known:
        known[part.settings] = read_settings(part.settings / "campaign.toml", "campaign.toml")
    shared = known[part.settings]
    border = Border(lenient=False)
    runs = run_table(read_table(part.path, part.name), part.name, border)
    computed = dict(zip(("load_left_N", "load_right_N"), loads_from_payload(shared.vehicle, runs), strict=True))
    filled = {name: np.where(np.isnan(runs.number(name)), load, runs.number(name)) for name, load in computed.items()}
    runs = replace(runs, numbers={**runs.numbers, **filled})
    return shared.campaign(runs, Logs.empty(len(runs)), root=part.settings, notes=tuple(border.notes))


def _days(campaign: Campaign, run_id: StrArray, part: Part) -> FloatArray:
    """Return the day of each run used, shape (n_runs,); 0 where none is known."""
    days = campaign.runs.number(DAY)
    if len(run_id) < len(days):
        days = days[np.isin(campaign.runs.run_id, run_id)]
    return np.where(np.isfinite(days), days, 0.0 if part.day is None else part.day)


@dataclass(frozen=True)
class Piece:
    """What to do for a vehicle.

    Parameters
    ----------
    vehicle : str
        Its id.
    new : tuple of Part
        Files to read.
    lines : tuple of str
        What is kept of its other files, as the store has it.
    whole : bool
        Whether these are all its files, so that its record can be made.
    """

    vehicle: str
    new: tuple[Part, ...]
    lines: tuple[str, ...] = ()
    whole: bool = True

    def __len__(self) -> int:
        return len(self.new)


@dataclass(frozen=True)
class PieceDone:
    """The result of a piece: the line of each file read, by the file's name, and the record of a whole vehicle."""

    lines: Mapping[str, str]
    record: VehicleRecord | None


def pieces_of(member: Member, kept: Mapping[str, str]) -> Iterator[Piece]:
    """Yield the pieces of a vehicle's work; `kept`: lines of files that need not be read, by the files' names."""
    new = tuple(part for part in member.parts if part.name not in kept)
    if len(new) <= MOST_FILES:
        yield Piece(member.vehicle, new, tuple(kept[part.name] for part in member.parts if part.name in kept))
        return
    for first in range(0, len(new), MOST_FILES):
        yield Piece(member.vehicle, new[first : first + MOST_FILES], whole=False)


def do_pieces(pieces: Sequence[Piece]) -> list[PieceDone]:
    """Do some pieces, settings read once; never raises for bad input: what is wrong is in the sums and the record."""
    read = iter(sums_of_parts([part for piece in pieces for part in piece.new]))
    return [_done(piece, [next(read) for _ in piece.new]) for piece in pieces]


def _done(piece: Piece, new: Sequence[PartSums]) -> PieceDone:
    lines = {part.name: line_of(part) for part in new}
    if not piece.whole:
        return PieceDone(lines, None)
    before = [PartSums.from_dict(unsealed(line)) for line in piece.lines]
    return PieceDone(lines, record_of(piece.vehicle, [*before, *new]))


def given_up(piece: Piece, why: str) -> PieceDone:
    """Return the result of a piece that took its worker down; its files are tried again by the next run."""
    return _done(piece, [PartSums(part.name, "", 0.0, 0.0, None, None, why) for part in piece.new])
