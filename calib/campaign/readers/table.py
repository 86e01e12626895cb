"""What every reader returns, and the careful reading of numbers written by people and spreadsheets."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from calib.campaign.model import Note
from calib.campaign.readers.times import TIME_FORMATS, moments_ns, time_format
from calib.errors import BadFileError
from calib.limits import COLUMNS, refuse_beyond

Wanted = Callable[[str], bool]

#: nothing measured is larger; a cell that is has been spoilt, and would overflow later
LARGEST: Final = 1e30

_EMPTY: Final = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none", "-"})
_POINT: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_COMMA: Final = re.compile(r"[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?", re.ASCII)
# one to three digits, one mark, exactly three digits: 1,234 is 1.234 in one country and 1234 in another
_AMBIGUOUS: Final = re.compile(r"[+-]?[1-9]\d{0,2}[,.]\d{3}", re.ASCII)


@dataclass(frozen=True, slots=True, eq=False)
class RawTable:
    """A table as read."""

    #: under the names found in the file, in its order: float64 where the reader knows that it is numeric, else an
    #: object array of str, float and None, shape (n_rows,)
    columns: Mapping[str, npt.NDArray[Any]]
    #: line of each row in the file, counted from 1, header included, shape (n_rows,)
    line: npt.NDArray[np.int64]
    #: what was recognised (encoding, delimiter, decimal comma)
    notes: tuple[Note, ...] = ()
    #: for a column that was written as times of the clock and holds seconds since its first cell: that first time, in
    #: nanoseconds since 1970 (or since midnight)
    epochs: Mapping[str, int] = field(default_factory=dict)


def objects(cells: Sequence[Any]) -> npt.NDArray[Any]:
    """Return cells of any kind as an array of objects, shape (n_rows,)."""
    out = np.empty(len(cells), dtype=object)
    out[:] = list(cells)
    return out


def refuse_duplicates(names: Sequence[str], shown: str, row: int = 1) -> None:
    """Refuse a header that names a column twice, too many columns, or none at all."""
    refuse_beyond(len(names), COLUMNS, shown=shown, what="columns", remedy="export those that are needed", row=row)
    seen: set[str] = set()
    for name in names:
        if len(name) > 100 or not name.isprintable():
            expected = "names of at most 100 printable characters"
            remedy = "check that this is the right file and its encoding UTF-8; export it again"
            raise BadFileError(shown, f"{name[:20]!r}, no column name", expected, remedy, row=row)
        if name in seen and name:
            raise BadFileError(
                shown,
                row=row,
                column=name,
                found="the column name twice",
                expected="each name once",
                remedy="rename or remove one of the two columns",
            )
        seen.add(name)
    if not any(names):
        raise BadFileError(shown, "no column names", "a header line", "put the column names first", row=row)


def numbers(
    cells: npt.NDArray[Any],
    *,
    shown: str,
    column: str,
    line: npt.NDArray[np.int64],
    decimal_comma: bool | None = None,
) -> tuple[npt.NDArray[np.float64], bool]:
    """Turn cells into numbers without guessing.

    Parameters
    ----------
    cells : array, shape (n_rows,)
        Text, numbers or None.
    shown, column : str
        File and column, for messages.
    line : array of int, shape (n_rows,)
        Line of each cell.
    decimal_comma : bool, optional
        What the rest of the file says about commas; None where nothing is known, and then ``1,234`` is refused.

    Returns
    -------
    values : array of float, shape (n_rows,)
        NaN where a cell is empty.
    used_comma : bool
        Whether a decimal comma was read.

    Raises
    ------
    BadFileError
        At the first cell that is no finite number, or could be read in two ways.
    """
    if cells.dtype != object:
        values = cells.astype(np.float64)
        bad = np.flatnonzero(np.abs(values) > LARGEST)
        if len(bad):
            raise _no_number(shown, column, int(line[bad[0]]), str(values[bad[0]]))
        return values, False
    out = np.full(len(cells), np.nan)
    used_comma = False
    for index, cell in enumerate(cells):
        if cell is None:
            continue
        if isinstance(cell, str):
            text = cell.strip().replace("−", "-")
            if text.lower() in _EMPTY:
                continue
            if _COMMA.fullmatch(text):
                if decimal_comma is not True and _AMBIGUOUS.fullmatch(text):
                    raise _ambiguous(shown, column, int(line[index]), text)
                used_comma = True
                text = text.replace(",", ".")
            elif decimal_comma is True and _AMBIGUOUS.fullmatch(text):
                raise _ambiguous(shown, column, int(line[index]), text)
            elif not _POINT.fullmatch(text):
                raise _no_number(shown, column, int(line[index]), text)
            value = float(text)
        else:
            value = float(cell)
        if not abs(value) <= LARGEST and not (isinstance(cell, float) and np.isnan(cell)):
            raise _no_number(shown, column, int(line[index]), str(cell))
        out[index] = value
    return out, used_comma


def comma_evidence(columns: Sequence[npt.NDArray[Any]]) -> bool | None:
    """Return whether a file writes decimal commas: True or False where some cell can be read in one way only."""
    comma = point = False
    for cells in columns:
        for cell in cells if cells.dtype == object else ():
            if isinstance(cell, str) and not _AMBIGUOUS.fullmatch(text := cell.strip()):
                comma = comma or ("," in text and _COMMA.fullmatch(text) is not None)
                point = point or ("." in text and _POINT.fullmatch(text) is not None)
        if comma and point:
            return None
    return True if comma else (False if point else None)


def _no_number(shown: str, column: str, row: int, text: str) -> BadFileError:
    expected = "a finite number below 1e30, or an empty cell"
    remedy = "correct the cell, or leave it empty where nothing was measured"
    return BadFileError(shown, repr(text[:40]), expected, remedy, row=row, column=column)


def _ambiguous(shown: str, column: str, row: int, text: str) -> BadFileError:
    return BadFileError(
        shown,
        row=row,
        column=column,
        found=f"{text!r}, which may mean {text.replace(',', '.')} or {text.replace(',', '').replace('.', '')}",
        expected="a number that can be read in one way only",
        remedy="export the table without thousands separators and with a decimal point",
    )


def made_numeric(
    columns: dict[str, npt.NDArray[Any]], shown: str, line: npt.NDArray[np.int64]
) -> tuple[list[Note], dict[str, int]]:
    """Turn columns of cells into numbers, in place; times of the clock become seconds since the first.

    `columns` (shape (n_rows,)): cells as read, by name; `line` (shape (n_rows,)): line of each row in the file. Returns
    `notes`: where commas were read as points, and in which format times were read; `epochs`. Raises BadFileError where
    a cell is no number.
    """
    evidence = comma_evidence(list(columns.values()))
    written = dict(columns)
    used = False
    notes: list[Note] = []
    epochs: dict[str, int] = {}
    for name, cells in columns.items():
        timed = _moments(cells, name, shown, line)
        if timed is not None:
            columns[name], epochs[name], form = timed
            text = f"times were read as {TIME_FORMATS[form]}"
            notes.append(Note("info", f"{shown}, column {name}", text, "time_format"))
            continue
        columns[name], comma = numbers(cells, shown=shown, column=name, line=line, decimal_comma=evidence)
        used = used or comma
    if used:
        notes.append(Note("info", shown, "decimal commas were read as decimal points", "decimal_comma"))
        notes += mixed_marks(written, shown, line)
    return notes, epochs


def mixed_marks(columns: Mapping[str, npt.NDArray[Any]], shown: str, line: npt.NDArray[np.int64]) -> list[Note]:
    """Return a note where a table writes decimal commas in some cells and points in others: which, and where.

    `columns` (shape (n_rows,)): cells as text, by name; `line` (shape (n_rows,)): line of each row in the file.
    """
    first: dict[str, tuple[int, str, str]] = {}
    for name, cells in columns.items():
        for mark, form in ((",", _COMMA), (".", _POINT)):
            for row, cell in zip(line.tolist(), cells, strict=True):
                if isinstance(cell, str) and mark in cell and form.fullmatch(cell.strip().replace("−", "-")):
                    first[mark] = min(first.get(mark, (row, name, cell)), (row, name, cell))
                    break
    if len(first) < 2:
        return []
    (row, name, cell), (other_row, other_name, other_cell) = first[","], first["."]
    text = (
        f"a decimal comma ({cell.strip()!r:.40}) and, in row {other_row}, column {other_name}, a decimal point "
        f"({other_cell.strip()!r:.40}); both were read as decimal marks: look whether one of them separates thousands"
    )
    return [Note("suspicious", f"{shown}, row {row}, column {name}", text, "decimal_marks")]


def _moments(
    cells: npt.NDArray[Any], column: str, shown: str, line: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.float64], int, str] | None:
    """Return seconds since the first cell, that first time and its format; None where the first cell is no time."""
    first = next((cell for cell in cells if cell is not None and str(cell).strip()), None)
    form = time_format(first) if isinstance(first, str) else None
    if form is None:
        return None
    time_ns, bad = moments_ns(cells)
    if bad is not None:
        raise BadFileError(
            shown,
            row=int(line[bad]),
            column=column,
            found=repr(str(cells[bad])[:40]) if cells[bad] is not None else "an empty cell",
            expected=f"a time as {TIME_FORMATS[form]}",
            remedy="correct the cell, or remove the row",
        )
    start = int(time_ns[0])
    return (time_ns - start) / 1e9, start, form
