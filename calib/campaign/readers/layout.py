"""Where the table stands in a file: sheet, separator, header row; looked for where nobody says."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from calib.campaign.readers.times import time_format
from calib.units import SUFFIXES

#: rows looked at in search of the header
LOOKED_AT: Final = 60
_NUMBER: Final = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?", re.ASCII)
#: the separators that are known -> all bytes but them and the end of a line
_ALL_BUT: Final = {mark: bytes(set(range(256)) - {ord(mark), 10}) for mark in (",", ";", "\t")}
_UNIT_WORDS: Final = frozenset(SUFFIXES) | {"m/s", "km/h", "°", "°C", "µm", "1", "-", "rpm", "rad/s", "counts", "ticks"}


@dataclass(frozen=True, slots=True)
class Layout:
    """Sheet and header row of a table; None where they are to be found."""

    sheet: str | None = None
    header_row: int | None = None


def is_number(cell: Any) -> bool:
    """Return whether a cell is a number or a time."""
    if isinstance(cell, int | float):
        return True
    text = str(cell).strip().replace("−", "-")
    return bool(_NUMBER.fullmatch(text)) or time_format(text) is not None


def _filled(row: Sequence[Any]) -> list[Any]:
    return [cell for cell in row if cell is not None and str(cell).strip()]


def find_header(rows: Sequence[Sequence[Any]]) -> int | None:
    """Return the index of the row that names the columns, or None where no row does so better than the first.

    The header is the first row of texts that is about as wide as the rows below it, with a number beneath it soon.

    `rows`: the first rows of the file, cells as read.
    """
    widths = [len(_filled(row)) for row in rows]
    for index, row in enumerate(rows):
        cells = _filled(row)
        below = sorted(width for width in widths[index + 1 :] if width)
        if len(cells) < 2 or not below:
            continue
        usual = below[len(below) // 2]
        texts = sum(not is_number(cell) for cell in cells)
        if len(cells) < 0.6 * usual or texts < 0.6 * len(cells):
            continue
        following = [row for row in rows[index + 1 : index + 4] if _filled(row)]
        if not any(any(is_number(cell) for cell in _filled(row)) for row in following):
            continue
        if following and len(_filled(following[0])) > len(row) and widths[index] < usual:
            continue
        return index
    return None


def with_units(header: Sequence[str], below: Sequence[Any]) -> list[str] | None:
    """Return the header with the units of a row beneath it in brackets, or None where that row holds no units."""
    cells = ["" if cell is None else str(cell).strip() for cell in below]
    bare = [cell.strip("[]()") for cell in cells]
    filled = [cell for cell in bare if cell]
    if not filled or not all(cell in _UNIT_WORDS for cell in filled) or all(is_number(cell) for cell in filled):
        return None
    units = [*bare, *[""] * (len(header) - len(bare))]
    return [
        f"{name} [{unit}]" if name and unit and "[" not in name else name
        for name, unit in zip(header, units, strict=False)
    ]


def find_delimiter(lines: Sequence[str]) -> str:
    """Return the separator that splits the longest stretch of lines into one number of cells, more than one.

    `lines`: the first lines of the file.
    """
    filled = [line for line in lines if line.strip()][:LOOKED_AT]
    # first come wins a tie: commas of equal regularity are decimal
    stretches = {mark: _stretch([len(row) for row in _split(filled, mark)]) for mark in (";", "\t", ",")}
    best = max(stretches, key=lambda mark: stretches[mark])
    return best if stretches[best] else ","


def of_one_width(body: bytes, width: int, delimiter: str) -> bool:
    """Return whether every line of a text without quotes has `width` cells, none more and none fewer.

    What is left of the text without its cells has to be the same line over and over: a row too long beside one too
    short, which are as many cells in all, is seen.
    """
    line = delimiter.encode() * (width - 1) + b"\n"
    marks = body.translate(None, _ALL_BUT[delimiter])
    if not body.endswith(b"\n"):
        marks += b"\n"
    return marks == line * (len(marks) // len(line))


def _stretch(counts: Sequence[int]) -> int:
    """Return the length of the longest stretch of equal counts above one."""
    longest = current = 0
    for index, count in enumerate(counts):
        current = 0 if count < 2 else current + 1 if index and counts[index - 1] == count else 1
        longest = max(longest, current)
    return longest


def _split(lines: Sequence[str], delimiter: str) -> list[list[str]]:
    try:
        return list(csv.reader(lines, delimiter=delimiter))
    except csv.Error:
        return [line.split(delimiter) for line in lines]
