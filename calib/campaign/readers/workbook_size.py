"""What a workbook unpacks to, looked at before a library lays out every empty place between its cells."""

from __future__ import annotations

import re
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from calib.errors import BadFileError
from calib.limits import SHEET_CELLS, SHEET_EMPTY, SHEET_UNPACKED_BYTES, SHEETS, refuse_beyond

#: parts of the archive that hold cells and their texts; all others describe, and are small
_SHEET: Final = re.compile(r"(?i)/?xl/worksheets/[^/]*\.xml")
_TEXTS: Final = re.compile(r"(?i)/?xl/sharedstrings\.xml")
_DESCRIBES: Final = re.compile(r"(?i).*\.(xml|rels)")
_DESCRIPTION_BYTES: Final = 8 << 20
#: XML read at once; no element of a sound workbook is as long
_PIECE: Final = 1 << 20
#: column, row, and whether the cell ends at once and so holds nothing
_CELL: Final = re.compile(rb"<(?:\w{1,20}:)?c\s[^<>]*?\br=[\"']([A-Z]{1,3})([0-9]{1,7})[\"'][^<>]*?(/?)>")
_ROW: Final = re.compile(rb"<(?:\w{1,20}:)?row\b")
_TEXT: Final = re.compile(rb"<(?:\w{1,20}:)?si\b")
_DAMAGE: Final = (zipfile.BadZipFile, zlib.error, ValueError, NotImplementedError, EOFError, RuntimeError)
_REMEDY: Final = "export the table as CSV or Parquet"


@dataclass(slots=True)
class _Extent:
    """Cells that hold something, and what lies between them."""

    cells: int = 0
    rows: int = 0
    places: int = 0
    last_row: int = 0

    @property
    def empty(self) -> int:
        """Places and rows without anything that a reader has to pass over before the last cell."""
        return max(0, self.last_row - self.rows) + max(0, self.places - self.cells)


def weigh(path: Path, shown: str) -> int:
    """Refuse a workbook that holds more than `calib.limits` allows, or little that is spread widely.

    Number of the last row, of any sheet, in which a cell holds something; what is below need not be read. Raises
    BadFileError where it is no zip archive, or beyond the limits.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            return _weighed(archive, shown)
    except _DAMAGE as error:
        remedy = "save it again as .xlsx, or export it as CSV"
        raise BadFileError(
            shown, "no workbook (it is not a zip archive, or a damaged one)", "an .xlsx file", remedy
        ) from error


def _weighed(archive: zipfile.ZipFile, shown: str) -> int:
    entries = archive.infolist()
    unpacked = sum(entry.file_size for entry in entries)
    refuse_beyond(unpacked, SHEET_UNPACKED_BYTES, shown=shown, what="bytes unpacked", remedy=_REMEDY)
    sheets = [entry for entry in entries if _SHEET.fullmatch(entry.filename)]
    refuse_beyond(len(sheets), SHEETS, shown=shown, what="sheets", remedy="keep the sheet with the table")
    texts = [entry for entry in entries if _TEXTS.fullmatch(entry.filename)]
    others = [entry for entry in entries if _DESCRIBES.fullmatch(entry.filename) and entry not in (*sheets, *texts)]
    described = sum(entry.file_size for entry in others)
    refuse_beyond(described, _DESCRIPTION_BYTES, shown=shown, what="bytes of styles and the like", remedy=_REMEDY)
    count = sum(len(_TEXT.findall(piece)) for entry in texts for piece in _pieces(archive, entry))
    refuse_beyond(count, SHEET_CELLS, shown=shown, what="texts", remedy=_REMEDY)
    cells = empty = last_row = 0
    for entry in sheets:
        extent = _extent(archive, entry)
        cells, empty, last_row = cells + extent.cells, empty + extent.empty, max(last_row, extent.last_row)
        refuse_beyond(cells, SHEET_CELLS, shown=shown, what="cells", remedy=_REMEDY)
        remedy = f"delete rows and columns that hold nothing, or {_REMEDY}"
        refuse_beyond(empty, SHEET_EMPTY, shown=shown, what="empty places between the cells", remedy=remedy)
    return last_row


def _extent(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> _Extent:
    """Count without a parser: an element that is written in no usual way is left to the library."""
    extent = _Extent()
    row, column, waiting = b"", b"A", 0
    for piece in _pieces(archive, entry):
        extent.rows += len(_ROW.findall(piece))
        for letters, digits, is_empty in _CELL.findall(piece):
            if digits != row:
                waiting += _number(column) if row else 0
                row = digits
            column = letters
            if not is_empty:
                extent.cells += 1
                extent.last_row = max(extent.last_row, int(digits))
                extent.places, waiting = extent.places + waiting, 0
    extent.places += _number(column) if row and extent.cells else 0
    return extent


def _number(letters: bytes) -> int:
    number = 0
    for letter in letters:
        number = 26 * number + letter - 64
    return number


def _pieces(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> Iterator[bytes]:
    """Yield the pieces of a part, cut where an element begins."""
    held = b""
    with archive.open(entry) as stream:
        while block := stream.read(_PIECE):
            data = held + block
            cut = data.rfind(b"<")
            if len(data) - cut > _PIECE:
                raise ValueError("an element without an end")
            yield data[:cut]
            held = data[cut:]
    yield held
