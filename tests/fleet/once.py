"""Fit a fleet once in a process of its own: ``python -m tests.fleet.once FLEET INTO --workers 2`` prints one JSON line.

Seconds are those of the call, from listing the folder to the fleet's view, workers' start included, imports of this
process before it not. Dask workers (``--scheduler``) run already; what they still import for the work counts.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import resource
import shutil
import sys
import time
from pathlib import Path

from calib.documents import to_json
from calib.fleet.run import fit_fleet


def main() -> None:
    """Fit, and print seconds and hash."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("fleet", type=Path)
    parser.add_argument("into", type=Path)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--scheduler", default="")
    given = parser.parse_args()
    if given.scheduler:
        import distributed  # noqa: F401 - an import of this process, as calib's own
    shutil.rmtree(given.into, ignore_errors=True)
    cpu, begun = time.process_time(), time.perf_counter()
    fleet = fit_fleet(given.fleet, given.into, workers=given.workers, scheduler=given.scheduler)
    took, own = time.perf_counter() - begun, time.process_time() - cpu
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    answer = {
        "seconds": took,
        "cpu": own + children.ru_utime + children.ru_stime,
        "parent": own,
        "sha256": hashlib.sha256(to_json(fleet.to_dict()).encode()).hexdigest(),
    }
    sys.stdout.write(json.dumps(answer) + "\n")


if __name__ == "__main__":
    main()
