"""An outside simulator of poses alone is judged by what a laser reads of them, and what it lacks is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.gap.observations.from_campaign import observations_of
from tests.gap.effects.making import STRAIGHT, Run, campaign

#: of the simulator's ends, four runs
X_M, Y_M = np.array([9.99, 10.01, 10.0, 9.98]), np.array([0.1, -0.1, 0.3, 0.2])


@pytest.mark.parametrize("posed", [True, False], ids=["end poses", "distances alone"])
def test_the_distance_of_a_simulated_pose_is_that_along_x(*, posed: bool) -> None:
    """A laser reads along the heading at the start, and nothing of how far the run ended off to a side."""
    made = campaign([Run(STRAIGHT)] * 4)
    numbers = {**made.runs.numbers, "sim_x_m": X_M, "sim_y_m": Y_M, "sim_theta_rad": np.zeros(4)}
    if not posed:
        numbers |= {name: np.full(4, np.nan) for name in ("ref_x_m", "ref_y_m", "ref_theta_rad")}
    seen = observations_of(replace(made, runs=replace(made.runs, numbers=numbers)))
    np.testing.assert_array_equal(seen.simulated[:, 0], X_M)
    stated = replace(made.runs, numbers={**numbers, "sim_distance_m": X_M + 1.0})
    np.testing.assert_array_equal(observations_of(replace(made, runs=stated)).simulated[:, 0], X_M + 1.0)


def test_a_channel_that_the_simulator_never_gives_is_said() -> None:
    made = campaign([Run(STRAIGHT)] * 4)
    numbers = {**made.runs.numbers, "sim_x_m": X_M, "sim_y_m": Y_M}
    seen = observations_of(replace(made, runs=replace(made.runs, numbers=numbers)))
    assert any("4 runs have no sim_ value for heading" in note for note in seen.notes)
