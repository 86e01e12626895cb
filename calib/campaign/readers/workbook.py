"""Excel workbooks (``.xlsx``): the first sheet that holds a table, or the one asked for.

What a workbook unpacks to is counted before a library lays out every empty place between its cells.
"""

from __future__ import annotations

import re
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.campaign.model import Note
from calib.campaign.readers.table import (
    HEADER_ROWS,
    Layout,
    RawTable,
    Wanted,
    check_header,
    find_header,
    header_with_units,
    object_array,
    to_numbers,
)
from calib.errors import BadFileError
from calib.limits import SHEET_CELLS, SHEET_EMPTY, SHEET_UNPACKED_BYTES, SHEETS, refuse_beyond

#: parts of the archive that hold cells and their texts; all others describe, and are small
_SHEET_PART: Final = re.compile(r"(?i)/?xl/worksheets/[^/]*\.xml")
_TEXTS_PART: Final = re.compile(r"(?i)/?xl/sharedstrings\.xml")
_OTHER_PART: Final = re.compile(r"(?i).*\.(xml|rels)")
_OTHER_BYTES: Final = 8 << 20
#: XML read at once; no element of a sound workbook is as long
_BLOCK_BYTES: Final = 1 << 20
#: column, row, and whether the cell ends at once and so holds nothing
_CELL: Final = re.compile(rb"<(?:\w{1,20}:)?c\s[^<>]*?\br=[\"']([A-Z]{1,3})([0-9]{1,7})[\"'][^<>]*?(/?)>")
_ROW: Final = re.compile(rb"<(?:\w{1,20}:)?row\b")
_TEXT: Final = re.compile(rb"<(?:\w{1,20}:)?si\b")
_DAMAGE: Final = (zipfile.BadZipFile, zlib.error, ValueError, NotImplementedError, EOFError, RuntimeError)
_REMEDY: Final = "export the table as CSV or Parquet"
_HEADER_ROW_REMEDY: Final = "correct header_row of the mapping"


def read(path: Path, shown: str, wanted: Wanted | None, layout: Layout) -> RawTable:
    """Read a sheet of a workbook; see `calib.campaign.readers.read_table`."""
    import openpyxl

    last_row = check_size(path, shown)
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
    check_header(header, shown, row=lines[0])
    if lines[0] > 1:
        notes.append(Note("info", shown, f"the header was found in row {lines[0]}", "preamble"))
    if rows and (named := header_with_units(header, rows[0])):
        header, rows, lines = named, rows[1:], [lines[0], *lines[2:]]
        notes.append(Note("info", shown, "the row beneath the header names units", "unit_row"))
    line = np.asarray(lines[1:], dtype=np.int64)
    columns: dict[str, Any] = {}
    for index, name in enumerate(header):
        if name and (wanted is None or wanted(name)):
            columns[name] = object_array([row[index] if index < len(row) else None for row in rows])
    epochs: dict[str, int] = {}
    if wanted is not None:
        number_notes, epochs = to_numbers(columns, shown, line)
        notes += number_notes
    return RawTable(columns, line, tuple(notes), epochs)


def _sheet(book: Any, shown: str, layout: Layout, last_row: int) -> tuple[str, list[str], list[list[Any]], list[int]]:
    """Return name, header, rows and line numbers of the sheet asked for, or of the first that holds a table."""
    if layout.sheet is not None and layout.sheet not in book.sheetnames:
        found = f"the sheets {', '.join(map(str, book.sheetnames))[:200]}"
        raise BadFileError(shown, found, f"a sheet {layout.sheet!r}", "correct sheet of the mapping")
    first: tuple[str, list[str], list[list[Any]], list[int]] = ("", [], [], [])
    for sheet in book.worksheets:
        if layout.sheet is not None and sheet.title != layout.sheet:
            continue
        sheet.reset_dimensions()
        filled = []
        for number, values in enumerate(sheet.iter_rows(max_row=last_row or None, values_only=True), start=1):
            cells = [_cell(value) for value in values]
            if any(cell is not None for cell in cells):
                filled.append((number, cells))
        header_at = _header_index(filled, layout, shown)
        if header_at is None and (first[1] or not filled):
            continue
        table = (str(sheet.title), *_rows_below(filled, header_at or 0, shown))
        if header_at is not None:
            return table
        first = table
    return first


def _header_index(filled: list[tuple[int, list[Any]]], layout: Layout, shown: str) -> int | None:
    if layout.header_row is None:
        return find_header([cells for _, cells in filled[:HEADER_ROWS]])
    index = next((index for index, (number, _) in enumerate(filled) if number == layout.header_row), None)
    if index is None:
        expected = "the header, as the mapping says"
        raise BadFileError(shown, "no cells", expected, _HEADER_ROW_REMEDY, row=layout.header_row)
    return index


def _rows_below(
    filled: list[tuple[int, list[Any]]], header_at: int, shown: str
) -> tuple[list[str], list[list[Any]], list[int]]:
    """Return the header, the rows beneath it, and the line numbers of all of them."""
    header = ["" if cell is None else str(cell).strip() for cell in filled[header_at][1]]
    while header and not header[-1]:
        header.pop()
    lines = [number for number, _ in filled[header_at:]]
    rows = [cells for _, cells in filled[header_at + 1 :]]
    for number, cells in zip(lines[1:], rows, strict=True):
        extra = [cell for cell in cells[len(header) :] if cell is not None]
        if extra:
            expected = f"at most {len(header)} cells, as the header in row {lines[0]} has"
            remedy = "name the column, remove the cell, or name the header's row (header_row)"
            raise BadFileError(shown, f"{str(extra[0])[:40]!r} beside the table", expected, remedy, row=number)
    return header, rows, lines


def _cell(value: Any) -> Any:
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, bool):
        return "true" if value else "false"
    return float(value) if isinstance(value, int | float) else str(value)


def check_size(path: Path, shown: str) -> int:
    """Refuse a workbook that holds more than `calib.limits` allows, or few cells that are spread widely.

    Returns the number of the last row, of any sheet, in which a cell holds something; what is below need not be read.
    Raises BadFileError where it is no zip archive, or beyond the limits.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            return _check_parts(archive, shown)
    except _DAMAGE as error:
        found = "no workbook (it is not a zip archive, or a damaged one)"
        remedy = "save it again as .xlsx, or export it as CSV"
        raise BadFileError(shown, found, "an .xlsx file", remedy) from error


def _check_parts(archive: zipfile.ZipFile, shown: str) -> int:
    def check(count: int, most: int, what: str, remedy: str = _REMEDY) -> None:
        refuse_beyond(count, most, shown=shown, what=what, remedy=remedy)

    entries = archive.infolist()
    check(sum(entry.file_size for entry in entries), SHEET_UNPACKED_BYTES, "bytes unpacked")
    sheets = [entry for entry in entries if _SHEET_PART.fullmatch(entry.filename)]
    check(len(sheets), SHEETS, "sheets", "keep the sheet with the table")
    texts = [entry for entry in entries if _TEXTS_PART.fullmatch(entry.filename)]
    others = [entry for entry in entries if _OTHER_PART.fullmatch(entry.filename) and entry not in (*sheets, *texts)]
    check(sum(entry.file_size for entry in others), _OTHER_BYTES, "bytes of styles and the like")
    n_texts = sum(len(_TEXT.findall(block)) for entry in texts for block in _blocks(archive, entry))
    check(n_texts, SHEET_CELLS, "texts")
    cells = empty = last_row = 0
    for entry in sheets:
        sheet_cells, sheet_empty, sheet_last = _extent(archive, entry)
        cells, empty, last_row = cells + sheet_cells, empty + sheet_empty, max(last_row, sheet_last)
        check(cells, SHEET_CELLS, "cells")
        remedy = f"delete rows and columns that hold nothing, or {_REMEDY}"
        check(empty, SHEET_EMPTY, "empty places between the cells", remedy)
    return last_row


def _extent(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> tuple[int, int, int]:
    """Return a sheet's filled cells, the empty places and rows before the last of them, and the last filled row.

    Counted without a parser: an element that is written in no usual way is left to the library.
    """
    from openpyxl.utils import column_index_from_string

    cells = rows = places = last_row = waiting = 0
    row, column = b"", b"A"
    for block in _blocks(archive, entry):
        rows += len(_ROW.findall(block))
        for letters, digits, is_empty in _CELL.findall(block):
            if digits != row:
                waiting += column_index_from_string(column.decode()) if row else 0
                row = digits
            column = letters
            if not is_empty:
                cells += 1
                last_row = max(last_row, int(digits))
                places, waiting = places + waiting, 0
    places += column_index_from_string(column.decode()) if row and cells else 0
    return cells, max(0, last_row - rows) + max(0, places - cells), last_row


def _blocks(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> Iterator[bytes]:
    """Yield the text of a part in blocks, cut where an element begins."""
    held = b""
    with archive.open(entry) as stream:
        while block := stream.read(_BLOCK_BYTES):
            data = held + block
            cut = data.rfind(b"<")
            if len(data) - cut > _BLOCK_BYTES:
                raise ValueError("an element without an end")
            yield data[:cut]
            held = data[cut:]
    yield held
