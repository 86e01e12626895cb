"""One table for the documentation: every command against a named reference in the same run, and growth with size.

``python -m tests.benchmarks.table`` prints Markdown. Times are seconds of the processor, children and threads included,
the least of several turns taken with the reference's; a busy machine stretches both.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from calib.campaign import write_campaign
from calib.campaign.model import Campaign
from calib.odometry import integrate
from calib.odometry.poses import Poses
from tests.benchmarks import measured, reading_bag, test_odometry
from tests.benchmarks.large_campaign import in_sessions
from tests.benchmarks.test_diagnosis import campaign_of, of_rows
from tests.benchmarks.test_startup import NEEDED
from tests.fleet.speeds import fleet_in, speeds

SAMPLE = "sample_runs/corridor_crossed"
PANDAS = "import pandas, pathlib; [pandas.read_csv(path) for path in sorted(pathlib.Path({!r}, 'logs').iterdir())]"
#: rows of a log where growth with the number of runs is asked
GROWTH_ROWS = 200
PARTS = ("commands", "reading", "sessions", "odometry", "fleet", "growth")


def spent(arguments: Sequence[str]) -> float:
    """Return the seconds of the processor that a Python process takes."""
    return measured.spent(arguments).cpu_s


def within(work: Callable[[], object]) -> float:
    """Return the seconds of the processor that a call takes in this process."""
    begun = time.process_time()
    work()
    return time.process_time() - begun


def least(turns: int, *works: Callable[[], float]) -> list[float]:
    """Return the least of several turns of each."""
    times = [[work() for work in works] for _ in range(turns)]
    return [min(column) for column in zip(*times, strict=True)]


def say(*cells: str) -> None:
    """Print a row."""
    sys.stdout.write(f"| {' | '.join(cells)} |\n")
    sys.stdout.flush()


def row(what: str, ours: float, reference: str, alone: float) -> None:
    """Print a row of the table of ratios."""
    say(what, f"{ours:.2f}", reference, f"{alone:.2f}", f"{ours / alone:.2f}")


def commands(turns: int, into: Path) -> None:
    """Commands on the sample campaign against the imports that they cannot do without."""
    ours, alone = least(turns, lambda: spent(["-m", "calib", "--help"]), lambda: spent(["-c", "import typer"]))
    row("`calib --help`", ours, "`import typer`", alone)
    for name, further in {
        "check": [],
        "fit": [],
        "geometry": [],
        "diagnose": [],
        "report": ["--into", str(into / "report.pdf"), "--force"],
    }.items():
        row(f"`calib {name}`, 60 runs", *_beside_imports(turns, ["-m", "calib", name, SAMPLE, *further]))


def reading(turns: int, into: Path, made: Campaign) -> None:
    """Logs as text against pandas alone, a bag against rosbags alone."""
    folder = write_campaign(made, into / "logs")
    ours, alone = least(
        turns, lambda: spent(["-m", "calib", "fit", str(folder)]), lambda: spent(["-c", PANDAS.format(str(folder))])
    )
    row(f"`calib fit`, {len(made.runs)} logs of {int(made.logs.offsets[-1])} samples", ours, "`pandas.read_csv`", alone)
    bag = into / "bag"
    reading_bag.make(bag, 32, "joints")
    ways = [reading_bag.WAYS[1], reading_bag.WAYS[0]]
    ours, alone = least(
        turns,
        *(lambda way=way: within(lambda: reading_bag.read(way, bag)) for way in ways),  # type: ignore[misc]
    )
    row("a bag of 32 MB", ours, "rosbags", alone)


def sessions(turns: int, into: Path) -> None:
    """1,020 runs in many sessions and in few, seconds and memory; 160 runs against the imports."""
    made = of_rows(campaign_of(1020), 810)
    few, many = (
        ["-m", "calib", "diagnose", str(write_campaign(in_sessions(made, n), into / f"s{n}"))] for n in (5, 85)
    )
    ours, alone = measured.least(turns, lambda: measured.spent(many), lambda: measured.spent(few))
    row("`calib diagnose`, 1,020 runs of 810 rows in 85 sessions", ours.cpu_s, "in 5 sessions", alone.cpu_s)
    row("the same, MB held", ours.peak_MB, "in 5 sessions", alone.peak_MB)
    command = ["-m", "calib", "diagnose", str(write_campaign(of_rows(campaign_of(160), 600), into / "r160"))]
    row("`calib diagnose`, 160 runs of 600 rows", *_beside_imports(turns, command))


def _beside_imports(turns: int, command: list[str]) -> tuple[float, str, float]:
    """Return the seconds of a command, and those of the imports that it cannot do without."""
    ours, alone = least(turns, lambda: spent(command), lambda: spent(["-c", NEEDED]))
    return ours, "bare imports", alone


def odometry(turns: int, into: Path) -> None:
    """Exact arcs over 4 million samples against a C loop (-O2), with and without machine code."""
    loop = test_odometry.compiled_loop(into)
    if loop is None:
        return
    shape = (4000, 1000)
    left, right = test_odometry.travel(shape)
    out = Poses(np.zeros(shape), np.zeros(shape), np.zeros(shape))
    integrate(left, right, test_odometry.TRACK_M, out=out)
    fast, arrays, alone = least(
        turns,
        lambda: test_odometry.seconds(lambda: integrate(left, right, test_odometry.TRACK_M, out=out)),
        lambda: test_odometry.seconds(lambda: integrate(left, right, test_odometry.TRACK_M, out=out, compiled=False)),
        lambda: test_odometry.seconds(lambda: loop(left, right, out)),
    )
    row("odometry as called by default, 4,000 runs of 1,000 samples (wall)", fast, "C loop", alone)
    row("odometry without the extra `fast` (wall)", arrays, "C loop", alone)


def fleets(turns: int, into: Path, vehicles: int) -> None:
    """A fleet by two workers and through Dask, in wall-clock seconds; see `tests.fleet.speeds`."""
    way = speeds(fleet_in(into, vehicles), into / "out", turns=turns)
    row(f"fleet of {vehicles} vehicles, two workers (wall)", way.two_s, "ideal scaling", 0.5 * way.strangers_s)
    row(f"fleet of {vehicles} vehicles, one worker (wall)", way.one_s, "two workers", way.two_s)
    if way.dask_s is not None:
        row(f"fleet of {vehicles} vehicles through Dask, two workers (wall)", way.dask_s, "two workers", way.two_s)
    say(f"a vehicle of {vehicles}, one worker", f"{way.cpu_s / vehicles:.4f}", "", "", "")


def growth(turns: int, into: Path, sizes: Sequence[int]) -> None:
    """What a further run costs between three numbers of runs; start-up, which is the same in all, falls out."""
    sys.stdout.write("\n")
    steps = [f"ms a run, {low} to {high}" for low, high in pairwise(sizes)]
    say("command", *(f"{size} runs" for size in sizes), *steps, "ratio")
    say("---", *("---:" for _ in range(len(sizes) + len(steps) + 1)))
    folders = [write_campaign(of_rows(campaign_of(size), GROWTH_ROWS), into / f"g{size}") for size in sizes]
    for name in ("check", "fit", "geometry", "diagnose"):
        times = least(
            turns,
            *(lambda command=["-m", "calib", name, str(folder)]: spent(command) for folder in folders),  # type: ignore[misc]
        )
        further = 1e3 * np.diff(times) / np.diff(sizes)
        ratio = f"{further[-1] / further[0]:.2f}"
        say(f"`calib {name}`", *(f"{took:.2f}" for took in times), *(f"{each:.1f}" for each in further), ratio)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--vehicles", type=int, default=2000)
    parser.add_argument("--sizes", type=int, nargs=3, default=(120, 480, 1920))
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        into = Path(place)
        sys.stdout.write(f"Load at the start {os.getloadavg()[0]:.1f}.\n\n")
        say("what", "s", "reference", "s", "ratio")
        say("---", "---:", "---", "---:", "---:")
        if "commands" in given.parts:
            commands(given.turns, into)
        if "reading" in given.parts:
            reading(given.turns, into, of_rows(campaign_of(160), 4000))
        if "sessions" in given.parts:
            sessions(min(given.turns, 3), into)
        if "odometry" in given.parts:
            odometry(given.turns, into)
        if "fleet" in given.parts:
            fleets(min(given.turns, 3), into, given.vehicles)
        if "growth" in given.parts:
            growth(min(given.turns, 2), into, given.sizes)
        sys.stdout.write(f"\nLoad at the end {os.getloadavg()[0]:.1f}.\n")


if __name__ == "__main__":
    main()
