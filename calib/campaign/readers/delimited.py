"""Text tables: encoding, remarks, delimiter and decimal mark are recognised."""

import codecs
import csv
import io
import itertools
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign.model import Note
from calib.campaign.readers import table
from calib.campaign.readers.sheets import LOOKED_AT, Rows, finished, heading, table_rows
from calib.campaign.readers.table import Layout, RawTable, Wanted, check_header, find_header, is_number
from calib.errors import BadFileError
from calib.types import FloatArray, grouped, unit_named

_DELIMITERS: Final = {",": "commas", ";": "semicolons", "\t": "tabs"}
_CELL_BYTES: Final = {mark: bytes(set(range(256)) - {ord(mark), 10}) for mark in _DELIMITERS}
_HEAD_BYTES: Final = 1 << 16
#: smaller tables are read without pandas, whose import takes longer
NUMPY_BYTES: Final = 1 << 16
_NUMBER_BYTES: Final = b"0123456789+-.eE\n"
_FEW_ROWS, _LEAST_LINES = 8, 2
_BATCH_ODD: Final = (b'"', b"\r", b";", b"\t", b"\0")
_BATCH_SIGNED_ZERO: Final = (b"-0,", b"-0\n")
#: beyond it a float64 skips whole numbers
_EXACT_WHOLE: Final = 2.0**53
_REMARK: Final = re.compile(rb"(?m)^[ \t]*#[^\n]*")
_BLANKS: Final = re.compile(rb"[ \t]+")
_FRAME_RATE: Final = re.compile(rb"(?im)(?:rate|frequency)\W+(\d+(?:\.\d+)?)|^(\d+(?:\.\d+)?)[,;\t ]*$")
_FRAMES: Final = re.compile(rb"Frames?(?=[,;\t])", re.IGNORECASE)


def read(path: Path, shown: str, wanted: Wanted | None, layout: Layout) -> RawTable:
    """Read a delimited text file."""
    if (size := path.stat().st_size) > 4 << 30:
        raise BadFileError(shown, f"{size} bytes", "at most 4 GiB", "split the file or store it as parquet")
    data, notes = _utf8(path.read_bytes(), shown)
    if layout.lab:
        data, tidied = _tidy(data.replace(b"\r\n", b"\n"), layout, shown)
        notes += tidied
    delimiter, skipped = _locate_header(data, layout, shown)
    start = _after(data, 0, skipped)
    if not data[start : _after(data, start, 1)].strip():
        actual = "an empty file" if not data.strip() else "an empty first line"
        raise BadFileError(shown, actual, "a header line with column names", "export the table again")
    if delimiter != "," and not any(note.code == "delimiter" for note in notes):
        notes.append(Note("info", shown, f"columns are separated by {_DELIMITERS[delimiter]}", "delimiter"))
    preamble = data[:start].decode("utf-8").splitlines() if skipped and layout.lab else []
    above = _split_cells(preamble[-1:], delimiter)[0] if preamble else []
    if layout.lab and (rate := _FRAME_RATE.search(data[:start])) and (name := _FRAMES.match(data, start)):
        data = data[: name.end()] + b" [%g Hz]" % float(rate[1] or rate[2]) + data[name.end() :]
    unit = unit_named((re.findall(rb"Length Units,(\w+)", data[:start]) or [b""])[0].decode())
    above = [f"{cell} [{unit}]" if unit and cell == "Position" else cell for cell in above]
    bodies = next((row for row in _split_cells(preamble, delimiter) if row[1:2] == ["Name"]), [])
    if len({*bodies[2:]}) > 1:
        above = [f"{body}:{cell}" if cell else cell for body, cell in zip(bodies, above, strict=False)]
    if wanted is not None and data.find(b'"', start) < 0:
        first = data[start : start + _HEAD_BYTES].decode("utf-8", errors="ignore").splitlines()[:LOOKED_AT]
        rows: Rows = list(enumerate(_split_cells(first, delimiter), start=skipped + 1))
        names, n_rows, recognised = heading(rows, layout, shown, above)
        _check_names(names, shown, skipped + 1)
        fast = _read_numeric(data[_after(data, start, n_rows) :], names, delimiter, wanted)
        if fast is not None:
            columns, n_read, comma = fast
            notes += recognised
            notes += table.notes_of_commas({}, shown, np.zeros(0, np.int64)) if comma else []
            return RawTable(columns, np.arange(n_read, dtype=np.int64) + skipped + 1 + n_rows, tuple(notes))
    cells = _read_cells(data[start:].decode("utf-8"), shown, delimiter, wanted, skipped, layout, above)
    return replace(cells, notes=(*notes, *cells.notes))


def read_batch(files: Sequence[tuple[Path, str]], wanted: Wanted) -> list[RawTable | None]:
    """Read many small plain files, those of one header at once; else None."""
    tables: list[RawTable | None] = [None] * len(files)
    plain = ((index, _plain_csv(path, shown)) for index, (path, shown) in enumerate(files))
    for header, group in grouped((parts[0], (index, parts[1])) for index, parts in plain if parts).items():
        names = [name.strip() for name in header.split(",")]
        keep = [name for name in names if name and wanted(name)]
        rows = [body.count(b"\n") for _, body in group]
        parsed = _parsed(b"".join(body for _, body in group), sum(rows), names, keep, ",", ".") if keep else None
        if parsed is None:
            continue
        values, is_decimal = parsed
        if np.fmax.reduce(np.abs(values[:, is_decimal]), axis=None, initial=0.0) >= _EXACT_WHOLE:
            continue
        for (index, _), part in zip(group, np.split(values, np.cumsum(rows)[:-1]), strict=True):
            columns = {name: part[:, column] for column, name in enumerate(keep)}
            tables[index] = RawTable(columns, np.arange(2, len(part) + 2, dtype=np.int64))
    return tables


def _plain_csv(path: Path, shown: str) -> tuple[str, bytes] | None:
    data = b""
    with suppress(OSError):
        data = path.read_bytes() if path.suffix.lower() == ".csv" else data
    start = data.find(b"\n") + 1
    if not 0 < start < len(data) or not data.isascii() or any(odd in data for odd in _BATCH_ODD):
        return None
    if b"-" in data and any(zero in data for zero in _BATCH_SIGNED_ZERO):
        return None
    data = data if data.endswith(b"\n") else data + b"\n"
    header = data[: start - 1].decode("ascii")
    names = [name.strip() for name in header.split(",")]
    if of_one_width(data[start:], len(names), ",") and _locate_header(data, Layout(), shown) == (",", 0):
        with suppress(BadFileError):
            check_header(names, shown)
            return header, data[start:]
    return None


def _check_names(names: list[str], shown: str, row: int) -> None:
    filled = [name for name in names if name]
    if len(filled) > 1 and all(is_number(name) for name in filled):
        actual = f"numbers alone ({', '.join(filled[:4])})"
        remedy = "put a line of names above, as t_s,counts_left,counts_right; a mapping can rename them"
        raise BadFileError(shown, actual, "the names of the columns", remedy, row=row)
    check_header(names, shown, row)


def _locate_header(data: bytes, layout: Layout, shown: str) -> tuple[str, int]:
    if layout.header_row is None:
        lines = _first_lines(data, _FEW_ROWS)
        usual = _first_delimiter(lines)
        rows = _split_cells(lines, usual)
        if len(rows) == _FEW_ROWS and len({len(row) for row in rows}) == 1 < len(rows[0]) and find_header(rows) == 0:
            return usual, 0
    lines = _first_lines(data, table.HEADER_ROWS + (layout.header_row or 0))
    if layout.header_row is not None:
        if layout.header_row > len(lines):
            expected = f"the header in row {layout.header_row}"
            raise BadFileError(shown, f"{len(lines)} rows", expected, "correct header_row of the mapping")
        return _find_delimiter(lines[layout.header_row - 1 :]), layout.header_row - 1
    usual = _first_delimiter(lines)
    header = find_header(_split_cells(lines, usual))
    if header == 0:
        return usual, 0
    delimiter = _find_delimiter(lines)
    if delimiter != usual:
        header = find_header(_split_cells(lines, delimiter))
    if header is None and layout.lab:
        return delimiter, next((at for at, line in enumerate(lines) if line.strip()), 0)
    return (delimiter, header) if header else (usual, 0)


def of_one_width(body: bytes, width: int, delimiter: str) -> bool:
    """Return whether every line has `width` cells; no quotes."""
    line = delimiter.encode() * (width - 1) + b"\n"
    marks = body.translate(None, _CELL_BYTES[delimiter]) + (b"" if body.endswith(b"\n") else b"\n")
    return marks == line * (len(marks) // len(line))


def _after(data: bytes, start: int, n_rows: int) -> int:
    for _ in range(n_rows):
        start = data.find(b"\n", start) + 1 or len(data)
    return start


def _first_delimiter(lines: list[str]) -> str:
    return next((mark for mark in (";", "\t") if lines and mark in lines[0]), ",")


def _first_lines(data: bytes, n_lines: int) -> list[str]:
    head = data[:_HEAD_BYTES]
    return head[: _after(head, 0, n_lines)].decode("utf-8", errors="ignore").splitlines()[:n_lines]


def _read_numeric(
    body: bytes, names: list[str], delimiter: str, wanted: Wanted
) -> tuple[dict[str, FloatArray], int, bool] | None:
    rows = body.count(b"\n") + (0 if body.endswith(b"\n") or not body else 1)
    keep = [name for name in names if name and wanted(name)]
    if rows == 0 or not keep or not of_one_width(body, len(names), delimiter):
        return None
    comma = delimiter != "," and b"," in body
    # 1,234 is ambiguous
    if comma and (b"." in body or not re.search(rb",\d{1,2}(?!\d)|,\d{4}|[+\-;\t\n]0,", body)):
        return None
    if (values := numpy_table(body, rows, len(names), delimiter)) is not None:
        values = values[:, [names.index(name) for name in keep]]
        values = None if values.size and np.abs(values).max() > table.LARGEST_VALUE else values
    elif parsed := _parsed(body, rows, names, keep, delimiter, "," if comma else "."):
        values = parsed[0]
    if values is None:
        return None
    return {name: values[:, index] for index, name in enumerate(keep)}, rows, comma


def numpy_table(body: bytes, rows: int, width: int, delimiter: str) -> FloatArray | None:
    """Return a small table of numbers, shape (rows, width); None for anything else."""
    if len(body) > NUMPY_BYTES or body.translate(None, _NUMBER_BYTES + delimiter.encode()):
        return None
    try:
        values = np.loadtxt(io.BytesIO(body), delimiter=delimiter, comments=None, ndmin=2)
    except ValueError:
        return None
    return values if values.shape == (rows, width) else None


def _parsed(
    body: bytes, rows: int, names: Sequence[str], keep: Sequence[str], delimiter: str, decimal: str
) -> tuple[FloatArray, list[bool]] | None:
    import pandas as pd

    try:
        frame = pd.read_csv(
            io.BytesIO(body),
            header=None,
            names=range(len(names)),
            usecols=[names.index(name) for name in keep],
            sep=delimiter,
            decimal=decimal,
            engine="c",
            index_col=False,
            quoting=csv.QUOTE_NONE,
            skip_blank_lines=False,
            low_memory=False,
            na_values=["-"],
        )
        kinds = [dtype.kind for dtype in frame.dtypes]
        if len(frame) != rows or not set(kinds) <= set("iuf"):
            return None
        values = frame.to_numpy(np.float64)
    except (ValueError, OverflowError):
        return None
    low, high = np.fmin.reduce(values, axis=None), np.fmax.reduce(values, axis=None)
    if max(-low, high) > table.LARGEST_VALUE:
        return None
    return values, [kind == "f" for kind in kinds]


def _read_cells(
    text: str, shown: str, delimiter: str, wanted: Wanted | None, skipped: int, layout: Layout, above: Sequence[str]
) -> RawTable:
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    try:
        rows: Rows = [(reader.line_num + skipped, row) for row in reader]
    except csv.Error as error:
        actual, at = f"text that is no table ({error})", reader.line_num + skipped
        raise BadFileError(shown, actual, "rows of separated cells", "export the file again", row=at) from error
    names, n_rows, recognised = heading(rows, layout, shown, above)
    _check_names(names, shown, skipped + 1)
    names, rows, omitted = table_rows(names, rows, n_rows, layout, shown)
    body: list[Sequence[str]] = []
    lines: list[int] = []
    for line, cells in rows:
        remark = len(cells) != len(names) and "".join(cells).lstrip().startswith("#")
        if remark or not any(cell.strip() for cell in cells):
            continue
        whole = cells if any(cell.strip() for cell in cells[len(names) :]) else cells[: len(names)]
        if len(whole) != len(names):
            expected = f"{len(names)}, as the header in row {skipped + 1} has"
            raise BadFileError(shown, f"{len(cells)} cells", expected, _remedy(cells, names, delimiter), row=line)
        body.append(whole)
        lines.append(line)
    grid = np.array(body, dtype=object).reshape(len(body), len(names))
    columns = {name: grid[:, index] for index, name in enumerate(names) if name and (wanted is None or wanted(name))}
    return finished(columns, lines, wanted, [*recognised, *omitted], shown)


def _remedy(cells: Sequence[str], names: list[str], delimiter: str) -> str:
    for other, called in _DELIMITERS.items():
        if other != delimiter and sum(cell.count(other) for cell in cells) + 1 == len(names):
            above = _DELIMITERS[delimiter]
            return f"the row separates its cells by {called}, those above by {above}: export it with one"
    if delimiter == "," and len(cells) > len(names):
        return "export with semicolons where commas are decimal, or quote the cell; name header_row if it stands lower"
    return "complete or remove the row; the file may have been cut"


def _utf8(data: bytes, shown: str) -> tuple[bytes, list[Note]]:
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
        central = re.search(rb"[A-Za-z][\xb3\xb9\xbf\x9a-\x9f][a-z]", data) is not None
        data = data.decode("cp1250" if central else "latin-1", errors="replace").encode("utf-8")
        name = "Windows-1250" if central else "Latin-1"
        notes.append(Note("info", shown, f"the text is not UTF-8; it was read as {name}", "encoding"))
    if b"\0" in data:
        row = data[: data.index(b"\0")].count(b"\n") + 1
        raise BadFileError(shown, "a NUL byte", "text", "export the file again; it is damaged or binary", row=row)
    if b"\r" in data and b"\n" not in data:
        data = data.replace(b"\r", b"\n")
    return data, notes


def _tidy(data: bytes, layout: Layout, shown: str) -> tuple[bytes, list[Note]]:
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
        mark, out = _find_delimiter(rows), io.StringIO()
        csv.writer(out, delimiter=mark, lineterminator="\n").writerows(table.turned(_split_cells(rows, mark)))
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
    lines = [line.strip() for line in lines if line.strip()][-table.HEADER_ROWS :]
    lines = lines[-max(_LEAST_LINES, len(lines) // 2) :]
    if len(lines) < _LEAST_LINES or any(mark in line for line in lines for mark in (";", "\t", '"')):
        return False
    rows = [line.split() for line in lines]
    alike = len(rows[0]) > 1 and all(len(row) == len(rows[0]) for row in rows)
    return alike and all(is_number(cell) and cell[-1] != "," for row in rows for cell in row)


def _split_cells(lines: Sequence[str], delimiter: str) -> list[list[str]]:
    with suppress(csv.Error):
        rows = list(csv.reader(lines, delimiter=delimiter, strict=True))
        if len(rows) == len(lines):
            return rows
    return [line.split(delimiter) for line in lines]


def _find_delimiter(lines: Sequence[str]) -> str:
    filled = [line for line in lines if line.strip()][: table.HEADER_ROWS]
    # commas as regular as semicolons are decimal
    regular = {}
    for mark in (";", "\t", ","):
        counts = itertools.groupby(len(row) for row in _split_cells(filled, mark))
        regular[mark] = max((len(list(stretch)) for count, stretch in counts if count > 1), default=0)
    best = max(regular, key=lambda mark: regular[mark])
    return best if regular[best] else ","
