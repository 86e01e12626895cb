"""Lists of numbers as users write them."""

from __future__ import annotations

import math

from calib.errors import BadInputError

__all__ = ["numbers"]


def numbers(text: str, count: int | None, name: str) -> tuple[float, ...]:
    """Return the numbers of a text such as ``300,1100``.

    Parameters
    ----------
    text : str
        Numbers separated by commas.
    count : int or None
        How many are expected; None: one or more.
    name : str
        What they are, for the message.

    Raises
    ------
    BadInputError
        Where the text holds something else.
    """
    try:
        made = tuple(float(part) for part in text.split(","))
    except ValueError:
        made = ()
    if not made or (count is not None and len(made) != count) or not all(map(math.isfinite, made)):
        wanted = f"{count} numbers" if count else "numbers"
        raise BadInputError(f"{name}: found {text!r:.60}; expected {wanted} separated by commas; write them as 1.5,2")
    return made
