"""How far a long piece of work is: library code calls what it is given, and never prints."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from typing import TypeVar

#: called with the steps done, all steps (0 where nobody knows), and the name of the stage; one stage follows another
Progress = Callable[[int, int, str], None]

Item = TypeVar("Item")


def silent(_done: int, _total: int, _stage: str) -> None:
    """Say nothing."""


def stepped(items: Collection[Item], progress: Progress, stage: str) -> Iterator[Item]:
    """Go through `items`, saying before each how many are done, and at the end that all are."""
    for number, item in enumerate(items):
        progress(number, len(items), stage)
        yield item
    progress(len(items), len(items), stage)
