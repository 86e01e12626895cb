"""The checksum of calib's own files: SHA-256 over a canonical form that survives re-indenting and re-ordering."""

from __future__ import annotations

import hashlib
import json
from typing import Any, Final

CHECKSUM_KEY: Final = "checksum"


def canonical_bytes(document: dict[str, Any]) -> bytes:
    """Return the bytes that the checksum covers.

    The document without its checksum; keys sorted, no white space, ASCII only, every number written as the shortest
    decimal that reads back as the same double, so that 4096 and 4096.0 are one number.

    Raises ValueError, OverflowError where a number is not a finite double.
    """
    body = {key: value for key, value in document.items() if key != CHECKSUM_KEY}
    text = json.dumps(_doubles(body), sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return text.encode("ascii")


def checksum(document: dict[str, Any]) -> str:
    """Return ``sha256:`` and the hexadecimal SHA-256 of the canonical form of `document`."""
    return "sha256:" + hashlib.sha256(canonical_bytes(document)).hexdigest()


def _doubles(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _doubles(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_doubles(item) for item in value]
    if isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value
