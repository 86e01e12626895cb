"""The size of the noise that a geometry states, against campaigns whose random walk is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from calib.kinematics.departures import NORMAL_GAIN
from calib.kinematics.estimate import estimate_geometry
from calib.kinematics.solve import DEGREES
from tests.kinematics.campaigns import Truth, campaign, mixed

#: of the true heading, rad per root metre
WALK = 2e-3
CAMPAIGNS = 20


def shares(sigma: tuple[float, float]) -> np.ndarray:
    """Variance of the walk of heading over the true one, estimated and to expect, by 20 end poses each: (2, n)."""
    made = (campaign(mixed(4), Truth(), np.random.default_rng(s), walk=WALK, sigma=sigma) for s in range(CAMPAIGNS))
    found = [estimate_geometry(one, using="end_poses") for one in made]
    stated = np.array([(one.noise["heading_walk"], one.noise_expected["heading_walk"]) for one in found])
    return np.square(stated / WALK).T


def test_the_noise_is_the_standard_deviation_of_what_made_it() -> None:
    """Neither robust weights nor the parameters fitted to the same few runs make it smaller, by an exact reference."""
    estimated, _ = shares((2e-4, 1e-4))
    error = estimated.std() / np.sqrt(CAMPAIGNS)
    # the variance from 20 runs of three channels scatters by a fifth; weights alone would take 0.22, parameters 0.05
    assert error < 0.05
    assert estimated.mean() == pytest.approx(1.0, abs=3.0 * error)


def test_the_noise_to_expect_holds_95_percent_of_what_comes() -> None:
    """Beside the noise of a usual reference 20 runs leave its size in doubt: normal regions by it are too narrow."""
    by_estimate, by_expected = (chi2.cdf(chi2.ppf(0.95, 1) * share, 1) for share in shares((2e-3, 1e-3)))
    assert by_estimate.mean() < 0.93
    # the mean over 20 campaigns, whose regions hold 0.88 to 1.0, is known to 0.012: two of those
    assert by_expected.mean() == pytest.approx(0.95, abs=0.024)


@pytest.mark.parametrize("channels", [1, 2, 3])
def test_weights_with_their_gain_leave_normal_noise_its_size(channels: int) -> None:
    mean = chi2(channels).expect(lambda square: (DEGREES + channels) / (DEGREES + square) * square)
    # five digits are stated
    assert NORMAL_GAIN[channels] * mean == pytest.approx(channels, rel=5e-5)
