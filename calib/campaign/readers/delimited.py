"""Text tables: comma, semicolon or tab; UTF-8, UTF-16 or Latin-1; decimal point or comma. All recognised and said."""

from __future__ import annotations

import codecs
import csv
import io
import re
from pathlib import Path
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import Note
from calib.campaign.readers.layout import (
    LOOKED_AT,
    Layout,
    find_delimiter,
    find_header,
    is_number,
    of_one_width,
    with_units,
)
from calib.campaign.readers.table import LARGEST, RawTable, Wanted, made_numeric, refuse_duplicates
from calib.errors import BadFileError

_NAMES: Final = {",": "commas", ";": "semicolons", "\t": "tabs"}
_MAX_BYTES: Final = 4 << 30
#: bytes in which the header is looked for
_HEAD: Final = 1 << 16
#: tables of nothing but numbers, up to so many bytes, are read by numpy: as fast as pandas there, whose import
#: takes as long as two hundred such logs
SMALL: Final = 1 << 16
_OF_NUMBERS: Final = b"0123456789+-.eE\n"
#: rows that show a header in the first of them
_FEW: Final = 8


def read(path: Path, shown: str, wanted: Wanted | None, layout: Layout) -> RawTable:
    """Read a delimited text file; see `calib.campaign.readers.read_table`."""
    size = path.stat().st_size
    if size > _MAX_BYTES:
        raise BadFileError(shown, f"{size} bytes", "at most 4 GiB", "split the file or store it as parquet")
    data, notes = _utf8(path.read_bytes(), shown)
    delimiter, skipped = _begin(data, layout, shown)
    start = _after_lines(data, skipped)
    end = data.find(b"\n", start)
    header = (data[start:end] if end >= 0 else data[start:]).decode("utf-8").strip("\r")
    if not header.strip():
        raise BadFileError(
            shown,
            found="an empty file" if not data.strip() else "an empty first line",
            expected="a header line with column names",
            remedy="export the table again",
        )
    if delimiter != ",":
        notes.append(Note("info", shown, f"columns are separated by {_NAMES[delimiter]}", "delimiter"))
    if skipped:
        notes.append(Note("info", shown, f"the header was found in row {skipped + 1}", "preamble"))
    if wanted is not None and data.find(b'"', start) < 0:
        names = [name.strip() for name in header.split(delimiter)]
        _refuse_names(names, shown, skipped + 1)
        fast = _fast(data, (end if end >= 0 else len(data)) + 1, names, delimiter, wanted)
        if fast is not None:
            columns, rows, comma = fast
            if comma:
                notes.append(Note("info", shown, "decimal commas were read as decimal points", "decimal_comma"))
            line = np.arange(skipped + 2, rows + skipped + 2, dtype=np.int64)
            return RawTable(columns, line, tuple(notes))
    return _careful(data[start:].decode("utf-8"), shown, delimiter, wanted, notes, skipped)


def _refuse_names(names: list[str], shown: str, row: int) -> None:
    """Refuse a header that names a column twice, or is a row of numbers: a file without names."""
    filled = [name for name in names if name]
    if len(filled) > 1 and all(is_number(name) for name in filled):
        raise BadFileError(
            shown,
            row=row,
            found=f"numbers alone ({', '.join(filled[:4])})",
            expected="the names of the columns",
            remedy="put a line of names above, as t_s,counts_left,counts_right; a mapping can rename them",
        )
    refuse_duplicates(names, shown, row)


def _begin(data: bytes, layout: Layout, shown: str) -> tuple[str, int]:
    """Return the separator and how many rows stand before the header."""
    if layout.header_row is None:
        # most logs begin with their header, and a few rows as wide as it and of numbers show it
        lines = _first_lines(data, _FEW).decode("utf-8", errors="ignore").splitlines()[:_FEW]
        usual = _usual(lines)
        rows = _split(lines, usual)
        if len(rows) == _FEW and len({len(row) for row in rows}) == 1 < len(rows[0]) and find_header(rows) == 0:
            return usual, 0
    most = LOOKED_AT + (layout.header_row or 0)
    lines = _first_lines(data, most).decode("utf-8", errors="ignore").splitlines()[:most]
    usual = _usual(lines)
    if layout.header_row is not None:
        if layout.header_row > len(lines):
            raise BadFileError(
                shown,
                found=f"{len(lines)} rows",
                expected=f"the header in row {layout.header_row}",
                remedy="correct header_row of the mapping",
            )
        return find_delimiter(lines[layout.header_row - 1 :]), layout.header_row - 1
    found = find_header(_split(lines, usual))
    if found == 0:
        return usual, 0
    delimiter = find_delimiter(lines)
    if delimiter != usual:
        found = find_header(_split(lines, delimiter))
    return (delimiter, found) if found else (usual, 0)


def begins_with_its_header(data: bytes, shown: str) -> bool:
    """Return whether the header of a text of commas is its first line."""
    return _begin(data, Layout(), shown) == (",", 0)


def _usual(lines: list[str]) -> str:
    first = lines[0] if lines else ""
    return ";" if ";" in first else "\t" if "\t" in first else ","


def _first_lines(data: bytes, lines: int) -> bytes:
    """Return the bytes up to a line feed that hold so many lines, or those in which the header is looked for."""
    at = 0
    for _ in range(lines):
        at = data.find(b"\n", at, _HEAD) + 1
        if not at:
            return data[:_HEAD]
    return data[:at]


def _split(lines: list[str], delimiter: str) -> list[list[str]]:
    try:
        rows = list(csv.reader(lines, delimiter=delimiter, strict=True))
    except csv.Error:
        rows = []
    # a cell over several lines would shift the numbers of the rows
    return rows if len(rows) == len(lines) else [line.split(delimiter) for line in lines]


def _after_lines(data: bytes, lines: int) -> int:
    at = 0
    for _ in range(lines):
        at = data.find(b"\n", at) + 1
    return at


def _utf8(data: bytes, shown: str) -> tuple[bytes, list[Note]]:
    """Return the file as UTF-8 without a byte order mark, with line feeds only, and what had to be done for it."""
    notes: list[Note] = []
    encoding = None
    if data.startswith(codecs.BOM_UTF8):
        data = data[3:]
        notes.append(Note("info", shown, "a UTF-8 byte order mark was skipped", "encoding"))
    elif data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encoding = "utf-16"
    elif b"\0" in data[:2000]:
        even, odd = data[0:2000:2].count(0), data[1:2000:2].count(0)
        encoding = "utf-16-le" if odd > 20 * (even + 1) else "utf-16-be" if even > 20 * (odd + 1) else None
    try:
        if encoding:
            data = data.decode(encoding).encode("utf-8")
            notes.append(Note("info", shown, "the text is UTF-16", "encoding"))
        elif not data.isascii():
            data.decode("utf-8")
    except UnicodeError:
        if encoding:
            raise BadFileError(shown, "broken UTF-16 text", "whole characters", "export the file again") from None
        data = data.decode("latin-1").encode("utf-8")
        notes.append(Note("info", shown, "the text is not UTF-8; it was read as Latin-1", "encoding"))
    if b"\0" in data:
        row = data[: data.index(b"\0")].count(b"\n") + 1
        raise BadFileError(shown, "a NUL byte", "text", "export the file again; it is damaged or binary", row=row)
    if b"\r" in data and b"\n" not in data:
        data = data.replace(b"\r", b"\n")
    return data, notes


def _fast(
    data: bytes, start: int, names: list[str], delimiter: str, wanted: Wanted
) -> tuple[dict[str, np.ndarray], int, bool] | None:
    """Read clean numeric columns at once; None where anything is odd, and then every cell is looked at."""
    body = data[start:]
    rows = body.count(b"\n") + (0 if body.endswith(b"\n") or not body else 1)
    keep = [name for name in names if name and wanted(name)]
    if rows == 0 or not keep or not of_one_width(body, len(names), delimiter):
        return None
    comma = delimiter != "," and data.find(b",", start) >= 0
    # with a point or an ambiguous 1,234 anywhere beside the commas, only the careful way can tell
    if comma and (data.find(b".", start) >= 0 or not re.search(rb",\d{1,2}(?!\d)|,\d{4}|[+\-;\t\n]0,", data)):
        return None
    positions = [names.index(name) for name in keep]
    plain = _plain(body, rows, len(names), delimiter)
    if plain is not None:
        few = plain[:, positions]
        within = few.size == 0 or np.abs(few).max() <= LARGEST
        return ({name: few[:, place] for place, name in enumerate(keep)}, rows, comma) if within else None
    import pandas as pd

    try:
        frame = pd.read_csv(
            io.BytesIO(body),
            header=None,
            names=range(len(names)),
            usecols=positions,
            sep=delimiter,
            decimal="," if comma else ".",
            engine="c",
            index_col=False,
            quoting=csv.QUOTE_NONE,
            skip_blank_lines=False,
            low_memory=False,
            na_values=["-"],
        )
        if any(dtype.kind not in "iuf" for dtype in frame.dtypes):
            return None
        # all columns at once: asking for each costs more than its numbers
        values = frame.to_numpy(np.float64)
        if np.fmax.reduce(values, axis=None) > LARGEST or np.fmin.reduce(values, axis=None) < -LARGEST:
            return None
        at = {position: place for place, position in enumerate(frame.columns)}
        columns = {name: values[:, at[position]] for name, position in zip(keep, positions, strict=True)}
    except (ValueError, OverflowError):
        return None
    return (columns, rows, comma) if len(frame) == rows else None


def _plain(body: bytes, rows: int, width: int, delimiter: str) -> FloatArray | None:
    """Return a small table of nothing but numbers, shape (rows, width); None where it is anything else."""
    if len(body) > SMALL or body.translate(None, _OF_NUMBERS + delimiter.encode()):
        return None
    try:
        values = np.loadtxt(io.BytesIO(body), delimiter=delimiter, comments=None, ndmin=2)
    except ValueError:
        return None
    return values if values.shape == (rows, width) else None


def _careful(text: str, shown: str, delimiter: str, wanted: Wanted | None, notes: list[Note], skipped: int) -> RawTable:
    """Read cell by cell, so that a fault is named by its row and column."""
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    rows: list[list[str]] = []
    lines: list[int] = []
    names: list[str] = []
    try:
        for cells in reader:
            if not names:
                names = [name.strip() for name in cells]
                _refuse_names(names, shown, skipped + 1)
                continue
            if not rows and (named := with_units(names, cells)):
                names = named
                notes.append(Note("info", shown, "the row beneath the header names units", "unit_row"))
                continue
            if not any(cell.strip() for cell in cells):
                continue
            if len(cells) > len(names) and not any(cell.strip() for cell in cells[len(names) :]):
                cells = cells[: len(names)]
            if len(cells) != len(names):
                raise BadFileError(
                    shown,
                    row=reader.line_num + skipped,
                    found=f"{len(cells)} cells",
                    expected=f"{len(names)}, as the header in row {skipped + 1} has",
                    remedy=_remedy(cells, names, delimiter),
                )
            rows.append(cells)
            lines.append(reader.line_num + skipped)
    except csv.Error as error:
        raise BadFileError(
            shown,
            row=reader.line_num + skipped,
            found=f"text that is no table ({error})",
            expected="rows of separated cells",
            remedy="export the file again",
        ) from error
    cells_by_row = np.empty((len(rows), len(names)), dtype=object)
    for index, cells in enumerate(rows):
        cells_by_row[index] = cells
    line = np.asarray(lines, dtype=np.int64)
    columns: dict[str, np.ndarray] = {
        name: cells_by_row[:, index] for index, name in enumerate(names) if name and (wanted is None or wanted(name))
    }
    epochs: dict[str, int] = {}
    if wanted is not None:
        said, epochs = made_numeric(columns, shown, line)
        notes += said
    return RawTable(columns, line, tuple(notes), epochs)


def _remedy(cells: list[str], names: list[str], delimiter: str) -> str:
    """Return what to do about a row of another width than the header."""
    for other, called in _NAMES.items():
        if other != delimiter and sum(cell.count(other) for cell in cells) + 1 == len(names):
            return f"the row separates its cells by {called}, those above by {_NAMES[delimiter]}: export it with one"
    if delimiter == "," and len(cells) > len(names):
        return "export with semicolons where commas are decimal, or quote the cell; name header_row if it stands lower"
    return "complete or remove the row; the file may have been cut"
