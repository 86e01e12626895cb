"""Runs that a plan proposes for what a lab has: driven by an independent simulation, they tell the causes apart."""

from __future__ import annotations

import pytest

from tests.gap.plan.driven import CAUSES, LABS, study

CAMPAIGNS = 1


@pytest.mark.parametrize(
    ("lab", "cause"), [("gyro", "gyro_scale"), ("closed loops", "radius_scale"), ("heading", "track_width")]
)
def test_proposed_runs_tell_the_cause_from_its_rivals(lab: str, cause: str) -> None:
    """The campaign was ambiguous; with a mark on the floor or a tape the cause at work is named."""
    found = study(lab, cause, CAMPAIGNS)
    assert found.ambiguous == CAMPAIGNS
    assert found.told == found.named == found.ambiguous
    assert found.runs > 0.0


def test_every_lab_has_causes_to_tell_apart() -> None:
    assert all(set(rivals) <= CAUSES.keys() and len(rivals) == 2 for _, rivals in LABS.values())
