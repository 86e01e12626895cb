"""What libraries warn of while they compute, as one note in place of lines about their code."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def numbers_beyond_said() -> Iterator[None]:
    """Say in one note, in place of a library's lines about its code, that numbers left what can be computed with."""
    beyond: list[str] = []
    with warnings.catch_warnings():
        before = warnings.showwarning

        def kept(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if issubclass(category, RuntimeWarning):
                beyond.append(str(message))
            else:
                before(message, category, *where, **more)

        warnings.showwarning = kept
        yield
    if beyond:
        what = ", ".join(dict.fromkeys(text.partition(" encountered")[0] for text in beyond))
        sys.stderr.write(
            f"calib: note: some numbers are too large, too small or missing to compute with ({what:.100})\n"
        )
