"""The checks of a campaign, on recordings that others made on real vehicles."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
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
#: recordings whose tracker was lost: its poses repeat in all digits while the wheels turn, then leap
LOST = {"bag2": {"lost_reference"}}


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_a_real_recording_raises_no_false_alarm(name: str, shared_data: Path) -> None:
    """Nothing is called wrong, and what is suspicious is true: nobody weighed these vehicles, and one was lost."""
    report = check_campaign(CAMPAIGNS[name](shared_data))
    assert report.wrong == ()
    assert {note.code for note in report.suspicious} == {"missing_load", *LOST.get(name, ())}


def test_the_recording_that_was_lost_stood_still_and_leapt(shared_data: Path) -> None:
    """Poses of the tracker repeat in all digits for 0.9 s, and then are 0.19 m away within a sample of 20 ms."""
    log = CAMPAIGNS["bag2"](shared_data).logs.of(0)
    between = (log["t_s"] > 32.9) & (log["t_s"] < 33.76)
    assert np.ptp(log["ref_x_m"][between]) == np.ptp(log["ref_y_m"][between]) == 0.0
    after = np.flatnonzero(log["t_s"] > 33.8)[0]
    assert np.hypot(*(log[name][after] - log[name][between][0] for name in ("ref_x_m", "ref_y_m"))) > 0.18
    assert all(np.ptp(log[f"counts_{end}_left"][between]) > 0.0 for end in ("front", "rear"))
