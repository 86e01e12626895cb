"""Kill commands: ``python -m tests.robust.kill --kills 200``.

Every command that writes is killed at random moments, and before each change of a name. What it only computes is
computed once before, so that the kills fall into reading and writing. After each kill each of its outputs is the old
one or the new one, whole; the campaign that it read is untouched and checks as before; the rerun succeeds, and leaves
nothing behind.
"""

from __future__ import annotations

import argparse
import contextlib
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from calib.cli import COMMANDS, function_of
from tests.fuzz.sound import small_campaign
from tests.robust.killing import (
    KILLED,
    ROOT,
    computed_once,
    content,
    ended,
    killed_after,
    killed_at_rename,
    leftovers,
    started,
)

FINE = {0, 1}


@dataclass(frozen=True)
class Job:
    """A command that writes: its arguments, what of it is whole each for itself, and what another run gives first."""

    name: str
    arguments: str
    units: tuple[str, ...]
    earlier: str = ""

    def words(self, text: str = "") -> list[str]:
        """Return the arguments, with the leave to replace."""
        return [*(text or self.arguments).split(), "--force"]


JOBS = (
    Job("fit", "fit lab --into out", ("out",), "fit lab --into out --reference-load 400"),
    Job("export", "export lab --to ros2 --load 400 --output out", ("out",),
        "export lab --to ros2 --load 400 --date 2020-01-01 --output out"),
    Job("export file", "export lab --to json --output c.json", ("c.json",),
        "export lab --to json --date 2020-01-01 --output c.json"),
    Job("ingest", "ingest lab/runs.csv lab/logs --into out --mapping m.toml", ("out",),
        "ingest lab/runs.csv --into out"),
    Job("geometry", "geometry yard --into out --output c.json", ("out", "c.json"),
        "geometry yard2 --into out --output c.json"),
    Job("diagnose", "diagnose yard --apply c.json --into out", ("c.json", "out"),
        "diagnose yard2 --apply c.json --into out"),
    Job("report", "report result --into r.pdf --html r.html --date 2025-01-01", ("r.pdf", "r.html"),
        "report result --into r.pdf --html r.html --date 2024-01-01"),
    Job("fleet", "fleet run vehicles --into out --date 2025-01-01",
        ("out",),
        "fleet run vehicles2 --into out --date 2025-01-01"),
)  # fmt: skip


def prepared(base: Path) -> Path:
    """Make the inputs of all jobs below `base`."""
    small_campaign(base / "lab")
    shutil.copytree(ROOT / "sample_runs" / "yard", base / "yard")
    for name, fewer in (("lab", 1), ("yard", 6)):
        # the same with fewer runs, for an earlier generation
        shutil.copytree(base / name, base / f"{name}2")
        rows = (base / f"{name}2" / "runs.csv").read_text().splitlines()
        (base / f"{name}2" / "runs.csv").write_text("\n".join(rows[:-fewer]) + "\n")
    (base / "m.toml").write_text('name = "anew"\n[table]\nrun_id = "run_id"\ndistance_m = "distance_m"\n')
    for number in range(3):
        small_campaign(base / "vehicles" / f"v{number}")
    shutil.copytree(base / "vehicles" / "v0", base / "vehicles2" / "v0")
    assert ended(started(["fit", "lab", "--into", "result"], base)) in FINE
    return base


class Trial:
    """One job with an old and a new generation of its outputs; for use inside `computed_once` of its arguments."""

    def __init__(self, job: Job, base: Path, kept: Path) -> None:
        self.job, self.base, self.kept = job, base, kept
        begun = time.monotonic()
        self.status = ended(started(job.words(), base))
        self.seconds = time.monotonic() - begun
        assert self.status in FINE, job.name
        self.new = self.state()
        self.inputs = self._inputs()
        self.put_back()
        self.old = self.state()

    def put_back(self) -> None:
        """Put the old generation in its place."""
        for unit in self.tops():
            self.remove(self.base / unit)
            self.copy(self.kept / unit, self.base / unit)

    def tops(self) -> list[str]:
        """Return the outputs as files and folders of their own."""
        return _tops(self.job)

    def state(self) -> list[dict[str, str]]:
        """Return what stands in each output."""
        return [content(self.base / unit) for unit in self.job.units]

    def faults(self, status: int) -> str:
        """Return what is wrong after a kill; then run again, look again, and put the old generation back."""
        after, wrong = self.state(), []
        wrong += [
            f"{unit} is torn"
            for unit, now, old, new in zip(self.job.units, after, self.old, self.new, strict=True)
            if now not in (old, new, {})
        ]
        wrong += [
            f"{unit} is gone" for unit, now, old in zip(self.job.units, after, self.old, strict=True) if old and not now
        ]
        wrong += ["an input was changed"] if self._inputs() != self.inputs else []
        wrong += ["check fails"] if ended(started(["check", "lab"], self.base)) != 0 else []
        if status == 98 or ended(started(self.job.words(), self.base)) != self.status:
            wrong.append("the rerun fails")
        wrong += ["the rerun gives something else"] if self.state() != self.new else []
        wrong += [f"left behind: {leftovers(self.base)}"] if leftovers(self.base) else []
        self.put_back()
        return "; ".join(wrong)

    def _inputs(self) -> list[dict[str, str]]:
        return [content(self.base / name) for name in ("lab", "yard", "vehicles", "result")]

    @staticmethod
    def remove(place: Path) -> None:
        if place.is_dir():
            shutil.rmtree(place)
        else:
            place.unlink(missing_ok=True)

    @staticmethod
    def copy(source: Path, target: Path) -> None:
        if source.is_dir():
            shutil.copytree(source, target)
        elif source.is_file():
            shutil.copy(source, target)


def _tops(job: Job) -> list[str]:
    return list(dict.fromkeys(unit.split("/")[0] for unit in job.units))


@contextlib.contextmanager
def trial_of(job: Job, base: Path) -> Iterator[Trial]:
    """Make the old generation and the new one, and keep what the new one computed for the runs to be killed."""
    kept = base / "kept"
    for place in (kept, *(base / unit for unit in _tops(job))):
        Trial.remove(place)
    kept.mkdir()
    if job.earlier:
        with computed_once(job.words(job.earlier), base) as status:
            assert status in FINE, job.earlier
        for unit in _tops(job):
            (base / unit).rename(kept / unit)
    with computed_once(job.words(), base) as status:
        assert status in FINE, job.name
        if not job.earlier:
            for unit in _tops(job):
                Trial.copy(base / unit, kept / unit)
        yield Trial(job, base, kept)


def before_each_change(trial: Trial) -> Iterator[str]:
    """Kill before each change of a name in turn, until the job ends by itself; yield what is wrong each time."""
    for number in range(200):
        status = killed_at_rename(number, trial.job.words(), trial.base)
        yield trial.faults(status)
        if status != KILLED:
            return


def main() -> int:
    """Kill, look, run again; the status is 1 where something was torn."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", default="", help="names of some jobs alone, separated by commas")
    options = parser.parse_args()
    jobs = [job for job in JOBS if not options.jobs or job.name in options.jobs.split(",")]
    rng, faults, begun = random.Random(options.seed), 0, time.monotonic()
    counted, changes = Counter[str](), 0
    with tempfile.TemporaryDirectory() as folder:
        base = prepared(Path(folder) / "base")
        for name in COMMANDS:
            function_of(name)
        for number, job in enumerate(jobs):
            kills = options.kills // len(jobs) + (number < options.kills % len(jobs))
            with trial_of(job, base) as trial:
                found, ends = list(before_each_change(trial)), Counter[str]()
                changes += len(found) - 1
                for _ in range(kills):
                    status = killed_after(rng.uniform(0.0, 1.1 * trial.seconds), job.words(), base)
                    now = trial.state()
                    which = "new" if now == trial.new else "old" if now == trial.old else "some new, some old"
                    ends[f"{'killed' if status == KILLED else 'ended first'}, {which}"] += 1
                    found.append(trial.faults(status))
            counted += ends
            faults += sum(map(bool, found))
            shown = ", ".join(f"{name}: {count}" for name, count in sorted(ends.items()))
            sys.stdout.write(
                f"{job.name}: {trial.seconds:.1f} s a run, {len(found) - kills - 1} changes of a name; {shown}\n"
            )
            sys.stdout.write("".join(f"  {fault}\n" for fault in found if fault))
            sys.stdout.flush()
    sys.stdout.write(
        f"{sum(counted.values())} random kills {dict(counted)}, and one before each of {changes} changes of a name, in "
        f"{time.monotonic() - begun:.0f} s; {faults} faults\n"
    )
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
