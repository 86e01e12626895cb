"""What parts of runs show where their ends do not: a mirror of closed loops, and runs of two vehicles or sensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.checks import listed
from calib.campaign.model import Campaign
from calib.gap.plan.planned_runs import joined
from calib.kinematics.estimate import estimate_geometry
from tests.kinematics.campaigns import Truth, campaign, square
from tests.kinematics.test_named_blunders import Columns, changed

TRUTH = Truth(sensor=(0.05, -0.02, 0.0))
LOOPS = [("loop", square(2.0, sense)) for sense in (1, -1) * 4]
FIRST = np.arange(len(LOOPS)) < 4


def looped(truth: Truth, seed: int) -> Campaign:
    """Return closed loops with poses along them, from the start pose."""
    return campaign(LOOPS, truth, np.random.default_rng(seed), along=True, duration_s=60.0, samples=60)


def mirrored(log: Columns) -> Columns:
    return log | {"ref_y_m": -log["ref_y_m"]}


def exchanged(log: Columns) -> Columns:
    return log | {"ref_x_m": log["ref_y_m"], "ref_y_m": log["ref_x_m"]}


@pytest.mark.parametrize(("change", "code"), [(mirrored, "y_mirrored"), (exchanged, "axes_exchanged")])
def test_closed_loops_in_a_mirror_are_named(change: Callable[[Columns], Columns], code: str) -> None:
    """Loops end alike in a mirror, but bend the other way than the wheels turn."""
    found = estimate_geometry(changed(looped(TRUTH, 1), change))
    assert not found.passed and [fault.code for fault in found.faults] == [code]


@pytest.mark.parametrize("other", [replace(TRUTH, sensor=(0.15, -0.02, 0.0)), None])
def test_runs_of_another_sensor_are_told(other: Truth | None) -> None:
    """Runs differ where each explains itself and one vehicle not all of them; runs of one vehicle do not."""
    first, second = looped(TRUTH, 1), looped(other or TRUTH, 2)
    made = joined(first.select(FIRST), second.select(~FIRST))
    found = estimate_geometry(made, using="windows")
    assert found.passed is (other is None)
    before, after = (listed(made.runs.run_id[part]) for part in (FIRST, ~FIRST))
    assert not other or f"sensor_x_m, for one, is less in {before} than in {after}:" in found.why[0]


def test_single_poses_that_are_off_are_no_motion_of_the_vehicle() -> None:
    """Few windows end at a spike of the tracker: they take no part in the verdict, and a note says so."""
    rng = np.random.default_rng(1)

    def spiked(log: Columns) -> Columns:
        hit = rng.random(len(log["t_s"])) < 0.02
        return log | {name: log[name] + hit * rng.normal(0.0, 0.3, len(hit)) for name in ("ref_x_m", "ref_y_m")}

    made = campaign(LOOPS[:5], Truth(), rng, along=True, duration_s=60.0, samples=400)
    found = estimate_geometry(changed(made, spiked))
    assert found.passed and any("windows are outliers" in note for note in found.notes)
