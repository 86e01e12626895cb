"""A task that takes a while, for workers that find it by name."""

from __future__ import annotations

import time
from collections.abc import Sequence


def doubled(items: Sequence[int]) -> list[int]:
    """Return twice each item, a tenth of a second each."""
    time.sleep(0.1 * len(items))
    return [2 * item for item in items]
