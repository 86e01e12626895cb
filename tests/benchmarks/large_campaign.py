"""A large campaign in a folder: ``python -m tests.benchmarks.large_campaign --runs 10000 --rows 1000 FOLDER``.

The wheels follow their load, as in `tests.benchmarks.test_diagnosis`; the same numbers make the same files.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.campaign import write_campaign
from calib.campaign.model import Campaign
from tests.benchmarks.test_diagnosis import campaign_of, of_rows


def in_sessions(made: Campaign, sessions: int) -> Campaign:
    """The campaign with its runs divided, in the order driven, into so many sessions of like length."""
    number = np.arange(len(made.runs)) * sessions // len(made.runs)
    labels = {**made.runs.labels, "session": np.array([f"s{session:03d}" for session in number])}
    return replace(made, runs=replace(made.runs, labels=labels))


def main() -> None:
    """Make it and write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--rows", type=int, default=1_000)
    parser.add_argument("--sessions", type=int, help="of which the runs are made in the order driven")
    given = parser.parse_args()
    made = of_rows(campaign_of(given.runs), given.rows)
    write_campaign(made if given.sessions is None else in_sessions(made, given.sessions), given.folder)


if __name__ == "__main__":
    main()
