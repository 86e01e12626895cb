"""Tables as laboratories keep them: header rows, units, remarks, sums, merged cells, loggers' remarks and blanks."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.readers import Layout, RawTable, read_table
from calib.campaign.readers.sheets import looks_like_units
from calib.errors import BadFileError

LAB = Layout(lab=True)
ROWS = [["Run 1", "out", 40250.5], ["Run 2", "back", 41000.25], ["Run 3", "out", 39000.0]]


def _csv(folder: Path, text: str, layout: Layout = LAB) -> RawTable:
    (folder / "t.csv").write_text(text, encoding="utf-8")
    return read_table(folder / "t.csv", "t", None, layout)


def _book(folder: Path, rows: list[list[object]], merged: tuple[str, ...] = ()) -> RawTable:
    import openpyxl

    book = openpyxl.Workbook()
    for row in rows:
        book.active.append(row)
    for cells in merged:
        book.active.merge_cells(cells)
    book.save(folder / "t.xlsx")
    return read_table(folder / "t.xlsx", "t", None, LAB)


def _said(table: RawTable) -> str:
    return "\n".join(note.where + ": " + note.text for note in table.notes)


@pytest.mark.parametrize(
    ("units", "names", "unknown"),
    [
        (["", "", "mm"], ["Run", "Way", "Dist [mm]"], ""),
        (["[-]", "[hh:mm]", "[mm/s]"], ["Run", "Way [hh:mm]", "Dist [mm/s]"], "hh:mm (Way)"),
        (["ms", "cnt", "V"], ["Run [ms]", "Way [cnt]", "Dist [V]"], "V (Dist)"),
        (
            ["[furlong]", "[fathom]", "[m]"],
            ["Run [furlong]", "Way [fathom]", "Dist [m]"],
            "furlong (Run), fathom (Way)",
        ),
    ],
)
@pytest.mark.parametrize("kind", ["csv", "xlsx"])
def test_a_row_of_units_is_no_row_whatever_stands_in_it(
    kind: str, units: list[str], names: list[str], unknown: str, tmp_path: Path
) -> None:
    """An unknown unit is said and kept in the name; the rows beneath are the same."""
    rows: list[list[object]] = [["Run", "Way", "Dist"], list(units), *map(list, ROWS)]
    if kind == "csv":
        table = _csv(tmp_path, "\n".join(";".join(map(str, row)) for row in rows) + "\n")
    else:
        table = _book(tmp_path, [[cell or None for cell in row] for row in rows])
    assert list(table.columns) == names
    assert [float(cell) for cell in table.columns[names[2]]] == [row[2] for row in ROWS]
    assert (f"not converted: {unknown}" in _said(table)) == bool(unknown)
    assert table.line.tolist() == [3, 4, 5]


@pytest.mark.parametrize(
    ("row", "is_units"),
    [
        (["mm", "cnt", ""], True),
        (["[hh:mm]", "", "x"], True),
        (["Run 1", "out", "40"], False),
        (["left", "right"], False),
        (["m", "a longer remark", "s"], True),
        ([None, None], False),
    ],
)
def test_units_look_like_units(row: list[str | None], is_units: bool) -> None:
    assert looks_like_units(row) == is_units


def test_several_header_rows_make_one_name(tmp_path: Path) -> None:
    """A name that is empty, a side only or there twice takes the group above it; others keep theirs."""
    text = "Run;Load;;Encoder;\n;left;right;left;right\n;kg;kg;;\na;30.5;31;100;110\nb;30.5;31;200;210\n"
    table = _csv(tmp_path, text)
    assert list(table.columns) == ["Run", "Load left [kg]", "Load right [kg]", "Encoder left", "Encoder right"]
    assert table.columns["Run"].tolist() == ["a", "b"]


def test_a_second_row_of_names_stands_over_a_part_of_the_columns(tmp_path: Path) -> None:
    """Sides beneath one heading, then units: no data row, though it is narrow."""
    text = "Protokoll;;;;\nNr.;Datum;Strecke;Radlast;\n;;;links;rechts\n;;mm;kg;kg\n"
    rows = "".join(f"{k};04.05.2026;4020{k},5;30,{k};31,{k}\n" for k in range(5))
    table = _csv(tmp_path, text + rows)
    assert list(table.columns) == ["Nr.", "Datum", "Strecke [mm]", "Radlast links [kg]", "Radlast rechts [kg]"]
    assert len(table.line) == 5


def test_rows_named_in_the_mapping_are_taken(tmp_path: Path) -> None:
    text = "a;b\nc;d\nodd;odd\nx;y\n1;2\n3;4\n"
    table = _csv(tmp_path, text, Layout(header_row=1, units_row=4, skip_rows=(2, 3), lab=True))
    assert list(table.columns) == ["a [x]", "b [y]"]
    assert table.columns["a [x]"].tolist() == ["1", "3"]
    with pytest.raises(BadFileError, match="correct units_row"):
        _csv(tmp_path, text, Layout(header_row=1, units_row=60, lab=True))


def test_remarks_means_and_sums_are_omitted_and_said(tmp_path: Path) -> None:
    """At the end and in between; a run of which nothing but its name is known stays."""
    rows: list[list[object]] = [["Run", "Way", "Dist [mm]"], *ROWS[:1], ["tyres changed"], *ROWS[1:], ["Run 4"]]
    rows += [["Mittelwert", None, 40083.6], ["Summe:", None, 120250.75], [None, None, None], ["Ende"]]
    table = _book(tmp_path, rows)
    assert table.columns["Run"].tolist() == ["Run 1", "Run 2", "Run 3", "Run 4"]
    for words in (
        "row 3: 'tyres changed' is a remark",
        "row 7: 'Mittelwert' is a mean",
        "row 8: 'Summe:'",
        "row 10: 'Ende'",
    ):
        assert words in _said(table)


def test_merged_cells_are_filled_and_dates_are_as_they_stand(tmp_path: Path) -> None:
    """A day merged over two rows is both rows' day; no time of day is added to a date."""
    day = datetime.date(2026, 5, 4)
    rows: list[list[object]] = [["Run", "Day", "Dist"], ["a", day, 1.5], ["b", None, 2.5], ["c", day, 3.5]]
    table = _book(tmp_path, rows, ("B2:B3",))
    assert table.columns["Day"].tolist() == ["2026-05-04"] * 3
    assert "1 cells of merged ranges were filled" in _said(table)
    clock = datetime.datetime(2026, 5, 4, 8, 30)
    table = _book(tmp_path, [["Run", "Start", "Dist"], ["a", clock, 1.5], ["b", datetime.datetime(2026, 5, 5), 2.5]])
    assert table.columns["Start"].tolist() == ["2026-05-04 08:30:00", "2026-05-05 00:00:00"]


def test_a_cell_beside_the_table_is_omitted_with_a_note(tmp_path: Path) -> None:
    table = _book(tmp_path, [["Run", "Dist"], ["a", 1.5], ["b", 2.5, "repeat?"]])
    assert list(table.columns) == ["Run", "Dist"]
    assert "row 3: 'repeat?' stands beside the table" in _said(table)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("# DL 8\n# t l r\n0.0 1 2\n0.1 3 4\n", ["t", "l", "r"]),
        ("# DL 8\nt\tl\tr\ns\tcnt\tcnt\n# started\n0.0\t1\t2\n0.1\t3\t4\n# end\n", ["t [s]", "l [cnt]", "r [cnt]"]),
        ("  0.0    1   2\n  0.1    3   4\n", ["column 1", "column 2", "column 3"]),
        ("t   l   r\n 0,0  1   2\n 0,1   3   4\n", ["t", "l", "r"]),
        ("#t;l;r\n0.0;1;2\n0.1;3;4\n", ["t", "l", "r"]),
        ("t,l,r\n0.0,1,2\n# a note, with, commas\n0.1,3,4\n", ["t", "l", "r"]),
    ],
    ids=["names in a remark", "units and remarks", "blanks, no names", "blanks, commas", "a hash", "a remark inside"],
)
def test_loggers_files_are_read_as_they_are(text: str, names: list[str], tmp_path: Path) -> None:
    """Remarks, blanks between the cells, no names: the same numbers, and rows numbered as in the file."""
    (tmp_path / "log.txt").write_text(text)
    table = read_table(tmp_path / "log.txt", "log", lambda _: True, LAB)
    assert list(table.columns) == names
    np.testing.assert_array_equal(np.column_stack(list(table.columns.values())), [[0.0, 1, 2], [0.1, 3, 4]])
    lines = text.splitlines()
    first = next(at for at, line in enumerate(lines, 1) if line.replace(",", ".").split(";")[0].split()[0][:3] == "0.0")
    assert table.line[0] == first


def test_a_campaigns_own_table_is_read_strictly(tmp_path: Path) -> None:
    """None of this holds for the files of a campaign."""
    with pytest.raises(BadFileError, match="numbers alone"):
        _csv(tmp_path, "0,1,2\n1,2,3\n2,3,4\n", Layout())
    assert _csv(tmp_path, "a,b,c\n1,2,3\nmean,2,3\n", Layout()).columns["a"].tolist() == ["1", "mean"]


@pytest.mark.parametrize("book", [False, True])
def test_a_header_that_comes_again_is_no_row(book: bool, tmp_path: Path) -> None:
    """Each block of a load, or page, begins with the header: its rows are omitted with a note, what differs is kept."""
    head = [["Run", "Weg", "Last L", "Last R"], [None, "mm", "N", "N"]]
    rows = [[1, 20100, 300, 301], [2, 20200, 300, 301], *head, [3, 20300, 400, 401], ["Run", "Weg", "Last L", "?"]]
    if book:
        table = _book(tmp_path, [*head, *rows])
    else:
        lines = (";".join("" if cell is None else str(cell) for cell in row) for row in [*head, *rows])
        table = _csv(tmp_path, "\n".join(lines) + "\n")
    assert [str(cell)[:3].removesuffix(".0") for cell in table.columns["Run"]] == ["1", "2", "3", "Run"]
    assert [note.where.partition(", ")[2] for note in table.notes if "header again" in note.text] == ["row 5", "row 6"]


def test_formulas_without_results_are_named(tmp_path: Path) -> None:
    """A program that writes a workbook computes nothing: the cells are empty until a spreadsheet program saves it."""
    rows: list[list[object]] = [["run", "start", "end", "distance_m"]]
    rows += [[f"r{at}", 0.5, 10.5 + at, f"=C{at + 2}-B{at + 2}"] for at in range(3)]
    assert "column distance_m: 3 formulas without results" in _said(_book(tmp_path, rows))
    assert "formulas" not in _said(_book(tmp_path, [[*row[:3], None] if at else row for at, row in enumerate(rows)]))
