"""Results as plain text: values to the digits of their uncertainty, blocks fitted to the width."""

import math
import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, zip_longest
from typing import Final

from calib import reporting
from calib.reporting import Block, Column, Equation, Facts, Heading, Items, Notice, Picture, Section, Table, Text

MISSING: Final = "–"
#: thousandths of m or rad are printed below
MILLI_BELOW: Final = 1.0
#: blanks as wide as a figure and as a full stop
_FIGURE, _STOP = "\u2007", "\u2008"
#: what terminals can show, and how it is printed
_PROSE: Final = (
    (re.compile(r"\bum\b"), "µm"),
    (re.compile(r"\bdegC\b"), "°C"),
    (re.compile(r"\bS_O\b"), "Sₒ"),
    (re.compile(r"\bchi2\("), "χ²("),
    (re.compile(r"(?<=[\w)])\^2\b"), "²"),
    (re.compile(r"(?<![\w.])-(?=\d)"), "−"),
    (re.compile(r" -> "), " → "),
)


def natural(names: Iterable[object]) -> list[str]:
    """Return distinct names sorted as people count: r2 before r10."""

    def key(name: str) -> list[tuple[int, str]]:
        return [(int(part) if k % 2 else -1, part) for k, part in enumerate(re.split(r"([0-9]+)", name))]

    return sorted({str(name) for name in names}, key=key)


def places(std: float, digits: int = 2) -> int:
    """Return the decimals at which `std` shows `digits` significant digits, 0 at least and 12 at most."""
    if not math.isfinite(std) or std <= 0:
        return 6
    # rounding may carry into the next decade: 0.0996 is 0.10
    return min(max(digits - 1 - math.floor(math.log10(float(f"{std:.{digits - 1}e}"))), 0), 12)


def fixed(value: float | None, decimals: int) -> str:
    """Return `value` with that many decimals and a true minus sign; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return MISSING
    text = f"{value:.{decimals}f}"
    if float(text) == 0:
        text = text.lstrip("-")
    return text.replace("-", "−")


def two_digits(std: float | None) -> str:
    """Return a standard or expanded uncertainty with two significant digits."""
    if std is None or not math.isfinite(std):
        return MISSING
    return fixed(float(f"{std:.1e}"), places(std)) if std else "0"


def measured(value: float, std: float) -> tuple[str, str]:
    """Return value and uncertainty with the same last place, two significant digits of uncertainty."""
    decimals = places(std)
    return fixed(value, decimals), two_digits(std) if decimals == 0 else fixed(std, decimals)


def aligned(rows: Iterable[Sequence[str]], *columns: int) -> tuple[tuple[str, ...], ...]:
    """Return rows, the given columns aligned at their decimal points."""
    padded = [list(row) for row in rows]
    for column in columns:
        fractions = [len(row[column].partition(".")[2]) for row in padded]
        most = max(fractions, default=0)
        for row, fraction in zip(padded, fractions, strict=True):
            if row[column] and row[column] != MISSING and fraction < most:
                row[column] += (_STOP if fraction == 0 else "") + _FIGURE * (most - fraction)
    return tuple(tuple(row) for row in padded)


def plural(count: int, noun: str) -> str:
    """Return a count with its noun."""
    return f"{count} {noun if count == 1 else noun + 's'}"


def capital(sentence: str) -> str:
    """Return a sentence with its first letter in upper case."""
    return sentence if "_" in sentence.partition(" ")[0] else sentence[:1].upper() + sentence[1:]


def prose(text: str) -> str:
    """Return a sentence with typographic signs for units and minus."""
    for pattern, sign in _PROSE:
        text = pattern.sub(sign, text)
    return text


def readable(unit: str, size: float) -> tuple[float, str]:
    """Return factor and unit in which a length or angle of this size (SI) reads well."""
    if unit not in {"m", "rad"}:
        return 1.0, unit
    return (1.0, unit) if size >= MILLI_BELOW else (1e3, f"m{unit}")


def probability(p: float | None) -> str:
    """Return a p-value: three decimals, or that it is below a thousandth."""
    if p is None or not math.isfinite(p):
        return MISSING
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


def span(low: float, high: float, unit: str, form: str = ".4g") -> str:
    """Return a range with its unit; one value where both ends read the same."""
    first, last = (format(end, form).replace("-", "−") for end in (low, high))
    return f"{first} {unit}".strip() if first == last else f"{first} to {last} {unit}".strip()


def length(value_m: float | None) -> str:
    """Return a length in mm or m, to three digits; a dash where there is none."""
    if value_m is None or not math.isfinite(value_m):
        return MISSING
    factor, unit = readable("m", abs(value_m))
    return f"{three_digits(factor * value_m)} {unit}"


def three_digits(value: float) -> str:
    """Return a size with three significant digits, without an exponent."""
    return fixed(value, places(abs(value), 3) if value else 0)


#: a smaller share would be printed as 0 %
LEAST_SHARE: Final = 0.005


def percent(share: float | None) -> str:
    """Return a share in whole percent, ``< 1 %`` for what is more than nothing; a dash where there is none."""
    if share is None or not math.isfinite(share):
        return MISSING
    return "< 1 %" if 0.0 < share < LEAST_SHARE else f"{100 * share:.0f} %".replace("-", "−")


#: suffix of a name -> unit; and whole names whose unit is not their suffix
_UNITS: Final = {
    "mps": "m/s", "C": "°C", "kg": "kg", "N": "N", "rad": "rad", "m": "m", "s": "s", "km": "km", "min": "min",
    "Hz": "Hz", "V": "V", "A": "A", "percent": "%",
}  # fmt: skip
_NAMED: Final = {
    "minutes_under_load": "time under load (min)",
    "turn": "turn (rad)",
    "turn_absolute": "total absolute rotation (rad)",
}


def with_unit(name: str) -> str:
    """Return ``speed_mps`` as ``speed (m/s)``; an unknown unit is the column's own."""
    words = in_words(name)
    return words if words.endswith(")") else f"{words} (as in the table)"


def in_words(name: str) -> str:
    """Return ``speed_mps`` as ``speed (m/s)``, else a name without its underscores."""
    stem, _, suffix = name.rpartition("_")
    text = f"{stem} ({_UNITS[suffix]})" if stem and suffix in _UNITS else name
    return _NAMED.get(name, text).replace("_", " ")


WIDTH: Final = 80
_NAME: Final = 26
_SIGNS: Final = str.maketrans({"−": "-", "→": "->", "\u2007": " ", "\u2008": " ", "\u200b": "", "\u00a0": " "})
EQUATIONS: Final = reporting.catalogue()["equation"]


@dataclass(frozen=True, slots=True)
class Line:
    """A line of text and its style: empty, ``heading``, ``caption``, ``dim``, ``good``, ``note``, ``bad``."""

    text: str
    style: str = ""


def plain(text: str) -> str:
    """Return a text with signs that users can copy and search for."""
    return text.translate(_SIGNS)


def to_text(blocks: Iterable[Block | Section], width: int = WIDTH) -> str:
    """Return blocks as plain text of at most `width` columns, with a final newline."""
    return "".join(f"{line.text.rstrip()}\n" for line in text_lines(blocks, width))


def text_lines(blocks: Iterable[Block | Section], width: int = WIDTH) -> list[Line]:
    """Return blocks as lines of at most `width` columns, longer words apart; no pictures, no detail."""
    lines: list[Line] = []
    for block in blocks:
        if isinstance(block, Section):
            inner = [Line(""), Line(plain(block.title), "heading"), *text_lines(block.blocks, width)]
        else:
            inner = _lines(block, width)
        if lines and isinstance(block, (Heading, Table, Section)) and lines[-1].text and inner and inner[0].text:
            lines.append(Line(""))
        lines += inner
    while lines and not lines[0].text:
        lines.pop(0)
    return lines


def _lines(block: Block, width: int) -> list[Line]:
    match block:
        case Heading():
            return [Line(plain(block.text), "heading")]
        case Text():
            return _wrapped(block.text, width, style="dim" if block.small else "")
        case Facts():
            return _facts(block.rows, width)
        case Items():
            return [line for item in block.sentences for line in _wrapped(item, width, lead="- ", indent="  ")]
        case Equation():
            return [Line(f"    {EQUATIONS[block.name]}")]
        case Notice():
            words = f"{block.title}: {block.text}" if block.text else f"{block.title}."
            return _wrapped(words, width, style=block.level)
        case Table():
            return [*_wrapped(block.caption, width, style="caption"), *table_lines(block, width), Line("")]
    assert isinstance(block, Picture)
    return []


def _wrapped(text: str, width: int, *, lead: str = "", indent: str = "", style: str = "") -> list[Line]:
    wrap = textwrap.TextWrapper(width, lead, indent, break_long_words=False, break_on_hyphens=False)
    return [Line(line, style) for line in wrap.wrap(plain(text))]


def _facts(rows: Sequence[tuple[str, str]], width: int) -> list[Line]:
    room = min(max((len(name) for name, _ in rows), default=0), _NAME)
    lines: list[Line] = []
    for name, value in rows:
        lead = f"  {plain(name):<{room}}  "
        lines += _wrapped(value or " ", width, lead=lead, indent=" " * (room + 4)) or [Line(lead)]
    return lines


GAP: Final = 2
#: wider texts may wrap
LONG: Final = 30
NARROW: Final = 24


@dataclass(frozen=True, slots=True)
class _Fitted:
    head: Column
    cells: tuple[str, ...]
    width: int
    least: int


def table_lines(table: Table, width: int) -> list[Line]:
    """Return header, rule and rows of a table, without columns of detail."""
    shown = [(number, column) for number, column in enumerate(table.columns) if not column.detail]
    fitted = [_fit(column, [plain(row[number]) for row in table.rows]) for number, column in shown]
    lines: list[str] = []
    for part in _parts(_with_room_for_groups(fitted), width):
        lines += ["", *_drawn(part, _widths(part, width))]
    return [Line(text, "dim" if set(text.strip()) <= {"─", " "} else "") for text in lines[1:]]


def columns_of(text: str) -> int:
    """Return how many columns a text takes; signs of East Asian scripts take two."""
    from rich.cells import cell_len

    return len(text) if text.isascii() else cell_len(text)


def _unit(column: Column) -> str:
    return f"({column.unit})" if column.unit else ""


def _fit(column: Column, cells: list[str]) -> _Fitted:
    if column.align == "right" and column.group == "" and not column.wide:
        cells = [cell.rstrip() for cell in cells]
    longest = max((columns_of(cell) for cell in cells), default=0)
    words = [columns_of(word) for word in [*column.title.split(), _unit(column)]]
    width = max([longest, *words, 1])
    if not column.wide and not (column.align == "left" and longest > LONG):
        return _Fitted(column, tuple(cells), max(width, columns_of(column.title)), width)
    unbroken = max((columns_of(word) for cell in cells for word in cell.split()), default=0)
    return _Fitted(column, tuple(cells), width, min(width, max(NARROW, unbroken, *words)))


def _with_room_for_groups(fitted: Sequence[_Fitted]) -> list[_Fitted]:
    widened = list(fitted)
    for group in dict.fromkeys(column.head.group for column in fitted if column.head.group):
        members = [number for number, column in enumerate(fitted) if column.head.group == group]
        room = sum(fitted[number].least for number in members) + GAP * (len(members) - 1)
        for k in range(max(0, columns_of(group) - room)):
            number = members[k % len(members)]
            column = widened[number]
            widened[number] = replace(column, width=max(column.width, column.least + 1), least=column.least + 1)
    return widened


def _parts(fitted: Sequence[_Fitted], width: int) -> list[list[_Fitted]]:
    parts: list[list[_Fitted]] = []
    part: list[_Fitted] = []
    for column in fitted:
        taken = sum(other.least + GAP for other in part) + column.least
        if part and taken > width and len(part) > (1 if parts else 0):
            group = [other for other in part[1:] if column.head.group and other.head.group == column.head.group]
            group = group if len(part) - len(group) > 1 else []
            parts.append(part[: len(part) - len(group)])
            part = [fitted[0], *group]
        part.append(column)
    return [*parts, part] if part else parts


def _widths(part: Sequence[_Fitted], width: int) -> list[int]:
    free = width - sum(column.least for column in part) - GAP * (len(part) - 1)
    widths = []
    for column in part:
        growth = max(0, min(column.width - column.least, free))
        free -= growth
        widths.append(column.least + growth)
    return widths


def _drawn(part: Sequence[_Fitted], widths: Sequence[int]) -> list[str]:
    groups = [column.head.group for column in part]
    titles = [column.head.title for column in part]
    heads = [textwrap.wrap(title, n, break_long_words=False) for title, n in zip(titles, widths, strict=True)]
    height = max(map(len, heads))
    rows = list(zip(*([""] * (height - len(head)) + head for head in heads), strict=True))
    if any(column.head.unit for column in part):
        rows.append(tuple(_unit(column.head) for column in part))
    lines = _group_lines(groups, widths) if any(groups) else []
    lines += [_row(words, part, widths) for words in rows]
    lines.append("─" * (sum(widths) + GAP * (len(widths) - 1)))
    for cells in zip(*(column.cells for column in part), strict=True):
        wrapped = (
            textwrap.wrap(cell, width, break_long_words=False, break_on_hyphens=False)
            if columns_of(cell) > width
            else [cell]
            for cell, width in zip(cells, widths, strict=True)
        )
        lines += [_row(words, part, widths) for words in zip_longest(*wrapped, fillvalue="")]
    return lines


def _group_lines(groups: Sequence[str], widths: Sequence[int]) -> list[str]:
    titles, rules = "", ""
    for title, members in groupby(zip(groups, widths, strict=True), key=lambda column: column[0]):
        taken = [width for _, width in members]
        room = sum(taken) + GAP * (len(taken) - 1)
        titles += f"{title[:room]:^{room}}" + " " * GAP
        rules += ("─" if title else " ") * room + " " * GAP
    return [titles.rstrip(), rules.rstrip()]


def _row(words: Sequence[str], part: Sequence[_Fitted], widths: Sequence[int]) -> str:
    cells = []
    for word, column, width in zip(words, part, widths, strict=True):
        # str.center counts signs of two columns as one
        blank = max(0, width - columns_of(word))
        before = {"left": 0, "right": blank, "center": blank // 2}[column.head.align]
        cells.append(" " * before + word + " " * (blank - before))
    return (" " * GAP).join(cells).rstrip()
