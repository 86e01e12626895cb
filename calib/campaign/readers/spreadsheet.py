"""Excel workbooks (``.xlsx``): the first sheet that holds cells."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.campaign.model import Note
from calib.campaign.readers.table import RawTable, Wanted, made_numeric, refuse_duplicates
from calib.errors import BadFileError

__all__ = ["read"]

#: the format's own limit; a file that promises more is damaged
_MAX_ROWS: Final = 1_048_576
_MAX_UNPACKED: Final = 1 << 30


def read(path: Path, shown: str, wanted: Wanted | None) -> RawTable:
    """Read a workbook's first sheet with cells; see `calib.campaign.readers.read_table`."""
    import openpyxl

    _weigh(path, shown)
    notes: list[Note] = []
    try:
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        try:
            header: list[str] = []
            rows: list[list[Any]] = []
            lines: list[int] = []
            sheet_name = ""
            for sheet in book.worksheets:
                sheet_name = str(sheet.title)
                sheet.reset_dimensions()
                header, rows, lines = _cells(sheet, shown)
                if header:
                    break
            if len(book.sheetnames) > 1 and header:
                notes.append(
                    Note("info", shown, f"the workbook has {len(book.sheetnames)} sheets; {sheet_name!r} was read")
                )
        finally:
            book.close()
    except BadFileError:
        raise
    except MemoryError:
        raise
    except Exception as error:
        # the library answers damaged workbooks with errors of many kinds (zip, XML, keys, values)
        raise BadFileError(
            shown,
            found=f"a damaged workbook ({type(error).__name__})",
            expected="an .xlsx file that a spreadsheet program opens",
            remedy="open it and save it again, or export it as CSV",
        ) from error
    if not header:
        raise BadFileError(shown, found="no cells", expected="a header line and rows", remedy="export the table again")
    refuse_duplicates(header, shown, row=lines[0] if lines else 1)
    line = np.asarray(lines[1:], dtype=np.int64)
    columns: dict[str, Any] = {}
    for index, name in enumerate(header):
        if name and (wanted is None or wanted(name)):
            cells = np.empty(len(rows), dtype=object)
            cells[:] = [row[index] if index < len(row) else None for row in rows]
            columns[name] = cells
    if wanted is not None:
        notes += made_numeric(columns, shown, line)
    return RawTable(columns, line, tuple(notes))


def _weigh(path: Path, shown: str) -> None:
    try:
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
    except (zipfile.BadZipFile, ValueError, NotImplementedError, EOFError) as error:
        raise BadFileError(
            shown,
            found="no workbook (it is not a zip archive)",
            expected="an .xlsx file",
            remedy="save it again as .xlsx, or export it as CSV",
        ) from error
    if unpacked > _MAX_UNPACKED:
        raise BadFileError(
            shown, found=f"{unpacked} bytes unpacked", expected="at most 1 GiB", remedy="export it as CSV or parquet"
        )


def _cells(sheet: Any, shown: str) -> tuple[list[str], list[list[Any]], list[int]]:
    header: list[str] = []
    rows: list[list[Any]] = []
    lines: list[int] = []
    for number, values in enumerate(sheet.iter_rows(values_only=True), start=1):
        if number > _MAX_ROWS:
            raise BadFileError(
                shown, found="more rows than the format allows", expected=f"{_MAX_ROWS}", remedy="export it as CSV"
            )
        cells = [_cell(value) for value in values]
        if all(cell is None for cell in cells):
            continue
        if not header:
            header = ["" if cell is None else str(cell).strip() for cell in cells]
            lines.append(number)
            continue
        extra = [cell for cell in cells[len(header) :] if cell is not None]
        if extra:
            raise BadFileError(
                shown,
                row=number,
                found=f"{str(extra[0])[:40]!r} beside the table",
                expected=f"at most {len(header)} cells, as the header has",
                remedy="name the column or remove the cell",
            )
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
