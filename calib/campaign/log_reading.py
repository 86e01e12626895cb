"""Read the logs of a campaign: several at a time, and those that were read before from the cache."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from calib.arrays import FloatArray
from calib.campaign.faults import Border
from calib.campaign.known_hashes import Content, FileState, KnownHashes
from calib.campaign.log_cache import LogCache, ReadLog, log_cache
from calib.campaign.log_stack import LogStack
from calib.campaign.logs_file import LogFile, Renames, read_log, wanted_in_log
from calib.campaign.model import Logs, Note
from calib.campaign.readers.alike import read_alike
from calib.campaign.readers.delimited import SMALL
from calib.campaign.readers.table import RawTable
from calib.campaign.settings import Encoder
from calib.errors import BadFileError
from calib.progress import Progress, silent, stepped

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

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
        See `calib.progress.Progress`.

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
    known = KnownHashes.read(None if cache is None else cache.folder, files[0][2].parent if files else Path())
    reader = _Reader(renames, cache, known, together=n_bytes >= MANY_BYTES or n_bytes > SMALL * len(files))
    threads = min(MOST_THREADS, _processors()) if reader.together and len(files) >= MANY else 1
    stored = 0
    for outcome, new in (_small if n_bytes < LARGE_BYTES * len(files) else _large)(reader, files, threads):
        stored += new
        yield outcome
    known.keep()
    if cache is not None and stored:
        cache.trim()


def _small(reader: _Reader, files: Sequence[LogFile], threads: int) -> Iterator[tuple[_Outcome, bool]]:
    """Read small logs, some at a time as one, which needs the interpreter for a part of the time only."""
    batches = [files[first : first + TOGETHER] for first in range(0, len(files), TOGETHER)]

    def read(batch: Sequence[LogFile]) -> list[tuple[_Outcome, bool]]:
        return reader.read(batch, [reader.known.content(path) for _, _, path, _ in batch])

    with _pool(min(threads, 2) if threads > 1 else 0) as pool:
        for outcomes in pool.map(read, batches) if pool else map(read, batches):
            yield from outcomes


def _large(reader: _Reader, files: Sequence[LogFile], threads: int) -> Iterator[tuple[_Outcome, bool]]:
    """Read large logs one by one, several threads at once."""

    def read(file: LogFile) -> tuple[_Outcome, bool]:
        return reader.read([file], [reader.known.content(file[2])])[0]

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
    known: KnownHashes
    #: parse small logs as one
    together: bool

    def read(self, files: Sequence[LogFile], contents: Sequence[Content]) -> list[tuple[_Outcome, bool]]:
        """Return what came of each of some logs, and whether it was put into the cache."""
        places = [self._place(file, content) for file, content in zip(files, contents, strict=True)]
        kept = [None if self.cache is None or place is None else self.cache.get(place) for place in places]
        anew = [number for number, log in enumerate(kept) if log is None]
        raws: dict[int, RawTable | None] = {}
        # an odd log may have asked for the parser of many already
        if (self.together or "pandas" in sys.modules) and len(anew) > 1:
            plain = [(files[number][2], files[number][3]) for number in anew]
            raws = dict(zip(anew, read_alike(plain, wanted_in_log(self.renames)), strict=True))
        outcomes = []
        for number, (file, content, place, log) in enumerate(zip(files, contents, places, kept, strict=True)):
            if log is not None:
                outcomes.append((_Outcome(dict(log.columns), log.notes, content.sha256), False))
            else:
                outcomes.append(self._parsed(file, content, place, raws.get(number)))
        return outcomes

    def _place(self, file: LogFile, content: Content) -> Path | None:
        if self.cache is None or not content.sha256:
            return None
        return self.cache.path_of(content.sha256, [file[3], sorted((self.renames or {}).items())])

    def _parsed(
        self, file: LogFile, content: Content, place: Path | None, raw: RawTable | None
    ) -> tuple[_Outcome, bool]:
        _, _, path, name = file
        own = Border(lenient=False)
        try:
            columns = read_log(path, name, own, self.renames, raw=raw)
        except BadFileError as error:
            return _Outcome({}, tuple(own.notes), content.sha256, error), False
        notes = tuple(own.notes)
        if not content.sha256 or FileState.of(path) != content.state:
            # a file that changed while it was read is neither kept nor named under the hash of what it was
            return _Outcome(columns, notes, KnownHashes(None).content(path).sha256), False
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
