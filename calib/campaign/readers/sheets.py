"""Laboratories' tables: several header rows, units, remarks, means and sums among the rows."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain, repeat, zip_longest
from math import pi
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from calib.campaign.model import Note
from calib.campaign.readers import table
from calib.campaign.readers.table import Layout, RawTable, Wanted, filled_cells, is_filled, is_number
from calib.errors import BadFileError
from calib.types import SUFFIXES, unit_named

Rows = list[tuple[int, Sequence[Any]]]
#: unit of a wheel's column -> kind of numbers, turns (or counts, metres) a unit, other spellings
COUNT_UNITS: Final[Mapping[str, tuple[str, float, str | None]]] = {
    "counts": ("counts", 1.0, r"counts?|cn?ts?|ticks?|(im)?pulses?|in[ck]|imp"),
    "counts/sample": ("increments", 1.0, r"increments|(cnt|ticks)/sample|counts/step"),
    "counts/s": ("count_rate", 1.0, r"(cnt|ticks|impulse)/s"),
    "turns": ("angle", 1.0, r"turn|revs?|revolutions|umdrehungen"),
    "rad": ("angle", 1.0 / (2.0 * pi), None),
    "deg": ("angle", 1.0 / 360.0, None),
    "turns/s": ("rate", 1.0, r"(rev|u)/s"),
    "rad/s": ("rate", 1.0 / (2.0 * pi), r"(radian|rad)s/s"),
    "deg/s": ("rate", 1.0 / 360.0, r"(°|degrees|grad)/s"),
    "rpm": ("rate", 1.0 / 60.0, r"(1|u|rev)/min"),
    "rad/min": ("rate", 1.0 / (60.0 * 2.0 * pi), None),
    "m": ("length", 1.0, None),
    "cm": ("length", 1e-2, None),
    "mm": ("length", 1e-3, None),
}
#: units of what calib does not use, and forms of times as hh:mm:ss,f
_OTHER_UNITS: Final = re.compile(
    r"m?v|m?a|k?w|k?hz|%|m?bar|[hk]?pa|nm|h|min|d|m/s²|[dmyhsfjt]{1,4}([.:/, \-]+[dmyhsfjt]{1,4})+", re.IGNORECASE
)
_NO_UNIT: Final = frozenset({"", "-", "–", "1"})
_SHORT: Final = 8
_TEXT_SHARE: Final = 0.6
_HEADER_ROWS: Final = 4
LOOKED_AT: Final = 20
#: of a table in which a row of one text is a remark
_LEAST_COLUMNS: Final = 3
SECTION: Final = "section"
UNNAMED: Final = re.compile(r"column \d+")
_BRACKETED: Final = re.compile(r"[\[(].*[\])]")
_SIDE: Final = re.compile(r"(l|r|li|re|left|right|links|rechts)\.?", re.IGNORECASE)
_UNIT_AT_END: Final = re.compile(r"[\[(][^\[\]()]*[\])]\s*$")
_WITH_UNIT: Final = re.compile(r"([+-]?\d[\d.,'\s]*?)\s*([^\W\d_][^\d\s]*|°\w?|%)")
SUMMARY: Final = re.compile(
    r"(mean|average|avg|sum|total|std|st\.?\s?dev|std\.?\s?dev|sd|min|max|minimum|maximum|median|mittel(wert)?|mw|summe"
    r"|gesamt|standardabweichung|st(d|and)?abw|durchschnitt|moyenne|somme|ecart.type|écart.type|media|suma|somma|ø|σ|Σ)\W*",
    re.IGNORECASE,
)


def heading(numbered: Rows, layout: Layout, shown: str, above: Sequence[Any] = ()) -> tuple[list[str], int, list[Note]]:
    """Return names with units in brackets, how many rows they take, and notes.

    `numbered`: the header first; `above`: the row over it; see `table_rows`.
    """
    lines, rows = zip(*numbered[:LOOKED_AT], strict=True)
    first = _texts(rows[0])
    notes = [Note("info", shown, f"the header was found in row {lines[0]}", "preamble")] if lines[0] > 1 else []
    if not layout.lab:
        units = _texts(rows[1]) if len(rows) > 1 else []
        named = list(filter(None, units))
        if not named or not all(map(_is_unit, named)) or all(map(is_number, named)):
            return first, 1, notes
        names, note = _with_units(first, units, shown)
        return names, 2, [*notes, note]
    if layout.header_row is None and len(filled_cells(first)) > 1 and all(map(is_number, filled_cells(first))):
        text = "no row names the columns; they are called column 1, column 2, ..."
        names = [f"column {number + 1}" for number in range(len(first))]
        return names, 0, [Note("info", shown, text, "names")]
    n_rows = _header_rows(rows, fixed=layout.header_row is not None)
    units_at = n_rows - 1 if n_rows > 1 and _holds_units(rows, n_rows - 1) else None
    if layout.units_row is not None:
        if layout.units_row not in lines:
            head, expected = f"rows {lines[0]} to {lines[-1]} at the head of the table", "the row of units among them"
            raise BadFileError(shown, head, expected, "correct units_row of the mapping", row=layout.units_row)
        units_at = lines.index(layout.units_row)
        n_rows = max(n_rows, units_at + 1)
    block = [_texts(row) for number, row in enumerate(rows[:n_rows]) if number != units_at]
    if layout.header_row is not None:
        block = block[:1]
    over = filled_cells(above)
    grouped = len(over) > 1 and not any(map(is_number, over))
    last = block[-1] + [""] * (max(map(len, block)) - len(block[-1]))
    names = _joined(last, [_texts(above), *block[:-1]] if grouped else block[:-1])
    if units_at is None:
        return names, n_rows, notes
    names, note = _with_units(names, _texts(rows[units_at]), shown)
    return names, n_rows, [*notes, note]


def looks_like_units(row: Sequence[Any]) -> bool:
    """Return whether a row holds units: some known or in brackets, others short."""
    cells = [str(cell).strip() for cell in filled_cells(row)]
    if not cells or any(map(is_number, cells)):
        return False
    known = sum(map(_known_unit, cells))
    return 2 * known >= len(cells) or (known > 0 and all(len(cell) <= _SHORT for cell in cells))


def _known_unit(text: str) -> bool:
    cell = text.strip()
    return bool(_is_unit(cell) or _BRACKETED.fullmatch(cell) or _OTHER_UNITS.fullmatch(bare(cell)))


def _holds_units(rows: Sequence[Sequence[Any]], at: int) -> bool:
    # names beneath one that spans columns: Load, Counts
    named = {column for row in rows[:at] for column, cell in enumerate(row) if is_filled(cell)}
    # what is no unit, and stands over text, is a label
    beneath = rows[at + 1] if at + 1 < len(rows) else ()
    for cell, below in zip(rows[at], beneath, strict=False):
        if is_filled(cell) and is_filled(below) and not (_known_unit(str(cell)) or is_number(str(below))):
            return False
    return looks_like_units(rows[at]) and {column for column, cell in enumerate(rows[at]) if is_filled(cell)} <= named


def unit_spelled(text: str) -> str:
    """Return a unit as calib writes it, if it knows it."""
    clean = text.strip()
    if clean in COUNT_UNITS:
        return clean
    counted = (unit for unit, (_, _, form) in COUNT_UNITS.items() if form and re.fullmatch(form, clean.lower()))
    return next(counted, None) or unit_named(clean) or clean


def bare(unit: str) -> str:
    """Return a unit without its brackets."""
    return unit.strip().strip("[]()").strip()


def _is_unit(text: str) -> bool:
    word = bare(text)
    return unit_spelled(word) in {*COUNT_UNITS, *SUFFIXES} or word in _NO_UNIT


def _texts(row: Sequence[Any]) -> list[str]:
    return ["" if cell is None else " ".join(str(cell).split()) for cell in row]


def _header_rows(rows: Sequence[Sequence[Any]], *, fixed: bool) -> int:
    body = list(rows[_HEADER_ROWS - 1 : LOOKED_AT]) or list(rows[1:])
    columns = [filled_cells(column) for column in zip_longest(*body)]
    numeric = [at for at, cells in enumerate(columns) if cells and 2 * sum(map(is_number, cells)) >= len(cells)]
    last = 0
    for at, row in enumerate(rows[1 : min(_HEADER_ROWS, len(rows) - 1)], start=1):
        filled = [column for column, cell in enumerate(row) if is_filled(cell)]
        over = [str(row[column]).strip() for column in filled if column in numeric]
        if any(map(is_number, over)):
            break
        texts = [cell for cell in over if cell.lower() not in table.EMPTY]
        wide = len(texts) >= _TEXT_SHARE * len(numeric) > 0
        further = len(texts) > 1 and set(filled) <= set(numeric)
        if _holds_units(rows, at):
            return at + 1
        if (wide or further) and not fixed:
            last = at
    return last + 1


def _joined(names: Sequence[str], groups: Sequence[Sequence[str]]) -> list[str]:
    spread, own = [""] * len(names), [""] * len(names)
    for group in groups:
        last = ""
        for at, cell in enumerate([*group, *[""] * len(names)][: len(names)]):
            last = cell or last
            spread[at] = last or spread[at]
            own[at] = cell or own[at]
    out, times = [], Counter(names)
    twice = any(len(name) == 1 and times[name] > 1 for name in names)
    for at, name in enumerate(names):
        # W beside an X and Y of two quantities
        unclear = not name or times[name] > 1 or _SIDE.fullmatch(name) or (len(name) == 1 and twice)
        group = (spread[at] if name else own[at]) if unclear else ""
        unit = _UNIT_AT_END.search(group) if name else None
        parts = (group[: unit.start()].rstrip(), name, unit[0].strip()) if unit else (group, name)
        out.append(" ".join(part for part in parts if part))
    return out


def _with_units(names: Sequence[str], units: Sequence[str], shown: str) -> tuple[list[str], Note]:
    out, unknown = list(names), []
    for at, (name, unit) in enumerate(zip(names, map(bare, units), strict=False)):
        if name and unit not in _NO_UNIT and not _UNIT_AT_END.search(name):
            out[at] = f"{name} [{unit}]"
            unknown += [] if _is_unit(unit) else [f"{unit} ({name})"]
    text = "the row beneath the header names units"
    if unknown:
        text += f"; not known, so their numbers are not converted: {', '.join(unknown)[:200]}"
    return out, Note("info", shown, text, "unit_row")


def finished(
    columns: dict[str, npt.NDArray[Any]], lines: Sequence[int], wanted: Wanted | None, notes: Sequence[Note], shown: str
) -> RawTable:
    """Return a table of cells as read; with `wanted` of numbers, clock times in s since the first.

    Raises BadFileError where a cell is no number; see `table_rows`.
    """
    line, notes = np.asarray(lines, dtype=np.int64), list(notes)
    if wanted is None:
        return RawTable(columns, line, tuple(notes))
    mark = table.comma_evidence(list(columns.values()))
    values: dict[str, npt.NDArray[Any]] = {}
    used_comma = False
    epochs: dict[str, int] = {}
    written: dict[str, tuple[str, str]] = {}
    for name, cells in columns.items():
        first = next(filter(is_filled, cells), None)
        form = table.time_format(first) if isinstance(first, str) else None
        if form is None:
            values[name], comma = table.numbers(cells, shown, name, line, mark, notes)
            used_comma = used_comma or comma
            continue
        time_ns, bad = table.moments_ns(cells)
        if bad is not None:
            actual = "an empty cell" if cells[bad] is None else repr(str(cells[bad])[:40])
            expected, remedy = f"a time as {table.TIME_FORMATS[form][0]}", "correct the cell, or remove the row"
            raise BadFileError(shown, actual, expected, remedy, row=int(line[bad]), column=name)
        epochs[name] = int(time_ns[0])
        values[name] = (time_ns - time_ns[0]) / table.NS_PER_S
        written[name] = str(cells[0]).strip(), table.format_words(cells)
        notes.append(Note("info", f"{shown}, column {name}", f"times were read as {written[name][1]}", "time_format"))
    notes += table.notes_of_commas(columns, shown, line) if used_comma else []
    return RawTable(values, line, tuple(notes), epochs, written)


def table_rows(
    names: list[str], rows: Rows, n_rows: int, layout: Layout, shown: str
) -> tuple[list[str], Rows, list[Note]]:
    """Return names, and the rows beneath the header; a laboratory's other rows are noted.

    `rows`: the `n_rows` of the header first; see `heading`.
    """
    heads, rows = [_without_end(_texts(row)) for _, row in rows[:n_rows]], rows[n_rows:]
    if not layout.lab:
        return names, rows, []
    kept: Rows = []
    notes = []
    last_remark, above = "", []
    shapes: set[tuple[int, str]] = set()
    for line, row in rows:
        if not (filled := [(at, cell) for at, cell in enumerate(row) if is_filled(cell)]):
            continue
        at, first = filled[0]
        text = " ".join(str(first).split())
        why = ""
        if len(filled) == 1 and len(names) >= _LEAST_COLUMNS and not is_number(first):
            shapes = shapes or {
                (column, _shape(str(cell).strip()))
                for _, other in rows
                if len(filled_cells(other)) > 1
                for column, cell in enumerate(other)
            }
            why = "" if "0" in _shape(text) and (at, _shape(text)) in shapes else "a remark"
        elif isinstance(first, str) and SUMMARY.fullmatch(text) and not is_number(text):
            why = "a mean, a sum or the like"
        elif len(filled) > 1 and _without_end(_texts(row)) in heads:
            why = "the beginning of the header again"
        last_remark = text if why == "a remark" else last_remark
        if why:
            notes.append(Note("info", f"{shown}, row {line}", f"{text[:60]!r} is {why}, no row; omitted", "remark"))
            continue
        kept.append((line, row))
        above.append(last_remark)
    units = [_unit_of_cells(row[at] for _, row in kept if at < len(row)) for at in range(len(names))]
    if any(units):
        kept = [(line, list(map(_without_unit, row, chain(units, repeat(""))))) for line, row in kept]
    whole = [
        f"{name} [{unit}]" if unit and not _UNIT_AT_END.search(name) else name
        for name, unit in zip(names, units, strict=True)
    ]
    headings = list(dict.fromkeys(above))
    if all(headings) and len(headings) > 1 == len({*map(_shape, headings)}):
        notes = [one for one in notes if one.text.split("'")[1] not in headings]
        text = f"{', '.join(headings)[:100]} stand above their rows; they are the column {SECTION!r}"
        notes.append(Note("info", shown, text, "remark"))
        whole, kept = [SECTION, *whole], [(at, [text, *row]) for text, (at, row) in zip(above, kept, strict=True)]
    return whole, kept, notes


def _without_end(cells: list[str]) -> list[str]:
    return cells[: max((at + 1 for at, cell in enumerate(cells) if cell), default=0)]


def _without_unit(cell: Any, unit: str) -> Any:
    return str(cell).strip().removesuffix(unit).rstrip() if unit and is_filled(cell) else cell


def _unit_of_cells(cells: Iterable[Any]) -> str:
    unit = ""
    for cell in filter(is_filled, cells):
        match = _WITH_UNIT.fullmatch(str(cell).strip())
        if match is None or (unit and match[2] != unit):
            return ""
        unit = match[2]
    return unit if unit and _is_unit(unit) else ""


def _shape(text: str) -> str:
    return re.sub(r"\d+", "0", text)
