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

#: pieces of work in a task, at most and at least: a task costs client, scheduler and worker 8 ms together,
#: a file of journeys takes 3 ms or more
BATCH: Final = 256
SMALLEST: Final = 8


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
        from distributed.protocol import deserialize, serialize

        def submit(batch: Sequence[Item]) -> Any:
            return client.submit(_in_bytes, *serialize((task, batch)), pure=False)

        client = self._client
        workers = max(1, sum(client.nthreads().values()))
        cut = batches(items, weigh, BATCH, workers, SMALLEST)
        batch_of = {submit(batch): batch for batch in cut}
        # this process needs them in the end, and has nothing to do until the first task is done
        import_modules(SHARED)
        suspects: list[Item] = []
        for future in as_completed(list(batch_of)):
            batch = batch_of.pop(future)
            try:
                yield from deserialize(*future.result())
            except KilledWorker:
                # the scheduler blames what waited for the dead worker, too
                suspects += batch
            future.release()
        for item in suspects:
            # by itself, so that nothing beside it can be to blame
            try:
                yield from deserialize(*submit([item]).result())
            except KilledWorker:
                yield given_up(item, "its worker died again and again; expected one that ends; read it alone")


def _in_bytes(header: Any, frames: Any) -> Any:
    """Run a task on items, all of it as bytes and its results too: the scheduler need not know what it passes on."""
    from distributed.protocol import deserialize, serialize

    task, items = deserialize(header, frames)
    return serialize(task(items))
