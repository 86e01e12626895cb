"""Excel workbooks (``.xlsx``), counted before unpacking, and Parquet tables (extra ``parquet``)."""

import datetime
import re
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib import errors
from calib.campaign.model import Note
from calib.campaign.readers import table
from calib.campaign.readers.sheets import Rows, finished, heading, table_rows
from calib.campaign.readers.table import Layout, RawTable, Wanted, filled_cells, object_array
from calib.errors import BadFileError, error_words, missing_reader, refuse_beyond

_SHEET_PART: Final = re.compile(r"(?i)/?xl/worksheets/[^/]*\.xml")
_TEXTS_PART: Final = re.compile(r"(?i)/?xl/sharedstrings\.xml")
_BOOK_PART: Final = re.compile(r"(?i)/?xl/workbook\.xml")
_OTHER_PART: Final = re.compile(r"(?i).*\.(xml|rels)")
_OTHER_BYTES: Final = 8 << 20
#: XML read at once; no sound element is as long
_BLOCK_BYTES: Final = 1 << 20
_CELL: Final = re.compile(rb"<(?:\w{1,20}:)?c\s[^<>]*?\br=[\"']([A-Z]{1,3})([0-9]{1,7})[\"'][^<>]*?(/?)>")
_MERGED: Final = re.compile(
    rb"<(?:\w{1,20}:)?mergeCell\s[^<>]*?\bref=[\"']([A-Z]{1,3})([0-9]{1,7}):([A-Z]{1,3})([0-9]{1,7})[\"']"
)
_ROW: Final = re.compile(rb"<(?:\w{1,20}:)?row\b")
_LISTED: Final = re.compile(rb"<(?:\w{1,20}:)?sheet\s")
_TEXT: Final = re.compile(rb"<(?:\w{1,20}:)?si\b")
_DAMAGE: Final = (zipfile.BadZipFile, zlib.error, ValueError, NotImplementedError, EOFError, RuntimeError)
_REMEDY: Final = "export the table as CSV or Parquet"


def read_sheet(path: Path, shown: str, wanted: Wanted | None, layout: Layout) -> RawTable:
    """Read a workbook's first sheet with a table, or the one asked for."""
    last_row = check_size(path, shown)
    notes: list[Note] = []
    with _opened(path, shown) as book:
        name, rows, at, merged = _sheet(book, path, shown, layout, last_row)
        if len(book.sheetnames) > 1 and rows and not layout.sheet:
            text = f"the workbook has {len(book.sheetnames)} sheets; {name!r} was read"
            notes.append(Note("info", shown, text, "sheet"))
    if not rows:
        raise BadFileError(shown, found="no cells", expected="a header line and rows", remedy="export the table again")
    header_row = rows[at][0]
    above = rows[at - 1][1] if at and rows[at - 1][0] == header_row - 1 else ()
    names, n_rows, recognised = heading(rows[at:], layout, shown, above)
    header = names[: max((at for at, name in enumerate(names, start=1) if name), default=0)]
    table.check_header(header, shown, row=header_row)
    header, rows, omitted = table_rows(header, rows[at:], n_rows, layout, shown)
    notes += [*recognised, *merged, *omitted, *_beside(rows, len(header), shown, layout, header_row)]
    columns = {
        name: object_array(_dated([row[index] if index < len(row) else None for _, row in rows]))
        for index, name in enumerate(header)
        if name and (wanted is None or wanted(name))
    }
    if bare := [column for column, cells in columns.items() if not filled_cells(cells.tolist())]:
        notes += _without_results(path, shown, (name, last_row), bare)
    return finished(columns, [line for line, _ in rows], wanted, notes, shown)


def _without_results(path: Path, shown: str, sheet: tuple[str, int], bare: Sequence[str]) -> list[Note]:
    (name, last_row), number = sheet, 0
    with suppress(BadFileError), _opened(path, shown, results=False) as book:
        book[name].reset_dimensions()
        cells = (cell for row in book[name].iter_rows(max_row=last_row or None, values_only=True) for cell in row)
        number = sum(isinstance(cell, str) and cell.startswith("=") for cell in cells)
    text = f"{number} formulas without results; open it in a spreadsheet program and save it again"
    return [Note("suspicious", f"{shown}, column {', '.join(bare)}", text, "formulas")] if number else []


def sheet_names(path: Path, shown: str) -> list[str]:
    """Return the names of a workbook's sheets."""
    check_size(path, shown)
    with _opened(path, shown) as book:
        return [str(sheet.title) for sheet in book.worksheets]


@contextmanager
def _opened(path: Path, shown: str, *, results: bool = True) -> Iterator[Any]:
    import openpyxl

    try:
        book = openpyxl.load_workbook(path, read_only=True, data_only=results)
        try:
            yield book
        finally:
            book.close()
    except (BadFileError, MemoryError):
        raise
    except Exception as error:
        expected = "an .xlsx file that a spreadsheet program opens"
        remedy = "open it and save it again, or export it as CSV"
        raise BadFileError(shown, f"a damaged workbook ({type(error).__name__})", expected, remedy) from error


def _sheet(book: Any, path: Path, shown: str, layout: Layout, last_row: int) -> tuple[str, Rows, int, list[Note]]:
    if layout.sheet is not None and layout.sheet not in book.sheetnames:
        actual = f"the sheets {', '.join(map(str, book.sheetnames))[:200]}"
        raise BadFileError(shown, actual, f"a sheet {layout.sheet!r}", "correct sheet of the mapping")
    first: tuple[str, Rows, int, list[Note]] = ("", [], 0, [])
    for sheet in (sheet for sheet in book.worksheets if layout.sheet in (None, sheet.title)):
        sheet.reset_dimensions()
        numbered = {
            number: [_cell(value) for value in values]
            for number, values in enumerate(sheet.iter_rows(max_row=last_row or None, values_only=True), start=1)
            if number not in layout.skip_rows
        }
        part = getattr(sheet, "_worksheet_path", "")
        notes = _fill_merged(numbered, path, part, shown, across=layout.runs_in_columns) if layout.lab else []
        if layout.runs_in_columns:
            numbered = dict(enumerate(table.turned(list(numbered.values())), start=1))
        filled: Rows = [row for row in numbered.items() if any(cell is not None for cell in row[1])]
        header_at = _header_index(filled, layout, shown)
        if header_at is None and (first[1] or not filled):
            continue
        first = str(sheet.title), filled, header_at or 0, notes
        if header_at is not None:
            return first
    return first


def _header_index(filled: Rows, layout: Layout, shown: str) -> int | None:
    if layout.header_row is None:
        return table.find_header([cells for _, cells in filled[: table.HEADER_ROWS]])
    index = next((index for index, (number, _) in enumerate(filled) if number == layout.header_row), None)
    if index is None:
        expected, remedy = "the header, as the mapping says", "correct header_row of the mapping"
        raise BadFileError(shown, "no cells", expected, remedy, row=layout.header_row)
    return index


def _fill_merged(rows: dict[int, list[Any]], path: Path, part: str, shown: str, *, across: bool) -> list[Note]:
    from openpyxl.utils import column_index_from_string

    n_filled = 0
    with zipfile.ZipFile(path) as archive:
        entry = next((one for one in archive.infolist() if one.filename.lstrip("/") == part.lstrip("/")), None)
        merges = [match for block in (_blocks(archive, entry) if entry else ()) for match in _MERGED.findall(block)]
    bottom = max(rows, default=0)
    places = sum(max(0, min(int(last), bottom) - int(first)) for _, first, _, last in merges)
    refuse_beyond(places, errors.SHEET_CELLS, shown=shown, what="merged cells", remedy=_REMEDY)
    titles = {number for number, cells in rows.items() if len(filled_cells(cells)) < 2}
    for letters, first, last_letters, last in merges:
        top, (left, right) = int(first), (column_index_from_string(one.decode()) - 1 for one in (letters, last_letters))
        value = rows[top][left] if top in rows and left < len(rows[top]) else None
        below = [(number, left) for number in range(top + 1, min(int(last), bottom) + 1)]
        beside = [(top, column) for column in range(left + 1, min(right + 1, len(rows.get(top, ()))))]
        for number, column in beside if across and top not in titles else () if across else below:
            if value is not None and number in rows and column < len(rows[number]) and rows[number][column] is None:
                rows[number][column] = value
                n_filled += 1
    text = f"{n_filled} cells of merged ranges were filled with what the first of each holds"
    return [Note("info", shown, text, "merged_cells")] if n_filled else []


def _beside(rows: Rows, width: int, shown: str, layout: Layout, header_row: int) -> list[Note]:
    notes = []
    for number, cells in rows:
        extra = next((f"{str(cell)[:40]!r}" for cell in cells[width:] if cell is not None), None)
        if extra and not layout.lab:
            expected = f"at most {width} cells, as the header in row {header_row} has"
            remedy = "name the column, remove the cell, or name the header's row (header_row)"
            raise BadFileError(shown, f"{extra} beside the table", expected, remedy, row=number)
        if extra:
            text = f"{extra} stands beside the table, under no name; omitted"
            notes.append(Note("info", f"{shown}, row {number}", text, "beside"))
    return notes


def _cell(value: Any) -> Any:
    if value is None or isinstance(value, str | datetime.datetime):
        return value
    if isinstance(value, bool):
        return "true" if value else "false"
    return float(value) if isinstance(value, int | float) else str(value)


def _dated(cells: list[Any]) -> list[Any]:
    days = all(cell.time() == datetime.time() for cell in cells if isinstance(cell, datetime.datetime))
    return [str(cell.date() if days else cell) if isinstance(cell, datetime.datetime) else cell for cell in cells]


def check_size(path: Path, shown: str) -> int:
    """Return the last filled row of any sheet; BadFileError beyond limits of `calib.errors`."""
    try:
        with zipfile.ZipFile(path) as archive:
            return _check_parts(archive, shown)
    except _DAMAGE as error:
        actual = "no workbook (it is not a zip archive, or a damaged one)"
        raise BadFileError(shown, actual, "an .xlsx file", "save it again as .xlsx, or export it as CSV") from error


def _check_parts(archive: zipfile.ZipFile, shown: str) -> int:
    check = partial(refuse_beyond, shown=shown, remedy=_REMEDY)
    entries = archive.infolist()
    check(sum(entry.file_size for entry in entries), errors.SHEET_UNPACKED_BYTES, what="bytes unpacked")
    sheets, books, texts, others = (
        [entry for entry in entries if part.fullmatch(entry.filename)]
        for part in (_SHEET_PART, _BOOK_PART, _TEXTS_PART, _OTHER_PART)
    )

    def count(element: re.Pattern[bytes], parts: Sequence[zipfile.ZipInfo]) -> int:
        return sum(len(element.findall(block)) for entry in parts for block in _blocks(archive, entry))

    check(max(len(sheets), count(_LISTED, books)), errors.SHEETS, what="sheets", remedy="keep the sheet with the table")
    size = sum(entry.file_size for entry in others if entry not in (*sheets, *texts))
    check(size, _OTHER_BYTES, what="bytes of styles and the like")
    check(count(_TEXT, texts), errors.SHEET_CELLS, what="texts")
    cells = empty = last_row = 0
    for entry in sheets:
        sheet_cells, sheet_empty, sheet_last = _extent(archive, entry)
        cells, empty, last_row = cells + sheet_cells, empty + sheet_empty, max(last_row, sheet_last)
        check(cells, errors.SHEET_CELLS, what="cells")
        remedy = f"delete rows and columns that hold nothing, or {_REMEDY}"
        check(empty, errors.SHEET_EMPTY, what="empty places between the cells", remedy=remedy)
    return last_row


def _extent(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> tuple[int, int, int]:
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


_MAX_ROWS: Final = 200_000_000
_THREADS_ROWS: Final = 100_000


def _filled(column: Any, empty: float) -> np.ndarray[Any, Any]:
    # Arrow's own conversion imports pandas
    whole = (column.fill_null(empty) if column.null_count else column).combine_chunks()
    dtype = np.dtype(str(whole.type).replace("double", "float64"))
    if not len(whole):
        return np.empty(0, dtype)
    return np.frombuffer(whole.buffers()[1], dtype, len(whole), whole.offset * dtype.itemsize).copy()


def _cells(column: Any) -> tuple[np.ndarray[Any, Any], int | None]:
    import pyarrow as pa

    if column.type in (pa.float64(), pa.int64()) and not column.null_count:
        return _filled(column, np.nan).astype(np.float64, copy=False), None
    if pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
        return _filled(column.cast(pa.float64(), safe=False), np.nan), None
    if pa.types.is_timestamp(column.type):
        moments = _filled(column.cast(pa.timestamp("ns")).cast(pa.int64()), np.iinfo(np.int64).min)
        epoch = int(moments[0]) if len(moments) else 0
        return (moments - epoch) / table.NS_PER_S, epoch
    if pa.types.is_string(column.type):
        return object_array(column.to_pylist()), None
    cells = (float(cell) if isinstance(cell, bool) else cell for cell in column.to_pylist())
    return object_array([cell if cell is None or isinstance(cell, float) else str(cell) for cell in cells]), None


def _damaged(shown: str, error: Exception, column: str | None = None) -> BadFileError:
    actual = f"a damaged parquet file ({error_words(error)})"
    return BadFileError(shown, actual, "a whole one", "write it again", column=column)


def read_parquet(path: Path, shown: str, wanted: Wanted | None, layout: Layout) -> RawTable:  # noqa: ARG001 - a reader's form
    """Read a parquet file."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise missing_reader(shown, "a parquet file", "pyarrow", "parquet") from error
    try:
        with pq.ParquetFile(path) as source:
            names = list(source.schema_arrow.names)
            rows = int(source.metadata.num_rows)
            table.check_header(names, shown)
            if not 0 <= rows <= _MAX_ROWS:
                raise BadFileError(shown, f"{rows} rows promised", f"at most {_MAX_ROWS}", "split the file")
            kept = [name for name in names if wanted is None or wanted(name)]
            read = source.read(columns=kept, use_threads=rows > _THREADS_ROWS)
    except (pa.ArrowException, OSError, ValueError, OverflowError) as error:
        raise _damaged(shown, error) from error
    line = np.arange(1, read.num_rows + 1, dtype=np.int64)
    columns: dict[str, np.ndarray[Any, Any]] = {}
    epochs: dict[str, int] = {}
    for name in kept:
        try:
            cells, epoch = _cells(read.column(name))
        except (pa.ArrowException, ValueError, OverflowError) as error:
            raise _damaged(shown, error, name) from error
        if epoch is not None:
            epochs[name] = epoch
        if wanted is not None:
            cells, _ = table.numbers(cells, shown, name, line)
        columns[name] = cells
    return RawTable(columns, line, (), epochs)
