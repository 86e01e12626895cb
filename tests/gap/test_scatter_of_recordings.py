"""Radii that scatter: from recording to recording noise that windows share, from session to session no obstacle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.campaign.read import read_campaign
from calib.gap.decision.diagnosis import Diagnosis, VerdictKind
from calib.gap.diagnose import diagnose_in_full
from tests.gap import free_drives, workshop

#: radii of rubber wheels differ by so much between recordings of a day, relative
SCATTER = 5e-4


def diagnosed(folder: Path, sizes: dict[str, float], seed: int) -> Diagnosis:
    written = free_drives.write(folder / "free", "differential", sizes, SCATTER, np.random.default_rng(seed))
    return diagnose_in_full(read_campaign(written), plan=False)


@pytest.mark.parametrize("seed", [1, 2])
def test_scatter_alone_is_no_gap(tmp_path: Path, seed: int) -> None:
    """Six recordings whose radii differ by 0.05 %, ten times what a window's repeats scatter by."""
    diagnosis = diagnosed(tmp_path, {}, seed)
    assert diagnosis.kind is VerdictKind.NO_GAP
    assert "from recording to recording" in diagnosis.sentence


@pytest.mark.parametrize(("effect", "size", "seed"), [("unequal_radii", 6e-3, 3), ("radius_scale", -8e-3, 4)])
def test_a_radius_beside_scatter_is_named_with_an_interval_that_holds_it(
    tmp_path: Path, effect: str, size: float, seed: int
) -> None:
    """The mean over six recordings is uncertain by the scatter over the root of six: the interval is no narrower."""
    diagnosis = diagnosed(tmp_path, {effect: size}, seed)
    assert [cause.effect for cause in diagnosis.causes] == [effect] and diagnosis.recommended
    low, high = diagnosis.causes[0].parameters["relative"].ci95
    assert low <= size <= high
    # of the difference of both radii, of their mean
    of_one = {"unequal_radii": np.sqrt(2.0), "radius_scale": np.sqrt(0.5)}[effect]
    expected = 2.0 * 1.96 * of_one * SCATTER / np.sqrt(free_drives.RECORDINGS)
    assert 0.5 * expected <= high - low <= 2.0 * expected


@pytest.mark.parametrize(
    ("design", "effect", "size"), [("corridor", "rear_drag", 1.4e-3), ("lab", "track_width", 1.5e-2)]
)
def test_radii_that_step_between_sessions_leave_the_fix_of_another_cause(
    tmp_path: Path, design: str, effect: str, size: float
) -> None:
    """Both are named; the fix is that of the cause that holds in every session, judged beside the steps."""
    sizes = {effect: size, "session_step": SCATTER}
    written = workshop.write(tmp_path / "c", design, sizes, np.random.default_rng(5))
    diagnosis = diagnose_in_full(read_campaign(written), plan=False)
    assert {cause.effect for cause in diagnosis.causes} == set(sizes)
    assert diagnosis.recommended and diagnosis.fix.corrects == (effect,)
    assert any("calibrate in each" in text for text in diagnosis.fix.leaves)
