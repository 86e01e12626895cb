"""A pool of this machine's processes, in which a worker that dies costs its own batch only."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, TypeVar

from calib.errors import RefusedError
from calib.fleet.batches import batches, one_each

if TYPE_CHECKING:
    from concurrent.futures import Future, ProcessPoolExecutor

Item = TypeVar("Item")
Result = TypeVar("Result")

#: pieces of work handed over at once, at most and at least: a file takes three milliseconds or more, a hand-over two
BATCH: Final = 64
SMALLEST: Final = 4
#: how often an item may take its worker down before it is given up
TRIES: Final = 2
#: what nearly every task needs and the parent too: imported before processes are made of it
SHARED: Final = ("calib.fleet.pieces", "scipy.special")
#: what nearly every task needs and what starts threads: imported by each worker
OWN: Final = ("pyarrow.parquet",)


class Processes:
    """A pool that is started at once, so that the workers import what they need while their parent lists the work."""

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._pool: ProcessPoolExecutor | None = None
        if _may_fork():
            import_modules(SHARED)
            # the first task makes the workers, as long as this process has no other thread
            self._open(careful=False).submit(int)
        else:
            _server()

    def close(self) -> None:
        """End the workers."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None

    def _open(self, careful: bool) -> ProcessPoolExecutor:
        from concurrent.futures import ProcessPoolExecutor
        from multiprocessing import get_context

        if careful:
            self.close()
        if self._pool is None:
            context = get_context("fork") if _may_fork() else _server()
            self._pool = ProcessPoolExecutor(
                1 if careful else self._workers, mp_context=context, initializer=_begin_worker
            )
        return self._pool

    def run(
        self,
        task: Callable[[Sequence[Item]], list[Result]],
        items: Sequence[Item],
        given_up: Callable[[Item, str], Result],
        weigh: Callable[[Item], int] = one_each,
    ) -> Iterator[Result]:
        """Run in the pool; a worker that dies costs its own batch, which is tried again one item at a time."""
        from concurrent.futures import FIRST_COMPLETED, wait
        from concurrent.futures.process import BrokenProcessPool

        waiting: list[tuple[Sequence[Item], int]] = [
            (batch, 0) for batch in batches(items, weigh, BATCH, self._workers, SMALLEST)
        ]
        while waiting:
            again: list[tuple[Sequence[Item], int]] = []
            # once a worker has died, single items: the one that kills it is found, the others go through
            careful = any(tries for _, tries in waiting)
            pool = self._open(careful)
            if careful:
                _refuse_unless_it_starts(pool)
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
    """Return whether this process may be copied as it is: no thread runs beside this one, a library's own included."""
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
    server.set_forkserver_preload(["__main__", *SHARED, *OWN])
    ensure_running()
    return server


def _begin_worker() -> None:
    """Begin a worker: an interruption is for its parent to act on, and it ends when its parent has ended."""
    import signal
    import threading

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    import_modules(OWN)


def _end_with_parent() -> None:
    import os
    from multiprocessing import parent_process
    from multiprocessing.connection import wait

    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def import_modules(modules: Sequence[str]) -> None:
    """Import modules, so that the first task need not; those that are not installed are passed over."""
    import importlib

    for module in modules:
        # an extra that is not installed: the task says so where it needs it
        with suppress(ImportError):
            importlib.import_module(module)
