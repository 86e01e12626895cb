"""The workers of a Dask scheduler."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final, TypeVar

from calib.errors import MissingExtraError, RefusedError
from calib.fleet.batches import batches, one_each
from calib.fleet.processes import OWN, SHARED, import_modules

Item = TypeVar("Item")
Result = TypeVar("Result")

#: pieces of work in a task: a task costs the scheduler and its connections some milliseconds
BATCH: Final = 64


@contextmanager
def dask_workers(scheduler: str) -> Iterator[DaskWorkers]:
    """Connect to a scheduler; see `calib.fleet.engines.engine`."""
    try:
        from distributed import Client, fire_and_forget
    except ImportError as error:
        raise MissingExtraError("a Dask scheduler", "distributed", "fleet") from error
    try:
        client = Client(scheduler, timeout="10s", set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise RefusedError(
            f"scheduler {scheduler}: found no answer ({' '.join(str(error).split())[:100]}); "
            "expected a Dask scheduler; start one, or leave the scheduler away"
        ) from error
    with client, client.as_current():
        # the workers import what they need while this process lists the work
        for worker in client.nthreads():
            fire_and_forget(
                client.submit(import_modules, (*SHARED, *OWN), workers=[worker], allow_other_workers=True, pure=False)
            )
        yield DaskWorkers(client)


class DaskWorkers:
    """A Dask scheduler's workers; it moves the tasks of a worker that dies to another."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def run(
        self,
        task: Callable[[Sequence[Item]], list[Result]],
        items: Sequence[Item],
        given_up: Callable[[Item, str], Result],
        weigh: Callable[[Item], int] = one_each,
    ) -> Iterator[Result]:
        """Run on the scheduler's workers."""
        from distributed import KilledWorker, as_completed

        client = self._client
        workers = max(1, sum(client.nthreads().values()))
        batch_of = {client.submit(task, batch, pure=False): batch for batch in batches(items, weigh, BATCH, workers)}
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
