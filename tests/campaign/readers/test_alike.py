"""Tables read together are the tables that each file gives by itself, to the bit; the odd ones are left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.campaign.readers import read_table
from calib.campaign.readers.alike import read_alike
from calib.errors import BadFileError

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


def _wanted(name: str) -> bool:
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
    for (path, name), table in zip(files, read_alike(files, _wanted), strict=True):
        alone = read_table(path, name, _wanted)
        assert table is not None
        assert list(table.columns) == list(alone.columns)
        for column, values in alone.columns.items():
            assert table.columns[column].tobytes() == np.asarray(values, dtype=np.float64).tobytes()
        np.testing.assert_array_equal(table.line, alone.line)
        assert table.notes == alone.notes


@pytest.mark.parametrize("odd", ODD)
def test_an_odd_file_changes_no_other(tmp_path: Path, odd: str) -> None:
    """Beside the plain ones it is left out, or gives what it gives by itself; so do they."""
    files = _written(tmp_path, PLAIN | {odd: ODD[odd]})
    tables = read_alike(files, _wanted)
    for (path, name), table in zip(files, tables, strict=True):
        if table is None:
            continue
        alone = read_table(path, name, _wanted)
        for column, values in alone.columns.items():
            assert table.columns[column].tobytes() == np.asarray(values, dtype=np.float64).tobytes()
    if odd not in {"beyond whole numbers", "an empty row"}:
        assert tables[-1] is None


def test_other_headers_are_read_apart(tmp_path: Path) -> None:
    """A file whose columns stand in another order is not mixed up; one that names a column twice is left out."""
    files = _written(tmp_path, PLAIN)
    (other := tmp_path / "other.csv").write_text("counts_left,t_s,counts_right\n5,0,7\n")
    (twice := tmp_path / "twice.csv").write_text("t_s,t_s\n5,0\n")
    tables = read_alike([*files, (other, "other"), (twice, "twice"), (tmp_path / "none.csv", "none")], _wanted)
    assert tables[4] is not None
    assert [float(column[0]) for column in tables[4].columns.values()] == [5.0, 0.0, 7.0]
    assert tables[5] is tables[6] is None
    with pytest.raises(BadFileError, match="twice"):
        read_table(twice, "twice", _wanted)
