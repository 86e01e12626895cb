"""Repeated looks: what they cost without care, and that spending the level keeps it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.challenge.looks import ever_alarmed, levels

#: three standard errors of a share of 0.05 over 20,000 draws
DRAWN = 0.005


def test_one_look_at_five_per_cent_alarms_in_five_per_cent() -> None:
    """The simulation itself is right where the answer is known."""
    assert ever_alarmed([0.05], 6, np.random.default_rng(1)) == pytest.approx(0.05, abs=DRAWN)


def test_five_looks_at_five_per_cent_alarm_far_oftener() -> None:
    """Armitage, McPherson and Rowe (1969): five looks at 5 % in one direction alarm in 14.2 %."""
    assert ever_alarmed([0.05] * 5, 1, np.random.default_rng(2)) == pytest.approx(0.142, abs=1.5 * DRAWN)


@pytest.mark.parametrize("n_channels", [1, 6])
def test_levels_that_halve_keep_it_below_five_per_cent(n_channels: int) -> None:
    """The levels add up to less than 5 %, and so do the alarms, for any number of looks."""
    # to the rounding of sixty sums
    assert levels(60).sum() <= 0.05 + 1e-15
    assert ever_alarmed(levels(10), n_channels, np.random.default_rng(3)) < 0.05 + DRAWN
