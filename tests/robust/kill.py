"""Kill commands at random moments: ``python -m tests.robust.kill --kills 200``.

After each kill the output is the old generation or the new one, whole; then the rerun succeeds and no leftovers stay.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from calib.cli.main import run
from tests.robust.killing import KILLED, ROOT, content, killed_after, leftovers

#: job -> arguments; the output is ``out``
JOBS = {
    "fit": ["fit", "lab", "--into", "out", "--reference-load", "400"],
    "export": ["export", "lab", "--to", "ros2", "--load", "300", "--output", "out"],
    "ingest": ["ingest", "lab/runs.csv", "lab/logs", "--into", "out"],
}


def _quietly(arguments: list[str], base: Path) -> int:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()), contextlib.chdir(base):
        return run(arguments)


def main() -> int:
    """Kill, look, run again; the status is 1 where something was torn."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng, counted, torn = random.Random(options.seed), Counter[str](), 0
    for name, arguments in JOBS.items():
        with tempfile.TemporaryDirectory() as folder:
            base = Path(folder)
            shutil.copytree(ROOT / "sample_runs" / "corridor", base / "lab")
            job = [*arguments, "--force"]
            _quietly(job, base)
            new = content(base / "out")
            # the old generation: the same files with other content
            started = time.monotonic()
            for _ in range(options.kills // len(JOBS)):
                for path in (base / "out").rglob("*"):
                    if path.is_file():
                        path.write_bytes(path.read_bytes() + b"\n")
                old = content(base / "out")
                status = killed_after(rng.uniform(0.1, 4.0), job, base)
                counted["killed" if status == KILLED else "ended first"] += 1
                after = content(base / "out")
                whole = after in (old, new)
                counted["new" if after == new else "old" if after == old else "TORN"] += 1
                rerun = _quietly(job, base)
                fine = whole and rerun in {0, 1} and content(base / "out") == new and not leftovers(base)
                torn += not fine
                if not fine:
                    sys.stdout.write(f"{name}: whole {whole}, rerun {rerun}, leftovers {leftovers(base)}\n")
            sys.stdout.write(f"{name}: {time.monotonic() - started:.0f} s\n")
    sys.stdout.write(f"{dict(counted)}; {torn} faults\n")
    return int(torn > 0)


if __name__ == "__main__":
    sys.exit(main())
