"""A recording that is off by itself is omitted and named, and hides nothing that all others share."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.gap.decision.diagnosis import VerdictKind
from calib.gap.decision.sought import Sought, lone_run
from calib.gap.diagnose import diagnose_in_full
from tests.gap import free_drives, workshop

BAD = 2
#: of some forty windows over a noise level that is known to a fifth
ROOT_SPREAD = 1.4


def with_one_late(folder: Path, sizes: dict[str, float], late_s: float) -> Campaign:
    """Return six recordings, one of whose references reads late."""
    campaign = read_campaign(free_drives.write(folder / "free", "differential", sizes, 1e-4, np.random.default_rng(9)))
    columns = {name: values.copy() for name, values in campaign.logs.columns.items()}
    log = campaign.logs.of(BAD)
    mine = slice(campaign.logs.offsets[BAD], campaign.logs.offsets[BAD + 1])
    for name in ("ref_x_m", "ref_y_m", "ref_theta_rad"):
        columns[name][mine] = np.interp(log["t_s"] - late_s, log["t_s"], log[name])
    return replace(campaign, logs=replace(campaign.logs, columns=columns))


@pytest.mark.parametrize("late_s", [0.5, 1.0])
def test_one_late_recording_hides_no_cause_of_all_others(tmp_path: Path, late_s: float) -> None:
    """It took up any noise level: no gap beside a misfit of 45 noise levels, or nothing said for want of repeats."""
    diagnosis = diagnose_in_full(with_one_late(tmp_path, {"track_width": 0.012}, late_s), plan=False)
    assert [cause.effect for cause in diagnosis.causes] == ["track_width"] and diagnosis.recommended
    assert diagnosis.evidence is not None and [*diagnosis.evidence.situation.omitted] == [f"rec{BAD}"]
    assert f"rec{BAD}" in diagnosis.sentence and "late" in diagnosis.sentence


def test_beside_sound_recordings_it_is_the_only_gap(tmp_path: Path) -> None:
    diagnosis = diagnose_in_full(with_one_late(tmp_path, {}, 1.0), plan=False)
    assert not diagnosis.recommended and f"rec{BAD}" in diagnosis.sentence
    assert all(line.before_rms < ROOT_SPREAD * line.floor_rms for line in diagnosis.closure.channels)
    # no all-clear: the status is not that of a sound campaign
    assert diagnosis.kind is not VerdictKind.NO_GAP or any(
        f"rec{BAD} alone" in text for text in diagnosis.correct_first
    )


def test_sound_recordings_are_all_used(tmp_path: Path) -> None:
    diagnosis = diagnose_in_full(with_one_late(tmp_path, {"track_width": 0.012}, 0.0), plan=False)
    assert diagnosis.evidence is not None and not diagnosis.evidence.situation.omitted


@pytest.mark.parametrize("repeats", [1, 3], ids=["driven once", "three repeats"])
def test_a_distance_of_another_run_is_omitted(tmp_path: Path, repeats: int) -> None:
    """Off by 6 % it took the slope of the load out of its interval, or left nothing to be named.

    Two repeats that agree tell which run it is, else what is named without it.
    """
    sizes, seed = {"load_radius": 1e-6}, {1: 14, 3: 15}[repeats]
    campaign = read_campaign(workshop.write(tmp_path / "c", "corridor", sizes, np.random.default_rng(seed)))
    situation = Sought(None, (), ()).situation(campaign)
    assert lone_run(situation) == {}
    condition = situation.observations.condition
    run = next(k for k in range(len(condition)) if (condition == condition[k]).sum() == repeats)
    distance_m = campaign.runs.number("distance_m").copy()
    distance_m[run] *= 0.94
    mistyped = replace(
        campaign, runs=replace(campaign.runs, numbers={**campaign.runs.numbers, "distance_m": distance_m})
    )
    diagnosis, clean = (diagnose_in_full(one, plan=False) for one in (mistyped, campaign))
    assert [*diagnosis.arrays.situation.omitted] == [str(campaign.runs.run_id[run])]
    assert not clean.arrays.situation.omitted
    (cause,), (other,) = diagnosis.causes, clean.causes
    assert cause.effect == other.effect and diagnosis.recommended
    for name, quantity in cause.parameters.items():
        low, high = other.parameters[name].ci95
        assert low <= quantity.value <= high
