"""Odd files, options and environments for every command: ``python -m tests.robust.attacks [PART...] [--seconds 60]``.

Each attack spoils a copy of sound inputs in one way and runs one command in a forked process of its own. A fault is: an
exit status other than 0, 1 or 2 (141 where nobody reads), a traceback, more than one line beside notes, a wait beyond
the limit, an input that has changed, JSON that is none. It prints how many were tried and how many held.
"""

from __future__ import annotations

import argparse
import contextlib
import fnmatch
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.robust import ending
from tests.robust.attack import Attack, fault_of, made
from tests.robust.attacks_on_commands import choices, fleets, simulators, surroundings
from tests.robust.attacks_on_files import documents, formats, logs, settings, tables

PARTS: dict[str, Callable[[], Iterator[Attack]]] = {
    "settings": settings,
    "tables": tables,
    "logs": logs,
    "formats": formats,
    "choices": choices,
    "fleets": fleets,
    "documents": documents,
    "simulators": simulators,
    "surroundings": surroundings,
}
#: so many times the processor time may pass by the clock: a busy machine is no hang
BUSY = 15.0


def chosen(part: str, shard: str = "1/1", only: str = "*") -> list[Attack]:
    """Return the i-th of n parts (``i/n``) of a part's attacks whose name or words match a glob."""
    number, parts = (int(text) for text in shard.split("/"))
    if not 1 <= number <= parts:
        raise ValueError(f"--shard {shard}: expected i/n with i from 1 to n")
    matching = [a for a in PARTS[part]() if any(fnmatch.fnmatchcase(t, only) for t in (a.name, " ".join(a.words)))]
    return matching[number - 1 :: parts]


def main() -> int:
    """Try the attacks of some parts, or all, and print each fault; the status is 1 where there is one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="all by default")
    parser.add_argument("--seconds", type=float, default=60.0, help="processor time that a command may take")
    parser.add_argument("--shard", default="1/1", metavar="I/N", help="only the I-th of N parts")
    parser.add_argument("--only", default="*", metavar="GLOB", help="only attacks whose name or words match")
    asked = parser.parse_args()
    tried, faults, ending.LONGEST_S = 0, 0, BUSY * asked.seconds
    with tempfile.TemporaryDirectory() as folder:
        with contextlib.redirect_stdout(sys.stderr):
            base = made(Path(folder) / "base")
        for part in asked.parts or PARTS:
            attacks = chosen(part, asked.shard, asked.only)
            for attack in attacks:
                fault = fault_of(attack, base, asked.seconds)
                if fault:
                    faults += 1
                    sys.stdout.write(f"  {part}: {attack.name!r}: {' '.join(attack.words)[:120]!r}: {fault}\n")
                    sys.stdout.flush()
            tried += len(attacks)
            sys.stdout.write(f"{part}: {len(attacks)} attacks\n")
            sys.stdout.flush()
    sys.stdout.write(f"{tried} tried, {tried - faults} held\n")
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
