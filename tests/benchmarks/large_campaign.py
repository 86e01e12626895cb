"""A large campaign in a folder: ``python -m tests.benchmarks.large_campaign --runs 10000 --rows 1000 FOLDER``.

The wheels follow their load, as in `tests.benchmarks.test_diagnosis`; the same numbers make the same files.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from calib.campaign.write import write_campaign
from tests.benchmarks.test_diagnosis import campaign_of, of_rows


def main() -> None:
    """Make it and write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--rows", type=int, default=1_000)
    given = parser.parse_args()
    write_campaign(of_rows(campaign_of(given.runs), given.rows), given.folder)


if __name__ == "__main__":
    main()
