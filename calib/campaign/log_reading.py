"""Read the logs of a campaign: several at once, and unchanged large ones from the cache.

The cache holds one file of plain columns a log, under the hash of its content; it may be deleted at any time.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import astuple, dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

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

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

#: environment variable: a folder for the cache, or ``off``
CACHE: Final = "CALIB_CACHE"
#: smaller campaigns are read in less time than it takes to ask
WORTH_BYTES: Final = 16 << 20
#: the oldest files go where all together are larger than this
MOST_BYTES: Final = 8 << 30
#: what reads a log, whose change makes what was kept worthless
_READ_BY: Final = ("columns.py", "log_reading.py", "logs_file.py", "readers/*.py")
_MAGIC: Final = b"calib-log-cache\n"


@dataclass(frozen=True, slots=True)
class ReadLog:
    """A log as read: its columns by calib's names (read-only where they come from the cache), and what was said."""

    columns: Mapping[str, FloatArray]
    notes: tuple[Note, ...]


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

    def get(self, path: Path) -> ReadLog | None:
        """Return what is kept at `path` (of `path_of`); None where there is nothing, or nothing whole."""
        try:
            data = path.read_bytes()
            head_end = data.index(b"\n", len(_MAGIC))
            if not data.startswith(_MAGIC):
                return None
            head = json.loads(data[len(_MAGIC) : head_end])
            body = memoryview(data)[head_end + 1 :]
            if zlib.crc32(body) != head["crc32"]:
                return None
            values = np.frombuffer(body, dtype="<f8").reshape(len(head["columns"]), -1)
            notes = tuple(Note(*map(str, note)) for note in head["notes"])
            columns = {str(name): row for name, row in zip(head["columns"], values, strict=True)}
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return ReadLog(columns, notes)

    def put(self, path: Path, log: ReadLog) -> None:
        """Keep a log at `path`; where that cannot be done it is read again the next time."""
        values = np.ascontiguousarray(np.stack(list(log.columns.values())), dtype="<f8")
        body = values.data.cast("B")
        head = {"columns": list(log.columns), "notes": [astuple(note) for note in log.notes], "crc32": zlib.crc32(body)}
        data = b"".join((_MAGIC, json.dumps(head).encode("utf-8"), b"\n", body))
        with suppress(CalibError, OSError):
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            write_bytes(path, data, force=True)

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


#: parsers and hashes let go of the interpreter; beyond some threads what they hold it for is all that is left
MOST_THREADS: Final = 8
#: fewer logs are read sooner than threads are started
MANY: Final = 8
#: and smaller ones, too: threads that take turns with the interpreter cost more there than a second core gives
LARGE_BYTES: Final = 512 << 10
#: small logs that are parsed as one
TOGETHER: Final = 16
#: where all of them are fewer bytes, each is read by numpy before what parses many as one is imported
MANY_BYTES: Final = 16 << 20


@dataclass(frozen=True, slots=True)
class _Content:
    """The hash of a file's bytes, empty where it cannot be read, and the state of the file before it was read."""

    sha256: str
    state: tuple[int, ...]


def _content(path: Path) -> _Content:
    state = _state(path)
    with suppress(OSError):
        return _Content(sha256_file(path), state)
    return _Content("", state)


def _state(path: Path) -> tuple[int, ...]:
    """Return inode, size and times of the last change of a file: any writing to it changes them; empty without it."""
    with suppress(OSError):
        status = path.stat()
        return status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns
    return ()


@dataclass(frozen=True, slots=True)
class _Outcome:
    """What came of reading a log: its columns or the error, what was said on the way, and the hash of its bytes."""

    columns: dict[str, FloatArray]
    notes: tuple[Note, ...]
    sha256: str
    error: BadFileError | None = None


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
    for (index, run_id, _, name), outcome in zip(
        stepped(files, progress, "logs"), _outcomes(files, renames), strict=True
    ):
        border.notes.extend(outcome.notes)
        if outcome.sha256:
            hashes[name] = outcome.sha256
        if outcome.error is None:
            stack.add(index, outcome.columns)
        else:
            border.fault(outcome.error, "unreadable_log", run_id)
    names = {index: (run_id, name) for index, run_id, _, name in files}
    return stack.finished(encoder, names, border), hashes


def _outcomes(files: Sequence[LogFile], renames: Renames | None) -> Iterator[_Outcome]:
    """Yield what came of each log, in their order."""
    n_bytes = _bytes(files)
    cache = log_cache(n_bytes)
    reader = _Reader(renames, cache, together=n_bytes >= MANY_BYTES or n_bytes > NUMPY_BYTES * len(files))
    threads = min(MOST_THREADS, _processors()) if reader.together and len(files) >= MANY else 1
    stored = 0
    for outcome, new in (_small if n_bytes < LARGE_BYTES * len(files) else _large)(reader, files, threads):
        stored += new
        yield outcome
    if cache is not None and stored:
        cache.trim()


def _small(reader: _Reader, files: Sequence[LogFile], threads: int) -> Iterator[tuple[_Outcome, bool]]:
    """Read small logs, some at a time as one, which needs the interpreter for a part of the time only."""
    batches = [files[first : first + TOGETHER] for first in range(0, len(files), TOGETHER)]

    def read(batch: Sequence[LogFile]) -> list[tuple[_Outcome, bool]]:
        return reader.read(batch)

    with _pool(min(threads, 2) if threads > 1 else 0) as pool:
        for outcomes in pool.map(read, batches) if pool else map(read, batches):
            yield from outcomes


def _large(reader: _Reader, files: Sequence[LogFile], threads: int) -> Iterator[tuple[_Outcome, bool]]:
    """Read large logs one by one, several threads at once."""

    def read(file: LogFile) -> tuple[_Outcome, bool]:
        return reader.read([file])[0]

    with _pool(threads if threads > 1 else 0) as pool:
        yield from pool.map(read, files) if pool else map(read, files)


@contextmanager
def _pool(threads: int) -> Iterator[ThreadPoolExecutor | None]:
    """Give so many threads, None where that is none; what they have not begun is not begun any more at the end."""
    if not threads:
        yield None
        return
    from concurrent.futures import ThreadPoolExecutor

    pool = ThreadPoolExecutor(threads)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def _bytes(files: Sequence[LogFile]) -> int:
    total = 0
    for _, _, path, _ in files:
        with suppress(OSError):
            total += path.stat().st_size
    return total


@dataclass(frozen=True, slots=True)
class _Reader:
    """What reading a log depends on beside its file."""

    renames: Renames | None
    cache: LogCache | None
    #: parse small logs as one
    together: bool

    def read(self, files: Sequence[LogFile]) -> list[tuple[_Outcome, bool]]:
        """Return what came of each of some logs, and whether it was put into the cache."""
        contents = [_content(path) for _, _, path, _ in files]
        places = [self._place(file, content) for file, content in zip(files, contents, strict=True)]
        kept = [None if self.cache is None or place is None else self.cache.get(place) for place in places]
        anew = [number for number, log in enumerate(kept) if log is None]
        raws: dict[int, RawTable | None] = {}
        # an odd log may have asked for the parser of many already
        if (self.together or "pandas" in sys.modules) and len(anew) > 1:
            plain = [(files[number][2], files[number][3]) for number in anew]
            raws = dict(zip(anew, read_batch(plain, wanted_in_log(self.renames)), strict=True))
        outcomes = []
        for number, (file, content, place, log) in enumerate(zip(files, contents, places, kept, strict=True)):
            if log is not None:
                outcomes.append((_Outcome(dict(log.columns), log.notes, content.sha256), False))
            else:
                outcomes.append(self._parsed(file, content, place, raws.get(number)))
        return outcomes

    def _place(self, file: LogFile, content: _Content) -> Path | None:
        if self.cache is None or not content.sha256:
            return None
        return self.cache.path_of(content.sha256, [file[3], sorted((self.renames or {}).items())])

    def _parsed(
        self, file: LogFile, content: _Content, place: Path | None, raw: RawTable | None
    ) -> tuple[_Outcome, bool]:
        _, _, path, name = file
        own = Border(lenient=False)
        try:
            columns = read_log(path, name, own, self.renames, raw=raw)
        except BadFileError as error:
            return _Outcome({}, tuple(own.notes), content.sha256, error), False
        notes = tuple(own.notes)
        if not content.sha256 or _state(path) != content.state:
            # a file that changed while it was read is neither kept nor named under the hash of what it was
            return _Outcome(columns, notes, _content(path).sha256), False
        if self.cache is None or place is None:
            return _Outcome(columns, notes, content.sha256), False
        self.cache.put(place, ReadLog(columns, notes))
        return _Outcome(columns, notes, content.sha256), True


def _processors() -> int:
    """Return how many processors this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1
