"""Read the logs of a campaign: several at a time, and those that were read before from the cache."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from calib.arrays import FloatArray
from calib.campaign.faults import Border
from calib.campaign.known_hashes import Content, FileState, KnownHashes
from calib.campaign.log_cache import LogCache, ReadLog, log_cache
from calib.campaign.log_stack import LogStack
from calib.campaign.logs_file import LogFile, Renames, read_log
from calib.campaign.model import Logs, Note
from calib.campaign.settings import Encoder
from calib.errors import BadFileError
from calib.progress import Progress, silent, stepped

__all__ = ["read_logs"]

#: parsers and hashes let go of the interpreter; beyond some threads what they hold it for is all that is left
MOST_THREADS: Final = 8
#: fewer logs are read sooner than threads are started
MANY: Final = 8
#: and smaller ones, too: threads that take turns with the interpreter cost more there than a second core gives
LARGE_BYTES: Final = 512 << 10


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
    cache = log_cache(path for _, _, path, _ in files)
    known = KnownHashes.read(None if cache is None else cache.folder, files[0][2].parent if files else Path())
    stored = 0
    threads = min(MOST_THREADS, _processors())
    if threads < 2 or len(files) < MANY:
        for _, _, path, name in files:
            outcome, new = _read(path, name, renames, cache, known.content(path))
            stored += new
            yield outcome
    else:
        from concurrent.futures import ThreadPoolExecutor

        # small logs: one thread hashes ahead, which needs the interpreter for a moment only, and this one parses
        small = _mean_bytes(files) < LARGE_BYTES
        pool = ThreadPoolExecutor(1 if small else threads)
        try:
            if small:
                contents = pool.map(known.content, (path for _, _, path, _ in files))
                read: Iterator[tuple[_Outcome, bool]] = (
                    _read(file[2], file[3], renames, cache, content)
                    for file, content in zip(files, contents, strict=True)
                )
            else:
                read = pool.map(lambda file: _read(file[2], file[3], renames, cache, known.content(file[2])), files)
            for outcome, new in read:
                stored += new
                yield outcome
        finally:
            pool.shutdown(cancel_futures=True)
    known.keep()
    if cache is not None and stored:
        cache.trim()


def _mean_bytes(files: Sequence[LogFile]) -> float:
    with suppress(OSError):
        return sum(path.stat().st_size for _, _, path, _ in files) / len(files)
    return 0.0


def _read(
    path: Path, name: str, renames: Renames | None, cache: LogCache | None, content: Content
) -> tuple[_Outcome, bool]:
    """Return what came of a log, and whether it was put into the cache."""
    sha256, place = content.sha256, None
    if cache is not None and sha256:
        place = cache.path_of(sha256, [name, sorted((renames or {}).items())])
        kept = cache.get(place)
        if kept is not None:
            return _Outcome(dict(kept.columns), kept.notes, sha256), False
    own = Border(lenient=False)
    try:
        columns = read_log(path, name, own, renames)
    except BadFileError as error:
        return _Outcome({}, tuple(own.notes), sha256, error), False
    notes = tuple(own.notes)
    if not sha256 or FileState.of(path) != content.state:
        # a file that changed while it was read is neither kept nor named under the hash of what it was
        return _Outcome(columns, notes, KnownHashes(None).content(path).sha256), False
    if cache is None or place is None:
        return _Outcome(columns, notes, sha256), False
    cache.put(place, ReadLog(columns, notes))
    return _Outcome(columns, notes, sha256), True


def _processors() -> int:
    """Return how many processors this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1
