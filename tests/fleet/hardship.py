"""What befalls engines changes no byte: ``python -m tests.fleet.hardship --vehicles 2000 FOLDER``.

One worker, two, files in a drawn order, Dask; then a worker killed in the middle (the pool's, Dask's), and the command
killed (by the signal that it cannot catch) and run again. Makes a fleet in FOLDER where it is not there yet; exit
status 1 where one result differs. Nothing here depends on how busy the machine is; `tests.fleet.speeds` measures.
"""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from calib.documents import to_json
from calib.fleet import run
from calib.fleet.run import fit_fleet
from calib.fleet.store import SUMS
from calib.fleet.workers import Engine
from tests.fleet.speeds import ROOT, at_once, dask_workers, fleet_in, say

#: files done before something is killed: some, and far from all
SOME = 20


class Shuffled:
    """Hands items out one by one in a drawn order."""

    def run(self, task: Any, items: Sequence[Any], given_up: Any, _weigh: Any = None) -> Iterator[Any]:
        """Run all of them."""
        order = np.random.default_rng(6).permutation(len(items))
        return Engine().run(task, [items[k] for k in order], given_up)


def hash_of(folder: Path, into: Path, **options: Any) -> str:
    """Fit a fleet afresh in this process and return the hash of its result."""
    shutil.rmtree(into, ignore_errors=True)
    return hashlib.sha256(to_json(fit_fleet(folder, into, **options).to_dict()).encode()).hexdigest()


def lines_in(path: Path) -> int:
    """Return how many files' sums are kept."""
    return path.read_bytes().count(b"\n") if path.is_file() else 0


@contextmanager
def killing(sums: Path, victim: Callable[[], int]) -> Iterator[list[int]]:
    """Kill a process once some files are done; give a list that then holds how many."""
    done: list[int] = []
    over = threading.Event()

    def kill() -> None:
        while not over.is_set() and lines_in(sums) < SOME:
            time.sleep(0.01)
        if not over.is_set():
            done.append(lines_in(sums))
            os.kill(victim(), signal.SIGKILL)

    sums.unlink(missing_ok=True)
    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    try:
        yield done
    finally:
        over.set()
        killer.join()


def pool_killed(fleet: Path, into: Path) -> str:
    """Kill one of the pool's workers in the middle."""
    with killing(into / SUMS, lambda: multiprocessing.active_children()[0].pid or 0) as done:
        answer = hash_of(fleet, into, workers=2)
    say(f"  a worker of the pool was killed when {done} files were done")
    return answer if done else "nothing was killed"


def dask_killed(fleet: Path, into: Path) -> str:
    """Kill one of Dask's workers in the middle."""
    with (
        dask_workers() as cluster,
        killing(into / SUMS, lambda: next(iter(cluster.workers.values())).process.pid) as done,
    ):
        answer = hash_of(fleet, into, scheduler=cluster.scheduler_address)
    say(f"  a worker of Dask was killed when {done} files were done")
    return answer if done else "nothing was killed"


def shuffled(fleet: Path, into: Path) -> str:
    """Hand the files out in a drawn order."""
    with mock.patch.object(run, "engine", lambda *_: nullcontext(Shuffled())):
        return hash_of(fleet, into)


def through_dask(fleet: Path, into: Path) -> str:
    """Fit through a scheduler with two worker processes."""
    with dask_workers() as cluster:
        return str(at_once(fleet, into, f"--scheduler {cluster.scheduler_address}")[0]["sha256"])


def command_killed(fleet: Path, into: Path) -> str:
    """Kill the command and its workers when a third is done, run it again, and return the hash of what it wrote."""
    shutil.rmtree(into, ignore_errors=True)
    n_files = sum(1 for _ in fleet.rglob("*.parquet"))
    command = [sys.executable, "-m", "calib", "fleet", "run", str(fleet), "--into", str(into), "--date", "2026-01-31"]
    process = subprocess.Popen(
        [*command, "--workers", "2"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        cwd=ROOT,
    )
    while process.poll() is None and lines_in(into / SUMS) < n_files // 3:
        time.sleep(0.01)
    if process.poll() is not None:
        return f"the command ended before it was killed: {process.returncode}"
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    say(f"  the command was killed with {lines_in(into / SUMS)} of {n_files} files done")
    again = subprocess.run([*command, "--workers", "2"], capture_output=True, text=True, check=False, cwd=ROOT)
    if again.returncode:
        return f"the second run ended with {again.returncode}: {again.stderr[-300:]}"
    say("  " + next(line.strip() for line in again.stdout.splitlines() if "read now" in line))
    return hashlib.sha256((into / "fleet.json").read_bytes()).hexdigest()


HARDSHIPS: dict[str, Callable[[Path, Path], str]] = {
    "two workers": lambda fleet, into: str(at_once(fleet, into, "--workers 2")[0]["sha256"]),
    "files in a drawn order": shuffled,
    "Dask, two workers": through_dask,
    "a worker of the pool killed": pool_killed,
    "a worker of Dask killed": dask_killed,
    "the command killed and run again": command_killed,
}


def main() -> None:
    """Do it all, say what came of it, and end with 1 where a result differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--vehicles", type=int, default=2000)
    given = parser.parse_args()
    fleet, into = fleet_in(given.folder, given.vehicles), given.folder / "out"
    alone = at_once(fleet, into, "")[0]["sha256"]
    say(f"one worker: {alone[:16]}")
    wrong = 0
    for what, work in HARDSHIPS.items():
        answer = work(fleet, into)
        wrong += answer != alone
        say(f"{what}: " + ("the same bytes" if answer == alone else f"NOT the same bytes: {answer[:300]}"))
    sys.exit(int(wrong > 0))


if __name__ == "__main__":
    main()
