"""What runs a fleet's tasks: this process, others of this machine, or the workers of a Dask scheduler."""

import asyncio
import importlib
import logging
import os
import re
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, ProcessPoolExecutor, wait
from contextlib import closing, contextmanager, suppress
from multiprocessing import get_all_start_methods, get_context, parent_process
from multiprocessing.connection import wait as wait_for
from pathlib import Path
from typing import Any, Final, TypeVar

from calib.errors import BadInputError, MissingExtraError, RefusedError, error_words

Item = TypeVar("Item")
Result = TypeVar("Result")
Task = Callable[[Sequence[Item]], list[Result]]

#: least batches in a worker's share of what remains: all end together
PARTS_OF_A_SHARE: Final = 2
#: least and most work in a batch; a hand-over takes 2 ms, by Dask 8 ms
SERIAL_BATCH: Final = (1, 16)
PROCESS_BATCH: Final = (4, 64)
DASK_BATCH: Final = (8, 256)
#: imported before processes are made of the parent
SHARED_MODULES: Final = ("calib.fleet.run", "scipy.special")
#: starts threads: imported by each worker
WORKER_MODULES: Final = ("pyarrow.parquet",)
#: for a scheduler to answer, and to close; without results it is asked after so long
ANSWER_S: Final = 10.0
CLOSE_S: Final = 2.0
QUIET_S: Final = 20.0
_ADDRESS: Final = re.compile(r"(tcp|tls)://([^\s/:]+|\[[0-9a-fA-F:]+\]):\d{1,5}")


@contextmanager
def engine(workers: int = 1, scheduler: str = "") -> "Iterator[Engine]":
    """Open an engine: this process, `workers` of this machine, or those of a Dask scheduler (``tcp://host:port``).

    Raises RefusedError where the scheduler does not answer.
    """
    backend = DaskEngine(scheduler) if scheduler else _ProcessEngine(workers) if workers > 1 else Engine()
    with closing(backend) as opened:
        yield opened


def batches(
    items: Sequence[Item], weigh: Callable[[Item], int], largest: int, workers: int, smallest: int = 1
) -> list[Sequence[Item]]:
    """Cut items into batches in order; see `Engine.run`.

    `largest`, `smallest`: work in a batch, but for a single larger item and the last.
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
    """Runs tasks in this process."""

    batch: tuple[int, int] = SERIAL_BATCH
    #: batches submitted at once
    most_submitted: int = 1

    @property
    def workers(self) -> int:
        """How many batches run at once."""
        return 1

    def close(self) -> None:
        """End the workers."""

    def submit(self, task: Task[Item, Result], batch: Sequence[Item]) -> Future[list[Result]]:
        """Begin a batch; raises BrokenExecutor where no worker is left."""
        future: Future[list[Result]] = Future()
        future.set_result(task(batch))
        return future

    def result(self, future: Future[list[Result]]) -> list[Result] | None:
        """Return a batch's results; None where its worker died."""
        try:
            return future.result()
        except BrokenExecutor:
            return None

    def renew(self) -> None:
        """Replace the workers after one has died."""

    def ask(self) -> None:
        """Raise RefusedError where no worker is left."""

    def run(
        self,
        task: Task[Item, Result],
        items: Sequence[Item],
        given_up: Callable[[Item, str], Result],
        weigh: Callable[[Item], int] = lambda _item: 1,
    ) -> Iterator[Result]:
        """Run a task on all items and yield results as they come, one an item.

        Items of a dead worker are tried again one by one. `task`: a module's function; `given_up`: gives the result of
        an item that ended two; `weigh`: work of an item.
        """
        smallest, largest = self.batch
        suspects: list[Item] = []
        cut = batches(items, weigh, largest, self.workers, smallest)
        for batch, results in self._completed(task, cut, self.most_submitted):
            if results is None:
                suspects += batch
            else:
                yield from results
        for (item,), results in self._completed(task, [[item] for item in suspects], 1):
            if results is None:
                yield given_up(item, "its worker died twice; expected one that ends; read it alone")
            else:
                yield from results

    def _completed(
        self, task: Task[Item, Result], cut: Sequence[Sequence[Item]], at_once: int
    ) -> Iterator[tuple[Sequence[Item], list[Result] | None]]:
        queue, running, broken = deque(cut), dict[Future[list[Result]], Sequence[Item]](), False
        while queue or running:
            while queue and not broken and len(running) < at_once:
                try:
                    running[self.submit(task, queue[0])] = queue[0]
                    queue.popleft()
                except BrokenExecutor:  # between two tasks: nothing of this batch was begun
                    broken = True
            done = wait(running, QUIET_S, FIRST_COMPLETED).done if running else set()
            if running and not done:
                self.ask()
            for future in done:
                batch, results = running.pop(future), self.result(future)
                broken = broken or results is None
                yield batch, results
            if broken and not running:
                self.renew()
                broken = False


class _ProcessEngine(Engine):
    batch = PROCESS_BATCH
    workers = 0

    def __init__(self, workers: int) -> None:
        self.workers, self.most_submitted = workers, 2 * workers
        if _may_fork():
            _import_modules(SHARED_MODULES)
        self._pool = self._started()
        # makes the workers, while there is no other thread
        self._pool.submit(int)

    def close(self) -> None:
        self._pool.shutdown(cancel_futures=True)

    def submit(self, task: Task[Item, Result], batch: Sequence[Item]) -> Future[list[Result]]:
        return self._pool.submit(task, batch)

    def renew(self) -> None:
        self.close()
        self._pool = self._started()
        try:
            self._pool.submit(int).result()
        except BrokenExecutor as error:
            raise RefusedError(
                "workers: found processes that end before their first task; expected some that can start; "
                "use one worker, and import calib in a process of its own to see what it lacks"
            ) from error

    def _started(self) -> ProcessPoolExecutor:
        context = get_context("fork") if _may_fork() else _server()
        return ProcessPoolExecutor(self.workers, mp_context=context, initializer=_begin_worker)


def _may_fork() -> bool:
    try:
        return "fork" in get_all_start_methods() and len(list(Path("/proc/self/task").iterdir())) == 1
    except OSError:
        return False


def _server() -> Any:
    if "forkserver" not in get_all_start_methods():
        return get_context("spawn")
    server = get_context("forkserver")
    server.set_forkserver_preload(["__main__", *SHARED_MODULES, *WORKER_MODULES])
    return server


def _begin_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _import_modules(WORKER_MODULES)


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        wait_for([parent.sentinel])
        os._exit(1)


def _import_modules(modules: Sequence[str]) -> None:
    for module in modules:
        with suppress(ImportError):
            importlib.import_module(module)


class DaskEngine(Engine):
    """The workers of a Dask scheduler, which replaces dead ones."""

    batch = DASK_BATCH
    most_submitted = 1_000_000

    def __init__(self, scheduler: str) -> None:
        if not _ADDRESS.fullmatch(scheduler):
            raise BadInputError(
                f"scheduler: found {scheduler!r}; expected tcp://host:port or tls://host:port; "
                "give the address that the scheduler prints at its start"
            )
        try:
            from distributed import Client, fire_and_forget
        except ImportError as error:
            raise MissingExtraError("a Dask scheduler", "distributed", "fleet") from error
        for name in [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]:
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self._address = scheduler
        try:
            _identify(scheduler)
            self._client = Client(scheduler, timeout=ANSWER_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise self._lost(error) from error
        modules = (*SHARED_MODULES, *WORKER_MODULES)
        for worker in self._client.nthreads():
            fire_and_forget(
                self._client.submit(_import_modules, modules, workers=[worker], allow_other_workers=True, pure=False)
            )
        self._executor = self._client.get_executor(pure=False)

    @property
    def workers(self) -> int:
        """See `Engine`."""
        threads: int = sum(self._client.nthreads().values())
        return max(1, threads)

    def close(self) -> None:
        """Leave the scheduler, even a silent one."""
        with suppress(OSError, TimeoutError, CancelledError, RuntimeError):
            self._client.close(timeout=CLOSE_S)

    def submit(self, task: Task[Item, Result], batch: Sequence[Item]) -> Future[list[Result]]:
        """See `Engine`."""
        from distributed.protocol import serialize

        future: Future[list[Result]] = self._executor.submit(_unpacked, *serialize((task, batch)))
        return future

    def result(self, future: Future[list[Result]]) -> list[Result] | None:
        """Return a batch's results; None where it is blamed for a worker's death."""
        from distributed import KilledWorker

        try:
            return future.result(ANSWER_S)
        except KilledWorker:
            return None
        except (CancelledError, OSError, TimeoutError) as error:
            raise self._lost(error) from error

    def ask(self) -> None:
        """See `Engine`."""
        try:
            self._client.sync(self._client.scheduler.identity, callback_timeout=ANSWER_S)
        except (OSError, TimeoutError) as error:
            raise self._lost(error) from error

    def _lost(self, error: Exception) -> RefusedError:
        return RefusedError(
            f"scheduler {self._address}: found no answer ({error_words(error)}); expected a Dask scheduler; start one, "
            "or leave the scheduler away; what was done before is kept"
        )


def _identify(address: str) -> None:
    from distributed import rpc

    async def identity() -> None:
        async with rpc(address, timeout=ANSWER_S) as scheduler:
            await asyncio.wait_for(scheduler.identity(), ANSWER_S)

    asyncio.run(identity())


def _unpacked(header: Any, frames: Any) -> list[Any]:
    from distributed.protocol import deserialize

    task, items = deserialize(header, frames)
    return list(task(items))
