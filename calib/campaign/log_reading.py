"""Read the logs of a campaign, several at once."""

import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Final

from calib.campaign.logs import LogFile, LogStack, in_log, read_log
from calib.campaign.model import Border, Logs, Note
from calib.campaign.readers.delimited import NUMPY_BYTES, read_batch
from calib.campaign.readers.table import RawTable
from calib.campaign.settings import Encoder
from calib.errors import BadFileError
from calib.io import sha256_file
from calib.types import FloatArray, Progress, silent, stepped


@dataclass(frozen=True, slots=True)
class _ReadLog:
    columns: Mapping[str, FloatArray]
    notes: tuple[Note, ...]
    #: of the file's bytes; empty where it cannot be read
    sha256: str = ""
    error: BadFileError | None = None


#: parsers and hashes release the interpreter; beyond some threads only what holds it is left
MOST_THREADS: Final = 8
#: smaller logs are parsed together, by two threads: what holds the interpreter would block more
LARGE_BYTES: Final = 512 << 10
TOGETHER: Final = 16
#: where all are fewer bytes, numpy reads each before the parser of many is imported
MANY_BYTES: Final = 16 << 20


def read_logs(
    files: Sequence[LogFile], n_runs: int, encoder: Encoder, border: Border, *, progress: Progress = silent
) -> tuple[Logs, dict[str, str]]:
    """Return logs end to end, their counters' overflow undone, and the SHA-256 of each by name.

    A log that cannot be used is a fault; see `LogStack`.
    """
    stack = LogStack(n_runs)
    hashes: dict[str, str] = {}
    for (index, run_id, _, name), log in zip(stepped(files, progress, "logs"), _read_all(files), strict=True):
        border.notes.extend(log.notes)
        if log.sha256:
            hashes[name] = log.sha256
        if log.error is None:
            stack.add(index, log.columns)
        else:
            border.fault(log.error, "unreadable_log", run_id)
    return stack.finished(encoder, {index: (run_id, name) for index, run_id, _, name in files}, border), hashes


def _read_all(files: Sequence[LogFile]) -> Iterator[_ReadLog]:
    n_bytes = sum(state[1] for _, _, path, _ in files if (state := _state(path)))
    large = n_bytes >= LARGE_BYTES * len(files)
    together = n_bytes >= MANY_BYTES or n_bytes > NUMPY_BYTES * len(files)
    read = partial(_read_some, together=together)
    size = 1 if large else TOGETHER
    batches = [files[first : first + size] for first in range(0, len(files), size)]
    threads = min(MOST_THREADS if large else 2, _processors()) if together else 1
    if threads == 1:
        yield from chain.from_iterable(map(read, batches))
    else:
        from concurrent.futures import ThreadPoolExecutor

        pool = ThreadPoolExecutor(threads)
        try:
            yield from chain.from_iterable(pool.map(read, batches))
        finally:
            pool.shutdown(cancel_futures=True)


def _read_some(files: Sequence[LogFile], *, together: bool) -> list[_ReadLog]:
    states = [(_state(path), _sha256(path)) for _, _, path, _ in files]
    raws: Sequence[RawTable | None] = [None] * len(files)
    # an odd log may have asked for the parser of many
    if (together or "pandas" in sys.modules) and len(files) > 1:
        raws = read_batch([file[2:] for file in files], in_log)
    logs = []
    for (_, _, path, name), (state, sha256), raw in zip(files, states, raws, strict=True):
        own = Border(lenient=False)
        # a file that changed while read is not named under its earlier hash
        try:
            columns = read_log(path, name, own, raw)
            logs.append(_ReadLog(columns, tuple(own.notes), sha256 if _state(path) == state else _sha256(path)))
        except BadFileError as error:
            logs.append(_ReadLog({}, tuple(own.notes), sha256, error))
    return logs


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _sha256(path: Path) -> str:
    with suppress(OSError):
        return sha256_file(path)
    return ""


def _state(path: Path) -> tuple[int, ...]:
    with suppress(OSError):
        status = path.stat()
        return status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns
    return ()
