"""Values as texts: numbers to the digits that their uncertainty allows, units, names of columns."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import Final

MISSING: Final = "–"
#: metres or radians from which on thousandths are not printed
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


def places(std: float, digits: int = 2) -> int:
    """Return the decimals at which `std` shows `digits` significant digits, 0 at least and 12 at most."""
    if not math.isfinite(std) or std <= 0:
        return 6
    # rounding may carry into the next decade: 0.0996 is 0.10
    exponent = math.floor(math.log10(float(f"{std:.{digits - 1}e}")))
    return min(max(digits - 1 - exponent, 0), 12)


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
    if std == 0:
        return "0"
    exponent = math.floor(math.log10(abs(float(f"{std:.1e}"))))
    return fixed(float(f"{std:.1e}"), max(1 - exponent, 0))


def measured(value: float, std: float) -> tuple[str, str]:
    """Return value and uncertainty as texts with the same last place, two significant digits of uncertainty."""
    decimals = places(std)
    return fixed(value, decimals), two_digits(std) if decimals == 0 else fixed(std, decimals)


def aligned(rows: Iterable[Sequence[str]], *columns: int) -> tuple[tuple[str, ...], ...]:
    """Return rows whose numbers, in the given columns, stand with their decimal points below each other.

    Shorter fractions are filled up with blanks as wide as a figure, since they have fewer significant digits.
    """
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
    return sentence[:1].upper() + sentence[1:]


def prose(text: str) -> str:
    """Return a sentence with typographic signs for units and minus."""
    for pattern, sign in _PROSE:
        text = pattern.sub(sign, text)
    return text


def readable(unit: str, size: float) -> tuple[float, str]:
    """Return factor and unit in which a length or angle of this size (SI) reads well: mm or m, mrad or rad."""
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
    """Return ``speed_mps`` as ``speed (m/s)``; a name of unknown unit says that it is the column's own."""
    words = in_words(name)
    return words if words.endswith(")") else f"{words} (as in the table)"


def in_words(name: str) -> str:
    """Return ``speed_mps`` as ``speed (m/s)``, and a name of no or unknown unit without its underscores."""
    stem, _, suffix = name.rpartition("_")
    text = f"{stem} ({_UNITS[suffix]})" if stem and suffix in _UNITS else name
    return _NAMED.get(name, text).replace("_", " ")
