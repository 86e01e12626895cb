"""Blunders through ``calib geometry``: each named or refused; the whole table: ``python -m tests.blunders.table``."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.blunders.table import Outcome, rows

#: one of each family, but for half a track (`tests.kinematics.test_estimate`), a steering's play and counters that wrap
#: (`tests.kinematics.test_departures`), and a vehicle that strafes (`tests.kinematics.test_adequacy`); the table has
#: all of them, along the path as well
NAMES = (
    "axes turned by 10 degrees",
    "positions in millimetres",
    "wheel angles in radians read as counts",
    "heading off by a turn in one run",
    "heading zero throughout",
    "steering in degrees",
    "counters reset halfway",
    "a tenth of the counts lost",
    "steering of the motor's shaft",
    "steering 0.3 rad off its zero",
    "reference by the vehicle's own odometry",
    "heading as the quaternion's z",
)


@pytest.mark.parametrize("name", NAMES)
def test_a_blunder_never_passes_and_is_not_named_otherwise(name: str, tmp_path: Path) -> None:
    """The plant shares no code with the package."""
    (at_end,) = rows([name], diagnose=False, folder=tmp_path, references=["end poses"], repeats=2)
    assert at_end.outcome in {Outcome.NAMED, Outcome.REFUSED}
