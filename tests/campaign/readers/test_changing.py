"""Tables that change half way (separator, decimal mark, width of a row, a cut end) are refused or said, by place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.readers import read_table
from calib.campaign.readers.layout import of_one_width
from calib.campaign.readers.table import RawTable
from calib.errors import BadFileError

#: samples of a log: more than are looked at in search of the header, and than are read by numpy
FEW, MANY = 200, 8000
HALF = 0.5


def _log(rows: int, *, more: str = "", cells: str = "") -> list[str]:
    return [f"t_s,counts_left,counts_right{more}", *(f"{0.1 * k:.1f},{8 * k},{9 * k}{cells}" for k in range(rows))]


def _wanted(name: str) -> bool:
    return name in {"t_s", "counts_left", "counts_right"}


def _read(path: Path, lines: list[str]) -> RawTable:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return read_table(path, path.name, _wanted)


def _from(lines: list[str], first: int, change: Callable[[str], str], last: int | None = None) -> list[str]:
    return [*lines[:first], *map(change, lines[first:last]), *(lines[last:] if last else [])]


def _semicolons(line: str) -> str:
    return line.replace(",", ";")


def _tabs(line: str) -> str:
    return line.replace(",", "\t")


def _short(line: str) -> str:
    return line.rpartition(",")[0]


def _long(line: str) -> str:
    return line.replace(",", ",5,", 1)


#: name -> what becomes of the lines from a row on, what is said of that row
REFUSED: dict[str, tuple[Callable[[list[str], int], list[str]], str]] = {
    "semicolons after commas": (
        lambda lines, at: _from(lines, at, _semicolons),
        "by semicolons, those above by commas",
    ),
    "commas after semicolons": (
        lambda lines, at: [*map(_semicolons, lines[:at]), *lines[at:]],
        "by commas, those above by semicolons",
    ),
    "tabs after commas": (lambda lines, at: _from(lines, at, _tabs), "by tabs, those above by commas"),
    "decimal commas between commas": (
        lambda lines, at: _from(lines, at, lambda line: line.replace(".", ",")),
        "export with semicolons where commas are decimal",
    ),
    "a row too long beside one too short": (
        lambda lines, at: _from(_from(lines, at, _long, at + 1), at + 1, _short, at + 2),
        "cells; expected",
    ),
    "a row too short beside one too long": (
        lambda lines, at: _from(_from(lines, at, _short, at + 1), at + 1, _long, at + 2),
        "cells; expected",
    ),
    "a row cut off": (lambda lines, at: _from(lines[: at + 1], at, _short), "the file may have been cut"),
}  # fmt: skip


@pytest.mark.parametrize("rows", [FEW, MANY])
@pytest.mark.parametrize("beside", ["", "a column of texts"])
@pytest.mark.parametrize("name", list(REFUSED))
def test_a_row_of_another_make_is_refused_by_its_number(name: str, beside: str, rows: int, tmp_path: Path) -> None:
    """However far down, and where the last column, which would be empty, is none that is read."""
    lines = _log(rows, more=",note", cells=",fine") if beside else _log(rows)
    change, words = REFUSED[name]
    at = int(HALF * rows)
    with pytest.raises(BadFileError, match=words) as caught:
        _read(tmp_path / "log.csv", change(lines, at))
    assert caught.value.row == at + 1


@pytest.mark.parametrize("rows", [FEW, MANY])
def test_a_decimal_mark_that_changes_is_said_by_row_and_column(rows: int, tmp_path: Path) -> None:
    """Both are read as decimal marks, and the first cell of each is named."""
    at = int(HALF * rows)
    points = [line.replace(",", ";") for line in _log(rows)]
    table = _read(tmp_path / "log.csv", _from(points, at, lambda line: line.replace(".", ",")))
    np.testing.assert_array_equal(table.columns["t_s"], [float(f"{0.1 * k:.1f}") for k in range(rows)])
    [note] = [note for note in table.notes if note.code == "decimal_marks"]
    assert note.level == "suspicious"
    assert note.where == f"log.csv, row {at + 1}, column t_s"
    assert "in row 2, column t_s, a decimal point ('0.0')" in note.text


@pytest.mark.parametrize("body", ["1,2\n3,4\n", "1,2\n3,4", "1,2,3\n4\n", "1\n2,3,4\n", "1,2\n\n", "1;2\n3;4\n"])
def test_lines_are_of_one_width_or_not(body: str) -> None:
    """Against the count of each line by itself; the end of the last one may lack."""
    assert of_one_width(body.encode(), 2, ",") == all(line.count(",") == 1 for line in body.splitlines())
