"""What the diagnosis says of a car whose windows scatter far beyond the stated sigmas and were never repeated."""

from __future__ import annotations

from pathlib import Path

from calib.gap.decision.diagnosis import VerdictKind
from calib.gap.diagnose import diagnose_in_full
from tests.real.dart import STEERING_ZERO_RAD, dart


def test_a_gap_that_closes_on_other_recordings_is_one_at_any_noise_level(shared_data: Path) -> None:
    """Makers' values: the zero is within its interval, the sensor's place named; no repeats, so no fix recommended."""
    found = diagnose_in_full(dart(shared_data), plan=False)
    assert found.kind is VerdictKind.PARTLY_EXPLAINED
    causes = {cause.effect: cause for cause in found.causes}
    assert {"steering_zero", "reference_lever_arm"} <= causes.keys()
    low, high = causes["steering_zero"].parameters["zero"].ci95
    assert low < abs(STEERING_ZERO_RAD) < high
    assert not found.recommended
    assert any("drive one route several times" in reason for reason in found.fix.why)
    assert "these runs cannot show how much of what is left is noise" in found.sentence
