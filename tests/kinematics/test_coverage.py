"""A small sample of the coverage script: intervals hold the truth about as often as they say."""

from __future__ import annotations

import pytest

from tests.kinematics.coverage import coverage

#: campaigns, and the least number whose interval must hold the truth: fewer have a probability of 1e-3 at 95 %
CAMPAIGNS, LEAST = 10, 7


@pytest.mark.parametrize("kind", ["squares", "arcs"])
def test_intervals_hold_the_truth(kind: str) -> None:
    """Of ten campaigns seven intervals or more of each ratio that squares and arcs determine hold the truth."""
    shares = coverage(kind, CAMPAIGNS)
    for name in ("right over left", "track over radius"):
        share, number = shares[name]
        assert number == CAMPAIGNS
        assert share * number >= LEAST, name
