"""Items shared out in batches: what is handed over at once, so that handing over costs little beside the work."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, TypeVar

Item = TypeVar("Item")

#: a batch is at most this part of a worker's share of what is left: the last ones are small, so that all end together
PARTS_OF_A_SHARE: Final = 2


def one_each(_item: object) -> int:
    """Say that an item is one piece of work, as every other is."""
    return 1


def batches(
    items: Sequence[Item], weigh: Callable[[Item], int], largest: int, workers: int = 1, smallest: int = 1
) -> list[Sequence[Item]]:
    """Cut items into batches in their order.

    Parameters
    ----------
    items : sequence
        What to do.
    weigh : callable
        Pieces of work that an item stands for.
    largest : int
        Pieces of work in a batch, at most; a single item may stand for more.
    workers : int
        Who share them.
    smallest : int
        Pieces of work from which on a batch may end, though it would be smaller for all to end together.

    Returns
    -------
    list of sequence
        None of them empty.
    """
    weights = [max(weigh(item), 1) for item in items]
    left = sum(weights)
    cut: list[Sequence[Item]] = []
    first = filled = 0
    for number, weight in enumerate(weights):
        if filled and filled + weight > min(largest, max(smallest, left // (PARTS_OF_A_SHARE * workers))):
            cut.append(items[first:number])
            left -= filled
            first, filled = number, 0
        filled += weight
    if filled:
        cut.append(items[first:])
    return cut
