"""Tasks of a fleet on the workers of a Dask scheduler."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any, Final

from calib.errors import BadInputError, MissingExtraError, RefusedError
from calib.fleet.engine import (
    SHARED_MODULES,
    WORKER_MODULES,
    Engine,
    Item,
    Outcome,
    Result,
    Task,
    import_modules,
)

#: pieces of work in a batch: a task costs client, scheduler and worker 8 ms together
DASK_BATCH: Final = (8, 256)
#: how long a scheduler may take to answer, and to say goodbye
ANSWER_S: Final = 10.0
CLOSE_S: Final = 2.0
#: how long nothing may come back before the scheduler is asked whether it is there
QUIET_S: Final = 20.0
#: between two looks at what is done
LOOK_S: Final = 0.02
_ADDRESS: Final = re.compile(r"(tcp|tls)://([^\s/:]+|\[[0-9a-fA-F:]+\]):\d{1,5}")


class DaskEngine(Engine):
    """The workers of a Dask scheduler, which moves the tasks of a worker that dies to another.

    Raises BadInputError for what is no address, MissingExtraError where Dask is not installed, RefusedError where the
    scheduler does not answer, at the start or later.
    """

    batch = DASK_BATCH

    def __init__(self, scheduler: str) -> None:
        import logging

        if not _ADDRESS.fullmatch(scheduler):
            raise BadInputError(
                f"scheduler: found {scheduler!r}; expected tcp://host:port or tls://host:port; "
                "give the address that the scheduler prints at its start"
            )
        try:
            from distributed import Client, fire_and_forget
        except ImportError as error:
            raise MissingExtraError("a Dask scheduler", "distributed", "fleet") from error
        # what goes wrong is said once, by the error
        for name in [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]:
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self._address = scheduler
        _refuse_silence(scheduler)
        try:
            self._client = Client(scheduler, timeout=ANSWER_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise self._lost(error) from error
        # the workers import what they need while this process lists the work
        modules = (*SHARED_MODULES, *WORKER_MODULES)
        for worker in self._client.nthreads():
            fire_and_forget(
                self._client.submit(import_modules, modules, workers=[worker], allow_other_workers=True, pure=False)
            )

    @property
    def workers(self) -> int:
        """How many threads the scheduler's workers have together."""
        threads: int = sum(self._client.nthreads().values())
        return max(1, threads)

    def close(self) -> None:
        """Leave the scheduler, even one that no longer answers."""
        from concurrent.futures import CancelledError

        with suppress(OSError, TimeoutError, CancelledError, RuntimeError):
            self._client.close(timeout=CLOSE_S)

    def completed(self, task: Task[Item, Result], cut: Sequence[Sequence[Item]]) -> Iterator[Outcome[Item, Result]]:
        """Yield the batches as they are done; None for those that the scheduler blames for a death."""
        submitted = {self._submit(task, batch): batch for batch in cut}
        # this process needs them in the end, and has nothing to do until the first task is done
        import_modules(SHARED_MODULES)
        for future in self._as_done(list(submitted)):
            yield submitted.pop(future), self._result(future)

    def alone(self, task: Task[Item, Result], item: Item) -> list[Result] | None:
        """Return the result of an item that nothing waits beside; None where its worker dies."""
        (future,) = self._as_done([self._submit(task, [item])])
        results: list[Result] | None = self._result(future)
        return results

    def _submit(self, task: Task[Item, Result], batch: Sequence[Item]) -> Any:
        from distributed.protocol import serialize

        return self._client.submit(_in_bytes, *serialize((task, batch)), pure=False)

    def _as_done(self, futures: list[Any]) -> Iterator[Any]:
        """Yield futures as they are done; the scheduler is asked for where nothing comes back for long."""
        import time

        from distributed import as_completed

        with self._client.as_current():
            done = as_completed(futures)
            heard = time.monotonic()
            while not done.is_empty():
                batch = done.next_batch(block=False)
                if batch:
                    heard = time.monotonic()
                    yield from batch
                elif time.monotonic() - heard > QUIET_S:
                    self._ask()
                    heard = time.monotonic()
                else:
                    time.sleep(LOOK_S)

    def _ask(self) -> None:
        try:
            self._client.sync(self._client.scheduler.identity, callback_timeout=ANSWER_S)
        except (OSError, TimeoutError) as error:
            raise self._lost(error) from error

    def _result(self, future: Any) -> Any:
        from concurrent.futures import CancelledError

        from distributed import KilledWorker
        from distributed.protocol import deserialize

        try:
            return deserialize(*future.result(timeout=ANSWER_S))
        except KilledWorker:
            return None
        except (CancelledError, OSError, TimeoutError) as error:
            raise self._lost(error) from error
        finally:
            future.release()

    def _lost(self, error: BaseException) -> RefusedError:
        return _no_answer(self._address, error)


def _no_answer(address: str, error: BaseException) -> RefusedError:
    why = " ".join(str(error).split())[:100] or type(error).__name__
    return RefusedError(
        f"scheduler {address}: found no answer ({why}); expected a Dask scheduler; start one, or leave the scheduler "
        "away; what was done before is kept"
    )


def _refuse_silence(address: str) -> None:
    """Refuse an address where nothing answers as a scheduler does; a client that waits there could not be closed."""
    import asyncio

    from distributed import rpc

    async def identity() -> None:
        async with rpc(address, timeout=ANSWER_S) as scheduler:
            await scheduler.identity()

    async def asked() -> None:
        await asyncio.wait_for(identity(), ANSWER_S)

    try:
        asyncio.run(asked())
    except (OSError, TimeoutError, ValueError) as error:
        raise _no_answer(address, error) from error


def _in_bytes(header: Any, frames: Any) -> Any:
    """Run a task on items, all of it as bytes and its results too: the scheduler need not know what it passes on."""
    from distributed.protocol import deserialize, serialize

    task, items = deserialize(header, frames)
    return serialize(task(items))
