"""Engines side by side, and what befalls them: a command killed and resumed, workers killed in the middle.

``python -m tests.fleet.hardship --vehicles 2000 FOLDER`` makes a fleet in FOLDER where it is not there yet. Ratios of
wall-clock seconds mean something on a quiet machine only; the load is printed beside them, and what two processes that
have nothing to do with one another reach on this machine: ideal scaling. One worker, two, and the two strangers each
begin in a process of their own, three times in turns, of which the least count.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.files import to_json
from calib.fleet.run import Fleet, fit_fleet
from calib.fleet.store import SUMS
from calib.plant.fleet import FleetSize, make_fleet

ROOT = Path(__file__).resolve().parents[2]
TURNS = 3


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _timed(what: str, work: Callable[[], str]) -> tuple[str, float]:
    load, begun, cpu = os.getloadavg()[0], time.perf_counter(), time.process_time()
    answer = work()
    took = time.perf_counter() - begun
    _say(f"{what}: {took:.2f} s ({time.process_time() - cpu:.2f} s of this process), load {load:.1f}")
    return answer, took


def _fit(folder: Path, into: Path, **options: object) -> str:
    shutil.rmtree(into, ignore_errors=True)
    return _hash(fit_fleet(folder, into, **options))  # type: ignore[arg-type]


def _hash(fleet: Fleet) -> str:
    return hashlib.sha256(to_json(fleet.to_dict()).encode()).hexdigest()


def at_once(folder: Path, into: Path, *workers: int) -> list[dict[str, Any]]:
    """Fit the fleet in processes of their own, all at once; see `tests.fleet.once`."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "tests.fleet.once", str(folder)]
    running = [
        subprocess.Popen(
            [*command, f"{into}{number}", "--workers", str(n)], stdout=subprocess.PIPE, cwd=ROOT, env=environment
        )
        for number, n in enumerate(workers)
    ]
    answers: list[dict[str, Any]] = [json.loads(process.communicate()[0]) for process in running]
    for number in range(len(workers)):
        shutil.rmtree(f"{into}{number}", ignore_errors=True)
    return answers


@dataclass(frozen=True)
class Scaling:
    """Least wall-clock seconds of one worker, of two, and of two processes at once that share nothing.

    `cpu_s` and `cpu_two_s` are seconds of the processor by one and by two workers, `hashes` those of all results.
    """

    one_s: float
    two_s: float
    strangers_s: float
    cpu_s: float
    cpu_two_s: float
    hashes: frozenset[str]


def scaling(folder: Path, into: Path) -> Scaling:
    """Fit a fleet in turns by one worker, by two, and by two strangers."""
    turns = [(at_once(folder, into, 1), at_once(folder, into, 2), at_once(folder, into, 1, 1)) for _ in range(TURNS)]
    one, two, strangers = (min(max(answer["seconds"] for answer in turn[way]) for turn in turns) for way in range(3))
    cpu, cpu_two = (min(turn[way][0]["cpu"] for turn in turns) for way in range(2))
    hashes = frozenset(answer["sha256"] for turn in turns for answers in turn for answer in answers)
    return Scaling(one, two, strangers, cpu, cpu_two, hashes)


def say_scaling(way: Scaling, vehicles: int) -> None:
    """Say what two workers gain, and what two strangers do."""
    rate = vehicles / way.cpu_s
    _say(f"one worker {way.one_s:.2f} s, {way.cpu_s:.2f} s of the processor: {rate:.0f} vehicles a second of it")
    _say(
        f"two workers {way.two_s:.2f} s, {way.cpu_two_s:.2f} s of the processor: {way.one_s / way.two_s:.2f} times one"
    )
    ideal = 2 * way.one_s / way.strangers_s
    _say(f"  each of two strangers {way.strangers_s:.2f} s: ideal scaling is {ideal:.2f} times on this machine")
    _say(f"  two workers reach {way.strangers_s / (2 * way.two_s):.2f} of it; same bytes: {len(way.hashes) == 1}")


def _lines(path: Path) -> int:
    return path.read_bytes().count(b"\n") if path.is_file() else 0


def killed_command(folder: Path, into: Path, n_files: int) -> bytes:
    """Kill the command (no signal that it could catch) when a third is done, run it again, and return its result."""
    shutil.rmtree(into, ignore_errors=True)
    command = [sys.executable, "-m", "calib", "fleet", "run", str(folder), "--into", str(into), "--date", "2026-01-31"]
    process = subprocess.Popen([*command, "--workers", "2"], stdout=subprocess.DEVNULL, start_new_session=True)
    while process.poll() is None and _lines(into / SUMS) < n_files // 3:
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    _say(f"killed with {_lines(into / SUMS)} of {n_files} files done")
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    _say(next(line.strip() for line in done.stdout.splitlines() if "read now" in line))
    return (into / "fleet.json").read_bytes()


def killed_worker(folder: Path, into: Path) -> str:
    """Kill one of the pool's workers once some files are done."""

    def kill() -> None:
        while _lines(into / SUMS) < 20:
            time.sleep(0.01)
        worker = multiprocessing.active_children()[0]
        _say(f"worker killed after {_lines(into / SUMS)} files")
        os.kill(worker.pid or 0, signal.SIGKILL)

    shutil.rmtree(into, ignore_errors=True)
    killer = threading.Thread(target=kill)
    killer.start()
    answer = _fit(folder, into, workers=2)
    killer.join()
    return answer


def main() -> None:
    """Run it all and say what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--vehicles", type=int, default=2000)
    given = parser.parse_args()
    fleet, into = given.folder / f"fleet{given.vehicles}", given.folder / "out"
    if not (fleet / "campaign.toml").is_file():
        size = FleetSize(given.vehicles, n_months=1, n_outliers=given.vehicles // 20, n_common=given.vehicles // 10)
        make_fleet(fleet, np.random.default_rng(5), size)
    n_files = sum(1 for _ in fleet.rglob("*.parquet"))
    _say(f"load {os.getloadavg()[0]:.1f}")
    way = scaling(fleet, into)
    say_scaling(way, given.vehicles)
    alone, two = min(way.hashes), way.two_s
    import distributed

    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        address = cluster.scheduler_address
        for when in ("fresh", *["used"] * (TURNS - 1)):
            shared, dask = _timed(f"Dask, two {when} workers", lambda: _fit(fleet, into, scheduler=address))
            _say(f"  Dask is {two / dask:.2f} of the pool's speed; same bytes: {shared == alone}")

        def kill() -> None:
            while _lines(into / SUMS) < 20:
                time.sleep(0.01)
            os.kill(next(iter(cluster.workers.values())).process.pid, signal.SIGKILL)

        shutil.rmtree(into, ignore_errors=True)
        killer = threading.Thread(target=kill)
        killer.start()
        _say(f"Dask, a worker killed: same bytes: {_fit(fleet, into, scheduler=address) == alone}")
        killer.join()
    _say(f"a pool's worker killed: same bytes: {killed_worker(fleet, into) == alone}")
    resumed = killed_command(fleet, into, n_files)
    _say(f"command killed and run again: same result: {hashlib.sha256(resumed).hexdigest() == alone}")


if __name__ == "__main__":
    main()
