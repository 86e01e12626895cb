"""What runs do not determine is left out with a sentence; what they determine together is said together."""

from __future__ import annotations

import numpy as np

from calib.gap.effects.effect import Parameter
from calib.gap.evidence.determined import said_of_undetermined, undetermined

LEFT = Parameter("slope_left", "m/N", typical=1e-6, largest=6e-6)
RIGHT = Parameter("slope_right", "m/N", typical=1e-6, largest=6e-6)


def test_an_interval_beyond_what_is_plausible_on_both_sides_says_nothing() -> None:
    """+-4 m on a track is left out; an implausible value that is well known, or a plausible one, is not."""
    widening = Parameter("widening", "m", typical=0.01, largest=0.1)
    for size, half, left_out in ((0.02, 4.0, True), (4.0, 0.1, False), (0.02, 0.05, False), (0.2, 0.25, False)):
        assert bool(undetermined([widening], np.array([size]), np.array([half]))) == left_out


def test_what_is_known_together_only_is_said_together() -> None:
    """Two slopes of which only the sum shows: each is unknown to 1e-4, their mean to 1e-7."""
    sum_sd, difference_sd = 2e-7, 2e-4
    turn = np.array([[0.5, 0.5], [0.5, -0.5]])
    covariance = turn @ np.diag([sum_sd**2, difference_sd**2]) @ turn.T
    words = said_of_undetermined([LEFT, RIGHT], np.array([3e-5, -2.7e-5]), covariance, 2.0)
    assert words.startswith("these runs do not determine slope_left and slope_right, only the mean of")
    # the mean's standard uncertainty is half that of the sum; its value half the sum's
    assert "1.5e-06 +- 2e-07 m/N" in words


def test_what_is_determined_needs_no_words() -> None:
    assert said_of_undetermined([LEFT, RIGHT], np.array([1e-6, 1e-6]), np.diag([1e-14, 1e-14]), 2.0) == ""
