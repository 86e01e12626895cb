"""The paper's Section 7 and its Eq. 7, recomputed: every table to the digits printed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calib.odometry import end_poses
from calib.odometry.poses import Poses, pose_errors
from calib.odometry.routes import Axle, end_of_route, find_route, follow

TRACK_M = 0.7
BELIEVED = Axle(0.1, 0.1, TRACK_M)
MICROMETRE = 0.5e-6  # tables with six decimals
TENTH_MM = 0.5e-5  # tables with five decimals


def real_radii(which: str, ratio: float) -> tuple[float, float]:
    """(left, right) relative to the believed radius for E_r = right / left."""
    return {
        "right": (1.0, ratio),
        "left": (1.0 / ratio, 1.0),
        "both": (2.0 / (1.0 + ratio), 2.0 * ratio / (1.0 + ratio)),
    }[which]


def end(route: str, left: float, right: float, track_m: float = TRACK_M) -> Poses:
    believed = Axle(0.1, 0.1, track_m)
    return end_of_route(find_route(route), believed, Axle(0.1 * left, 0.1 * right, track_m))[0]


def test_the_route_ends_at_8_8_90_degrees() -> None:
    pose = find_route("paper_route").poses()[-1]
    np.testing.assert_allclose(pose.stacked(), [8.0, 8.0, math.pi / 2], rtol=0.0, atol=1e-14)


@pytest.mark.parametrize(
    ("ratio", "first", "x", "y", "degrees", "error"),
    [
        (0.98, 4.9000, 8.052432, 7.803350, 88.2000, 0.203520),
        (0.98825, 4.9413, 8.031934, 7.885041, 88.9425, 0.119312),
        (0.98971, 4.9486, 8.028140, 7.899415, 89.0739, 0.104447),
        (0.99, 4.9500, 8.027381, 7.902267, 89.1000, 0.101496),
    ],
)
def test_equal_radii_shorten_the_route(
    ratio: float, first: float, x: float, y: float, degrees: float, error: float
) -> None:
    """Fig. 12."""
    poses = follow(find_route("paper_route"), BELIEVED, Axle(0.1 * ratio, 0.1 * ratio, TRACK_M))[0]
    # 4.94125 and 4.94855 lie on the border of two roundings
    assert float(poses.x_m[1]) == pytest.approx(first, abs=0.50001e-4)
    last = poses[-1]
    np.testing.assert_allclose((last.x_m, last.y_m), (x, y), rtol=0.0, atol=MICROMETRE)
    assert math.degrees(float(last.theta_rad)) == pytest.approx(degrees, abs=0.5e-4)
    assert math.hypot(float(last.x_m) - 8.0, float(last.y_m) - 8.0) == pytest.approx(error, abs=MICROMETRE)


@pytest.mark.parametrize(
    ("which", "ratio", "x", "y"),
    [
        ("right", 0.99, -0.188960, -1.592997),
        ("right", 1.01, -0.040105, +1.609007),
        ("left", 0.99, -0.041685, -1.625215),
        ("left", 1.01, -0.185983, +1.577423),
        ("both", 0.99, -0.115684, -1.608986),
        ("both", 1.01, -0.113398, +1.593098),
    ],
)
def test_unequal_radii_bend_the_straight(which: str, ratio: float, x: float, y: float) -> None:
    """Fig. 13: global errors at the end of 15 m."""
    pose = end("straight15", *real_radii(which, ratio))
    np.testing.assert_allclose((pose.x_m - 15.0, pose.y_m), (x, y), rtol=0.0, atol=MICROMETRE)


def test_the_bend_of_the_straight_is_the_textbook_parabola_to_first_order() -> None:
    """e_y = (E_r - 1) S^2 / 2b, 1.60714 m at one percent."""
    first_order = 0.01 * 15.0**2 / (2 * TRACK_M)
    assert first_order == pytest.approx(1.60714, abs=TENTH_MM)
    small = 1e-6
    pose = end("straight15", *real_radii("both", 1.0 + small))
    # second order in small
    assert float(pose.y_m) / small == pytest.approx(15.0**2 / (2 * TRACK_M), rel=1e-5)


@pytest.mark.parametrize(
    ("which", "ratio", "x", "y"),
    [
        ("right", 0.99, +1.19578, -0.61858),
        ("right", 1.01, -1.24753, +0.41224),
        ("left", 0.99, +1.19415, -0.51603),
        ("left", 1.01, -1.19433, +0.32638),
        ("both", 0.99, +1.19524, -0.56748),
        ("both", 1.01, -1.22052, +0.36933),
    ],
)
def test_unequal_radii_miss_the_end_of_the_route(which: str, ratio: float, x: float, y: float) -> None:
    """Fig. 14: global errors, x lateral to the last straight."""
    pose = end("paper_route", *real_radii(which, ratio))
    errors = pose_errors(pose, Poses.from_stacked([8.0, 8.0, math.pi / 2]))
    np.testing.assert_allclose((errors.global_x_m, errors.global_y_m), (x, y), rtol=0.0, atol=TENTH_MM)
    # along the last straight is global y, left of it is minus global x
    np.testing.assert_allclose((errors.along_m, errors.lateral_m), (y, -x), rtol=0.0, atol=TENTH_MM)


@pytest.mark.parametrize(
    ("which", "ratio", "x"),
    [
        ("right", 0.9994, +0.07357),
        ("right", 1.0006, -0.07375),
        ("left", 0.9994, +0.07195),
        ("left", 1.0006, -0.07195),
        ("both", 0.9994, +0.07276),
        ("both", 1.0006, -0.07285),
    ],
)
def test_the_corrected_radii_leave_seven_centimetres(which: str, ratio: float, x: float) -> None:
    """Fig. 16."""
    assert float(end("paper_route", *real_radii(which, ratio)).x_m) - 8.0 == pytest.approx(x, abs=TENTH_MM)


def test_with_the_vehicles_width_as_track_come_the_papers_printed_errors() -> None:
    """1.1 m before and 0.06 m after the correction, each the largest case to the digits printed, with track 0.8 m."""

    def largest(*ratios: float) -> float:
        ends = [end("paper_route", *real_radii(which, r), 0.8) for which in ("right", "left", "both") for r in ratios]
        return max(abs(float(pose.x_m) - 8.0) for pose in ends)

    assert round(largest(0.99, 1.01), 1) == 1.1
    assert round(largest(0.9994, 1.0006), 2) == 0.06


@pytest.mark.parametrize(
    ("dt_s", "end_point", "euler", "mid_point"),
    [
        (0.01, 0.003535, 0.003535, 4.91e-7),
        (0.05, 0.017659, 0.017659, 1.23e-5),
        (0.10, 0.035301, 0.035300, 4.90e-5),
        (0.20, 0.070584, 0.070584, 1.96e-4),
        (0.50, 0.175833, 0.175811, 1.22e-3),
    ],
)
def test_integration_schemes_miss_the_end_of_an_arc(
    dt_s: float, end_point: float, euler: float, mid_point: float
) -> None:
    """Eq. (7): 90 degrees of R = 3 m at 0.5 m/s, the last step cut to what is left of the arc."""
    turn = 0.5 / 3.0 * dt_s
    n = math.ceil(math.pi / 2 / turn - 1e-9)
    turns = np.diff(np.minimum(np.arange(n + 1) * turn, math.pi / 2))
    left, right = (3.0 - TRACK_M / 2) * turns, (3.0 + TRACK_M / 2) * turns
    misses = {}
    for scheme in ("end_point", "euler", "mid_point", "exact"):
        pose = end_poses(left, right, TRACK_M, scheme=scheme)
        misses[scheme] = math.hypot(float(pose.x_m) - 3.0, float(pose.y_m) - 3.0)
    assert misses["end_point"] == pytest.approx(end_point, abs=MICROMETRE)
    assert misses["euler"] == pytest.approx(euler, abs=MICROMETRE)
    # printed with three digits
    assert misses["mid_point"] == pytest.approx(mid_point, rel=0.0051)
    assert misses["exact"] < 1e-13
    assert misses["end_point"] == pytest.approx(0.35355 * dt_s, rel=0.01)


def test_a_closed_square_hides_the_integration_scheme() -> None:
    """The errors of the four corners cancel."""
    route = find_route("square_ccw").divided(0.1)
    half = 0.5 * TRACK_M * route.turn_rad
    for scheme in ("end_point", "euler", "mid_point", "exact"):
        pose = end_poses(route.length_m - half, route.length_m + half, TRACK_M, scheme=scheme)
        assert math.hypot(float(pose.x_m), float(pose.y_m)) < 1e-12
