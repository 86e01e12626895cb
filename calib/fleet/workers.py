"""Where the tasks of a fleet run: in this process, in processes of this machine, or on a Dask scheduler."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, Final, TypeVar

from calib.errors import RefusedError

if TYPE_CHECKING:
    from concurrent.futures import Future, ProcessPoolExecutor

Item = TypeVar("Item")
Result = TypeVar("Result")
Task = Callable[[Sequence[Item]], list[Result]]
#: a batch with its results; None where its worker died
Outcome = tuple[Sequence[Item], list[Result] | None]

#: a batch is at most this part of a worker's share of the remaining work: the last ones are small, so that all workers
#: end together
PARTS_OF_A_SHARE: Final = 2
#: pieces of work in a batch, least and most: in this process (between two progress reports); in processes, where a file
#: takes 3 ms or more and a hand-over 2 ms
SERIAL_BATCH: Final = (1, 16)
PROCESS_BATCH: Final = (4, 64)
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


@contextmanager
def engine(workers: int = 1, scheduler: str = "") -> Iterator[Engine]:
    """Open an engine: this process, processes of this machine, or the workers of a Dask scheduler.

    `workers`: processes; 1 is this process. `scheduler`: address of a Dask scheduler (``tcp://host:port``), in place of
    `workers`. Raises MissingExtraError where Dask is not installed, RefusedError where the scheduler does not answer.
    """
    opened: Engine
    if scheduler:
        from calib.fleet.dask import DaskEngine

        opened = DaskEngine(scheduler)
    else:
        opened = ProcessEngine(workers) if workers > 1 else Engine()
    try:
        yield opened
    finally:
        opened.close()


def run_tasks(
    task: Task[Item, Result],
    items: Sequence[Item],
    given_up: Callable[[Item, str], Result],
    weigh: Callable[[Item], int] = equal_weight,
    *,
    workers: int = 1,
    scheduler: str = "",
) -> Iterator[Result]:
    """Run one task on an engine of its own; see `engine` and `Engine.run`."""
    with engine(workers, scheduler) as opened:
        yield from opened.run(task, items, given_up, weigh)


class ProcessEngine(Engine):
    """Processes of this machine, started at once: they import what they need while their parent lists the work."""

    batch = PROCESS_BATCH

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._pool: ProcessPoolExecutor | None = None
        if _may_fork():
            import_modules(SHARED_MODULES)
            # the first task makes the workers, as long as this process has no other thread
            self._opened().submit(int)
        else:
            _server()

    @property
    def workers(self) -> int:
        """How many processes there are."""
        return self._workers

    def close(self) -> None:
        """End the processes."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None

    def completed(self, task: Task[Item, Result], cut: Sequence[Sequence[Item]]) -> Iterator[Outcome[Item, Result]]:
        """Yield the batches as they are done; when a worker dies, those at work yield None and a new pool goes on."""
        from concurrent.futures import FIRST_COMPLETED, wait
        from concurrent.futures.process import BrokenProcessPool

        queue, running, broken = deque(cut), dict[Any, Sequence[Item]](), False
        while queue or running:
            while queue and not broken and len(running) < 2 * self._workers:
                try:
                    running[self._opened().submit(task, queue[0])] = queue[0]
                    queue.popleft()
                except BrokenProcessPool:  # between two tasks: nothing of this batch was begun
                    broken = True
            done: set[Future[list[Result]]] = wait(running, return_when=FIRST_COMPLETED).done if running else set()
            for future in done:
                batch = running.pop(future)
                try:
                    yield batch, future.result()
                except BrokenProcessPool:
                    broken = True
                    yield batch, None
            if broken and not running:
                self.close()
                _refuse_unless_it_starts(self._opened())
                broken = False

    def alone(self, task: Task[Item, Result], item: Item) -> list[Result] | None:
        """Return the result of an item in a process of its own; None where that dies."""
        from concurrent.futures.process import BrokenProcessPool

        self.close()
        pool = self._opened(1)
        _refuse_unless_it_starts(pool)
        try:
            return pool.submit(task, [item]).result()
        except BrokenProcessPool:
            return None
        finally:
            self.close()

    def _opened(self, workers: int | None = None) -> ProcessPoolExecutor:
        from concurrent.futures import ProcessPoolExecutor
        from multiprocessing import get_context

        if self._pool is None:
            context = get_context("fork") if _may_fork() else _server()
            count = self._workers if workers is None else workers
            self._pool = ProcessPoolExecutor(count, mp_context=context, initializer=_begin_worker)
        return self._pool


def _refuse_unless_it_starts(pool: ProcessPoolExecutor) -> None:
    """Refuse a pool whose workers die before they are given anything: no item is to blame for that."""
    from concurrent.futures.process import BrokenProcessPool

    try:
        pool.submit(int).result()
    except BrokenProcessPool as error:
        raise RefusedError(
            "workers: found processes that end before their first task; expected some that can start; "
            "use one worker, and import calib in a process of its own to see what it lacks"
        ) from error


def _may_fork() -> bool:
    """Return whether this process may be copied: no other thread runs in it, a library's own included."""
    from multiprocessing import get_all_start_methods
    from pathlib import Path

    try:
        return "fork" in get_all_start_methods() and len(list(Path("/proc/self/task").iterdir())) == 1
    except OSError:
        return False


def _server() -> Any:
    """Return a context that makes workers of a server process, which has imported what they need and has no threads."""
    from multiprocessing import get_all_start_methods, get_context

    if "forkserver" not in get_all_start_methods():
        return get_context("spawn")
    from multiprocessing.forkserver import ensure_running

    server = get_context("forkserver")
    server.set_forkserver_preload(["__main__", *SHARED_MODULES, *WORKER_MODULES])
    ensure_running()
    return server


def _begin_worker() -> None:
    """Begin a worker: its parent acts on an interruption, and it ends when its parent has ended."""
    import signal
    import threading

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    import_modules(WORKER_MODULES)


def _end_with_parent() -> None:
    import os
    from multiprocessing import parent_process
    from multiprocessing.connection import wait

    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def import_modules(modules: Sequence[str]) -> None:
    """Import modules, so that the first task need not; those that are not installed are skipped."""
    import importlib

    for module in modules:
        # an extra that is not installed: the task reports it where it needs it
        with suppress(ImportError):
            importlib.import_module(module)
