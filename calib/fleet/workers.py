"""Where the tasks of a fleet run: in this process, in processes of this machine, or on a Dask scheduler."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from calib.errors import RefusedError
from calib.fleet.dask import DaskEngine
from calib.fleet.engine import (
    SHARED_MODULES,
    WORKER_MODULES,
    Engine,
    Item,
    Outcome,
    Result,
    Task,
    equal_weight,
    import_modules,
)

if TYPE_CHECKING:
    from concurrent.futures import Future, ProcessPoolExecutor

#: pieces of work in a batch, least and most: a file takes 3 ms or more and a hand-over to a process 2 ms
PROCESS_BATCH: Final = (4, 64)


@contextmanager
def engine(workers: int = 1, scheduler: str = "") -> Iterator[Engine]:
    """Open an engine: this process, processes of this machine, or the workers of a Dask scheduler.

    `workers`: processes; 1 is this process. `scheduler`: address of a Dask scheduler (``tcp://host:port``), in place of
    `workers`. Raises MissingExtraError where Dask is not installed, RefusedError where the scheduler does not answer.
    """
    opened = DaskEngine(scheduler) if scheduler else ProcessEngine(workers) if workers > 1 else Engine()
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
