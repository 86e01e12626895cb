"""Read the logs of a campaign: several at once, and unchanged large ones from the cache.

The cache holds one file of plain columns a log, under the hash of its content; it may be deleted at any time.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import astuple, dataclass
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any, Final
from zipfile import BadZipFile

import numpy as np

from calib.campaign.counters import LogStack
from calib.campaign.logs_file import LogFile, Renames, read_log, wanted_in_log
from calib.campaign.model import Border, Logs, Note
from calib.campaign.readers.delimited import NUMPY_BYTES, read_batch
from calib.campaign.readers.table import RawTable
from calib.campaign.settings import Encoder
from calib.errors import BadFileError, CalibError
from calib.io import sha256_file, write_bytes
from calib.types import FloatArray, Progress, silent, stepped

#: environment variable: a folder for the cache, or ``off``
CACHE: Final = "CALIB_CACHE"
#: smaller campaigns are read in less time than it takes to ask
WORTH_BYTES: Final = 16 << 20
#: the oldest files go where all together are larger than this
MOST_BYTES: Final = 8 << 30
#: what reads a log, whose change makes what was kept worthless
_READ_BY: Final = ("settings.py", "log_reading.py", "logs_file.py", "readers/*.py")


@dataclass(frozen=True, slots=True)
class ReadLog:
    """A log as read: its columns by calib's names and what was noted; or why it cannot be used."""

    columns: Mapping[str, FloatArray]
    notes: tuple[Note, ...]
    #: hash of the file's bytes; empty where it cannot be read
    sha256: str = ""
    error: BadFileError | None = None


@dataclass(frozen=True, slots=True)
class LogCache:
    """A folder of logs as read.

    A file is written under another name first and then renamed, so that a reader, this process or another, sees it
    whole or not at all; one that is damaged is as good as none.
    """

    folder: Path

    def path_of(self, sha256: str, asked: Sequence[Any]) -> Path:
        """Return the place of a log.

        `sha256`: of the file's bytes; `asked`: what else the answer depends on: the file's name in messages, columns
        renamed.
        """
        what = json.dumps([_read_by(), sha256, *asked], sort_keys=True)
        name = hashlib.sha256(what.encode("utf-8", "backslashreplace")).hexdigest()
        return self.folder / name[:2] / f"{name}.log"

    def get(self, path: Path, sha256: str) -> ReadLog | None:
        """Return the log kept at `path` (of `path_of`); None where there is none, or none whole."""
        try:
            with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as stored:
                columns = dict(zip(map(str, stored["names"]), stored["values"], strict=True))
                notes = tuple(Note(*map(str, note)) for note in stored["notes"])
        except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile):
            return None
        return ReadLog(columns, notes, sha256)

    def put(self, path: Path, log: ReadLog) -> None:
        """Keep a log at `path`; where that cannot be done it is read again the next time."""
        data = io.BytesIO()
        notes = np.asarray([astuple(note) for note in log.notes], dtype=np.str_)
        np.savez(data, names=list(log.columns), values=np.stack(list(log.columns.values())), notes=notes)
        with suppress(CalibError, OSError):
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            write_bytes(path, data.getvalue(), force=True)

    def trim(self, most_bytes: int = MOST_BYTES) -> None:
        """Remove the oldest files until all together are at most `most_bytes`."""
        files = []
        for path in self.folder.glob("*/*"):
            with suppress(OSError):
                status = path.stat()
                files.append((status.st_mtime_ns, status.st_size, path))
        total = sum(size for _, size, _ in files)
        for _, size, path in sorted(files):
            if total <= most_bytes:
                break
            with suppress(OSError):
                path.unlink()
            total -= size


def log_cache(n_bytes: int) -> LogCache | None:
    """Return the cache for a campaign's logs, or None where they are few bytes or the environment says ``off``."""
    folder = cache_folder("logs") if n_bytes >= WORTH_BYTES else None
    return None if folder is None else LogCache(folder)


def cache_folder(name: str) -> Path | None:
    """Return the user's folder for a cache, that of the environment variable itself; None where it says ``off``."""
    chosen = os.environ.get(CACHE, "")
    if chosen:
        return None if chosen == "off" else Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME", "")
    if not Path(base).is_absolute():
        try:
            base = str(Path.home() / ".cache")
        except RuntimeError:
            return None
    return Path(base) / "calib" / name


@lru_cache(maxsize=1)
def _read_by() -> str:
    """Return a digest of the code by which logs are read, the parser's version included."""
    from importlib.metadata import version

    here = Path(__file__).parent
    digest = hashlib.sha256(version("pandas").encode())
    for pattern in _READ_BY:
        for path in sorted(here.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()


#: parsers and hashes release the interpreter; beyond some threads what holds it is all that is left
MOST_THREADS: Final = 8
#: fewer logs are read sooner than threads are started
MANY: Final = 8
#: smaller logs are parsed some at a time as one, by two threads: what holds the interpreter would block more of them
LARGE_BYTES: Final = 512 << 10
TOGETHER: Final = 16
#: where all of them are fewer bytes, each is read by numpy before what parses many as one is imported
MANY_BYTES: Final = 16 << 20


def read_logs(
    files: Sequence[LogFile],
    n_runs: int,
    encoder: Encoder,
    border: Border,
    renames: Renames | None = None,
    *,
    progress: Progress = silent,
) -> tuple[Logs, dict[str, str]]:
    """Read the logs of a campaign and undo the overflow of their counters.

    Parameters
    ----------
    files : sequence of LogFile
        Logs there are, in the order of the runs.
    n_runs : int
        Rows of the run table.
    encoder : Encoder
        ``wrap_bits`` where the settings name it; else overflows are looked for.
    border : Border
        Takes notes and faults in the order of the runs; a log that cannot be used is a fault.
    renames : mapping of str to (str, float), optional
        See `calib.campaign.logs_file.read_log`.
    progress : callable
        See `calib.types.Progress`.

    Returns
    -------
    logs : Logs
        Of all runs, end to end.
    hashes : dict of str to str
        SHA-256 of each log, by its name.
    """
    stack = LogStack(n_runs)
    hashes: dict[str, str] = {}
    for (index, run_id, _, name), log in zip(stepped(files, progress, "logs"), _read_all(files, renames), strict=True):
        border.notes.extend(log.notes)
        if log.sha256:
            hashes[name] = log.sha256
        if log.error is None:
            stack.add(index, log.columns)
        else:
            border.fault(log.error, "unreadable_log", run_id)
    names = {index: (run_id, name) for index, run_id, _, name in files}
    return stack.finished(encoder, names, border), hashes


def _read_all(files: Sequence[LogFile], renames: Renames | None) -> Iterator[ReadLog]:
    """Yield the logs in their order."""
    n_bytes = 0
    for _, _, path, _ in files:
        with suppress(OSError):
            n_bytes += path.stat().st_size
    cache, large = log_cache(n_bytes), n_bytes >= LARGE_BYTES * len(files)
    together = n_bytes >= MANY_BYTES or n_bytes > NUMPY_BYTES * len(files)
    reader = _Reader(renames, cache, together=together)
    size = 1 if large else TOGETHER
    batches = [files[first : first + size] for first in range(0, len(files), size)]
    threads = min(MOST_THREADS if large else 2, _processors()) if together and len(files) >= MANY else 1
    if threads == 1:
        yield from chain.from_iterable(map(reader.read, batches))
    else:
        from concurrent.futures import ThreadPoolExecutor

        pool = ThreadPoolExecutor(threads)
        try:
            yield from chain.from_iterable(pool.map(reader.read, batches))
        finally:
            pool.shutdown(cancel_futures=True)
    if cache is not None:
        cache.trim()


@dataclass(frozen=True, slots=True)
class _Reader:
    """What reading a log depends on beside its file."""

    renames: Renames | None
    cache: LogCache | None
    #: parse small logs as one
    together: bool

    def read(self, files: Sequence[LogFile]) -> list[ReadLog]:
        """Return some logs, from the cache where it has them."""
        states = [_state(path) for _, _, path, _ in files]
        hashes = [_sha256(path) for _, _, path, _ in files]
        places = [self._place(name, sha256) for (_, _, _, name), sha256 in zip(files, hashes, strict=True)]
        logs = {
            number: log
            for number, place in enumerate(places)
            if self.cache is not None and place is not None and (log := self.cache.get(place, hashes[number]))
        }
        new = [number for number in range(len(files)) if number not in logs]
        raws: dict[int, RawTable | None] = {}
        # an odd log may have asked for the parser of many already
        if (self.together or "pandas" in sys.modules) and len(new) > 1:
            plain = [(files[number][2], files[number][3]) for number in new]
            raws = dict(zip(new, read_batch(plain, wanted_in_log(self.renames)), strict=True))
        for number in new:
            logs[number] = log = self._parsed(files[number], hashes[number], raws.get(number))
            if _state(files[number][2]) != states[number]:
                # a file that changed while it was read is neither kept nor named under the hash of what it was
                logs[number] = ReadLog(log.columns, log.notes, _sha256(files[number][2]), log.error)
            elif self.cache is not None and (place := places[number]) is not None and log.error is None:
                self.cache.put(place, log)
        return [logs[number] for number in range(len(files))]

    def _place(self, name: str, sha256: str) -> Path | None:
        if self.cache is None or not sha256:
            return None
        return self.cache.path_of(sha256, [name, sorted((self.renames or {}).items())])

    def _parsed(self, file: LogFile, sha256: str, raw: RawTable | None) -> ReadLog:
        own = Border(lenient=False)
        try:
            columns = read_log(file[2], file[3], own, self.renames, raw=raw)
        except BadFileError as error:
            return ReadLog({}, tuple(own.notes), sha256, error)
        return ReadLog(columns, tuple(own.notes), sha256)


def _sha256(path: Path) -> str:
    with suppress(OSError):
        return sha256_file(path)
    return ""


def _state(path: Path) -> tuple[int, ...]:
    """Return inode, size and times of the last change of a file: any writing to it changes them; empty without it."""
    with suppress(OSError):
        status = path.stat()
        return status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns
    return ()


def _processors() -> int:
    """Return how many processors this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1
