"""Logs: which is whose, read one by one or together, end to end, counters' overflow undone."""

import os
import re
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign.model import LOG_COLUMNS, REFERENCE_POSE, WHEEL_SETS, Border, LogColumns, Logs, Note, RunTable
from calib.campaign.readers import READERS, RawTable, read_table
from calib.campaign.readers.delimited import NUMPY_BYTES, read_batch
from calib.campaign.settings import Encoder, Recognised, converted, recognise, second_column
from calib.errors import BadFileError
from calib.io import inside, sha256_file
from calib.types import FloatArray, IntArray, Progress, silent, stepped

_MAX_PATH: Final = 500
#: widths looked for where the settings name none
WIDTHS: Final = (13, 16, 32)
#: share of the counter's span up to which a step's direction is certain
_CLEAR_STEP: Final = 0.4
#: an undone overflow is at most so many times the largest other step
_LIKE_OTHERS: Final = 2.0
#: nothing is divided by less time between samples
_SHORTEST_STEP_S: Final = 1e-9
#: seconds that 32 bits of milliseconds and microseconds hold
_FULL_CLOCKS_S: Final = (2**32 / 1e3, 2**32 / 1e6)
#: least growth of columns: samples, share
_GROWTH: Final = 1 << 16
_GROWTH_SHARE: Final = 0.125
#: a log with a later first sample is noted: its times count from that
LATE_START_S: Final = 1.0


def log_files(folder: Path, runs: RunTable, shown: str, border: Border) -> "list[LogFile]":
    """Return the logs that there are, in the order of the runs.

    Without a name it is ``logs/<run_id>.csv`` or of another format; a missing one, or one named twice, is a fault.
    Raises BadFileError where a path leads out of the folder.
    """
    plain, suffixes = _plain_logs(folder), READERS if (folder / "logs").exists() else ()
    files: list[LogFile] = []
    taken: dict[Path, int] = {}

    def fault(actual: str, expected: str, remedy: str, row: int) -> BadFileError:
        return BadFileError(shown, actual, expected, remedy, row=row, column="log")

    for index, (run_id, row) in enumerate(zip(map(str, runs.run_id), map(int, runs.line), strict=True)):
        if "log" in runs.labels:
            relative = str(runs.labels["log"][index])
        else:
            candidates = [f"logs/{run_id}{suffix}" for suffix in suffixes] if Path(run_id).name == run_id else []
            relative = next((name for name in candidates if name in plain or (folder / name).exists()), "")
        if not relative:
            continue
        if len(relative) > _MAX_PATH:
            raise fault(f"a path of {len(relative)} characters", f"at most {_MAX_PATH}", "correct the path", row)
        path = plain.get(relative) or inside(folder, relative, named_in=shown, row=row, column="log")
        if path in taken:
            twice = f"{relative}, which row {taken[path]} names too"
            border.fault(fault(twice, "a log of its own for each run", "correct the path", row), "shared_log", run_id)
        taken.setdefault(path, row)
        # the file system may not hold such a name
        if relative not in plain and not os.path.isfile(path):  # noqa: PTH113
            missing = f"{relative}, which is {'a folder' if path.is_dir() else 'not there'}"
            remedy = "put the file there, or leave the cell empty"
            border.fault(fault(missing, "a log file", remedy, row), "missing_log", run_id)
            continue
        files.append((index, run_id, path, relative))
    return files


def _plain_logs(folder: Path) -> dict[str, Path]:
    logs = folder.resolve() / "logs"
    with suppress(OSError), os.scandir(logs) as entries:
        if not logs.is_symlink():
            return {f"logs/{one.name}": logs / one.name for one in entries if one.is_file(follow_symlinks=False)}
    return {}


#: run number, run id, path, and its name in messages
LogFile = tuple[int, str, Path, str]


def read_log(path: Path, shown: str, border: Border, raw: RawTable | None = None) -> dict[str, FloatArray]:
    """Read one log: columns of `LOG_COLUMNS` in SI units, times from the run's start, shape (n_samples,) each.

    `raw`: the columns that `in_log` picks, where they were read already. Raises BadFileError where a required column is
    missing or holds a gap, or a cell is no number.
    """
    raw = read_table(path, shown, in_log) if raw is None else raw
    border.notes.extend(raw.notes)
    columns: dict[str, FloatArray] = {}
    add_recognised(columns, raw, shown, border)
    refuse_incomplete(columns, shown, raw.line)
    omit_lost_frames(columns, REFERENCE_POSE, shown, border)
    from_first_sample(columns, shown, border)
    return columns


#: steps that a reference does not take at once
_LOST_STEPS: Final = 10.0


def omit_lost_frames(columns: dict[str, FloatArray], names: Sequence[str], shown: str, border: Border) -> None:
    """Empty poses, in place, of zero after one far away: a tracker that sees nothing writes these.

    `names`: of the pose, x and y first; without two of them nothing changes.
    """
    poses = [name for name in names if name in columns and columns[name].dtype == np.float64]
    if len(poses) < 2:
        return
    zero = np.logical_and.reduce([columns[name] == 0.0 for name in poses])
    away = np.hypot(columns[poses[0]], columns[poses[1]])
    kept = np.flatnonzero(~zero & np.isfinite(away))
    if not zero.any() or not len(kept):
        return
    last = kept[np.maximum(np.searchsorted(kept, np.arange(len(zero))) - 1, 0)]
    step = np.abs(np.diff(away[kept], prepend=away[kept[0]]))
    lost = zero & (last < np.arange(len(zero))) & (away[last] > _LOST_STEPS * np.median(step))
    if lost.any():
        columns.update({name: np.where(lost, np.nan, columns[name]) for name in poses})
        border.say(
            shown, f"{lost.sum()} poses are exactly 0 in {' and '.join(poses)}: lost frames, omitted", "lost_frames"
        )


def in_log(name: str) -> bool:
    """Return whether a log may have a column of this name."""
    return log_column(name).name in LOG_COLUMNS


def add_recognised(
    columns: dict[str, FloatArray], raw: RawTable, shown: str, border: Border, mapped: Collection[str] = ()
) -> str:
    """Add the columns of known names, in SI units; return the source of the times.

    Raises BadFileError where two columns mean the same.

    `columns`: changed in place; `mapped`: columns of `raw` to pass over; see `RawTable`.
    """
    time, present = "t_s", set(columns)
    for header, cells in raw.columns.items():
        match = log_column(header)
        if header in mapped or match.name not in LOG_COLUMNS or match.name in present:
            continue
        if match.name in columns:
            raise second_column(match, header, shown)
        border.recognised(shown, match)
        time = header if match.name == "t_s" else time
        columns[match.name] = converted(cells, match.factor, match.offset)
    return time


def from_first_sample(columns: dict[str, FloatArray], shown: str, border: Border) -> float:
    """Let times that begin after `LATE_START_S` count from the first sample, in place; return its time.

    Clocks of 32 bits, in ms or us, go on where they start again.
    """
    start, step = float(columns["t_s"][0]), np.diff(columns["t_s"])
    for full in _FULL_CLOCKS_S:
        again = np.abs(step + full) < _LIKE_OTHERS * np.median(np.abs(step)) if len(step) else np.zeros(0)
        if again.any():
            columns["t_s"] = columns["t_s"] + full * np.cumsum([0, *again])
            border.say(shown, "its clock of 32 bits starts again, which was undone", "clock_wrap")
    if abs(start) > LATE_START_S:
        border.say(shown, f"times count from the first sample, which stood at {start:.10g} s", "start_time")
        columns["t_s"] = columns["t_s"] - start
    return start


def log_column(name: str) -> Recognised:
    """Return what a log's column is, by its whole name or the part after stream or group.

    `name`: ``counts_left``, ``Encoder/counts_left`` or ``/wheels:counts_left``.
    """
    whole = recognise(name, LOG_COLUMNS, further=False)
    if whole.name in LOG_COLUMNS:
        return whole
    return replace(recognise(re.split(r"[:/]", name)[-1], LOG_COLUMNS, further=False), found=name)


def refuse_incomplete(columns: Mapping[str, FloatArray], shown: str, line: IntArray) -> None:
    """Refuse a log without time, wheels or rows, or with gaps in them.

    `line` (shape (n_samples,)): of each sample in the file. Raises BadFileError, which names column or row.
    """
    wheels = max(WHEEL_SETS, key=lambda names: sum(name in columns for name in names) / len(names))
    for name in ("t_s", *wheels):
        if name not in columns:
            expected = f"t_s with {' or '.join(' and '.join(names) for names in WHEEL_SETS)}"
            remedy = "name the columns so in the header line; a unit may differ if it is named (t_ms)"
            raise BadFileError(shown, "no such column", expected, remedy, row=1, column=name)
        # one pass: the sum is NaN with a gap
        if np.isnan(columns[name].sum()) and len(gaps := np.flatnonzero(np.isnan(columns[name]))):
            remedy = "remove the row; a gap in time is found and said"
            row = int(line[gaps[0]])
            raise BadFileError(shown, "an empty cell", "a number in every row", remedy, row=row, column=name)
    if len(line) < 2:
        actual = "one row" if len(line) else "no rows"
        raise BadFileError(shown, actual, "one row a sample, two or more", "export the log again")


def detect_wrap_bits(counts: FloatArray, offsets: IntArray, time_s: FloatArray | None = None) -> int | None:
    """Find the width of a counter that overflows inside the logs.

    All counts lie in one span, and each jump, undone, is a step like the others, as a reset is not. Shapes: see
    `unwrap`.
    """
    if not len(counts) or np.isnan(counts).all():
        return None
    low, high = np.nanmin(counts), np.nanmax(counts)
    for bits in WIDTHS:
        full = 2.0**bits
        unsigned, signed = low >= 0 and high < full, low >= -full / 2 and high < full / 2
        if not (unsigned or signed) or high - low < 0.875 * full:
            continue
        step = np.abs(_steps(counts, offsets))
        jumps = step > full / 2
        step[jumps] -= full
        if time_s is not None and jumps.any():
            duration = _steps(time_s, offsets)
            step /= np.fmax(duration / max(float(np.nanmedian(duration)), _SHORTEST_STEP_S), 1.0)
        most = float(np.fmax.reduce(step[~jumps], initial=0.0))
        if jumps.any() and most < _CLEAR_STEP * full and -float(step[jumps].min()) <= _LIKE_OTHERS * most:
            return bits
    return None


def unwrap(counts: FloatArray, offsets: IntArray, bits: int) -> tuple[FloatArray, IntArray]:
    """Undo overflows: every step is the shortest around the counter.

    `counts` (n_samples,): logs end to end; `offsets` (n_runs + 1,): where each begins. Returns `counts`, each log from
    its own first value, and the overflows undone in each.
    """
    full = 2.0**bits
    step = _steps(counts, offsets)
    if not (turns := np.where(np.isnan(step), 0.0, -np.rint(step / full))).any():
        return counts, np.zeros(len(offsets) - 1, dtype=np.int64)
    total = np.cumsum(turns)
    start = np.repeat(total[np.minimum(offsets[:-1], len(total) - 1)], np.diff(offsets))
    wraps = np.diff(np.concatenate(([0.0], np.cumsum(np.abs(turns))))[offsets])
    return counts + full * (total - start), wraps.astype(np.int64)


def _steps(counts: FloatArray, offsets: IntArray) -> FloatArray:
    step = np.diff(counts, prepend=counts[:1])
    starts = offsets[:-1]
    step[starts[starts < len(step)]] = 0.0
    return step


#: a turn and its rounding
FULL_TURN_RAD: Final = 2.0 * np.pi + 1e-3


class LogStack:
    """Columns that grow as logs come, an array each, so that no log is held twice."""

    def __init__(self, n_runs: int) -> None:
        self._lengths = np.zeros(n_runs, dtype=np.int64)
        self._columns: dict[str, FloatArray] = {}
        self._size = 0

    def add(self, run: int, columns: Mapping[str, FloatArray]) -> None:
        """Add the log of the next run, columns of shape (n_samples,)."""
        begin = self._size
        self._lengths[run] = n_samples = len(columns["t_s"])
        self._size += n_samples
        for name in LOG_COLUMNS:
            if name in columns and name not in self._columns:
                self._columns[name] = np.full(begin, np.nan)
        for name, column in self._columns.items():
            if len(column) < self._size:
                column.resize(self._size + max(_GROWTH, int(_GROWTH_SHARE * self._size)), refcheck=False)
            column[begin : self._size] = columns.get(name, np.nan)

    def finished(self, encoder: Encoder, names: Mapping[int, tuple[str, str]], border: Border) -> Logs:
        """Return all runs' logs, end to end, their counters' overflow undone; the stack is empty afterwards.

        Without ``wrap_bits`` overflows are looked for; `names`: run id and log, for messages.
        """
        offsets = np.concatenate(([0], np.cumsum(self._lengths))).astype(np.int64)
        columns = LogColumns(self._size, len(self._columns))
        for name in LOG_COLUMNS:
            if (column := self._columns.pop(name, None)) is None:
                continue
            column.resize(self._size, refcheck=False)
            # no wheel steers half a turn between samples: the sensor restarts at zero
            jumps = name == "steer_rad" and bool((np.abs(_steps(column, offsets)) > np.pi).any())
            if jumps and np.nanmin(column) >= 0.0 and np.nanmax(column) <= FULL_TURN_RAD:
                column = np.where(column > np.pi, column - 2.0 * np.pi, column)
                border.say("logs, column steer_rad", "angles from 0 to 2 pi were counted about zero", "wrap")
            counted = len(column) and name.startswith("counts_")
            if counted and (bits := encoder.wrap_bits or detect_wrap_bits(column, offsets, columns.get("t_s"))):
                column, wraps = unwrap(column, offsets, bits)
                for run in np.flatnonzero(wraps):
                    run_id, shown = names[int(run)]
                    source = "found in the jumps; give encoder.wrap_bits to make it sure"
                    how = "as the settings say" if encoder.wrap_bits else source
                    text = f"{int(wraps[run])} overflow(s) of a {bits}-bit counter were undone ({how})"
                    border.say(f"{shown}, column {name}", text, "wrap", run_id=run_id)
            columns.add(name, column)
        return Logs(offsets=offsets, columns=columns)


#: columns, or why a log cannot be used; notes; SHA-256 of the file, empty where unreadable
_ReadLog = tuple[Mapping[str, FloatArray] | BadFileError, Sequence[Note], str]


#: parsers and hashes release the interpreter; more threads wait for what holds it
MOST_THREADS: Final = 8
#: smaller logs are parsed together, by two threads: more would wait for the interpreter
LARGE_BYTES: Final = 512 << 10
TOGETHER: Final = 16
#: fewer bytes in all are read by numpy, without importing the parser of many
MANY_BYTES: Final = 16 << 20


def read_logs(
    files: Sequence[LogFile], n_runs: int, encoder: Encoder, border: Border, *, progress: Progress = silent
) -> tuple[Logs, dict[str, str]]:
    """Return logs, see `LogStack`, and the SHA-256 of each by name; one that cannot be used is a fault."""
    stack, hashes = LogStack(n_runs), dict[str, str]()
    for (index, run_id, _, name), log in zip(stepped(files, progress, "logs"), _read_all(files), strict=True):
        columns, notes, sha256 = log
        border.notes.extend(notes)
        hashes |= {name: sha256} if sha256 else {}
        if isinstance(columns, BadFileError):
            border.fault(columns, "unreadable_log", run_id)
        else:
            stack.add(index, columns)
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
    logs: list[_ReadLog] = []
    for (_, _, path, name), (state, sha256), raw in zip(files, states, raws, strict=True):
        own = Border(lenient=False)
        # a file may have changed while read
        try:
            logs.append((read_log(path, name, own, raw), own.notes, sha256 if _state(path) == state else _sha256(path)))
        except BadFileError as error:
            logs.append((error, own.notes, sha256))
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
