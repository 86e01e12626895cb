"""Fuzz every file format and option: ``python -m tests.fuzz.run --inputs 100000``.

The inputs run in one process, which is renewed after some thousands, and where one of them has killed it.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import os
import resource
import select
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.fuzz.inputs import AIMS, outcomes
from tests.fuzz.sound import prepared

#: inputs of one process, memory that it may take, and seconds without an answer after which it hangs
OF_A_PROCESS, MEMORY_BYTES, SILENT_S = 5000, 8 << 30, 120.0


def answers(base: Path, first: int, count: int, seed: int, aim: str) -> Iterator[dict[str, Any]]:
    """Yield what another process answers to some inputs; where it dies, that is the answer to the last of them."""
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        os.close(reading)
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
        with os.fdopen(writing, "w") as out:
            faulthandler.dump_traceback_later(0.8 * SILENT_S)
            for number, answered, fault in outcomes(base, count, seed, first, aim):
                record = {"number": number, "status": str(answered.status)[:40], "seconds": answered.seconds}
                if fault:
                    record |= {"fault": fault, "arguments": " ".join(answered.arguments)[:300]}
                out.write(json.dumps(record) + "\n")
                out.flush()
                faulthandler.dump_traceback_later(0.8 * SILENT_S)
        os._exit(0)
    os.close(writing)
    pending, number, ended = b"", first, ""
    while number < first + count and not ended:
        if not select.select([reading], [], [], SILENT_S)[0]:
            os.kill(child, signal.SIGKILL)
            ended = "hangs"
        elif not (block := os.read(reading, 1 << 16)):
            ended = "the process died"
        else:
            *lines, pending = (pending + block).split(b"\n")
            for line in lines:
                number += 1
                yield json.loads(line)
    os.close(reading)
    _, status = os.waitpid(child, 0)
    if ended:
        yield {"number": number, "status": ended, "seconds": 0.0, "fault": f"{ended} ({status})", "arguments": "?"}


def main() -> int:
    """Run the inputs, print every fault with its number, and a summary; the status is 1 where there is a fault."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--aim", choices=sorted(AIMS), default="all", help="all, or numbers alone")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="begin no process after so many seconds")
    options = parser.parse_args()
    started, statuses, faults, longest = time.monotonic(), Counter[str](), 0, 0.0
    number, end = options.first, options.first + options.inputs
    with tempfile.TemporaryDirectory() as folder:
        base = prepared(Path(folder) / "base")
        while number < end and time.monotonic() - started < options.seconds:
            for record in answers(base, number, min(OF_A_PROCESS, end - number), options.seed, options.aim):
                number = record["number"] + 1
                statuses[record["status"]] += 1
                longest = max(longest, record["seconds"])
                if "fault" in record:
                    faults += 1
                    sys.stdout.write(f"input {record['number']}: {record['arguments']!r}: {record['fault']}\n")
            sys.stdout.write(f"{number} after {time.monotonic() - started:.0f} s\n")
            sys.stdout.flush()
    counted = ", ".join(f"{status}: {count}" for status, count in sorted(statuses.items()))
    sys.stdout.write(
        f"{number - options.first} inputs (seed {options.seed}) in {time.monotonic() - started:.0f} s; exit {counted}; "
        f"the longest took {longest:.1f} s; {faults} faults\n"
    )
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
