"""Tables as read: header, numbers and times."""

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from calib.campaign.model import Note
from calib.errors import COLUMNS, BadFileError, refuse_beyond
from calib.types import BoolArray, FloatArray, IntArray

Wanted = Callable[[str], bool]
Cells = npt.NDArray[Any]
Notes = list[Note] | None

NS_PER_S: Final = 1_000_000_000
GAP_STEPS: Final = 5.0
#: no measurement is larger; squares would overflow
LARGEST_VALUE: Final = 1e30
#: rows searched for the header; loggers' preambles are shorter
HEADER_ROWS: Final = 60
#: of motion capture: kind, name, number, quantity, axis
_HEADER_LINES: Final = 6
_HEADER_SHARE: Final = 0.6

_NOT_MEASURED: Final = frozenset({"n.a.", "n/a", "k.a.", "k. a.", "--", "?"})
EMPTY: Final = frozenset({"", "nan", "na", "#n/a", "null", "none", "-"}) | _NOT_MEASURED
_POINT: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_COMMA: Final = re.compile(r"[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?", re.ASCII)
_POINT_OR_COMMA: Final = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?", re.ASCII)
#: 1,234 is 1.234 in one country and 1234 in another
_AMBIGUOUS: Final = re.compile(r"[+-]?[1-9]\d{0,2}[,.]\d{3}", re.ASCII)
_GROUPED: Final = re.compile(r"[+-]?[1-9]\d{0,2}([., '’\xa0\u202f])\d{3}(?:\1\d{3})*(?:(?!\1)([.,])\d*)?", re.ASCII)
#: so long a whole number has marks between thousands where others have; a year has none
UNMARKED_DIGITS: Final = 5
_HEX: Final = re.compile(r"0x[\da-f]+", re.ASCII | re.IGNORECASE)

_CLOCK: Final = r"(?P<hour>\d{1,2}):(?P<minute>\d{2})(?::(?P<second>\d{2})(?:[.,](?P<fraction>\d{1,9}))?)?"
_ZONE: Final = r"\s*(?P<zone>Z|UTC|[+-]\d{2}:?\d{2}|[+-]\d{2})?"
_HALF_DAY_NS: Final = 43_200 * NS_PER_S
_DAYS_TO_1970: Final = date(1970, 1, 1).toordinal()
_TIMES: Final = {
    "iso8601": re.compile(
        rf"(?P<year>\d{{4}})(?P<mark>[-/])(?P<month>\d{{2}})(?P=mark)(?P<day>\d{{2}})[T ]{_CLOCK}{_ZONE}", re.ASCII
    ),
    "day_first": re.compile(
        rf"(?P<day>\d{{1,2}})\.(?P<month>\d{{1,2}})\.(?P<year>\d{{4}})[T ]+{_CLOCK}{_ZONE}", re.ASCII
    ),
    "slashes": re.compile(
        rf"(?P<day>\d{{1,2}})/(?P<month>\d{{1,2}})/(?P<year>\d{{4}}),?[T ]+{_CLOCK}(\s*(?P<half>[AP]M))?{_ZONE}",
        re.ASCII | re.IGNORECASE,
    ),
    "time_of_day": re.compile(_CLOCK, re.ASCII),
}

#: name of a format -> an example, and the format in words
TIME_FORMATS: Final = {
    "iso8601": ("2026-05-04T10:15:30.250+02:00", "ISO 8601 (year-month-day, hours:minutes:seconds)"),
    "day_first": ("04.05.2026 10:15:30,250", "day.month.year hours:minutes:seconds"),
    "slashes": ("04/05/2026 10:15:30.250", "day/month/year hours:minutes:seconds"),
    "time_of_day": ("10:15:30.250", "times of day (hours:minutes:seconds)"),
}


@dataclass(frozen=True, slots=True)
class Layout:
    """Sheet and rows (from 1) of a table; None: to be found."""

    sheet: str | None = None
    header_row: int | None = None
    units_row: int | None = None
    skip_rows: tuple[int, ...] = ()
    #: each run in a column, names in the first
    runs_in_columns: bool = False
    #: a laboratory's file (`calib.campaign.readers.sheets`), not a campaign's
    lab: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class RawTable:
    """A table as read."""

    #: shape (n_rows,): float64 where numeric, else str, float and None
    columns: Mapping[str, npt.NDArray[Any]]
    #: in the file, from 1, header included, shape (n_rows,)
    line: IntArray
    notes: tuple[Note, ...] = ()
    #: column of clock times, in s since its first cell -> that cell in ns since 1970 or midnight
    epochs: Mapping[str, int] = field(default_factory=dict)
    #: first cell and format of these columns, as written
    written: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    def select(self, keep: slice | BoolArray) -> "RawTable":
        """Return the rows that `keep` picks."""
        return replace(self, columns={name: cells[keep] for name, cells in self.columns.items()}, line=self.line[keep])


def object_array(cells: Sequence[Any]) -> npt.NDArray[Any]:
    """Return cells as an array of objects, shape (n_rows,)."""
    out = np.empty(len(cells), dtype=object)
    out[:] = list(cells)
    return out


def check_header(names: Sequence[str], shown: str, row: int = 1) -> None:
    """Refuse a header with a column twice, too many columns, or none."""
    refuse_beyond(len(names), COLUMNS, shown=shown, what="columns", remedy="export those that are needed", row=row)
    seen: set[str] = set()
    for name in names:
        if len(name) > 100 or not name.isprintable():
            expected = "names of at most 100 printable characters"
            remedy = "check that this is the right file and its encoding UTF-8; export it again"
            raise BadFileError(shown, f"{name[:20]!r}, no column name", expected, remedy, row=row)
        if name in seen and name:
            remedy = "rename or remove one of the two columns"
            raise BadFileError(shown, "the column name twice", "each name once", remedy, row=row, column=name)
        seen.add(name)
    if not any(names):
        raise BadFileError(shown, "no column names", "a header line", "put the column names first", row=row)


def is_filled(cell: Any) -> bool:
    """Return whether a cell holds something."""
    return cell is not None and bool(str(cell).strip())


def filled_cells(row: Sequence[Any]) -> list[Any]:
    """Return the cells of a row that hold something."""
    return [cell for cell in row if is_filled(cell)]


def is_number(cell: Any) -> bool:
    """Return whether a cell is a number or a time."""
    if isinstance(cell, int | float):
        return True
    text = str(cell).strip().replace("−", "-")
    return any(form.fullmatch(text) for form in (_POINT_OR_COMMA, _GROUPED, _HEX)) or time_format(text) is not None


def turned(rows: Sequence[Sequence[Any]]) -> list[list[Any]]:
    """Return a table with a run a row, without titles."""
    columns = map(list, itertools.zip_longest(*(row for row in rows if len(filled_cells(row)) > 1)))
    return [column for column in columns if filled_cells(column)]


def format_words(cells: Sequence[Any] | npt.NDArray[Any]) -> str:
    """Return the form of times in words; empty for none."""
    if (form := time_format(str(cells[0]))) is None:
        return ""
    month_first = form == "slashes" and _month_before_day(cells)
    return TIME_FORMATS[form][1].replace("day/month", "month/day" if month_first else "day/month")


def find_header(rows: Sequence[Sequence[Any]]) -> int | None:
    """Return the index of the first row of texts as wide as those below, a number soon beneath."""
    filled = [filled_cells(row) for row in rows]
    for index, cells in enumerate(filled):
        below = sorted(len(row) for row in filled[index + 1 :] if row)
        if len(cells) < 2 or not below:
            continue
        usual = below[len(below) // 2]
        texts = sum(not is_number(cell) for cell in cells)
        if len(cells) < _HEADER_SHARE * usual or texts < _HEADER_SHARE * len(cells):
            continue
        following = [row for row in filled[index + 1 : index + 4] if row]
        wide = following and (len(following[0]) <= len(rows[index]) or len(cells) >= usual)
        if wide and any(map(is_number, itertools.chain.from_iterable(following))):
            return _beneath_numbers(filled, index)
    return None


def _beneath_numbers(filled: Sequence[Sequence[Any]], first: int) -> int:
    if len({*filled[first]}) == len(filled[first]):
        return first
    numeric = [sum(map(is_number, row)) for row in filled[: first + _HEADER_LINES + 1]]
    for index in range(first + 2, len(numeric) - 1):
        as_wide = len(filled[index]) >= _HEADER_SHARE * len(filled[first]) and len(filled[index + 1]) > 1
        if as_wide and not numeric[index] and numeric[index + 1] >= _HEADER_SHARE * len(filled[index + 1]):
            return index if any(numeric[first + 1 : index]) else first
    return first


def numbers(
    cells: Cells, shown: str, column: str, line: IntArray, decimal_comma: bool | None = None, notes: Notes = None
) -> tuple[FloatArray, bool]:
    """Return cells as numbers, NaN where empty, and whether a decimal comma was read.

    Raises BadFileError at a cell that is no finite number, or ambiguous.
    `decimal_comma`: see `comma_evidence`; without, ``1,234`` is refused.
    """
    if cells.dtype != object:
        values = cells.astype(np.float64)
        for row in np.flatnonzero(np.abs(values) > LARGEST_VALUE):
            raise _no_number(shown, column, int(line[row]), str(values[row]))
        return values, False
    out, used_comma = np.full(len(cells), np.nan), False
    notes = [] if notes is None else notes
    marks: set[str] | None = None
    odd: dict[str, list[tuple[str, str]]] = {}
    for index, cell in enumerate(cells):
        if cell is None:
            continue
        if isinstance(cell, str):
            text = cell.strip().replace("−", "-")
            if text.lower() in EMPTY:
                if text.lower() in _NOT_MEASURED:
                    odd.setdefault("not_measured", []).append((text, "an empty cell"))
                continue
            comma = _COMMA.fullmatch(text) is not None
            unclear = (comma != (decimal_comma is True) or decimal_comma is None) and _AMBIGUOUS.fullmatch(text)
            if unclear or not (comma or _POINT.fullmatch(text)):
                marks = _thousands(cells, decimal_comma) if marks is None else marks
                if plain := _without_marks(text, marks):
                    odd.setdefault("thousands", []).append((text, plain))
                    text, comma = plain, "," in plain
                elif not unclear or comma or "?" in marks:
                    raise (_ambiguous if unclear else _no_number)(shown, column, int(line[index]), text)
            used_comma = used_comma or comma
            value = float(text.replace(",", "."))
        else:
            value = float(cell)
        if not abs(value) <= LARGEST_VALUE and not (isinstance(cell, float) and np.isnan(cell)):
            raise _no_number(shown, column, int(line[index]), str(cell))
        out[index] = value
    for code, examples in odd.items():
        text = f"{len(examples)} cells were read as is {examples[0][0]!r}: as {examples[0][1]}"
        notes.append(Note("info", f"{shown}, column {column}", text, code))
    return out, used_comma


def _without_marks(text: str, marks: set[str]) -> str | None:
    if "x" in marks and _HEX.fullmatch(text):
        return str(int(text, 16))
    parts = _GROUPED.fullmatch(text)
    return text.replace(parts[1], "") if parts and parts[1] in marks else None


def _thousands(cells: npt.NDArray[Any], decimal_comma: bool | None) -> set[str]:
    texts = [cell.strip() for cell in cells if isinstance(cell, str)]
    parts = [match for text in texts if (match := _GROUPED.fullmatch(text)) and not _AMBIGUOUS.fullmatch(text)]
    marks = {match[1] for match in parts} | ({"x"} if all(map(_HEX.fullmatch, texts)) else set())
    for mark, form, other in ((".", _POINT, True), (",", _COMMA, False)):
        decimal = any(mark in text and form.fullmatch(text) and not _AMBIGUOUS.fullmatch(text) for text in texts)
        marks |= {mark} if decimal_comma is other and not decimal else set()
    whole = [int(text) for text in texts if text.isdecimal()]
    return marks | {"?"} if decimal_comma is None and whole and 100 <= min(whole) <= max(whole) < 1000 else marks


def _no_number(shown: str, column: str, row: int, text: str) -> BadFileError:
    expected, remedy = "a finite number below 1e30, or an empty cell", "correct the cell, or leave it empty"
    return BadFileError(shown, repr(text[:40]), expected, remedy, row=row, column=column)


def _ambiguous(shown: str, column: str, row: int, text: str) -> BadFileError:
    actual = f"{text!r}, which may mean {text.replace(',', '.')} or {text.replace(',', '').replace('.', '')}"
    expected, remedy = "a number that can be read in one way only", "export it without marks between thousands"
    return BadFileError(shown, actual, expected, remedy, row=row, column=column)


def comma_evidence(columns: Sequence[npt.NDArray[Any]]) -> bool | None:
    """Return whether a file has decimal commas, if its cells tell."""
    comma = point = False
    for cells in columns:
        for cell in cells if cells.dtype == object else ():
            if isinstance(cell, str) and not _AMBIGUOUS.fullmatch(text := cell.strip()):
                match = _GROUPED.fullmatch(text)
                decimal = match and (match[2] or {",": ".", ".": ","}.get(match[1]))
                comma = comma or decimal == "," or ("," in text and _COMMA.fullmatch(text) is not None)
                point = point or decimal == "." or ("." in text and _POINT.fullmatch(text) is not None)
        if comma and point:
            return None
    return True if comma or (not point and _without_thousands(columns)) else (False if point else None)


def _without_thousands(columns: Sequence[npt.NDArray[Any]]) -> bool:
    """Return whether whole numbers stand without marks, and no point anywhere: a comma separates no thousands then."""
    texts = [[cell.strip() for cell in cells if isinstance(cell, str) and cell.strip()] for cells in columns]
    unmarked = any(len(text) >= UNMARKED_DIGITS for of in texts if all(map(str.isdecimal, of)) for text in of)
    return unmarked and not any("." in text for of in texts for text in of)


def notes_of_commas(columns: Mapping[str, npt.NDArray[Any]], shown: str, line: IntArray) -> list[Note]:
    """Return notes on decimal commas, and on decimal points beside them."""
    notes = [Note("info", shown, "decimal commas were read as decimal points", "decimal_comma")]
    first: dict[str, tuple[int, str, str]] = {}
    for name, cells in columns.items():
        for mark, form in ((",", _COMMA), (".", _POINT)):
            for row, cell in zip(line.tolist(), cells, strict=True):
                text = cell.strip() if isinstance(cell, str) and mark in cell else ""
                if form.fullmatch(text) and not _AMBIGUOUS.fullmatch(text):
                    first[mark] = min(first.get(mark, (row, name, cell)), (row, name, cell))
                    break
    if len(first) < 2:
        return notes
    (row, name, cell), (other_row, other_name, other_cell) = first[","], first["."]
    text = f"""a decimal comma ({cell.strip()!r:.40}) and, in row {other_row}, column {other_name}, a decimal point
        ({other_cell.strip()!r:.40}); both were read as decimal marks: look whether one of them separates thousands"""
    return [*notes, Note.of(f"{shown}, row {row}, column {name}", text, "decimal_marks")]


def time_format(text: str) -> str | None:
    """Return the name of a text's format (of `TIME_FORMATS`), or None."""
    clean = text.strip()
    kind = next((name for name, form in _TIMES.items() if form.fullmatch(clean)), None)
    return None if kind == "time_of_day" and clean.count(":") != 2 else kind


def moment_ns(text: str, *, month_first: bool = False) -> int:
    """Return a time in ns since 1970 (UTC without a zone), or midnight; raises ValueError.

    `month_first`: before the day, between slashes.
    """
    clean = text.strip()
    if (match := next(filter(None, (form.fullmatch(clean) for form in _TIMES.values())), None)) is None:
        raise ValueError(f"{clean[:40]!r} is no time")
    part = match.groupdict()
    hour, minute, second = (int(part[name] or 0) for name in ("hour", "minute", "second"))
    if half := part.get("half"):
        hour = hour % 12 + (12 if half.upper() == "PM" else 0)
    if hour > 24 or minute > 59 or second > 60:
        raise ValueError("no time of day")
    since_midnight = (hour * 3600 + minute * 60 + second) * NS_PER_S + int((part["fraction"] or "").ljust(9, "0"))
    if "year" not in part:
        return since_midnight
    exchanged = month_first and match.re is _TIMES["slashes"]
    names = ("year", "day", "month") if exchanged else ("year", "month", "day")
    days = date(*(int(part[name]) for name in names)).toordinal() - _DAYS_TO_1970
    zone_s = 0
    if part["zone"] not in {None, "Z", "UTC"}:
        digits = part["zone"][1:].replace(":", "").ljust(4, "0")
        zone_s = (int(digits[:2]) * 3600 + int(digits[2:]) * 60) * (-1 if part["zone"][0] == "-" else 1)
    return (days * 86_400 - zone_s) * NS_PER_S + since_midnight


def _month_before_day(cells: Sequence[Any] | npt.NDArray[Any]) -> bool:
    matches = (_TIMES["slashes"].fullmatch(str(cell).strip()) for cell in cells)
    return any(int(match["month"]) > 12 for match in matches if match)


def moments_ns(cells: Sequence[Any] | npt.NDArray[Any]) -> tuple[IntArray, int | None]:
    """Return times of one format, see `moment_ns`, and the index of the first cell that is none."""
    out = np.zeros(len(cells), dtype=np.int64)
    passed_ns = 0
    month_first = len(cells) > 0 and time_format(str(cells[0])) == "slashes" and _month_before_day(cells)
    for index, cell in enumerate(cells):
        try:
            out[index] = moment_ns(str(cell), month_first=month_first) + passed_ns
        except ValueError:
            return out, index
        if index and out[index] < out[index - 1] - _HALF_DAY_NS and _TIMES["time_of_day"].fullmatch(str(cell).strip()):
            passed_ns += 2 * _HALF_DAY_NS
            out[index] += 2 * _HALF_DAY_NS
    return out, None
