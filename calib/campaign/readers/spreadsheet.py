"""Excel workbooks (``.xlsx``): the first sheet that holds a table, or the one asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from calib.campaign.model import Note
from calib.campaign.readers.layout import LOOKED_AT, Layout, find_header, with_units
from calib.campaign.readers.table import RawTable, Wanted, made_numeric, objects, refuse_duplicates
from calib.campaign.readers.workbook_size import weigh
from calib.errors import BadFileError


def read(path: Path, shown: str, wanted: Wanted | None, layout: Layout) -> RawTable:
    """Read a sheet of a workbook; see `calib.campaign.readers.read_table`."""
    import openpyxl

    last_row = weigh(path, shown)
    notes: list[Note] = []
    try:
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        try:
            sheet_name, header, rows, lines = _sheet(book, shown, layout, last_row)
            if len(book.sheetnames) > 1 and header:
                text = f"the workbook has {len(book.sheetnames)} sheets; {sheet_name!r} was read"
                notes.append(Note("info", shown, text, "sheet"))
        finally:
            book.close()
    except (BadFileError, MemoryError):
        raise
    except Exception as error:
        # the library answers damaged workbooks with errors of many kinds (zip, XML, keys, values)
        expected = "an .xlsx file that a spreadsheet program opens"
        remedy = "open it and save it again, or export it as CSV"
        raise BadFileError(shown, f"a damaged workbook ({type(error).__name__})", expected, remedy) from error
    if not header:
        raise BadFileError(shown, found="no cells", expected="a header line and rows", remedy="export the table again")
    refuse_duplicates(header, shown, row=lines[0] if lines else 1)
    if lines[0] > 1:
        notes.append(Note("info", shown, f"the header was found in row {lines[0]}", "preamble"))
    if rows and (named := with_units(header, rows[0])):
        header, rows, lines = named, rows[1:], [lines[0], *lines[2:]]
        notes.append(Note("info", shown, "the row beneath the header names units", "unit_row"))
    line = np.asarray(lines[1:], dtype=np.int64)
    columns: dict[str, Any] = {}
    for index, name in enumerate(header):
        if name and (wanted is None or wanted(name)):
            columns[name] = objects([row[index] if index < len(row) else None for row in rows])
    epochs: dict[str, int] = {}
    if wanted is not None:
        said, epochs = made_numeric(columns, shown, line)
        notes += said
    return RawTable(columns, line, tuple(notes), epochs)


def _sheet(book: Any, shown: str, layout: Layout, last_row: int) -> tuple[str, list[str], list[list[Any]], list[int]]:
    """Return name, header, rows and line numbers of the sheet asked for, or of the first that holds a table."""
    if layout.sheet is not None and layout.sheet not in book.sheetnames:
        expected = f"a sheet {layout.sheet!r}"
        remedy = "correct sheet of the mapping"
        raise BadFileError(shown, f"the sheets {', '.join(map(str, book.sheetnames))[:200]}", expected, remedy)
    first: tuple[str, list[str], list[list[Any]], list[int]] = ("", [], [], [])
    for sheet in book.worksheets:
        if layout.sheet is not None and sheet.title != layout.sheet:
            continue
        sheet.reset_dimensions()
        filled = _filled(sheet, last_row)
        header_at = _header_at(filled, layout, shown)
        if header_at is None and (first[1] or not filled):
            continue
        table = (str(sheet.title), *_cells(filled, header_at or 0, shown))
        if header_at is not None:
            return table
        first = table
    return first


def _filled(sheet: Any, last_row: int) -> list[tuple[int, list[Any]]]:
    """Return the rows that hold cells, with their numbers."""
    filled = []
    for number, values in enumerate(sheet.iter_rows(max_row=last_row or None, values_only=True), start=1):
        cells = [_cell(value) for value in values]
        if any(cell is not None for cell in cells):
            filled.append((number, cells))
    return filled


def _header_at(filled: list[tuple[int, list[Any]]], layout: Layout, shown: str) -> int | None:
    if layout.header_row is None:
        return find_header([cells for _, cells in filled[:LOOKED_AT]])
    at = next((index for index, (number, _) in enumerate(filled) if number == layout.header_row), None)
    if at is None:
        remedy = "correct header_row of the mapping"
        raise BadFileError(shown, "no cells", "the header, as the mapping says", remedy, row=layout.header_row)
    return at


def _cells(filled: list[tuple[int, list[Any]]], at: int, shown: str) -> tuple[list[str], list[list[Any]], list[int]]:
    number, cells = filled[at]
    header = ["" if cell is None else str(cell).strip() for cell in cells]
    while header and not header[-1]:
        header.pop()
    rows: list[list[Any]] = []
    lines = [number]
    for number, cells in filled[at + 1 :]:
        extra = [cell for cell in cells[len(header) :] if cell is not None]
        if extra:
            expected = f"at most {len(header)} cells, as the header in row {lines[0]} has"
            remedy = "name the column, remove the cell, or name the header's row (header_row)"
            raise BadFileError(shown, f"{str(extra[0])[:40]!r} beside the table", expected, remedy, row=number)
        rows.append(cells)
        lines.append(number)
    return header, rows, lines


def _cell(value: Any) -> Any:
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return float(value)
    return str(value)
