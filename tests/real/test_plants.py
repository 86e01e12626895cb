"""A few manipulations of recorded data, diagnosed; the whole table is ``python -m tests.real.plants``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.real.manipulations import CORRIDOR, POSES
from tests.real.plants import BASES, calibrated, outcome_of
from tests.real.recordings import straight_line


def test_there_are_fifteen_manipulations_and_more_of_each_recording() -> None:
    """Each recording gets 15 or more, under different names, an outsider and two at once among them."""
    for manipulations in (POSES, CORRIDOR):
        names = [each.name for each in manipulations]
        assert len(set(names)) == len(names) >= 15
        assert any(not each.truth for each in manipulations)
        assert any(each.both for each in manipulations)


def test_a_manipulation_changes_the_data_as_it_says(shared_data: Path) -> None:
    """Both wheels' counts 1 % more: to the rounding of a count, and nothing else."""
    base = straight_line(shared_data)
    by_name = {each.name: each for each in CORRIDOR}
    struck = by_name["both wheels' counts +1 %"].change(base)
    for name in ("counts_left", "counts_right"):
        # whole counts: half a count
        np.testing.assert_allclose(struck.runs.number(name), 1.01 * base.runs.number(name), atol=0.5)
        np.testing.assert_allclose(struck.logs.columns[name], 1.01 * base.logs.columns[name], atol=0.5)
    np.testing.assert_array_equal(struck.runs.number("distance_m"), base.runs.number("distance_m"))


@pytest.mark.slow
def test_strong_manipulations_of_a_straight_line_are_named(shared_data: Path) -> None:
    """A temperature and a further column that drive the radii are named first, on real noise, and never `no_gap`."""
    name = "straightline_laser"
    whole = BASES[name][0](shared_data)
    # every second way out and back: the effects show at four standard deviations yet
    base, own, covariance = calibrated(whole.select(np.arange(len(whole.runs)) // 2 % 2 == 0))
    wanted = {"temperature, 6e-4 per K", "a further column"}
    for manipulation in (each for each in CORRIDOR if each.name in wanted):
        outcome = outcome_of(name, base, own, covariance, manipulation)
        assert outcome.found, outcome
        assert not outcome.wrong, outcome
        assert outcome.verdict != "no_gap"
