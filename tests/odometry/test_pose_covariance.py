"""Covariance of the pose along a path: finite differences, Monte Carlo, the vehicle's runtime, closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from calib.odometry import end_poses, integrate
from calib.odometry.poses import PathSteps, RandomWalk, ellipses, jacobian, steps
from calib.radius.law import JOINT
from calib.types import FloatArray

RADIUS_LEFT_M, RADIUS_RIGHT_M, TRACK_M = 0.099, 0.101, 0.7
OFFSETS_N = (250.0, -120.0)


def wheel_turns(n: int = 400, seed: int = 2) -> tuple[FloatArray, FloatArray]:
    """A path with bends, a stop, and some reverse driving."""
    rng = np.random.default_rng(seed)
    base = np.concatenate([np.full(n // 2, 0.5), np.zeros(10), np.full(n - n // 2 - 10, -0.3)])
    return base + 0.1 * np.sin(np.arange(n) / 25) + 0.02 * rng.standard_normal(n), base


def path_of(left_rad: FloatArray, right_rad: FloatArray) -> PathSteps:
    return steps(
        left_rad * RADIUS_LEFT_M,
        right_rad * RADIUS_RIGHT_M,
        TRACK_M,
        radius_left_m=RADIUS_LEFT_M,
        radius_right_m=RADIUS_RIGHT_M,
    )


def test_the_path_of_the_covariance_is_the_path_of_the_odometry() -> None:
    left, right = wheel_turns()
    path = path_of(left, right)
    expected = integrate(path.left_m, path.right_m, TRACK_M)
    # a few hundred additions of numbers of the order of 10 m
    np.testing.assert_allclose(path.poses.stacked(), expected.stacked(), rtol=0.0, atol=1e-12)


def test_jacobians_are_the_differences_that_changed_parameters_make() -> None:
    """Central differences of the odometry itself, at every fiftieth step, all five parameters."""
    left, right = wheel_turns()
    made = jacobian(path_of(left, right), load_offset_left_N=OFFSETS_N[0], load_offset_right_N=OFFSETS_N[1])
    assert made.shape == (400, 3, len(JOINT))
    for number, size in enumerate((1e-6, 1e-9, 1e-6, 1e-9, 1e-6)):
        ends = []
        for sign in (1.0, -1.0):
            p = np.zeros(5)
            p[number] = sign * size
            radius_left = RADIUS_LEFT_M + p[0] + p[1] * OFFSETS_N[0]
            radius_right = RADIUS_RIGHT_M + p[2] + p[3] * OFFSETS_N[1]
            ends.append(integrate(left * radius_left, right * radius_right, TRACK_M + p[4]).stacked())
        differences = (ends[0] - ends[1]) / (2 * size)
        scale = np.abs(differences).max()
        # third derivatives times size squared, and 1e-15 of rounding over the size
        np.testing.assert_allclose(made[::50, :, number], differences[::50], rtol=0.0, atol=1e-5 * scale)


def test_a_random_walk_scatters_as_its_covariance_says() -> None:
    """Monte Carlo: noise on distance and heading of each step, by the definition."""
    left, right = (0.5 * part for part in wheel_turns(200))
    path = path_of(left, right)
    walk = RandomWalk(sigma_along_m_per_sqrt_m=2e-3, sigma_heading_rad_per_sqrt_m=3e-3)
    runs = 20_000
    rng = np.random.default_rng(8)
    turned = np.abs(path.right_m - path.left_m) / TRACK_M
    root = np.sqrt(np.abs(0.5 * (path.left_m + path.right_m)) + 0.1 * turned)
    along = walk.sigma_along_m_per_sqrt_m * root * rng.standard_normal((runs, len(root)))
    turn = walk.sigma_heading_rad_per_sqrt_m * root * rng.standard_normal((runs, len(root)))
    noisy = end_poses(path.left_m + along - 0.5 * TRACK_M * turn, path.right_m + along + 0.5 * TRACK_M * turn, TRACK_M)
    spread = np.cov(noisy.stacked().T)
    said = walk.covariance(path)[-1]
    sigma = np.sqrt(np.diag(said))
    # entries of a correlation matrix from 20,000 draws: standard error 0.007 to 0.01; four of those
    np.testing.assert_allclose(spread / np.outer(sigma, sigma), said / np.outer(sigma, sigma), rtol=0.0, atol=0.04)


def test_heading_noise_on_a_straight_gives_the_textbook_cubic() -> None:
    """var(theta) = q S, cov(y, theta) = q S^2 / 2, var(y) = q S^3 / 3 as the steps get short."""
    n, length, sigma = 20_000, 30.0, 1e-3
    step = np.full(n, length / n)
    path = steps(step, step, TRACK_M, radius_left_m=0.1, radius_right_m=0.1)
    made = RandomWalk(sigma_heading_rad_per_sqrt_m=sigma).covariance(path)[-1]
    q = sigma**2
    # steps of 1/20,000 of the length
    assert made[2, 2] == pytest.approx(q * length, rel=1e-9)
    assert made[1, 2] == pytest.approx(q * length**2 / 2, rel=1e-4)
    assert made[1, 1] == pytest.approx(q * length**3 / 3, rel=1e-4)
    assert made[0, 0] == pytest.approx(0.0, abs=1e-18)


def test_readings_at_both_ends_scatter_as_said() -> None:
    """Monte Carlo: each encoder misread at the start and at the end."""
    left, right = wheel_turns(200)
    path = path_of(left, right)
    walk = RandomWalk(count_std=0.5, counts_per_rev_left=500.0, counts_per_rev_right=700.0)
    rng = np.random.default_rng(4)
    runs = 20_000
    travel = [np.repeat(part[None], runs, axis=0) for part in (path.left_m, path.right_m)]
    for part, radius, per_rev in ((travel[0], RADIUS_LEFT_M, 500.0), (travel[1], RADIUS_RIGHT_M, 700.0)):
        size = 2 * np.pi * radius / per_rev * 0.5
        part[:, 0] += size * rng.standard_normal(runs)
        part[:, -1] += size * rng.standard_normal(runs)
    spread = np.cov(end_poses(travel[0], travel[1], TRACK_M).stacked().T)
    said = walk.covariance(path)[-1]
    sigma = np.sqrt(np.diag(said))
    # as above, and the readings act at the ends of the steps instead of within them
    np.testing.assert_allclose(spread / np.outer(sigma, sigma), said / np.outer(sigma, sigma), rtol=0.0, atol=0.04)


def test_many_paths_at_once_are_the_paths_one_by_one() -> None:
    left, right = wheel_turns(120)
    pairs = [(left, right), (right, left), (0.5 * left, right)]
    stacked = path_of(np.stack([a for a, _ in pairs]), np.stack([b for _, b in pairs]))
    walk = RandomWalk(1e-3, 2e-3, 0.3)
    many, many_random = jacobian(stacked), walk.covariance(stacked)
    for number, (a, b) in enumerate(pairs):
        np.testing.assert_allclose(many[number], jacobian(path_of(a, b)), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(many_random[number], walk.covariance(path_of(a, b)), rtol=1e-9, atol=1e-15)


def test_ellipses_hold_95_percent_of_points() -> None:
    covariance = np.array([[4e-4, 1.5e-4, 0.0], [1.5e-4, 1e-4, 0.0], [0.0, 0.0, 1e-6]])
    major_m, minor_m, angle_rad = ellipses(covariance)
    points = np.random.default_rng(3).multivariate_normal([0.0, 0.0], covariance[:2, :2], 40_000)
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    u = (points[:, 0] * c + points[:, 1] * s) / major_m
    v = (-points[:, 0] * s + points[:, 1] * c) / minor_m
    # a share of 0.95 of 40,000 is known to 0.0011; four of those
    assert float(np.mean(u * u + v * v <= 1.0)) == pytest.approx(0.95, abs=0.0045)


def test_ellipse_axes_are_those_of_the_eigenvalues() -> None:
    covariance = np.array([[3.0, 1.2], [1.2, 2.0]])
    values = np.linalg.eigvalsh(covariance)
    major_m, minor_m, _ = ellipses(covariance)
    k = np.sqrt(5.991464547107979)  # chi-square, two degrees of freedom, 95 %
    np.testing.assert_allclose((minor_m, major_m), k * np.sqrt(values), rtol=1e-12)
