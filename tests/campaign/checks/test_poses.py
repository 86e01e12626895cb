"""Poses of the reference in their unit."""

from __future__ import annotations

import numpy as np
import pytest

from calib.campaign.checks.poses import implausible_poses
from tests.kinematics.campaigns import Truth, campaign, square
from tests.kinematics.test_named_blunders import Columns, changed


@pytest.mark.parametrize("wrapped", [False, True])
@pytest.mark.parametrize("degrees", [False, True])
def test_headings_along_the_path_in_degrees_are_wrong(degrees: bool, wrapped: bool) -> None:
    """Also where they wrap, at 360 or at two pi; radians are no fault."""
    made = campaign([("s", square(2.0, s)) for s in (1, -1) * 2], Truth(), np.random.default_rng(1), along=True)

    def turned(log: Columns) -> Columns:
        turn, heading = (360.0 if degrees else 2.0 * np.pi), log["ref_theta_rad"] * (180.0 / np.pi if degrees else 1.0)
        return log | {"ref_theta_rad": heading % turn if wrapped else heading}

    notes = [note for note in implausible_poses(changed(made, turned)) if "along the path" in note.text]
    assert [note.level for note in notes] == ["wrong"] * degrees
