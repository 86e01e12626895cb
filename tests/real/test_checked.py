"""The checks of a campaign, on recordings that others made on real vehicles."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from calib.campaign.check import check_campaign
from calib.campaign.model import Campaign
from tests.real import recordings

PARTS = ("lstraight", "lstraight_0", "lstraight_1", "lstraight_2", "l90", "l90_0", "l90_1", "l90_2")
CAMPAIGNS: dict[str, Callable[[Path], Campaign]] = {
    "optiodom/diff": recordings.optiodom_differential,
    "optiodom/tricyc": recordings.optiodom_tricycle,
    **{f"{part}, whole": lambda folder, part=part: recordings.khepera(folder, part) for part in PARTS},
    **{f"{part}, cut": lambda folder, part=part: recordings.khepera(folder, part, tuples_per_run=20) for part in PARTS},
    "laser": recordings.straight_line,
    "motion capture": lambda folder: recordings.straight_line(folder, "motion_capture"),
    **{bag: lambda folder, bag=bag: recordings.mecanum(folder, bag) for bag in ("bag1", "bag2")},
}


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_a_real_recording_raises_no_false_alarm(name: str, shared_data: Path) -> None:
    """Nothing is called wrong, and the one thing that is suspicious is true: nobody weighed these vehicles."""
    report = check_campaign(CAMPAIGNS[name](shared_data))
    assert report.wrong == ()
    assert {note.code for note in report.suspicious} == {"missing_load"}
