"""JSON and CSV text as calib writes it, and the checksum of its own files.

The checksum is SHA-256 over a canonical form that survives re-indenting and re-ordering.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final

#: of the program, as its documents name it
VERSION = "1.0.0"

CHECKSUM_KEY: Final = "checksum"


def to_json(value: Any, *, ascii_only: bool = False) -> str:
    """Return `value` as indented JSON with a final newline.

    `value`: plain values, numpy scalars included; `ascii_only`: escape all other characters, as is always done where a
    text has no UTF-8 form (an unpaired surrogate). Raises ValueError where a number is NaN or infinite.
    """
    import json

    text = json.dumps(value, indent=2, ensure_ascii=ascii_only, allow_nan=False, default=_python_scalar) + "\n"
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return to_json(value, ascii_only=True)
    return text


def _python_scalar(value: Any) -> Any:
    if hasattr(value, "item"):
        return value.item()
    raise TypeError(f"{type(value).__name__} has no JSON form")


def csv_text(columns: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return a table for people and spreadsheets as CSV.

    `columns`: names of the columns; `rows`: cells; None is an empty cell, and no cell is a formula
    (`spreadsheet_cell`).
    """
    import csv
    import io

    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([spreadsheet_cell(name) for name in columns])
    writer.writerows([spreadsheet_cell(cell) for cell in row] for row in rows)
    return text.getvalue()


def spreadsheet_cell(value: Any) -> Any:
    """Return a cell that a spreadsheet does not evaluate: a text that begins like a formula gets a leading quote.

    Numbers stay numbers, also those written as texts.
    """
    if not isinstance(value, str) or not value.startswith(("=", "+", "-", "@", "\t", "\r")):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value


def canonical_bytes(document: dict[str, object]) -> bytes:
    """Return the bytes that the checksum covers.

    The document without its checksum; keys sorted, no white space, ASCII only, every number written as the shortest
    decimal that reads back as the same double, so that 4096 and 4096.0 are one number. Raises ValueError,
    OverflowError where a number is not a finite double.
    """
    import json

    body = {key: value for key, value in document.items() if key != CHECKSUM_KEY}
    text = json.dumps(_doubles(body), sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return text.encode("ascii")


def checksum(document: dict[str, object]) -> str:
    """Return ``sha256:`` and the hexadecimal SHA-256 of the canonical form of `document`."""
    import hashlib

    return "sha256:" + hashlib.sha256(canonical_bytes(document)).hexdigest()


def _doubles(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _doubles(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_doubles(item) for item in value]
    if isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value
