"""Sums of pulls along the way: the stated spread is that of the sum, no matter what neighbours share."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student

from calib.kinematics.uncertainty import Freedom, covariance_along, own_directions

N_BLOCKS, DRAWS = 40, 150
#: chance goes beyond these once in a thousand at 95 % of 150; lasting errors are met less exactly, by a few per cent
LEAST, MOST = 0.89, 0.993


def _white(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(N_BLOCKS, 1))


def _of_poses(rng: np.random.Generator) -> np.ndarray:
    """Each error of a pose lengthens one block and shortens the next; a third as much beside it is their own."""
    return np.diff(rng.normal(size=(N_BLOCKS + 1, 1)), axis=0) + 0.6 * _white(rng)


def _lasting(rng: np.random.Generator) -> np.ndarray:
    noise = rng.normal(size=(N_BLOCKS + 30, 1))
    for at in range(1, len(noise)):
        noise[at] += 0.5 * noise[at - 1]
    return noise[30:]


@pytest.mark.parametrize("law", [_white, _of_poses, _lasting])
def test_intervals_of_sums_hold_nought(law: object) -> None:
    """The sum of pulls of mean zero lies within its 95 % interval in about 95 of 100 draws."""
    rng = np.random.default_rng(20261122)
    information = np.full((N_BLOCKS, 1, 1), 1.0 / N_BLOCKS)
    inside = []
    for _ in range(DRAWS):
        pulls = law(rng)  # type: ignore[operator]
        # the fit has taken its mean
        covariance, freedom = covariance_along(pulls - pulls.mean(), information, np.eye(1))
        inside.append(abs(pulls.sum()) < np.sqrt(covariance[0, 0]) * student.ppf(0.975, freedom.dof[0]))
    assert LEAST <= np.mean(inside) <= MOST


def test_directions_keep_what_turns_show_apart() -> None:
    """To first order the second is the ratio of the radii, the third the track over their mean; none is the others'."""
    values = np.array([0.05, 0.06, 0.4])
    rows = own_directions(("radius_left_m", "radius_right_m", "track_m"), values)
    alike = rows @ values  # all lengths grow alike: ratios stay
    np.testing.assert_allclose(alike, [0.055, 0.0, 0.0], atol=1e-15)
    assert np.linalg.matrix_rank(rows) == 3
    np.testing.assert_array_equal(own_directions(("track_m", "delay_s"), np.ones(2)), np.eye(2))


def test_degrees_of_freedom_of_a_sum_are_those_of_its_largest_part() -> None:
    """Welch and Satterthwaite: alone a direction keeps its own; of two alike parts the sum has twice as many."""
    freedom = Freedom(np.array([[1.0, 1.0], [1.0, -1.0]]), np.array([1.0, 1.0]), np.array([5.0, 5.0]))
    assert freedom.of(np.array([1.0, -1.0])) == pytest.approx(5.0)
    assert freedom.of(np.array([1.0, 0.0])) == pytest.approx(10.0)
