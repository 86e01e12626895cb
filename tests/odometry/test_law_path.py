"""A journey under a law along its path, with loads that change on the way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from calib.errors import BadInputError
from calib.odometry.law_path import AxleLaw, LawPath, law_journey, law_path
from calib.odometry.poses import COMPONENTS, RandomWalk, ellipses
from calib.odometry.routes import NAMED, Loading, Route, arc, find_route, straight
from calib.radius.law import RadiusLaw, WheelLaw

TRACK_M = 0.7
ROUNDING_M = 1e-11  # a few hundred additions of numbers of the order of 10 m
COVARIANCE = np.array([[4e-12, -5e-15], [-5e-15, 2.5e-17]])


def wheel(radius: float, slope: float) -> WheelLaw:
    return WheelLaw(300.0, radius, slope, COVARIANCE, 58.0, 2e-5, 200.0, 1100.0, 60)


LAW = RadiusLaw(left=wheel(0.1, 1.3e-6), right=wheel(0.0995, -1.2e-6))
TWO = Loading.from_rows([(4.0, 900.0, 400.0), (0.0, 300.0, 350.0)])


def made(
    route: Route,
    loading: Loading = TWO,
    *,
    rng: np.random.Generator | None = None,
    draws: int = 20_000,
    **more: object,
) -> LawPath:
    axle = AxleLaw(LAW, TRACK_M, **more)  # type: ignore[arg-type]
    return law_path(axle, route, loading=loading, reference_N=(300.0, 300.0), draws=draws, rng=rng)


def circle(pose: tuple[float, float, float], left_m: float, right_m: float) -> tuple[float, float, float]:
    """Both wheels roll so far on one circle: the textbook's centre of rotation."""
    x, y, theta = pose
    turn = (right_m - left_m) / TRACK_M
    radius = 0.5 * (left_m + right_m) / turn
    return (
        x + radius * (math.sin(theta + turn) - math.sin(theta)),
        y - radius * (math.cos(theta + turn) - math.cos(theta)),
        theta + turn,
    )


def test_two_straight_pieces_with_two_pairs_of_radii_are_two_arcs() -> None:
    """Without the correction the odometry believes the radii at 300 N; the wheels roll on those at the load carried."""
    path = made(Route.from_segments("r", straight(10.0)))
    pose = (0.0, 0.0, 0.0)
    for length, left_N, right_N in ((4.0, 300.0, 350.0), (6.0, 900.0, 400.0)):
        left = length * (0.1 + 1.3e-6 * (left_N - 300.0)) / 0.1
        right = length * (0.0995 - 1.2e-6 * (right_N - 300.0)) / 0.0995
        pose = circle(pose, left, right)
    np.testing.assert_allclose(path.without.poses[-1].stacked(), pose, rtol=0.0, atol=ROUNDING_M)
    np.testing.assert_allclose(path.corrected.poses[-1].stacked(), [10.0, 0.0, 0.0], rtol=0.0, atol=ROUNDING_M)
    end = path.to_dict()["without"]
    assert end["error_lateral_m"] == pytest.approx(pose[1], abs=ROUNDING_M)
    assert end["error_global_x_m"] == pytest.approx(pose[0] - 10.0, abs=ROUNDING_M)
    assert path.ratio > 1.0


def test_the_load_changes_at_its_place_and_nowhere_else() -> None:
    path = made(find_route("paper_route"))
    loads = [row["load_left_N"] for row in path.error_rows()]
    places = path.distance_m[np.flatnonzero(np.diff(loads)) + 1]
    np.testing.assert_allclose(places, [4.0], rtol=0.0, atol=1e-12)  # the border between two pieces


@pytest.mark.parametrize("name", NAMED)
def test_radii_that_follow_the_load_keep_to_the_route(name: str) -> None:
    path = made(find_route(name))
    np.testing.assert_allclose(path.corrected.poses.stacked(), path.reference.stacked(), rtol=0.0, atol=ROUNDING_M * 4)


def test_the_systematic_part_is_the_scatter_of_vehicles_whose_law_is_another() -> None:
    """Monte Carlo: coefficients drawn once a journey, for both pieces the same; driven as two arcs."""
    path = made(Route.from_segments("r", straight(10.0)), track_std_m=2e-3)
    rng = np.random.default_rng(5)
    ends = []
    means = [[one.radius_ref_m, one.slope_m_per_N] for one in (LAW.left, LAW.right)]
    spread = COVARIANCE + np.diag([2e-5**2, 0.0])
    draws = 20_000
    lefts, rights = (rng.multivariate_normal(mean, spread, draws).tolist() for mean in means)
    tracks = (TRACK_M + 2e-3 * rng.standard_normal(draws)).tolist()
    for (a, b), (c, d), track in zip(lefts, rights, tracks, strict=True):
        pose = (0.0, 0.0, 0.0)
        for length, left_N, right_N in ((4.0, 300.0, 350.0), (6.0, 900.0, 400.0)):
            left = length * (a + b * (left_N - 300.0)) / float(LAW.left.radius_m(left_N))
            right = length * (c + d * (right_N - 300.0)) / float(LAW.right.radius_m(right_N))
            # another track bends the path as a difference of travels that is so much larger
            middle, half = 0.5 * (left + right), 0.5 * (right - left) * TRACK_M / track
            pose = circle(pose, middle - half, middle + half)
        ends.append(pose)
    said = path.corrected.systematic[-1]
    sigma = np.sqrt(np.diag(said))
    got = np.cov(np.array(ends).T)
    # 20,000 draws: entries of a correlation matrix to 0.01; four of those
    np.testing.assert_allclose(got / np.outer(sigma, sigma), said / np.outer(sigma, sigma), rtol=0.0, atol=0.04)


def test_under_one_load_the_path_ends_in_the_scatter_of_the_journey() -> None:
    route = find_route("paper_route")
    path = made(route, Loading.from_rows([(0.0, 700.0, 700.0)]), rng=np.random.default_rng(1), draws=40_000)
    journey = law_journey(
        LAW,
        route,
        loads_N=(700.0, 700.0),
        reference_N=(300.0, 300.0),
        track_m=TRACK_M,
        band="prediction",
        draws=40_000,
        rng=np.random.default_rng(0),
    )
    # quantiles of 40,000 draws at 58 degrees of freedom
    assert path.ratio_ci95 == pytest.approx(journey.ratio_ci95, rel=0.01)
    assert made(route).ratio_ci95 is None
    # the same first-order propagation, with the coefficients of the law instead of its radii
    assert path.corrected.rms_m[-1] == pytest.approx(journey.corrected_rms_m, rel=1e-9)
    assert path.without.rms_m[-1] == pytest.approx(journey.without_rms_m, rel=1e-9)
    assert (np.diff(ellipses(path.corrected.systematic)[0]) > 0).all()


def test_a_stated_track_is_as_certain_as_stated_however_few_runs_gave_the_radii() -> None:
    """A sum of a Student variate of five degrees of freedom and a normal one: its quantile by a Monte Carlo apart."""
    joint, std_m, n = np.zeros((5, 5)), 1e-3, 400_000
    joint[:2, :2] = joint[2:4, 2:4] = COVARIANCE
    joint[4, 4] = std_m**2
    law = RadiusLaw(*(replace(each, dof=5.0) for each in (LAW.left, LAW.right)), joint=joint)
    route, known, rng = Route.from_segments("bend", arc(3.0, 1.5)), LAW.left.radius_m(300.0), np.random.default_rng(3)
    at = {"loads_N": (300.0, 300.0), "reference_N": (300.0, 300.0), "track_m": TRACK_M}
    found = law_journey(law, route, **at, band="mean", draws=1000, rng=rng).corrected["heading_rad"]
    # a turn of a / b: relative errors of the radii and of the track add up
    left_m, right_m = 1.5 * (3.0 - 0.5 * TRACK_M), 1.5 * (3.0 + 0.5 * TRACK_M)
    by_radius = np.hypot(left_m / known, right_m / LAW.right.radius_m(300.0)) / TRACK_M * np.sqrt(COVARIANCE[0, 0])
    off = by_radius * rng.standard_t(5.0, n) + 1.5 / TRACK_M * std_m * rng.standard_normal(n)
    # 2.5 % of 400,000 draws beyond: the quantile to half a percent
    assert np.ptp(found.linear) == pytest.approx(2 * np.quantile(np.abs(off), 0.95), rel=0.01)


def test_the_random_part_is_that_of_the_walk_on_a_straight() -> None:
    """var(theta) = q S, var(y) = q S^3 / 3, var(x) = p S."""
    walk = RandomWalk(sigma_along_m_per_sqrt_m=2e-3, sigma_heading_rad_per_sqrt_m=1e-3)
    path = made(Route.from_segments("r", straight(10.0)), walk=walk)
    random = path.corrected.random[-1]
    assert random[2, 2] == pytest.approx(1e-6 * 10.0, rel=1e-9)
    assert random[1, 1] == pytest.approx(1e-6 * 1000.0 / 3.0, rel=1e-3)  # steps of 1/200 of the way
    assert random[0, 0] == pytest.approx(4e-6 * 10.0, rel=1e-9)


def test_tables_hold_what_the_path_says() -> None:
    path = made(find_route("paper_route"), walk=RandomWalk(1e-3, 1e-3, 0.3))
    errors, covariance = path.error_rows(), path.covariance_rows()
    assert len(errors) == len(covariance) == len(path.distance_m)
    last = covariance[-1]
    theta = path.reference.theta_rad[-1]
    for part, matrix in (("systematic", path.corrected.systematic), ("random", path.corrected.random)):
        assert last[f"{part}_x_y_m2"] == matrix[-1, 0, 1]
        assert last[f"{part}_y_theta_m_rad"] == matrix[-1, 1, 2]
    # at the end the route heads along y: left of it is -x
    assert theta == pytest.approx(math.pi / 2, abs=1e-12)
    assert errors[-1]["corrected_std_lateral_m"] == pytest.approx(errors[-1]["corrected_std_global_x_m"], rel=1e-9)
    assert errors[-1]["without_error_lateral_m"] == pytest.approx(-errors[-1]["without_error_global_x_m"], rel=1e-9)
    assert all(f"without_error_{name}" in errors[0] for name in COMPONENTS)


def test_cutting_a_route_leaves_it_where_it_is() -> None:
    route = Route.from_segments("r", straight(2.0), arc(1.0, -2.0), arc(0.0, 1.0), straight(-1.0))
    cut = route.cut([0.0, 0.5, 2.0, 3.0, 4.5, 99.0])
    assert len(cut) == 7
    np.testing.assert_allclose(cut.poses()[-1].stacked(), route.poses()[-1].stacked(), rtol=0.0, atol=1e-13)
    assert {0.5, 3.0, 4.5} <= set(np.round(cut.distance_m(), 12).tolist())


@pytest.mark.parametrize(
    "rows", [[], [(1.0, 300.0, 300.0)], [(0.0, 0.0, 300.0)], [(0.0, 1.0, 1.0), (0.0, 2.0, 2.0)], [(0.0, 1.0, math.nan)]]
)
def test_impossible_loads_are_refused(rows: list[tuple[float, float, float]]) -> None:
    with pytest.raises(BadInputError, match="loads along the path"):
        Loading.from_rows(rows)


def test_a_change_beyond_the_end_is_refused() -> None:
    with pytest.raises(BadInputError, match="before the end of r at 3 m"):
        made(Route.from_segments("r", straight(3.0)))
