"""What all stages share: types of arrays, the callback that reports progress, and operations on samples and poses."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import TypeVar

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
StrArray = npt.NDArray[np.str_]
#: a row of a table by its columns
Row = dict[str, str | float | None]

#: called with the steps done, the number of steps (0 where it is not known), and the name of the stage
Progress = Callable[[int, int, str], None]

Item = TypeVar("Item")
Key = TypeVar("Key")


def floats(values: npt.ArrayLike) -> FloatArray:
    """Return values as an array of doubles; one that is such an array is not copied."""
    return np.asarray(values, dtype=np.float64)


def silent(_done: int, _total: int, _stage: str) -> None:
    """Report nothing."""


def stepped(items: Collection[Item], progress: Progress, stage: str) -> Iterator[Item]:
    """Iterate over `items` and report the number done: before each item, and after the last."""
    for number, item in enumerate(items):
        progress(number, len(items), stage)
        yield item
    progress(len(items), len(items), stage)


def grouped(pairs: Iterable[tuple[Key, Item]]) -> dict[Key, list[Item]]:
    """Return the second parts of pairs by the first, in the order in which these first appear."""
    groups: dict[Key, list[Item]] = {}
    for key, item in pairs:
        groups.setdefault(key, []).append(item)
    return groups


def since_start(steps: FloatArray, offsets: IntArray) -> FloatArray:
    """Return running sums of steps within each run, 0 at its first sample; runs stand in the last axis, same shape."""
    total = np.cumsum(steps, axis=-1)
    return np.asarray(total - np.repeat(total[..., offsets[:-1]], np.diff(offsets), axis=-1))


def unwrapped(theta: FloatArray) -> FloatArray:
    """Return headings without jumps of whole turns, NaN where they were, shape (n,)."""
    good = np.isfinite(theta)
    headings = theta.copy()
    headings[good] = np.unwrap(theta[good])
    return headings


def in_frame(apart: FloatArray, heading_rad: FloatArray) -> FloatArray:
    """Return differences of poses, shape (3, n), ahead, to the left and in heading, at headings (n,), shape (n, 3)."""
    cosine, sine = np.cos(heading_rad), np.sin(heading_rad)
    return np.stack([cosine * apart[0] + sine * apart[1], cosine * apart[1] - sine * apart[0], apart[2]], axis=1)


def evenly(count: int, most: int) -> IntArray:
    """Return the indices of at most `most` of `count` samples, at equal distances, both ends among them."""
    return np.linspace(0, max(count - 1, 0), min(count, most)).round().astype(np.int64)


def rows_of(columns: Mapping[str, FloatArray]) -> list[dict[str, float]]:
    """Return the rows of columns of equal length (n,), each a mapping by name."""
    return [dict(zip(columns, row, strict=True)) for row in np.stack(list(columns.values()), axis=1).tolist()]
