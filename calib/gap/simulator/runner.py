"""Runs of the user's simulator: several at once, stopped as a whole, cached by content; the table that each leaves."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import os
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Final

import numpy as np

from calib.campaign.log_reading import cache_folder
from calib.errors import BadFileError, BadInputError, CalibError
from calib.gap.simulator.settings import PLACES, SimulatorSettings
from calib.io import sha256_file, write_bytes
from calib.types import FloatArray, Progress

#: what a simulator may predict, in the order of the channels: distance, x, y, heading
COLUMNS: Final = ("sim_distance_m", "sim_x_m", "sim_y_m", "sim_theta_rad")
#: a run that ends further off, in metres or radians, has diverged
LARGEST: Final = 1e6
#: of a table of 100 000 runs; what is larger is no table of end poses
MOST_BYTES: Final = 32 << 20


class BadTableError(ValueError):
    """What is wrong with a simulator's table, as ``found ...; expected ...``."""


def read_table(path: Path, run_ids: Sequence[str]) -> FloatArray:
    """Return the simulated (distance, x, y, heading) of each run, (n_runs, 4); NaN in a column that is not written.

    Rows of other runs are passed over. Raises BadTableError.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise BadTableError(f"found a table of {path.stat().st_size} bytes; expected {MOST_BYTES} at most")
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise BadTableError("found no output file; expected it to write the CSV at {out}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise BadTableError(f"found an output file that cannot be read ({error}); expected CSV in UTF-8") from error
    try:
        lines = [(number, row) for number, row in enumerate(csv.reader(io.StringIO(text)), start=1) if row]
    except csv.Error as error:
        raise BadTableError(f"found {error} in its CSV; expected a header and a row a run") from error
    header = [name.strip() for name in lines[0][1]] if lines else []
    columns = [name for name in COLUMNS if name in header]
    if "run_id" not in header or not columns or len(set(header)) < len(header):
        raise BadTableError(
            f"found the columns {', '.join(header)[:120] or 'none'}; expected run_id and some of {', '.join(COLUMNS)}"
        )
    by_run: dict[str, dict[str, str]] = {}
    for number, row in lines[1:]:
        if len(row) != len(header):
            raise BadTableError(f"found {len(row)} cells in row {number} of its CSV; expected {len(header)}")
        cells = dict(zip(header, row, strict=True))
        run_id = cells["run_id"].strip()
        if run_id in by_run:
            raise BadTableError(f"found run {run_id[:60]} twice in its CSV; expected a row a run")
        by_run[run_id] = cells
    missing = [run_id for run_id in run_ids if run_id not in by_run]
    if missing:
        raise BadTableError(
            f"found no row for {len(missing)} of {len(run_ids)} runs ({missing[0]} first); expected all"
        )
    values = np.full((len(run_ids), len(COLUMNS)), np.nan)
    for name in columns:
        values[:, COLUMNS.index(name)] = [_number(by_run[run_id][name], name, run_id) for run_id in run_ids]
    return values


def _number(text: str, name: str, run_id: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= LARGEST:
        raise BadTableError(
            f"found {name} = {text[:30]!r} in run {run_id}; expected a number between -{LARGEST:g} and {LARGEST:g}"
        )
    return value


#: what a file is; another number makes what was kept worthless
FORMAT: Final = "calib-simulator-run/1"


@dataclass(frozen=True, slots=True)
class RunCache:
    """A folder of results, one file a run; each is written whole or not at all, a damaged one is as good as none."""

    folder: Path | None  #: None where nothing is kept
    depends: str  #: digest of the command, the simulator's files and the campaign's

    def _path(self, parameters: Mapping[str, float], repeat: int) -> Path | None:
        asked = json.dumps([FORMAT, self.depends, sorted(parameters.items()), repeat])
        name = hashlib.sha256(asked.encode()).hexdigest()
        return None if self.folder is None else self.folder / name[:2] / f"{name}.json"

    def get(self, parameters: Mapping[str, float], repeat: int, run_ids: Sequence[str]) -> FloatArray | None:
        """Return what a run simulated, shape (n_runs, 4); None where nothing whole is kept."""
        path = self._path(parameters, repeat)
        try:
            document = json.loads(b"" if path is None else path.read_bytes())
            values = np.array(document["values"], dtype=np.float64)
            if document["format"] != FORMAT or document["runs"] != list(run_ids) or values.shape != (len(run_ids), 4):
                return None
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return values

    def put(self, parameters: Mapping[str, float], repeat: int, run_ids: Sequence[str], values: FloatArray) -> None:
        """Keep what a run simulated; where that cannot be done it runs again the next time."""
        path = self._path(parameters, repeat)
        if path is None:
            return
        document = {"format": FORMAT, "runs": list(run_ids), "values": values.tolist()}
        with suppress(CalibError, OSError):
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            write_bytes(path, json.dumps(document).encode(), force=True)


def run_cache(settings: SimulatorSettings, campaign_hashes: Mapping[str, str]) -> RunCache:
    """Return the cache of a simulator on a campaign.

    Results depend on the command, on the files that it names or that ``inputs`` lists, and on the campaign's files.
    """
    folder = settings.path.resolve().parent
    files = {part: folder / part for part in settings.command if "{" not in part}
    for name in settings.inputs:
        if not (folder / name).is_file():
            raise BadFileError(
                settings.path, repr(name)[:60], "a file beside it", "correct the path, or remove it", column="inputs"
            )
        files[name] = folder / name
    hashes = {name: sha256_file(path) for name, path in files.items() if path.is_file()}
    what = json.dumps([list(settings.command), hashes, dict(campaign_hashes)], sort_keys=True)
    return RunCache(cache_folder("simulator"), hashlib.sha256(what.encode()).hexdigest())


#: of a simulator's own output, what is kept and what an error shows: its last lines say what went wrong
KEPT_BYTES: Final = 4096
SHOWN_CHARACTERS: Final = 300
#: stage of the progress
RUNS_STAGE: Final = "simulator runs"
#: how often a run is looked at: an interruption is heeded within this time
LOOK_S: Final = 0.05


@dataclass(frozen=True, slots=True)
class Job:
    """One run of the simulator."""

    parameters: dict[str, float]
    what: str  #: what it is for, as an error names it
    repeat: int = 0  #: number among runs with the same parameters


class _Stopped(Exception):
    """The run was stopped because another failed or the user interrupted."""


@dataclass(eq=False)
class SimulatorRunner:
    """Runs a simulator on a campaign, at most `workers` at once; results that are kept already are not run again."""

    settings: SimulatorSettings  #: the command
    campaign: Path  #: folder of the campaign
    run_ids: Sequence[str]  #: runs that it has to simulate
    cache: RunCache  #: of results
    workers: int  #: runs at once
    progress: Progress  #: see `calib.types.Progress`
    asked: int = 0  #: runs that were asked for
    ran: int = 0  #: of these, those that were not kept already
    seconds: list[float] = field(default_factory=list)  #: wall time of each that ran
    _stop: threading.Event = field(default_factory=threading.Event)

    def run(self, jobs: Sequence[Job]) -> list[FloatArray]:
        """Return what each run simulates, (n_runs, 4); an error or an interruption ends all that is at work."""
        from concurrent.futures import ThreadPoolExecutor

        results = [self.cache.get(job.parameters, job.repeat, self.run_ids) for job in jobs]
        todo = [number for number, result in enumerate(results) if result is None]
        self.asked, self.ran = self.asked + len(jobs), self.ran + len(todo)
        if not todo:
            return [result for result in results if result is not None]
        command = self._command()
        with ThreadPoolExecutor(min(self.workers, len(todo))) as pool:
            try:
                # an interruption while they are handed over ends those at work, too
                waiting = {pool.submit(self._one, command, jobs[number]): number for number in todo}
                while waiting:
                    # asleep, not in the futures' own wait: an interruption there leaves their locks held
                    time.sleep(LOOK_S)
                    for future in [future for future in waiting if future.done()]:
                        results[waiting.pop(future)] = future.result()
                    self.progress(len(jobs) - len(waiting), len(jobs), RUNS_STAGE)
            except BaseException:
                self._stop.set()
                pool.shutdown(wait=True, cancel_futures=True)
                raise
        return [result for result in results if result is not None]

    @property
    def sentence(self) -> str:
        """How often it was asked to run so far, and how long that took."""
        each = f", {sum(self.seconds) / len(self.seconds):.2g} s each" if self.seconds else ""
        runs = "1 run" if self.ran == 1 else f"{self.ran} runs"
        return f"Simulator: {runs}{each}; {self.asked - self.ran} of {self.asked} results were kept from before."

    def _command(self) -> list[str]:
        """Return the command with its program as a path; refused where there is no such program."""
        name, *rest = self.settings.command
        beside = self.settings.path.resolve().parent / name
        program = str(beside) if os.sep in name and beside.is_file() else shutil.which(name)
        if program is None:
            raise BadInputError(
                f"{self.settings.path}, command: found no program {name!r}; expected one that runs; give its path"
            )
        return [program, *rest]

    def _one(self, command: Sequence[str], job: Job) -> FloatArray:
        begun = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="calib-simulator-", ignore_cleanup_errors=True) as folder:
            parameters, out = Path(folder) / "parameters.json", Path(folder) / "out.csv"
            parameters.write_text(json.dumps(job.parameters), encoding="utf-8")
            paths = (str(self.campaign), str(parameters), str(out))
            arguments = [_filled(part, dict(zip(PLACES, paths, strict=True))) for part in command]
            tail = self._finished(arguments, job)
            try:
                values = read_table(out, self.run_ids)
            except BadTableError as error:
                raise self._failed(job, str(error), tail) from None
        self.cache.put(job.parameters, job.repeat, self.run_ids, values)
        self.seconds.append(time.monotonic() - begun)
        return values

    def _finished(self, arguments: list[str], job: Job) -> bytes:
        """Run the command to its end and return the last of its output."""
        if self._stop.is_set():
            raise _Stopped
        try:
            process = subprocess.Popen(
                arguments,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                cwd=self.settings.path.resolve().parent,
                # a group of its own, so that what it starts ends with it
                start_new_session=True,
            )
        except OSError as error:
            raise self._failed(job, f"found that it cannot be started ({error.strerror})", b"") from error
        kept = bytearray()
        assert process.stdout is not None
        reader = threading.Thread(target=_drain, args=(process.stdout, kept), daemon=True)
        reader.start()
        deadline = time.monotonic() + self.settings.timeout_s
        fault, status = "", None
        while not fault and status is None:
            # its output ends with it, and is waited for asleep; the wait for a process asks again and again
            reader.join(LOOK_S)
            with suppress(subprocess.TimeoutExpired):
                status = process.wait(0.0 if reader.is_alive() else LOOK_S)
            if status is None and time.monotonic() > deadline:
                fault = f"found no end after {self.settings.timeout_s:g} s; expected one, or a larger timeout_s"
            if self._stop.is_set():
                break
        _kill(process)
        reader.join(1.0)
        if status is None and not fault:
            raise _Stopped
        if fault or status != 0:
            raise self._failed(job, fault or f"found exit status {status}; expected 0", bytes(kept))
        return bytes(kept)

    def _failed(self, job: Job, words: str, tail: bytes) -> BadInputError:
        text = tail.decode("utf-8", "replace").strip()
        lines = " | ".join(line.strip() for line in text.splitlines() if line.strip())
        shown = "".join(sign if sign.isprintable() else "?" for sign in lines)[-SHOWN_CHARACTERS:]
        output = f"its output ends: {shown}" if shown else "it printed nothing"
        return BadInputError(f"{self.settings.path}: simulator run with {job.what}: {words}; {output}")


def _filled(part: str, places: dict[str, str]) -> str:
    for place, path in places.items():
        part = part.replace(place, path)
    return part


def _drain(stream: IO[bytes], kept: bytearray) -> None:
    """Read a stream to its end and keep the last of it, so that its writer never waits."""
    with suppress(OSError, ValueError):
        while data := stream.read1(KEPT_BYTES):  # type: ignore[attr-defined]
            kept += data
            del kept[:-KEPT_BYTES]


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End a process and all of its group, whether or not it has ended itself."""
    with suppress(OSError):
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    with suppress(subprocess.TimeoutExpired):
        process.wait(5.0)
