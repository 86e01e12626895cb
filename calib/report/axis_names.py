"""Columns as axes are called: in words, with their unit."""

from __future__ import annotations

from typing import Final

#: suffix of a name -> unit; and whole names whose unit is not their suffix
_UNITS: Final = {
    "mps": "m/s", "C": "°C", "kg": "kg", "N": "N", "rad": "rad", "m": "m", "s": "s", "km": "km", "min": "min",
    "Hz": "Hz", "V": "V", "A": "A", "percent": "%",
}  # fmt: skip
_NAMED: Final = {
    "minutes_under_load": "time under load (min)",
    "turn": "turn (rad)",
    "turn_absolute": "turn either way (rad)",
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
