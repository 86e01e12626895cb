"""A weave that every run begins alike, flat at both ends, adds no net turn; the law's intervals hold the truth."""

from __future__ import annotations

import numpy as np
import pytest

from calib.radius.fit import fit_campaign
from tests.radius.campaigns import COUNTS_PER_REV, campaign_of

RADIUS_M = {"left": 0.1002, "right": 0.09985}
SLOPE = -1.3e-6


def flat_at_both_ends(amplitude: float, wavelength: float, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return what the axle's middle rolled and turned along a weave that grows and fades over 3 m."""
    x = np.linspace(0.0, distance, 800)
    y = amplitude * np.sin(2 * np.pi * x / wavelength) * np.minimum(1.0, np.minimum(x, distance - x) / 3.0) ** 2
    rolled = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))))
    return rolled, np.arctan(np.gradient(y, x))


@pytest.mark.parametrize(("amplitude", "wavelength"), [(0.02, 6.0), (0.05, 3.0), (0.1, 6.0), (0.1, 15.0), (0.25, 6.0)])
def test_runs_that_weave_alike_keep_their_radii(amplitude: float, wavelength: float) -> None:
    rng = np.random.default_rng(4)
    loads = np.tile([300.0, 600.0, 900.0], 6)
    distance = rng.uniform(20.0, 25.0, len(loads))
    logs, ends = [], []
    for load, far in zip(loads, distance, strict=True):
        rolled, turned = flat_at_both_ends(amplitude, wavelength, far)
        turns = [
            (rolled + sign * 0.35 * turned) / (2 * np.pi * (radius + SLOPE * (load - 300.0) + rng.normal(0.0, 2e-5)))
            for sign, radius in zip((-1.0, 1.0), RADIUS_M.values(), strict=True)
        ]
        logs.append(tuple(np.floor(COUNTS_PER_REV * turn) for turn in turns))
        ends.append([counts[-1] for counts in logs[-1]])
    numbers = {
        "distance_m": distance + rng.normal(0.0, 0.0015, len(loads)),
        "counts_left": np.array(ends)[:, 0],
        "counts_right": np.array(ends)[:, 1],
        "load_left_N": loads,
        "load_right_N": loads,
    }
    sessions = np.repeat(["a", "b", "c"], 6)
    fit = fit_campaign(campaign_of(numbers, logs=logs, labels={"session": sessions}), reference_load_N=300.0)
    assert "weave" in {part.name for part in fit.radii.budget}
    for side, wheel in fit.wheels.items():
        low, high = wheel.radius_ref_ci95_m
        assert low < RADIUS_M[side] < high
        least, most = wheel.slope_ci95_m_per_N or (0.0, 0.0)
        assert least < SLOPE < most
        # no worse than no correction of the turn, which adds none here, and than a tenth of the weave's own effect
        assert abs(wheel.law.radius_ref_m - RADIUS_M[side]) < 2e-5 + 0.1 * 0.1 * (np.pi * amplitude / wavelength) ** 2
