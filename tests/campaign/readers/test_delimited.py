"""Text tables: read by numpy, by pandas, in a batch or cell by cell they give the same; tables that change half way
(delimiter, decimal mark, width of a row, a cut end) are refused or noted, by place.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.readers import read_table
from calib.campaign.readers.delimited import NUMPY_BYTES, numpy_table, of_one_width, read_batch
from calib.campaign.readers.table import RawTable
from calib.errors import BadFileError

#: samples of a log: more the header is looked for in, and than are read by numpy
FEW_ROWS, MANY_ROWS = 200, 8000
#: share of the rows before the change
CHANGE_AT = 0.5
HEADER = "t_s,counts_left,counts_right,note\n"
PLAIN = {
    "whole": "0,1,2,x\n1,3,4,y\n",
    "decimal": "0.125,1.5,2e3,x\n0.3333333333333333,-7,+4,y\n",
    "no end": "0,1,2,x\n1,3,4,y",
    "gap": "0,,2,x\n1,3,nan,y\n",
}
ODD = {
    "text in a number": "0,x,2,x\n",
    "quotes": '0,"1",2,x\n',
    "semicolons": "0;1;2;x\n",
    "carriage returns": "0,1,2,x\r\n1,3,4,y\r\n",
    "a cell too many": "0,1,2,x,9\n1,3,4,y\n",
    "a row that makes up for another": "0,1,2,x,9\n1,3,4\n",
    "an empty row": "0,1,2,x\n\n1,3,4,y\n",
    "a zero with a sign": "0,-0,2,x\n",
    "too large": "0,1e31,2,x\n",
    "beyond whole numbers": "0,12345678901234567,2.5,x\n0.5,1.5,1,x\n",
    "not ASCII": "0,1,2,µ\n",
    "nothing": "",
}


def table(rows: list[list[str]], delimiter: str = ",") -> bytes:
    return "".join(delimiter.join(row) + "\n" for row in rows).encode()


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_numbers_are_what_pandas_reads(delimiter: str) -> None:
    """Counts, decimals of any length, signs and exponents."""
    pd = pytest.importorskip("pandas")
    rng = np.random.default_rng(3)
    rows = [[f"{k}", f"{value:.17g}", f"{value:+.3e}", f"{-k}."] for k, value in enumerate(rng.normal(size=200) * 1e3)]
    body = table(rows, delimiter)
    values = numpy_table(body, len(rows), 4, delimiter)
    assert values is not None
    expected = pd.read_csv(io.BytesIO(body), header=None, sep=delimiter).to_numpy(np.float64)
    # pandas parses seventeen digits to within one unit in the last place
    np.testing.assert_allclose(values, expected, rtol=3e-16, atol=0.0)


@pytest.mark.parametrize("cell", ["", "-", "nan", " 1", "1_0", "0x1", "1e", "1.2.3", "inf", '"1"', "1,5", "#"])
def test_anything_but_a_number_is_read_cell_by_cell(cell: str) -> None:
    assert numpy_table(table([["1", "2"], ["3", cell]], ";"), 2, 2, ";") is None


def test_a_blank_or_a_short_row_is_read_cell_by_cell() -> None:
    assert numpy_table(b"1,2\n\n3,4\n", 3, 2, ",") is None
    assert numpy_table(b"1,2\n3\n", 2, 2, ",") is None


def test_a_large_table_is_left_to_pandas() -> None:
    rows = [["1", "2"]] * (NUMPY_BYTES // 4 + 1)
    assert numpy_table(table(rows), len(rows), 2, ",") is None
    assert numpy_table(table(rows[1:]), len(rows) - 1, 2, ",") is not None


def _not_a_note(name: str) -> bool:
    return name != "note"


def _written(folder: Path, contents: dict[str, str]) -> list[tuple[Path, str]]:
    files = []
    for name, rows in contents.items():
        path = folder / f"{name}.csv"
        path.write_bytes((HEADER + rows).encode())
        files.append((path, name))
    return files


def test_plain_files_give_what_each_gives_by_itself(tmp_path: Path) -> None:
    """Whole numbers beside decimals, a last line without an end, gaps: columns, their order, and lines."""
    files = _written(tmp_path, PLAIN)
    for (path, name), table in zip(files, read_batch(files, _not_a_note), strict=True):
        alone = read_table(path, name, _not_a_note)
        assert table is not None
        assert list(table.columns) == list(alone.columns)
        for column, values in alone.columns.items():
            assert table.columns[column].tobytes() == np.asarray(values, dtype=np.float64).tobytes()
        np.testing.assert_array_equal(table.line, alone.line)
        assert table.notes == alone.notes


@pytest.mark.parametrize("odd", ODD)
def test_an_odd_file_changes_no_other(tmp_path: Path, odd: str) -> None:
    """Beside the plain ones it is omitted, or gives what it gives by itself; so do they."""
    files = _written(tmp_path, PLAIN | {odd: ODD[odd]})
    tables = read_batch(files, _not_a_note)
    for (path, name), table in zip(files, tables, strict=True):
        if table is None:
            continue
        alone = read_table(path, name, _not_a_note)
        for column, values in alone.columns.items():
            assert table.columns[column].tobytes() == np.asarray(values, dtype=np.float64).tobytes()
    if odd not in {"beyond whole numbers", "an empty row"}:
        assert tables[-1] is None


def test_other_headers_are_read_apart(tmp_path: Path) -> None:
    """A file whose columns stand in another order is not mixed up; one that names a column twice is omitted."""
    files = _written(tmp_path, PLAIN)
    (other := tmp_path / "other.csv").write_text("counts_left,t_s,counts_right\n5,0,7\n")
    (twice := tmp_path / "twice.csv").write_text("t_s,t_s\n5,0\n")
    tables = read_batch([*files, (other, "other"), (twice, "twice"), (tmp_path / "none.csv", "none")], _not_a_note)
    assert tables[4] is not None
    assert [float(column[0]) for column in tables[4].columns.values()] == [5.0, 0.0, 7.0]
    assert tables[5] is tables[6] is None
    with pytest.raises(BadFileError, match="twice"):
        read_table(twice, "twice", _not_a_note)


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


#: name -> the change of the lines from a row on, the words on that row
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


@pytest.mark.parametrize("rows", [FEW_ROWS, MANY_ROWS])
@pytest.mark.parametrize("beside", ["", "a column of texts"])
@pytest.mark.parametrize("name", list(REFUSED))
def test_a_row_of_another_form_is_refused_by_its_number(name: str, beside: str, rows: int, tmp_path: Path) -> None:
    """However far down, and where the last column, which would be empty, is none that is read."""
    lines = _log(rows, more=",note", cells=",fine") if beside else _log(rows)
    change, words = REFUSED[name]
    at = int(CHANGE_AT * rows)
    with pytest.raises(BadFileError, match=words) as caught:
        _read(tmp_path / "log.csv", change(lines, at))
    assert caught.value.row == at + 1


@pytest.mark.parametrize("rows", [FEW_ROWS, MANY_ROWS])
def test_a_decimal_mark_that_changes_is_noted_by_row_and_column(rows: int, tmp_path: Path) -> None:
    """Both are read as decimal marks, and the first cell of each is named."""
    at = int(CHANGE_AT * rows)
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
