"""Types that all stages share: arrays of numbers and texts, and the callback that reports progress."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from typing import TypeVar

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
StrArray = npt.NDArray[np.str_]
#: a row of a table by its columns
Row = dict[str, str | float | None]

#: called with the steps done, the number of steps (0 where it is not known), and the name of the stage
Progress = Callable[[int, int, str], None]

Item = TypeVar("Item")


def silent(_done: int, _total: int, _stage: str) -> None:
    """Report nothing."""


def stepped(items: Collection[Item], progress: Progress, stage: str) -> Iterator[Item]:
    """Iterate over `items` and report the number done: before each item, and after the last."""
    for number, item in enumerate(items):
        progress(number, len(items), stage)
        yield item
    progress(len(items), len(items), stage)
