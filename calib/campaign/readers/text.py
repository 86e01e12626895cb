"""Text files made plain: encoding, remarks, blanks, runs in columns; their delimiter."""

from __future__ import annotations

import codecs
import csv
import io
import itertools
import re
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

from calib.campaign.model import Note
from calib.campaign.readers.table import HEADER_ROWS, Layout, is_number, turned
from calib.errors import BadFileError

_REMARK: Final = re.compile(rb"(?m)^[ \t]*#[^\n]*")
_BLANKS: Final = re.compile(rb"[ \t]+")
_HEAD_BYTES: Final = 1 << 16
_LEAST_LINES: Final = 2


def utf8(data: bytes, shown: str) -> tuple[bytes, list[Note]]:
    """Return the file as UTF-8 without byte order mark, and notes of changes."""
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


def tidy(data: bytes, layout: Layout, shown: str) -> tuple[bytes, list[Note]]:
    """Return a text with empty lines for those without cells, so that rows keep their numbers, and notes.

    Lines that begin with ``#`` are remarks, but for one right above the numbers that names as many columns.
    """
    notes: list[Note] = []
    if layout.skip_rows:
        lines = data.split(b"\n")
        for row in layout.skip_rows:
            lines[row - 1 : row] = [b""] * len(lines[row - 1 : row])
        data = b"\n".join(lines)
    if _REMARK.search(data):
        data, n_remarks = _without_remarks(data)
        text = f"{n_remarks} line(s) that begin with # are remarks"
        notes += [Note("info", shown, text, "remarks")] if n_remarks else []
    if _by_blanks(data):
        data = b"\n".join(_BLANKS.sub(b"\t", line.strip()) for line in data.split(b"\n"))
        notes.append(Note("info", shown, "columns are separated by blanks", "delimiter"))
    if layout.runs_in_columns:
        rows = data.decode("utf-8").splitlines()
        mark, out = find_delimiter(rows), io.StringIO()
        csv.writer(out, delimiter=mark, lineterminator="\n").writerows(turned(split_cells(rows, mark)))
        data = out.getvalue().encode("utf-8")
    return data.rstrip(b"\n") + b"\n" if data.strip() else data, notes


def _without_remarks(data: bytes) -> tuple[bytes, int]:
    head = data[:_HEAD_BYTES].decode("utf-8", errors="ignore").split("\n")
    first = next((at for at, line in enumerate(head) if line.strip() and not line.lstrip().startswith("#")), 0)
    names = max((at for at, line in enumerate(head[:first]) if line.strip()), default=None)
    remarks = _REMARK.findall(data)
    if names is None or not _names(head[names], head[first]):
        return _REMARK.sub(b"", data), len(remarks)
    lines = data.split(b"\n", names + 1)
    text = lines[names].lstrip()[1:].lstrip(b" ") + b"\n"
    before = _REMARK.sub(b"", b"\n".join(lines[:names]) + (b"\n" if names else b""))
    return before + text + _REMARK.sub(b"", lines[-1]), len(remarks) - 1


def _names(remark: str, below: str) -> bool:
    for separator in (";", "\t", ",", None):
        cells, numbers = (line.strip().split(separator) for line in (remark.strip()[1:], below))
        if len(cells) == len(numbers) > 1 and any(map(is_number, numbers)):
            return not any(is_number(cell) for cell in cells if cell.strip())
    return False


def _by_blanks(data: bytes) -> bool:
    lines = data[:_HEAD_BYTES].decode("utf-8", errors="ignore").split("\n")
    if len(data) > _HEAD_BYTES:
        lines.pop()
    lines = [line.strip() for line in lines if line.strip()][-HEADER_ROWS:]
    lines = lines[-max(_LEAST_LINES, len(lines) // 2) :]
    if len(lines) < _LEAST_LINES or any(mark in line for line in lines for mark in (";", "\t", '"')):
        return False
    rows = [line.split() for line in lines]
    alike = len(rows[0]) > 1 and all(len(row) == len(rows[0]) for row in rows)
    return alike and all(is_number(cell) and cell[-1] != "," for row in rows for cell in row)


def split_cells(lines: Sequence[str], delimiter: str) -> list[list[str]]:
    """Return the cells of lines; a cell over several lines would shift the numbers of the rows."""
    with suppress(csv.Error):
        rows = list(csv.reader(lines, delimiter=delimiter, strict=True))
        if len(rows) == len(lines):
            return rows
    return [line.split(delimiter) for line in lines]


def find_delimiter(lines: Sequence[str]) -> str:
    """Return the delimiter that splits the most consecutive lines into one number of cells, above one."""
    filled = [line for line in lines if line.strip()][:HEADER_ROWS]
    # first of equals: commas as regular as semicolons are decimal
    regular = {}
    for mark in (";", "\t", ","):
        counts = itertools.groupby(len(row) for row in split_cells(filled, mark))
        regular[mark] = max((len(list(stretch)) for count, stretch in counts if count > 1), default=0)
    best = max(regular, key=lambda mark: regular[mark])
    return best if regular[best] else ","
