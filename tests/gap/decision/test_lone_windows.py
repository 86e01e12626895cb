"""Single windows that are off: omitted where the others settle the cause, kept where their like is off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.gap.decision.sought import Sought, lone_windows
from calib.gap.diagnose import diagnose_in_full
from tests.gap import free_drives

#: an instrument that loses its fix drifts off so far within seconds, slower than a leap
OFF_M = 0.4
#: half the time of such a drift
HALF_S = 8.0
RADII = -0.004


def driven(folder: Path, middles: Sequence[Sequence[float]]) -> Campaign:
    """Return six recordings of wheels too small, whose reference drifts off and back about times in s of each."""
    rng = np.random.default_rng(21)
    campaign = read_campaign(free_drives.write(folder / "free", "differential", {"radius_scale": RADII}, 1e-4, rng))
    logs, columns = campaign.logs, dict(campaign.logs.columns)
    x_m = columns["ref_x_m"].copy()
    for run, at_s in enumerate(middles):
        mine = slice(logs.offsets[run], logs.offsets[run + 1])
        for middle_s in at_s:
            t_s = (columns["t_s"][mine] - middle_s) / HALF_S
            x_m[mine] += OFF_M * np.where(np.abs(t_s) < 1.0, np.cos(0.5 * np.pi * t_s) ** 2, 0.0)
    return replace(campaign, logs=replace(logs, columns=columns | {"ref_x_m": x_m}))


def test_windows_whose_reading_is_off_by_itself_are_omitted_by_time(tmp_path: Path) -> None:
    """Of six recordings one loses its fix for some seconds: the others' radii stand, and the times are told."""
    at_s = {"rec1": 28.0}
    campaign = driven(tmp_path, [[at_s[f"rec{run}"]] if f"rec{run}" in at_s else [] for run in range(6)])
    diagnosis = diagnose_in_full(campaign, plan=False)
    (cause,) = [cause for cause in diagnosis.causes if cause.effect == "radius_scale"]
    assert diagnosis.recommended
    low, high = cause.parameters["relative"].ci95 or (0.0, 0.0)
    assert low <= RADII <= high
    omitted = [name.removesuffix(" s").split(" at ") for name in diagnosis.arrays.situation.omitted]
    assert {run for run, _ in omitted} == set(at_s)
    assert all(abs(float(middle_s) - at_s[run]) < 3.0 * HALF_S for run, middle_s in omitted)
    assert all(name in diagnosis.sentence for name in diagnosis.arrays.situation.omitted)


@pytest.mark.parametrize("every", [1, 2])
def test_many_windows_off_are_no_single_readings_fault(tmp_path: Path, every: int) -> None:
    """Of a reference that drifts again and again nothing is omitted: noise, or a cause, is missing."""
    campaign = driven(tmp_path, [np.arange(10.0, 80.0, 20.0 * every).tolist()] * 6)
    assert lone_windows(Sought(None, (), ()).situation(campaign)) == (set(), {})
