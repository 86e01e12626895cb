"""Fuzz every file format and option: ``python -m tests.fuzz.run --inputs 100000``."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.fuzz.inputs import outcomes, prepared


def main() -> int:
    """Run the inputs, print every fault with its number, and a summary; the status is 1 where there is a fault."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after so many seconds")
    options = parser.parse_args()
    started, statuses, faults, done, longest = time.monotonic(), Counter[str](), 0, 0, 0.0
    with tempfile.TemporaryDirectory() as folder:
        for number, outcome in outcomes(prepared(Path(folder) / "base"), options.inputs, options.seed):
            done += 1
            statuses[str(outcome.status)[:40]] += 1
            longest = max(longest, outcome.seconds)
            if outcome.fault:
                faults += 1
                sys.stdout.write(f"input {number}: {' '.join(outcome.arguments)[:300]!r}: {outcome.fault}\n")
                sys.stdout.flush()
            if time.monotonic() - started > options.seconds:
                break
    counted = ", ".join(f"{status}: {count}" for status, count in sorted(statuses.items()))
    sys.stdout.write(
        f"{done} inputs (seed {options.seed}) in {time.monotonic() - started:.0f} s; exit {counted}; the longest took "
        f"{longest:.1f} s; {faults} faults\n"
    )
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
