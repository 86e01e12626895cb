"""Where the tasks run: in this process, in processes of this machine, or on a Dask scheduler."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar

from calib.errors import MissingExtraError, RefusedError

if TYPE_CHECKING:
    from concurrent.futures import Future, ProcessPoolExecutor

__all__ = ["Engine", "engine", "run_tasks"]

Item = TypeVar("Item")
Result = TypeVar("Result")

#: items handed over at once: a file takes some milliseconds, a hand-over a part of one
BATCH: Final = 16
#: how often an item may take its worker down before it is given up
TRIES: Final = 2
#: what nearly every task needs, imported once for all workers where the system can pass it on to them
PRELOADED: Final = ("calib.fleet.part_sums", "calib.fleet.vehicle", "pyarrow.parquet", "scipy.special")


class Engine(Protocol):
    """What runs tasks; workers stay from one call to the next."""

    def run(
        self,
        task: Callable[[Sequence[Item]], list[Result]],
        items: Sequence[Item],
        given_up: Callable[[Item, str], Result],
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
        with _dask_client(scheduler) as client, client.as_current():
            yield _Dask(client)
    elif workers > 1:
        processes = _Processes(workers)
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
    *,
    workers: int = 1,
    scheduler: str = "",
) -> Iterator[Result]:
    """Run one task on an engine of its own; see `engine` and `Engine.run`."""
    with engine(workers, scheduler) as opened:
        yield from opened.run(task, items, given_up)


def _batches(items: Sequence[Item], size: int) -> list[Sequence[Item]]:
    return [items[first : first + size] for first in range(0, len(items), size)]


class _Here:
    """The process that asks."""

    def run(
        self,
        task: Callable[[Sequence[Item]], list[Result]],
        items: Sequence[Item],
        given_up: Callable[[Item, str], Result],  # noqa: ARG002 - an engine's form
    ) -> Iterator[Result]:
        """Run in this process."""
        for batch in _batches(items, BATCH):
            yield from task(batch)


class _Processes:
    """A pool of this machine's processes, started with the first task."""

    def __init__(self, workers: int) -> None:
        from multiprocessing import get_all_start_methods, get_context

        self._workers = workers
        # a server that never ran anything makes the workers: no thread of this process is copied, and what they all
        # import is imported once
        if "forkserver" in get_all_start_methods():
            server = get_context("forkserver")
            server.set_forkserver_preload(["__main__", *PRELOADED])
            self._context: Any = server
        else:
            self._context = get_context("spawn")
        self._pool: ProcessPoolExecutor | None = None

    def close(self) -> None:
        """End the workers."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None

    def _open(self, careful: bool) -> ProcessPoolExecutor:
        from concurrent.futures import ProcessPoolExecutor

        if careful:
            self.close()
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1 if careful else self._workers, mp_context=self._context)
        return self._pool

    def run(
        self,
        task: Callable[[Sequence[Item]], list[Result]],
        items: Sequence[Item],
        given_up: Callable[[Item, str], Result],
    ) -> Iterator[Result]:
        """Run in the pool; a worker that dies costs its own batch, which is tried again one item at a time."""
        from concurrent.futures import FIRST_COMPLETED, wait
        from concurrent.futures.process import BrokenProcessPool

        # some batches a worker, so that few items that take seconds each are shared out, too
        size = max(1, min(BATCH, len(items) // (4 * self._workers)))
        waiting: list[tuple[Sequence[Item], int]] = [(batch, 0) for batch in _batches(items, size)]
        while waiting:
            again: list[tuple[Sequence[Item], int]] = []
            # once a worker has died, single items: the one that kills it is found, the others go through
            careful = any(tries for _, tries in waiting)
            pool = self._open(careful)
            running: dict[Future[list[Result]], tuple[Sequence[Item], int]] = {}
            queue = list(reversed(waiting))
            broken = False
            while queue or running:
                while queue and not broken and len(running) < (1 if careful else 2 * self._workers):
                    batch, tries = queue.pop()
                    try:
                        running[pool.submit(task, batch)] = (batch, tries)
                    except BrokenProcessPool:
                        # a worker died between two tasks: nothing of this batch was begun
                        queue.append((batch, tries))
                        broken = True
                if broken and not running:
                    again += list(reversed(queue))
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
            if broken or careful:
                self.close()
            waiting = again


def _dask_client(scheduler: str) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        raise MissingExtraError("a Dask scheduler", "distributed", "fleet") from error
    try:
        return Client(scheduler, timeout="10s", set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise RefusedError(
            f"scheduler {scheduler}: found no answer ({' '.join(str(error).split())[:100]}); "
            "expected a Dask scheduler; start one, or leave the scheduler away"
        ) from error


class _Dask:
    """A Dask scheduler; it moves the tasks of a worker that dies to another."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def run(
        self,
        task: Callable[[Sequence[Item]], list[Result]],
        items: Sequence[Item],
        given_up: Callable[[Item, str], Result],
    ) -> Iterator[Result]:
        """Run on the scheduler's workers."""
        from distributed import KilledWorker, as_completed

        client = self._client
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
