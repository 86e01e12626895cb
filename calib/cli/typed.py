"""Messages of the library in the words of the command line: arguments become options."""

from __future__ import annotations

import re
from collections.abc import Collection

_LEADING = re.compile(r"^([a-z][a-z_]*)(?=: )")
_FLAG = re.compile(r"\bforce=True\b")


def as_typed(message: str, options: Collection[str]) -> str:
    """Return a message whose argument names are the options that were typed.

    `message`: of the library: ``draws: found 0; expected 100 or more``; `options`: options of the command, ``--draws``
    and so on; other names stay as they are.
    """
    named = _LEADING.match(message)
    if named and f"--{named[1].replace('_', '-')}" in options:
        message = f"--{named[1].replace('_', '-')}{message[named.end() :]}"
    return _FLAG.sub("--force", message)
