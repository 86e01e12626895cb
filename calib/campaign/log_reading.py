"""Read the logs of a campaign: several at once, unchanged large ones from the cache.

The cache holds a file of plain columns a log, under its content's hash; it may be deleted at any time.
"""

import hashlib
import io
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import astuple, dataclass, replace
from functools import lru_cache, partial
from itertools import chain
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np

from calib.campaign.logs import LogFile, LogStack, in_log, read_log
from calib.campaign.model import Border, Logs, Note
from calib.campaign.readers.delimited import NUMPY_BYTES, read_batch
from calib.campaign.readers.table import RawTable
from calib.campaign.settings import Encoder
from calib.errors import BadFileError, CalibError
from calib.io import sha256_file, write_bytes
from calib.types import FloatArray, Progress, silent, stepped

#: environment variable: a folder for the cache, or ``off``
CACHE: Final = "CALIB_CACHE"
#: reading smaller campaigns, or smaller logs on average, takes less time than asking
WORTH_BYTES, WORTH_LOG_BYTES = 16 << 20, 64 << 10
#: the oldest files go where all exceed this
MOST_BYTES: Final = 8 << 30
#: reads a log: its change makes what was kept worthless
_READ_BY: Final = ("settings.py", "log_reading.py", "logs.py", "readers/*.py")


@dataclass(frozen=True, slots=True)
class _ReadLog:
    columns: Mapping[str, FloatArray]
    notes: tuple[Note, ...]
    #: of the file's bytes; empty where it cannot be read
    sha256: str = ""
    error: BadFileError | None = None


def _kept(path: Path, sha256: str) -> _ReadLog | None:
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as stored:
            columns = dict(zip(map(str, stored["names"]), stored["values"], strict=True))
            return _ReadLog(columns, tuple(Note(*map(str, note)) for note in stored["notes"]), sha256)
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile):
        return None


def _keep(path: Path, log: _ReadLog) -> None:
    data = io.BytesIO()
    notes = np.asarray([astuple(note) for note in log.notes], dtype=np.str_)
    np.savez(data, names=list(log.columns), values=np.stack(list(log.columns.values())), notes=notes)
    keep(path, data.getvalue())


def keep(path: Path, data: bytes) -> None:
    """Write a file of a cache; if that fails it is missing."""
    with suppress(CalibError, OSError):
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_bytes(path, data, force=True)


def trim_cache(folder: Path, most_bytes: int = MOST_BYTES) -> None:
    """Remove the oldest files of a cache until it has at most `most_bytes`."""
    files = sorted((state[2], state[1], path) for path in folder.glob("*/*") if (state := _state(path)))
    totals = np.cumsum([size for _, size, _ in files[::-1]])[::-1]
    for (_, _, path), total in zip(files, totals, strict=True):
        if total > most_bytes:
            with suppress(OSError):
                path.unlink()


def cache_folder(name: str) -> Path | None:
    """Return the cache folder, by `CACHE` or the user's; None where that says ``off``."""
    if chosen := os.environ.get(CACHE, ""):
        return None if chosen == "off" else Path(chosen)
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    # a user may have no home
    with suppress(RuntimeError):
        return (base if base.is_absolute() else Path.home() / ".cache") / "calib" / name
    return None


@lru_cache(maxsize=1)
def _read_by() -> str:
    from importlib.metadata import version

    here = Path(__file__).parent
    digest = hashlib.sha256(version("pandas").encode())
    for pattern in _READ_BY:
        for path in sorted(here.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()


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
    cache = cache_folder("logs") if n_bytes >= max(WORTH_BYTES, WORTH_LOG_BYTES * len(files)) else None
    large = n_bytes >= LARGE_BYTES * len(files)
    together = n_bytes >= MANY_BYTES or n_bytes > NUMPY_BYTES * len(files)
    read = partial(_read_some, cache=cache, together=together)
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
    if cache is not None:
        trim_cache(cache)


def _read_some(files: Sequence[LogFile], *, cache: Path | None, together: bool) -> list[_ReadLog]:
    logs: dict[int, _ReadLog] = {}
    # of each new log its state and hash before it is read, and its place in the cache
    new: dict[int, tuple[tuple[int, ...], str, Path | None]] = {}
    for number, (_, _, path, name) in enumerate(files):
        state, sha256, place = _state(path), _sha256(path), None
        if cache is not None and sha256:
            what = json.dumps([_read_by(), sha256, name]).encode("utf-8", "backslashreplace")
            key = hashlib.sha256(what).hexdigest()
            place = cache / key[:2] / f"{key}.log"
        if place is not None and (log := _kept(place, sha256)):
            logs[number] = log
        else:
            new[number] = state, sha256, place
    raws: Sequence[RawTable | None] = [None] * len(new)
    # an odd log may have asked for the parser of many
    if (together or "pandas" in sys.modules) and len(new) > 1:
        raws = read_batch([files[number][2:] for number in new], in_log)
    for (number, (state, sha256, place)), raw in zip(new.items(), raws, strict=True):
        path, name = files[number][2:]
        own = Border(lenient=False)
        try:
            log = _ReadLog(read_log(path, name, own, raw), tuple(own.notes), sha256)
        except BadFileError as error:
            log = _ReadLog({}, tuple(own.notes), sha256, error)
        if _state(path) != state:
            # a file that changed while read is not kept, nor named under its earlier hash
            log = replace(log, sha256=_sha256(path))
        elif place is not None and log.error is None:
            _keep(place, log)
        logs[number] = log
    return [logs[number] for number in range(len(files))]


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
