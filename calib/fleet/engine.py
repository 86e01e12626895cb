"""What runs the tasks of a fleet: batches of items, here in this process; others give them to workers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Final, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
Task = Callable[[Sequence[Item]], list[Result]]
#: a batch with its results; None where its worker died
Outcome = tuple[Sequence[Item], list[Result] | None]


#: a batch is at most this part of a worker's share of the remaining work: the last ones are small, so that all workers
#: end together
PARTS_OF_A_SHARE: Final = 2
#: pieces of work in a batch, least and most: in this process (between two progress reports)
SERIAL_BATCH: Final = (1, 16)
#: what nearly every task needs and the parent too: imported before processes are made of it
SHARED_MODULES: Final = ("calib.fleet.reading", "scipy.special")
#: what nearly every task needs and what starts threads: imported by each worker
WORKER_MODULES: Final = ("pyarrow.parquet",)


def equal_weight(_item: object) -> int:
    """Return the weight of an item that is one piece of work, as every other is."""
    return 1


def batches(
    items: Sequence[Item], weigh: Callable[[Item], int], largest: int, workers: int = 1, smallest: int = 1
) -> list[Sequence[Item]]:
    """Cut items into batches in their order.

    Parameters
    ----------
    items, weigh : sequence, callable
        What to do, and how many pieces of work an item stands for.
    largest, smallest : int
        Pieces of work in a batch, at most (a single item may stand for more) and at least (but for the last).
    workers : int
        How many share them.

    Returns
    -------
    list of sequence
        None of them empty.
    """
    weights = [max(weigh(item), 1) for item in items]
    remaining = sum(weights)
    cut: list[Sequence[Item]] = []
    first = filled = 0
    for number, weight in enumerate(weights):
        share = max(smallest, remaining // (PARTS_OF_A_SHARE * workers))
        if filled and filled + weight > min(largest, share):
            cut.append(items[first:number])
            remaining -= filled
            first, filled = number, 0
        filled += weight
    if filled:
        cut.append(items[first:])
    return cut


class Engine:
    """Runs tasks in this process; the engines below give the batches to others. Workers stay between two calls."""

    #: least and most pieces of work in a batch
    batch: tuple[int, int] = SERIAL_BATCH

    @property
    def workers(self) -> int:
        """How many batches run at once."""
        return 1

    def completed(self, task: Task[Item, Result], cut: Sequence[Sequence[Item]]) -> Iterator[Outcome[Item, Result]]:
        """Yield the batches with their results as they are done."""
        for batch in cut:
            yield batch, task(batch)

    def alone(self, task: Task[Item, Result], item: Item) -> list[Result] | None:
        """Return the result of an item that has a worker to itself; None where the worker dies."""
        return task([item])

    def close(self) -> None:
        """End the workers."""

    def run(
        self,
        task: Task[Item, Result],
        items: Sequence[Item],
        given_up: Callable[[Item, str], Result],
        weigh: Callable[[Item], int] = equal_weight,
    ) -> Iterator[Result]:
        """Run a task on all items, a few at a time, and yield the results as they come.

        A worker that dies costs its own batches: their items are tried again one by one, so that the one that kills its
        worker is found and the others go through.

        Parameters
        ----------
        task : callable
            Takes some items and returns a result for each; a module's function, since it is sent to others by name.
        items : sequence
            What to do.
        given_up : callable
            Makes the result of an item that took its worker down twice, from the item and the reason.
        weigh : callable
            Pieces of work that an item stands for, so that batches are alike.

        Yields
        ------
        Result
            One an item.
        """
        smallest, largest = self.batch
        suspects: list[Item] = []
        for batch, results in self.completed(task, batches(items, weigh, largest, self.workers, smallest)):
            if results is None:
                suspects += batch
            else:
                yield from results
        for item in suspects:
            results = self.alone(task, item)
            if results is None:
                yield given_up(item, "its worker died twice; expected one that ends; read it alone")
            else:
                yield from results


def import_modules(modules: Sequence[str]) -> None:
    """Import modules, so that the first task need not; those that are not installed are skipped."""
    import importlib

    for module in modules:
        # an extra that is not installed: the task reports it where it needs it
        with suppress(ImportError):
            importlib.import_module(module)
