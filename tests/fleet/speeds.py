"""How fast engines are beside one another: ``python -m tests.fleet.speeds --vehicles 2000 FOLDER``.

Makes a fleet in FOLDER where it is not there yet and fits it by one worker, by two, by two processes at once that have
nothing to do with one another (ideal scaling: what this machine gives), and through a Dask scheduler with two fresh
worker processes. Each way begins in a process of its own (`tests.fleet.once` says what its seconds hold), in turns, of
which the least count. Ratios of seconds by the clock mean something on a quiet machine only: the load is printed.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.plant.make import FleetSize, make_fleet

ROOT = Path(__file__).resolve().parents[2]


def say(text: str) -> None:
    """Print a line at once."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def fleet_in(folder: Path, vehicles: int) -> Path:
    """Return the folder of a fleet, made where it is not there yet."""
    fleet = folder / f"fleet{vehicles}"
    if not (fleet / "campaign.toml").is_file():
        size = FleetSize(vehicles, n_months=1, n_outliers=vehicles // 20, n_common=vehicles // 10)
        make_fleet(fleet, np.random.default_rng(5), size)
    return fleet


def at_once(fleet: Path, into: Path, *ways: str) -> list[dict[str, Any]]:
    """Fit the fleet in processes of their own, all at once; each way is options of `tests.fleet.once`."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "tests.fleet.once", str(fleet)]
    running = [
        subprocess.Popen(
            [*command, f"{into}{number}", *way.split()],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env=environment,
        )
        for number, way in enumerate(ways)
    ]
    answers = []
    for process, way in zip(running, ways, strict=True):
        said, complaint = process.communicate()
        if process.returncode:
            raise RuntimeError(f"{way or 'one worker'} ended with {process.returncode}: {complaint[-500:]}")
        answers.append(json.loads(said))
    for number in range(len(ways)):
        shutil.rmtree(f"{into}{number}", ignore_errors=True)
    return answers


@contextmanager
def dask_workers() -> Iterator[Any]:
    """Give a Dask cluster on this machine with two fresh worker processes, which have calib, as a pool's parent has."""
    import distributed

    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        host="127.0.0.1",
        preload=["calib.fleet.run"],
    ) as cluster:
        yield cluster


@dataclass(frozen=True)
class Speeds:
    """Least wall-clock seconds of each way; of the processor by one worker, by two, and by the parent of two.

    `dask_s` is None where Dask was not asked for; `hashes` are those of all results.
    """

    one_s: float
    two_s: float
    strangers_s: float
    dask_s: float | None
    cpu_s: float
    cpu_two_s: float
    parent_s: float
    hashes: frozenset[str]


def speeds(fleet: Path, into: Path, *, turns: int = 3, dask: bool = True) -> Speeds:
    """Fit a fleet in turns by one worker, by two, by two strangers, and through Dask."""
    one, two, strangers, through = [], [], [], []
    for _ in range(turns):
        one += at_once(fleet, into, "")
        two += at_once(fleet, into, "--workers 2")
        strangers.append(at_once(fleet, into, "", ""))
        if dask:
            with dask_workers() as cluster:
                through += at_once(fleet, into, f"--scheduler {cluster.scheduler_address}")
    everything = [*one, *two, *through, *(answer for pair in strangers for answer in pair)]
    return Speeds(
        one_s=min(answer["seconds"] for answer in one),
        two_s=min(answer["seconds"] for answer in two),
        strangers_s=min(max(answer["seconds"] for answer in pair) for pair in strangers),
        dask_s=min((answer["seconds"] for answer in through), default=None),
        cpu_s=min(answer["cpu"] for answer in one),
        cpu_two_s=min(answer["cpu"] for answer in two),
        parent_s=min(answer["parent"] for answer in two),
        hashes=frozenset(answer["sha256"] for answer in everything),
    )


def main() -> None:
    """Measure, and say it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--vehicles", type=int, default=2000)
    parser.add_argument("--turns", type=int, default=3)
    given = parser.parse_args()
    fleet = fleet_in(given.folder, given.vehicles)
    say(f"load {os.getloadavg()[0]:.1f}")
    way = speeds(fleet, given.folder / "out", turns=given.turns)
    say(
        f"one worker {way.one_s:.2f} s, {way.cpu_s:.2f} s of the processor: "
        f"{given.vehicles / way.cpu_s:.0f} vehicles a second of it"
    )
    say(
        f"two workers {way.two_s:.2f} s: {way.one_s / way.two_s:.2f} times one; "
        f"{way.cpu_two_s:.2f} s of the processor, {way.parent_s:.2f} of them the parent's"
    )
    ideal = 2 * way.one_s / way.strangers_s
    say(f"each of two strangers {way.strangers_s:.2f} s: ideal scaling is {ideal:.2f} times on this machine")
    if way.dask_s is not None:
        say(f"Dask, two fresh workers {way.dask_s:.2f} s: {way.two_s / way.dask_s:.2f} of the pool's speed")
    say(f"same bytes: {len(way.hashes) == 1}; load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
