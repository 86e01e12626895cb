"""Verdicts on recordings whose references are as labs have them: continuous, without repeats, of a distance only."""

from __future__ import annotations

from pathlib import Path

import pytest

from calib.gap.decision.diagnosis import VerdictKind
from calib.gap.diagnose import diagnose_in_full
from tests.real import recordings


@pytest.mark.parametrize("bag", ["bag1", "bag2"])
def test_strafing_is_never_no_gap(bag: str, shared_data: Path) -> None:
    """Nearly 0.4 m and more sideways, which the wheels of a differential drive know nothing of: why, and no fix.

    Where it turned, its radius is told: 0.0680 m where 0.07 m is stated, by an independent fit of the four wheels.
    """
    verdict = diagnose_in_full(recordings.mecanum_as_differential(shared_data, bag), plan=False)
    assert not verdict.fix.recommended
    named = [cause.effect for cause in verdict.causes]
    assert (verdict.kind, named) in (
        (VerdictKind.UNKNOWN, []),
        (VerdictKind.UNDECIDED, []),
        (VerdictKind.PARTLY_EXPLAINED, ["radius_scale"]),
    )
    for cause in verdict.causes:
        low, high = cause.parameters["relative"].ci95
        assert low < 0.0680 / 0.07 - 1.0 < high
    assert "nothing" in verdict.noise.support
    undecided, unknown = (
        "Drive one route several times under the same conditions.",
        "wheels that this drive does not have",
    )
    assert (unknown if verdict.kind is VerdictKind.UNKNOWN else undecided) in verdict.sentence
