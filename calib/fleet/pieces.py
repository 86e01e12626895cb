"""A piece of a fleet's work: the new files of a vehicle read to sums, and the vehicle's record where that is all."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from calib.fleet.members import Member, Part
from calib.fleet.part_sums import PartSums, sums_of_parts
from calib.fleet.store import line_of
from calib.fleet.vehicle import VehicleRecord, record_of

#: files of a vehicle that are read in one piece; the record of one that has more new ones is a piece of its own
MOST_FILES: Final = 64


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


@dataclass(frozen=True)
class PieceDone:
    """What came of a piece: the line of each file read, by the file's name, and the record of a whole vehicle."""

    n_files: int
    lines: Mapping[str, str]
    record: VehicleRecord | None


def pieces_of(member: Member, kept: Mapping[str, str]) -> Iterator[Piece]:
    """Yield the pieces of a vehicle's work.

    Parameters
    ----------
    member : Member
        The vehicle.
    kept : mapping of str to str
        Lines of files that need not be read, by the files' names.
    """
    new = tuple(part for part in member.parts if part.name not in kept)
    if len(new) <= MOST_FILES:
        yield Piece(member.vehicle, new, tuple(kept[part.name] for part in member.parts if part.name in kept))
        return
    for first in range(0, len(new), MOST_FILES):
        yield Piece(member.vehicle, new[first : first + MOST_FILES], whole=False)


def size_of(piece: Piece) -> int:
    """Return how many files a piece reads."""
    return len(piece.new)


def do_pieces(pieces: Sequence[Piece]) -> list[PieceDone]:
    """Do some pieces; never raises for bad input: what is wrong stands in the sums and in the record.

    Parameters
    ----------
    pieces : sequence of Piece
        Settings that their files share are read once.

    Returns
    -------
    list of PieceDone
        One a piece.
    """
    read = iter(sums_of_parts([part for piece in pieces for part in piece.new]))
    return [_done(piece, [next(read) for _ in piece.new]) for piece in pieces]


def _done(piece: Piece, new: Sequence[PartSums]) -> PieceDone:
    lines = {part.name: line_of(part) for part in new}
    if not piece.whole:
        return PieceDone(len(new), lines, None)
    before = [PartSums.from_dict(json.loads(line)) for line in piece.lines]
    return PieceDone(len(new), lines, record_of(piece.vehicle, [*before, *new]))


def given_up(piece: Piece, why: str) -> PieceDone:
    """Return what stands for a piece that took its worker down; its files are tried again by the next run."""
    lines = {part.name: line_of(PartSums(part.name, "", 0.0, 0.0, None, None, why)) for part in piece.new}
    record = VehicleRecord(piece.vehicle, 0, 0.0, None, None, why) if piece.whole else None
    return PieceDone(len(piece.new), lines, record)
