"""Seconds of the processor and memory of Python processes that take turns."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
#: a small process starts the command: a process begins with the most memory that the one had which started it
_BETWEEN = (
    "import os, sys; quiet = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)]; "
    "child = os.posix_spawn(sys.executable, [sys.executable, *sys.argv[1:]], os.environ, file_actions=quiet); "
    "_, status, used = os.wait4(child, 0); "
    "print(os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3)"
)


@dataclass(frozen=True)
class Spent:
    """What a process took."""

    cpu_s: float  #: of user and system
    peak_MB: float  #: most memory held


def spent(arguments: Sequence[str]) -> Spent:
    """Run a Python process, and return what it took; one thread."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    # what is compiled is kept, as that of an installed tool is
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    command = [sys.executable, "-S", "-c", _BETWEEN, *arguments]
    process = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment, check=False)
    status, cpu_s, peak_MB = process.stdout.split()
    if int(status) not in (0, 1) or process.stderr.startswith("Traceback"):
        raise RuntimeError(f"{' '.join(arguments)}: {process.stderr[-300:]}")
    return Spent(float(cpu_s), float(peak_MB))


def least(
    turns: int, *works: Callable[[], Spent], enough: Callable[[list[Spent]], bool] = lambda _: False
) -> list[Spent]:
    """Return the least of several turns of each; no more turns than until it is `enough`."""
    found: list[Spent] = []
    for _ in range(turns):
        taken = [work() for work in works]
        found = [
            Spent(min(one.cpu_s, now.cpu_s), min(one.peak_MB, now.peak_MB))
            for one, now in zip(found or taken, taken, strict=True)
        ]
        if enough(found):
            break
    return found
