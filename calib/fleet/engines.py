"""Where the tasks run: in this process, in processes of this machine, or on a Dask scheduler."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final, Protocol, TypeVar

from calib.fleet.batches import batches, one_each
from calib.fleet.dask_workers import dask_workers
from calib.fleet.processes import Processes

Item = TypeVar("Item")
Result = TypeVar("Result")

#: pieces of work between two looks at what came of them
BATCH: Final = 16


class Engine(Protocol):
    """What runs tasks; workers stay from one call to the next."""

    def run(
        self,
        task: Callable[[Sequence[Item]], list[Result]],
        items: Sequence[Item],
        given_up: Callable[[Item, str], Result],
        weigh: Callable[[Item], int] = one_each,
    ) -> Iterator[Result]:
        """Run a task on all items, a few at a time, and yield the results as they come.

        Parameters
        ----------
        task : callable
            Takes some items and returns a result for each; a module's function, since it is sent to others by name.
        items : sequence
            What to do.
        given_up : callable
            Makes the result of an item that took its worker down twice.
        weigh : callable
            Pieces of work that an item stands for, so that batches are alike.

        Yields
        ------
        Result
            One an item.
        """


@contextmanager
def engine(workers: int = 1, scheduler: str = "") -> Iterator[Engine]:
    """Open an engine.

    Parameters
    ----------
    workers : int
        Processes of this machine; 1 is this process.
    scheduler : str
        Address of a Dask scheduler (``tcp://host:port``); takes the place of `workers`.

    Yields
    ------
    Engine

    Raises
    ------
    MissingExtraError
        Where Dask is asked for and not installed.
    RefusedError
        Where the scheduler does not answer.
    """
    if scheduler:
        with dask_workers(scheduler) as connected:
            yield connected
    elif workers > 1:
        processes = Processes(workers)
        try:
            yield processes
        finally:
            processes.close()
    else:
        yield _Here()


def run_tasks(
    task: Callable[[Sequence[Item]], list[Result]],
    items: Sequence[Item],
    given_up: Callable[[Item, str], Result],
    weigh: Callable[[Item], int] = one_each,
    *,
    workers: int = 1,
    scheduler: str = "",
) -> Iterator[Result]:
    """Run one task on an engine of its own; see `engine` and `Engine.run`."""
    with engine(workers, scheduler) as opened:
        yield from opened.run(task, items, given_up, weigh)


class _Here:
    """The process that asks."""

    def run(
        self,
        task: Callable[[Sequence[Item]], list[Result]],
        items: Sequence[Item],
        given_up: Callable[[Item, str], Result],  # noqa: ARG002 - an engine's form
        weigh: Callable[[Item], int] = one_each,
    ) -> Iterator[Result]:
        """Run in this process."""
        for batch in batches(items, weigh, BATCH):
            yield from task(batch)
