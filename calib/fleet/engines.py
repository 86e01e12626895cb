"""Where the tasks run: in this process, in processes of this machine, or on a Dask scheduler."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, TypeVar

from calib.errors import MissingExtraError, RefusedError

__all__ = ["run_tasks"]

Item = TypeVar("Item")
Result = TypeVar("Result")

#: items handed over at once: a file takes some milliseconds, a hand-over a part of one
BATCH: Final = 16
#: how often an item may take its worker down before it is given up
TRIES: Final = 2


def run_tasks(
    task: Callable[[Sequence[Item]], list[Result]],
    items: Sequence[Item],
    given_up: Callable[[Item, str], Result],
    *,
    workers: int = 1,
    scheduler: str = "",
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
    workers : int
        Processes of this machine; 1 is this process.
    scheduler : str
        Address of a Dask scheduler (``tcp://host:port``); takes the place of `workers`.

    Yields
    ------
    Result
        One an item.

    Raises
    ------
    MissingExtraError
        Where Dask is asked for and not installed.
    RefusedError
        Where the scheduler does not answer.
    """
    if scheduler:
        yield from _on_dask(task, items, given_up, scheduler)
    elif workers > 1:
        yield from _on_processes(task, items, given_up, workers)
    else:
        for batch in _batches(items, BATCH):
            yield from task(batch)


def _batches(items: Sequence[Item], size: int) -> list[Sequence[Item]]:
    return [items[first : first + size] for first in range(0, len(items), size)]


def _on_processes(
    task: Callable[[Sequence[Item]], list[Result]],
    items: Sequence[Item],
    given_up: Callable[[Item, str], Result],
    workers: int,
) -> Iterator[Result]:
    """Run in a pool; a worker that dies costs its own batch, which is tried again one item at a time."""
    from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import get_context

    waiting: list[tuple[Sequence[Item], int]] = [(batch, 0) for batch in _batches(items, BATCH)]
    while waiting:
        again: list[tuple[Sequence[Item], int]] = []
        # once a worker has died, single items: the one that kills it is found, the others go through
        careful = any(tries for _, tries in waiting)
        with ProcessPoolExecutor(1 if careful else workers, mp_context=get_context("spawn")) as pool:
            running: dict[Future[list[Result]], tuple[Sequence[Item], int]] = {}
            queue = list(reversed(waiting))
            broken = False
            while queue or running:
                while queue and not broken and len(running) < (1 if careful else 2 * workers):
                    batch, tries = queue.pop()
                    running[pool.submit(task, batch)] = (batch, tries)
                if broken and not running:
                    again += [(batch, tries) for batch, tries in reversed(queue)]
                    break
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    batch, tries = running.pop(future)
                    try:
                        yield from future.result()
                    except BrokenProcessPool:
                        broken = True
                        if len(batch) > 1:
                            again += [([item], tries + 1) for item in batch]
                        elif tries + 1 >= TRIES:
                            yield given_up(batch[0], "its worker died twice; expected one that ends; read it alone")
                        else:
                            again.append((batch, tries + 1))
        waiting = again


def _on_dask(
    task: Callable[[Sequence[Item]], list[Result]],
    items: Sequence[Item],
    given_up: Callable[[Item, str], Result],
    scheduler: str,
) -> Iterator[Result]:
    """Run on a Dask scheduler; it moves the tasks of a worker that dies to another."""
    try:
        from distributed import Client, KilledWorker, as_completed
    except ImportError as error:
        raise MissingExtraError("a Dask scheduler", "distributed", "fleet") from error
    try:
        client: Any = Client(scheduler, timeout="10s", set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise RefusedError(
            f"scheduler {scheduler}: found no answer ({' '.join(str(error).split())[:100]}); "
            "expected a Dask scheduler; start one, or leave the scheduler away"
        ) from error
    with client, client.as_current():
        batch_of = {client.submit(task, batch, pure=False): batch for batch in _batches(items, BATCH)}
        finished = as_completed(list(batch_of))
        for future in finished:
            batch = batch_of.pop(future)
            try:
                yield from future.result()
            except KilledWorker:
                if len(batch) == 1:
                    yield given_up(batch[0], "its worker died again and again; expected one that ends; read it alone")
                    continue
                for item in batch:
                    single = client.submit(task, [item], pure=False)
                    batch_of[single] = [item]
                    finished.add(single)
            future.release()
