"""Which columns of a log are wheels, by their names and by what they do; both sides or neither."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from calib.campaign.ingest.contents import BEHAVIOURS, RISES, ColumnContents
from calib.campaign.ingest.guesses import count_unit, side_of
from calib.campaign.model import LOG_COLUMNS
from calib.campaign.readers.sheets import UNNAMED
from calib.campaign.settings import recognise

#: wheels at four corners, by their sides, front first
_CORNERS: Final = {
    "counts_left": ("counts_front_left", "counts_rear_left"),
    "counts_right": ("counts_front_right", "counts_rear_right"),
}
_PAIR: Final = ("counts_left", "counts_right")
#: share of its span by which two wheels of a side differ at most that are coupled: they slip, they do not steer
_COUPLED: Final = 0.02


@dataclass(frozen=True, slots=True)
class Wheel:
    """A column that is a wheel."""

    column: ColumnContents
    #: its unit, where the name does not say it; empty for counts
    unit: str = ""
    #: what to check
    remark: str = ""


def settled(
    guessed: Mapping[str, ColumnContents], columns: Sequence[ColumnContents], taken: frozenset[str]
) -> tuple[dict[str, Wheel], list[str]]:
    """Return the wheels among a log's columns, and remarks on what is none.

    Parameters
    ----------
    guessed : mapping of str to ColumnContents
        Calib's column -> the one whose name looks like it, wheels only.
    columns : sequence of ColumnContents
        All columns, with the width of the counter where any of the logs shows it.
    taken : frozenset of str
        Columns that are something else.

    Returns
    -------
    wheels : dict of str to Wheel
        Calib's column -> the wheel.
    remarks : list of str
        Lines for the mapping.
    """
    found = dict(guessed)
    remarks: list[str] = []
    corners = [name for pair in _CORNERS.values() for name in pair if name in found]
    note = ""
    own = any(recognise(found[name].name, LOG_COLUMNS).name == name for name in corners)
    if corners and not own and not set(_PAIR) & set(found):
        note = _folded(found, corners)
    ambiguous = ""
    if len(set(_PAIR) & set(found)) < 2 and not corners and "counts_front" not in found:
        ambiguous = _by_behaviour(found, columns, taken)
    one = [name for name in _PAIR if name in found]
    if len(one) == 1 and "counts_front" not in found:
        [name] = one
        other = _PAIR[1 - _PAIR.index(name)]
        text = f"#{name} = {found.pop(name).name!r}   # looks like a wheel, but no column looks like {other}"
        remarks.append(text.replace("'", '"'))
    wheels = {name: _wheel(column, note or ambiguous) for name, column in sorted(found.items(), key=_place)}
    return wheels, remarks


def _place(item: tuple[str, ColumnContents]) -> int:
    return LOG_COLUMNS.index(item[0])


def _folded(found: dict[str, ColumnContents], corners: Sequence[str]) -> str:
    """Make two wheels of corners that are a pair, or are coupled on each side (skid steer), in place; what to say."""
    for axle in (0, 1):
        names = [pair[axle] for pair in _CORNERS.values()]
        if sorted(corners) == sorted(names):
            for side, name in zip(_PAIR, names, strict=True):
                found[side] = found.pop(name)
            return ""
    if len(corners) == 4 and all(_coupled(*(found[name] for name in pair)) for pair in _CORNERS.values()):
        for side, (front, rear) in _CORNERS.items():
            found[side] = found.pop(front)
            del found[rear]
        return "   # both wheels of this side turn alike: skid steer; of a mecanum drive name all four"
    return ""


def _coupled(front: ColumnContents, rear: ColumnContents) -> bool:
    if front.low is None or front.high is None or rear.low is None or rear.high is None:
        return False
    span = max(front.high - front.low, rear.high - rear.low)
    return max(abs(front.low - rear.low), abs(front.high - rear.high)) <= _COUPLED * span


def _by_behaviour(found: dict[str, ColumnContents], columns: Sequence[ColumnContents], taken: frozenset[str]) -> str:
    """Find two counters by what they do, in place: they overflow, or rise in whole steps; returns what to check."""
    free = [column for column in columns if column.name not in taken and column.whole]
    counters = [column for column in free if column.wrap_bits]
    what = "overflows"
    if not counters:
        counters = [column for column in free if column.does == RISES and not column.even]
        what = "rises in whole numbers"
    if not counters and all(UNNAMED.fullmatch(column.name) for column in columns):
        counters = [column for column in columns if column.does == RISES]
        what = "rises"
    if len(counters) != 2:
        return ""
    sides = [side_of(column.name) for column in counters]
    if sides == ["right", "left"] or (None in sides and (sides[0] == "right" or sides[1] == "left")):
        counters.reverse()
    found |= dict(zip(_PAIR, counters, strict=True))
    unclear = None in sides or sides[0] == sides[1]
    return f"   # {what}, as a counter does; which side it is on is not said: check" if unclear else ""


def _wheel(column: ColumnContents, remark: str) -> Wheel:
    unit = BEHAVIOURS.get(column.does, "")
    if count_unit(column.name) not in {None, "counts"} or (column.unit == "counts" and unit != "counts/sample"):
        return Wheel(column, "", remark)
    if unit:
        return Wheel(column, unit, remark or f"   # {column.does}")
    if column.kind == "number" and not column.whole and not column.wrap_bits:
        if column.does:
            return Wheel(column, "rad", remark or "   # no whole numbers: an angle; rad, deg or turns")
        return Wheel(column, "rad/s", remark or "   # neither whole nor rising: a rate; or rad, an angle")
    return Wheel(column, "", remark)
