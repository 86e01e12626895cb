"""Run a command in a process that kills itself before its n-th change of a name, or is killed after some time."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

#: patches every way in which calib gives a file or a folder its name; the n-th call kills the process first
_DRIVER = """
import os, signal, sys
import calib.folders
from calib.cli.main import run
left = [int(sys.argv[1])]
def deadly(function):
    def call(*args, **kwargs):
        left[0] -= 1
        if left[0] < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*args, **kwargs)
    return call
for name in ("rename", "replace", "link"):
    setattr(os, name, deadly(getattr(os, name)))
calib.folders._exchange = deadly(calib.folders._exchange)
status = run(sys.argv[2:])
print(left[0], file=sys.stderr)
sys.exit(status)
"""
ROOT = Path(__file__).resolve().parents[2]
KILLED = -signal.SIGKILL


def _environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1"}


def killed_at_rename(number: int, arguments: list[str], cwd: Path) -> int:
    """Return the status of a command that is killed before its change of a name number `number`, from 0."""
    done = subprocess.run(
        [sys.executable, "-c", _DRIVER, str(number), *arguments],
        check=False,
        cwd=cwd,
        env=_environment(),
        capture_output=True,
    )
    return done.returncode


def killed_after(seconds: float, arguments: list[str], cwd: Path) -> int:
    """Return the status of a command that is killed after so many seconds, if it has not ended before."""
    process = subprocess.Popen(
        [sys.executable, "-m", "calib", *arguments],
        cwd=cwd,
        env=_environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    time.sleep(seconds)
    process.kill()
    return process.wait()


def content(folder: Path) -> dict[str, str]:
    """Return the hash of every file below a folder by its path; what a killed writer left under its own name aside."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not any(part.startswith(".calib-") for part in path.relative_to(folder).parts)
    }


def leftovers(folder: Path) -> list[str]:
    """Return what killed writers left below a folder."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob(".calib-*"))
