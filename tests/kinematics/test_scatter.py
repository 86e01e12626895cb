"""Scatter of radii from run to run, told from random walks by campaigns in which either is known."""

from __future__ import annotations

import numpy as np
import pytest

from calib.kinematics.estimate import estimate_geometry
from calib.kinematics.result import Geometry
from tests.kinematics.campaigns import Truth, campaign, mixed

CAMPAIGNS = 12
#: of a reference that hardly errs
SIGMA = (2e-4, 1e-4)
WALK, SCATTER = 2e-3, 1e-3
#: a journey far longer than the runs
WAY_M = 100.0


def geometries(runs: int, campaigns: int = CAMPAIGNS, **noise: float) -> list[Geometry]:
    routes = [("line", [(length, 0.0)]) for length in np.geomspace(2.0, 30.0, runs // 2)] + mixed(runs)[: runs // 2]
    made = (campaign(routes, Truth(), np.random.default_rng(s), sigma=SIGMA, **noise) for s in range(campaigns))
    return [estimate_geometry(one, using="end_poses") for one in made]


def heading_variance(walk: float, scatter: float) -> float:
    """Of a straight journey: by a walk, and by one difference of the radii all the way."""
    return walk**2 * WAY_M + (scatter * WAY_M / Truth().track_m) ** 2


def shares(noise: dict[str, float]) -> tuple[float, float]:
    """Variance to expect over the true one: mean over campaigns, and its standard error."""
    found = [one.noise_expected for one in geometries(24, **noise)]
    true = heading_variance(noise.get("walk", 0.0), np.sqrt(2.0) * noise.get("scatter", 0.0))
    each = np.array([heading_variance(one["heading_walk"], one["yaw_scatter"]) for one in found]) / true
    return float(each.mean()), float(each.std() / np.sqrt(CAMPAIGNS))


def test_a_long_journey_scatters_as_radii_that_differ_from_run_to_run() -> None:
    """By a walk alone the variance would be a fortieth of the true one."""
    share, error = shares({"scatter": SCATTER})
    assert share == pytest.approx(1.0, abs=3.0 * error)


def test_a_walk_alone_is_hardly_taken_for_radii_that_differ() -> None:
    """Short runs leave some scatter possible: at worst they leave the variance of a journey to a factor of two."""
    share, error = shares({"walk": WALK})
    assert 1.0 - 3.0 * error < share < 2.0


def test_few_runs_tell_no_scatter() -> None:
    (few,) = geometries(6, campaigns=1, walk=WALK)
    assert few.n_runs == 6
    assert not {"radius_scatter", "yaw_scatter"} & set(few.noise_expected)
