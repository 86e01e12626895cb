"""Runs of the user's simulator, several at once, and what a step off each parameter changes."""

import json
import os
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Final

import numpy as np

from calib.errors import BadInputError
from calib.gap.effects.simulator import SimulatorParameter, WheelMotion, as_simulated
from calib.gap.observations import N_CHANNELS, Channel, Observations
from calib.gap.predict import Path as DrivenPath
from calib.gap.predict import predict
from calib.gap.simulator import PLACES, BadTableError, Declared, RunCache, SimulatorSettings, read_table
from calib.types import FloatArray, Progress

#: bytes of output kept for an error
KEPT_BYTES: Final = 4096
SHOWN_CHARACTERS: Final = 300
RUNS_STAGE: Final = "simulator runs"
#: between looks at a run, and for an interruption
LOOK_S: Final = 0.05


@dataclass(frozen=True, slots=True)
class Job:
    """One run of the simulator."""

    parameters: dict[str, float]
    what: str
    repeat: int = 0


class _Stopped(Exception):
    """Another run failed, or the user interrupted."""


@dataclass(eq=False)
class SimulatorRunner:
    """Runs a simulator on a campaign, at most `workers` at once; kept results are not run again."""

    settings: SimulatorSettings
    campaign: Path
    run_ids: Sequence[str]
    cache: RunCache
    workers: int
    progress: Progress
    asked: int = 0
    ran: int = 0  #: of these, not kept already
    seconds: list[float] = field(default_factory=list)  #: wall time of each run
    _stop: threading.Event = field(default_factory=threading.Event)

    def run(self, jobs: Sequence[Job]) -> list[FloatArray]:
        """Return what each run simulates, (n_runs, 4); an error or interruption ends all."""
        results = [self.cache.get(job.parameters, job.repeat, self.run_ids) for job in jobs]
        todo = [number for number, result in enumerate(results) if result is None]
        self.asked, self.ran = self.asked + len(jobs), self.ran + len(todo)
        command = self._command() if todo else []
        with ThreadPoolExecutor(min(self.workers, max(len(todo), 1))) as pool:
            try:
                waiting = {pool.submit(self._one, command, jobs[number]): number for number in todo}
                while waiting:
                    # not in the futures' own wait, where an interruption leaves locks held
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
        """How often it was to run, and how long that took."""
        each = f", {sum(self.seconds) / len(self.seconds):.2g} s each" if self.seconds else ""
        runs = "1 run" if self.ran == 1 else f"{self.ran} runs"
        return f"Simulator: {runs}{each}; {self.asked - self.ran} of {self.asked} results were kept from before."

    def _command(self) -> list[str]:
        name, *arguments = self.settings.command
        beside = self.settings.path.resolve().parent / name
        program = str(beside) if os.sep in name and beside.is_file() else shutil.which(name)
        if program is None:
            raise BadInputError(
                f"{self.settings.path}, command: found no program {name!r}; expected one that runs; give its path"
            )
        return [program, *arguments]

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
        if self._stop.is_set():
            raise _Stopped
        try:
            process = subprocess.Popen(
                arguments,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                cwd=self.settings.path.resolve().parent,
                # a group, so that what it starts ends with it
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
    with suppress(OSError, ValueError):
        while data := stream.read1(KEPT_BYTES):  # type: ignore[attr-defined]
            kept += data
            del kept[:-KEPT_BYTES]


def _kill(process: subprocess.Popen[bytes]) -> None:
    with suppress(OSError):
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    with suppress(subprocess.TimeoutExpired):
        process.wait(5.0)


#: of an instrument's uncertainty within which a simulator repeats itself
NOISE_SHARE: Final = 0.02
#: runs of a noisy one per set of parameters
REPEATS: Final = 4
#: change by a step, in standard deviations of a noisy run, that shows a signature within 1 %
CLEAR_CHANGE: Final = 60.0
#: largest step over a nominal value that is not zero
NOT_NOTHING: Final = 0.9
_HEADING: Final = 3
#: agreement of a distance with its end point
SAME_DISTANCE_M: Final = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Differences:
    """A simulator about its nominal parameters, as (distance, x, y, heading)."""

    runner: SimulatorRunner
    nominal: FloatArray  #: shape (n_runs, 4): NaN if not predicted
    change: Mapping[str, FloatArray]  #: by parameter, shape (n_runs, 4): per unit, 0 if not predicted
    size: Mapping[str, float]  #: by parameter: deviation over which it was taken
    scatter: FloatArray  #: shape (n_runs, 4): standard deviation of one run; 0 if it repeats itself
    repeats: int  #: runs averaged at each set of parameters
    axis: float | None = None  #: of its distances: 1, along x; 2, straight from the start; None: neither
    met: Mapping[str, float] = field(default_factory=dict)  #: deviations of a run that the changes meet

    @property
    def by_cause(self) -> dict[str, Declared]:
        """The parameters by the id of their cause."""
        return self.runner.settings.by_cause

    def effects(self, nominal: DrivenPath) -> list[SimulatorParameter]:
        """Return the parameters as effects on a path, the model alone."""
        rows, parameters = self.rows(nominal.s), self.runner.settings.parameters
        wheels = WheelMotion(nominal, self.scatter[rows] * np.sqrt(2.0 / self.repeats))
        carried = {}
        for each in parameters:
            both_ways = self.repeats > 1 and not each.parameter.sign and each.name not in self.met
            size = self.size[each.name]
            carried[each.name] = wheels.carried(self.change[each.name][rows] * size, size, both_ways=both_ways)
        if len(self.met) > 1:
            pushes = [carried[name].motion(size) for name, size in self.met.items()]
            moved = (predict(nominal.s, pushes).reading - nominal.reading)[:, :4]
            left = sum((self.change[name][rows] - carried[name].reading) * size for name, size in self.met.items())
            (first, size), *_ = self.met.items()
            missed = np.where(wheels.on, left - moved, 0.0)
            carried[first] = replace(carried[first], reading=carried[first].reading + missed / size)
        return [SimulatorParameter(each.parameter, carried[each.name], each.family) for each in parameters]

    def through(self, deviation: Mapping[str, float], table: FloatArray, typical: Mapping[str, float]) -> "Differences":
        """Return the differences adjusted to meet a run's table, by the least change of derivatives (Broyden 1965)."""
        change = difference(table, self.nominal)
        miss = change - sum((self.change[name] * size for name, size in deviation.items()), np.zeros_like(change))
        square = sum((size / typical[name]) ** 2 for name, size in deviation.items())
        if not square > 0.0:
            return self
        moved = {
            name: self.change[name] + miss * (size / typical[name] ** 2 / square) for name, size in deviation.items()
        }
        sizes = {name: size for name, size in deviation.items() if size != 0.0}
        return replace(self, change={**self.change, **moved}, size={**self.size, **sizes}, met=sizes)

    def simulated(self, measured: Observations) -> Observations:
        """Return observations with what the simulator makes of them, and the noise of both."""
        simulated = np.full((len(measured), N_CHANNELS), np.nan)
        simulated[:, :4] = self.nominal[self.rows(measured)]
        simulated[:, 3] += (
            2 * np.pi * np.nan_to_num(np.round((measured.measured[:, 3] - simulated[:, 3]) / (2 * np.pi)))
        )
        usable = measured.usable & np.isfinite(simulated)
        axis = self.axis
        ahead = np.where(measured.measured[:, Channel.ALONG] < 0.0, -1.0, 1.0) if axis == 1.0 else axis
        noise = self.scatter[self.rows(measured)] / np.sqrt(self.repeats)
        variance = noise**2
        variance[:, 1:3] = variance[:, 1:3].mean(axis=1, keepdims=True)
        observations = replace(
            measured,
            simulated=np.where(usable, simulated, np.nan),
            usable=usable,
            calibration_held=True,
            axis=measured.axis if ahead is None else np.where(measured.axis == 0.0, 0.0, ahead),
            sigma=np.sqrt(measured.sigma**2 + variance),
        )
        return as_simulated(observations, noise)

    def rows(self, observations: Observations) -> list[int]:
        """Return the row of each observation in the tables."""
        number = {run_id: row for row, run_id in enumerate(self.runner.run_ids)}
        return [number[str(run)] for run in observations.labels["run_id"]]


def difference(later: FloatArray, earlier: FloatArray) -> FloatArray:
    """Return the difference of tables (n_runs, 4), 0 if not predicted."""
    apart = later - earlier
    apart[:, _HEADING] = (apart[:, _HEADING] + np.pi) % (2 * np.pi) - np.pi
    return np.nan_to_num(apart)


def averaged(tables: list[FloatArray]) -> FloatArray:
    """Return the mean of tables (n_runs, 4)."""
    first = tables[0]
    return first + sum((difference(table, first) for table in tables), np.zeros_like(first)) / len(tables)


def differences_of(runner: SimulatorRunner, sigma: FloatArray) -> Differences:
    """Run a simulator at nominal parameters, and with each a step off; `sigma` (4,): uncertainties."""
    settings = runner.settings
    steps = {each.name: each.step for each in settings.parameters}
    jobs = [Job(settings.nominal, "the nominal parameters"), *(_off(settings, *step) for step in steps.items())]
    tables = runner.run(jobs)
    nominal = tables[0]
    again = nominal if _repeats(tables, sigma) else runner.run([replace(jobs[0], repeat=1)])[0]
    scatter = np.sqrt(0.5 * np.mean(difference(again, nominal) ** 2, axis=0))
    if (scatter > NOISE_SHARE * sigma).any():
        known = dict(zip(steps.items(), tables[1:], strict=True))
        return _averaged(runner, jobs[0], [nominal, again], known, scatter)
    change = {name: difference(table, nominal) / steps[name] for name, table in zip(steps, tables[1:], strict=True)}
    # what is flat about nominal may act further off
    idle = [each for each in settings.parameters if not change[each.name].any()]
    nothing = np.zeros_like(nominal)
    far = [(each.name, way * _clear_step(each, nothing, nothing)) for each in idle for way in (-1, 1)[abs(each.sign) :]]
    for (name, size), table in zip(far, runner.run([_off(settings, *step) for step in far]), strict=True):
        if (moved := difference(table, nominal) / size).any():
            change[name], steps[name] = moved, size
    return Differences(runner, nominal, change, steps, nothing, 1, _distance_axis(tables))


def _averaged(
    runner: SimulatorRunner,
    nominal: Job,
    at_nominal: Sequence[FloatArray],
    known: Mapping[tuple[str, float], FloatArray],
    scatter: FloatArray,
) -> Differences:
    settings, sets = runner.settings, {("", 0.0): list(at_nominal)}
    size = dict[str, float]()
    for each in settings.parameters:
        first = known[each.name, each.step]
        size[each.name] = step = _clear_step(each, difference(first, at_nominal[0]), scatter)
        sets[each.name, step] = [first] if step == each.step else []
        if not each.parameter.sign:
            sets[each.name, -step] = []
    counts = {at: REPEATS // sum(of == at[0] for of, _ in sets) for at in sets}
    jobs = [
        replace(_off(settings, *at) if at[0] else nominal, repeat=number)
        for at, tables in sets.items()
        for number in range(len(tables), counts[at])
    ]
    results = iter(runner.run(jobs))
    for at, tables in sets.items():
        tables += [next(results) for _ in range(len(tables), counts[at])]
    within = np.stack([difference(table, averaged(tables)) for tables in sets.values() for table in tables])
    # less two, so that a square over it is 1 on average
    scatter = np.sqrt(np.sum(within**2, axis=0) / (len(within) - len(sets) - 2))
    means = {at: averaged(tables) for at, tables in sets.items()}
    middle = means["", 0.0]
    change = {}
    for name in size:
        sides = [difference(table, middle) / step for (of, step), table in means.items() if of == name]
        change[name] = np.mean(sides, axis=0)
    return Differences(runner, middle, change, size, scatter, REPEATS, _distance_axis(list(means.values())))


def _repeats(tables: Sequence[FloatArray], sigma: FloatArray) -> bool:
    for written, limit in zip(np.moveaxis(np.stack(tables), 2, 0), NOISE_SHARE * sigma, strict=True):
        if not np.isnan(written).all():
            coarse = np.array_equal(written, np.round(written, int(-np.log10(limit))))
            if coarse or not (written[1:] == written[0]).any(axis=0).all():
                return False
    return True


def _off(settings: SimulatorSettings, name: str, step: float) -> Job:
    value = settings.nominal[name] + step
    return Job(settings.nominal | {name: value}, f"{name} = {value:g}")


def _clear_step(each: Declared, change: FloatArray, scatter: FloatArray) -> float:
    square = np.maximum(np.mean(change**2, axis=0) - 2.0 * scatter**2, 0.0)
    shown = float(np.max(np.sqrt(square / np.where(scatter > 0.0, scatter, np.inf) ** 2)))
    # to either side, a length not to nothing
    most = max(min(each.largest, NOT_NOTHING * abs(each.nominal) or np.inf) / abs(each.step), 1.0)
    return each.step * min(max(CLEAR_CHANGE / shown, 1.0) if shown > 0.0 else most, most)


def _distance_axis(tables: list[FloatArray]) -> float | None:
    distance, x, y, _ = np.concatenate(tables).T
    known = np.isfinite(distance + x + y)
    if not known.any():
        return None
    off = [float(np.abs(distance - one)[known].max()) for one in (np.abs(x), np.hypot(x, y))]
    best = int(np.argmin(off))
    return best + 1.0 if off[best] < SAME_DISTANCE_M else None
