"""Times as people and loggers write them, kept as integer nanoseconds: ISO 8601, day first, time of day, seconds."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from calib.arrays import IntArray

NS_PER_S: Final = 1_000_000_000
_CLOCK: Final = r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,](\d{1,9}))?)?"
_ZONE: Final = r"\s*(Z|UTC|[+-]\d{2}:?\d{2}|[+-]\d{2})?"
_ISO: Final = re.compile(rf"(\d{{4}})-(\d{{2}})-(\d{{2}})[T ]{_CLOCK}{_ZONE}", re.ASCII)
_DAY_FIRST: Final = re.compile(rf"(\d{{1,2}})\.(\d{{1,2}})\.(\d{{4}})[T ]+{_CLOCK}{_ZONE}", re.ASCII)
_OF_DAY: Final = re.compile(_CLOCK, re.ASCII)

#: name of a format -> what it looks like
TIME_FORMATS: Final = {
    "iso8601": "2026-05-04T10:15:30.250+02:00",
    "day_first": "04.05.2026 10:15:30,250",
    "time_of_day": "10:15:30.250",
}


def decimal_ns(text: str) -> int:
    """Return seconds written as a decimal number as nanoseconds, exactly; further digits are rounded off.

    Raises ValueError where the text is no such number.
    """
    match = re.fullmatch(r"([+-]?)(\d+)(?:\.(\d*))?", text.strip(), re.ASCII)
    if match is None:
        return round(float(text) * NS_PER_S)
    digits = (match[3] or "")[:10].ljust(10, "0")
    nanoseconds = int(match[2]) * NS_PER_S + (int(digits) + 5) // 10
    return -nanoseconds if match[1] == "-" else nanoseconds


def time_format(text: str) -> str | None:
    """Return the name of the format that a text is written in (of `TIME_FORMATS`), or None."""
    clean = text.strip()
    if _ISO.fullmatch(clean):
        return "iso8601"
    if _DAY_FIRST.fullmatch(clean):
        return "day_first"
    return "time_of_day" if _OF_DAY.fullmatch(clean) and clean.count(":") == 2 else None


def moment_ns(text: str) -> int:
    """Return one time as nanoseconds since 1970 (UTC where no zone is named), or since midnight for a time of day.

    Raises ValueError where the text is none of `TIME_FORMATS`, or names no day of the calendar.
    """
    clean = text.strip()
    if match := _ISO.fullmatch(clean):
        year, month, day = int(match[1]), int(match[2]), int(match[3])
    elif match := _DAY_FIRST.fullmatch(clean):
        day, month, year = int(match[1]), int(match[2]), int(match[3])
    elif match := _OF_DAY.fullmatch(clean):
        return _of_day(match.groups())
    else:
        raise ValueError(f"{clean[:40]!r} is no time")
    days = int(np.datetime64(f"{year:04d}-{month:02d}-{day:02d}", "D").astype(np.int64))
    return (days * 86_400 - _zone_s(match[8])) * NS_PER_S + _of_day(match.groups()[3:7])


def moments_ns(cells: Sequence[Any] | npt.NDArray[Any]) -> tuple[IntArray, int | None]:
    """Return a column of times as nanoseconds.

    `cells` (shape (n_rows,)): all in one of `TIME_FORMATS`. Returns `time_ns` (shape (n_rows,)): nanoseconds since
    1970, or since the first midnight; `bad`: index of the first cell that is no time; None where all are.
    """
    out = np.zeros(len(cells), dtype=np.int64)
    days = 0
    for index, cell in enumerate(cells):
        try:
            out[index] = moment_ns(str(cell)) + days
        except ValueError:
            return out, index
        if index and out[index] < out[index - 1] - 43_200 * NS_PER_S and _OF_DAY.fullmatch(str(cell).strip()):
            # a time of day that falls by more than half a day has passed midnight
            days += 86_400 * NS_PER_S
            out[index] += 86_400 * NS_PER_S
    return out, None


def _of_day(parts: Sequence[str | None]) -> int:
    hour, minute, second, rest = int(parts[0] or 0), int(parts[1] or 0), int(parts[2] or 0), parts[3] or ""
    if hour > 24 or minute > 59 or second > 60:
        raise ValueError("no time of day")
    return (hour * 3600 + minute * 60 + second) * NS_PER_S + int(rest.ljust(9, "0"))


def _zone_s(zone: str | None) -> int:
    if zone is None or zone in {"Z", "UTC"}:
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    seconds = int(digits[:2]) * 3600 + int(digits[2:]) * 60
    return -seconds if zone[0] == "-" else seconds
