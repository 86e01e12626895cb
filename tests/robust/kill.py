"""Kill commands: ``python -m tests.robust.kill --kills 200``.

Every command that writes is killed at random moments, and before each change of a name. After each kill each of its
outputs is the old one or the new one, whole; the campaign that it read is untouched and checks as before; the rerun
succeeds, and leaves nothing behind.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from calib.cli.main import COMMANDS
from tests.fuzz.sound import small_campaign
from tests.robust.killing import KILLED, ROOT, content, ended, killed_after, killed_at_rename, leftovers, started

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
    Job("fleet", "fleet run vehicles --into out", ("out/fleet.json", "out/vehicles.csv")),
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
    assert ended(started(["fit", "lab", "--into", "result"], base)) in FINE
    return base


def imported(base: Path) -> None:
    """Import what the jobs import, so that their copies of this process need not; nothing of it is called here."""
    names = base / "modules.json"
    code = "import json, sys; from calib.cli.main import run; [run(job) for job in json.load(sys.stdin)]; "

    done = subprocess.run(
        [sys.executable, "-c", f"{code}open({str(names)!r}, 'w').write(json.dumps(sorted(sys.modules)))"],
        input=json.dumps([job.words() for job in JOBS]),
        text=True,
        cwd=base,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(done.stderr[-500:])
    for name in (*json.loads(names.read_text()), *(f"calib.cli.{module}" for module in COMMANDS.values())):
        if name.partition(".")[0] != "__main__":
            with contextlib.suppress(ImportError):
                importlib.import_module(name)


class Trial:
    """One job with an old and a new generation of its outputs."""

    def __init__(self, job: Job, base: Path) -> None:
        self.job, self.base = job, base
        for unit in ("out", *job.units):
            self._remove(base / unit)
        begun = time.monotonic()
        self.status = ended(started(job.words(), base))
        self.seconds = time.monotonic() - begun
        self.new = self.state()
        if job.earlier:
            assert ended(started(job.words(job.earlier), base)) in FINE, job.earlier
        self.old = self.state()
        self.kept = base / "kept"
        self._remove(self.kept)
        self.kept.mkdir()
        for unit in self.tops():
            self._copy(base / unit, self.kept / unit)
        self.inputs = self._inputs()

    def tops(self) -> list[str]:
        """Return the outputs as files and folders of their own."""
        return list(dict.fromkeys(unit.split("/")[0] for unit in self.job.units))

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
        for unit in self.tops():
            self._remove(self.base / unit)
            self._copy(self.kept / unit, self.base / unit)
        return "; ".join(wrong)

    def _inputs(self) -> list[dict[str, str]]:
        return [content(self.base / name) for name in ("lab", "yard", "vehicles", "result")]

    @staticmethod
    def _remove(place: Path) -> None:
        if place.is_dir():
            shutil.rmtree(place)
        else:
            place.unlink(missing_ok=True)

    @staticmethod
    def _copy(source: Path, target: Path) -> None:
        if source.is_dir():
            shutil.copytree(source, target)
        elif source.is_file():
            shutil.copy(source, target)


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
        imported(base)
        for number, job in enumerate(jobs):
            trial = Trial(job, base)
            found = list(before_each_change(trial))
            changes += len(found) - 1
            kills = options.kills // len(jobs) + (number < options.kills % len(jobs))
            ends: Counter[str] = Counter()
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
