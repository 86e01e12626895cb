"""The closed-loop vehicle against a time-stepped loop, and the laws it obeys."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.errors import BadInputError
from calib.odometry.poses import Poses
from calib.odometry.routes import NAMED, Axle, Route, arc, end_of_route, find_route, follow, straight

ROUNDING_M = 1e-12

BELIEVED = Axle(0.1, 0.1, 0.7)


def stepped(
    route: Route, believed: Sequence[float], real: Sequence[float], step_m: float = 0.02
) -> tuple[float, float, float]:
    """A controller that, step by step, turns the wheels as the believed radii ask; the wheels roll on the real ones."""
    x = y = theta = 0.0
    for length, turn in zip(route.length_m.tolist(), route.turn_rad.tolist(), strict=True):
        n = max(1, math.ceil(abs(length) / step_m), math.ceil(abs(turn) / 0.01))
        for _ in range(n):
            left_rad = (length - 0.5 * believed[2] * turn) / n / believed[0]
            right_rad = (length + 0.5 * believed[2] * turn) / n / believed[1]
            left, right = left_rad * real[0], right_rad * real[1]
            bend = (right - left) / real[2]
            path = 0.5 * (left + right)
            u = 0.5 * bend
            chord = path * (math.sin(u) / u if abs(u) > 1e-7 else 1.0 - u * u / 6.0)
            x += chord * math.cos(theta + u)
            y += chord * math.sin(theta + u)
            theta += bend
    return x, y, theta


@pytest.mark.parametrize("name", NAMED)
def test_the_exact_solution_is_that_of_a_time_stepped_loop(name: str) -> None:
    route = find_route(name)
    rng = np.random.default_rng(6)
    n = 20
    believed = Axle(*(scale * (1 + 0.01 * rng.standard_normal(n)) for scale in (0.1, 0.1, 0.7)))
    real = Axle(*(scale * (1 + 0.01 * rng.standard_normal(n)) for scale in (0.1, 0.1, 0.7)))
    ends = end_of_route(route, believed, real)
    looped = [
        stepped(route, [float(a[k]) for a in believed.arrays()], [float(a[k]) for a in real.arrays()]) for k in range(n)
    ]
    np.testing.assert_allclose(ends.stacked(), looped, rtol=0.0, atol=ROUNDING_M * max(1.0, route.total_m / 10))


def test_end_poses_alone_are_those_of_the_whole_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calib.odometry.routes.BLOCK", 7)
    route = find_route("figure8")
    real = Axle(np.linspace(0.098, 0.102, 30), 0.1, np.linspace(0.69, 0.71, 30))
    np.testing.assert_allclose(
        end_of_route(route, BELIEVED, real).stacked(),
        follow(route, BELIEVED, real)[:, -1].stacked(),
        rtol=0.0,
        atol=1e-11,  # sums of arcs of 12 m in another order
    )


def test_a_vehicle_that_knows_itself_stays_on_the_route() -> None:
    for name in NAMED:
        route = find_route(name).divided(0.1)
        driven = follow(route, Axle(0.099, 0.101, 0.68), Axle(0.099, 0.101, 0.68))[0]
        np.testing.assert_allclose(driven.stacked(), route.poses().stacked(), rtol=0.0, atol=1e-12)


SEGMENTS = st.lists(
    st.one_of(
        st.builds(straight, st.floats(-5.0, 5.0)),
        st.builds(arc, st.floats(0.0, 4.0), st.floats(-2 * math.pi, 2 * math.pi)),
    ),
    min_size=1,
    max_size=8,
)
RATIO = st.floats(0.97, 1.03)


@settings(max_examples=150, deadline=None)
@given(segments=SEGMENTS, left=RATIO, right=RATIO)
def test_swapped_wheels_on_the_mirrored_route_drive_the_mirrored_path(
    segments: list[tuple[float, float]], left: float, right: float
) -> None:
    route = Route.from_segments("r", *segments)
    seen = end_of_route(route, BELIEVED, Axle(0.1 * left, 0.1 * right, 0.7))
    mirrored = end_of_route(route.mirrored(), BELIEVED, Axle(0.1 * right, 0.1 * left, 0.7))
    np.testing.assert_allclose(
        mirrored.stacked(), Poses(seen.x_m, -seen.y_m, -seen.theta_rad).stacked(), rtol=0.0, atol=1e-11
    )


@settings(max_examples=150, deadline=None)
@given(segments=SEGMENTS, left=RATIO, right=RATIO, scale=st.floats(0.1, 10.0))
def test_scaling_the_route_and_the_vehicle_scales_the_error(
    segments: list[tuple[float, float]], left: float, right: float, scale: float
) -> None:
    route = Route.from_segments("r", *segments)
    large = Route("r", scale * route.length_m, route.turn_rad)
    small = end_of_route(route, BELIEVED, Axle(0.1 * left, 0.1 * right, 0.7))
    made = end_of_route(
        large, Axle(0.1 * scale, 0.1 * scale, 0.7 * scale), Axle(0.1 * left * scale, 0.1 * right * scale, 0.7 * scale)
    )
    np.testing.assert_allclose((made.x_m, made.y_m), (scale * small.x_m, scale * small.y_m), rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(made.theta_rad, small.theta_rad, rtol=0.0, atol=1e-11)


@settings(max_examples=150, deadline=None)
@given(segments=SEGMENTS, left=RATIO, right=RATIO, spacing=st.floats(0.05, 2.0))
def test_dividing_the_route_does_not_move_the_end(
    segments: list[tuple[float, float]], left: float, right: float, spacing: float
) -> None:
    route = Route.from_segments("r", *segments)
    real = Axle(0.1 * left, 0.1 * right, 0.7)
    coarse, fine = end_of_route(route, BELIEVED, real), end_of_route(route.divided(spacing), BELIEVED, real)
    np.testing.assert_allclose(fine.stacked(), coarse.stacked(), rtol=0.0, atol=1e-11)


@settings(max_examples=100, deadline=None)
@given(segments=SEGMENTS, left=RATIO, right=RATIO)
def test_driving_the_route_back_leads_home_whatever_the_radii(
    segments: list[tuple[float, float]], left: float, right: float
) -> None:
    there = Route.from_segments("r", *segments)
    whole = Route(
        "there and back",
        np.concatenate([there.length_m, -there.length_m[::-1]]),
        np.concatenate([there.turn_rad, -there.turn_rad[::-1]]),
    )
    end = end_of_route(whole, BELIEVED, Axle(0.1 * left, 0.1 * right, 0.71))
    np.testing.assert_allclose(end.stacked(), 0.0, rtol=0.0, atol=1e-11)


def test_only_ratios_of_radii_matter() -> None:
    route = find_route("paper_route")
    a = end_of_route(route, Axle(0.1, 0.1, 0.7), Axle(0.099, 0.1, 0.7))
    b = end_of_route(route, Axle(0.2, 0.3, 0.7), Axle(0.198, 0.3, 0.7))
    np.testing.assert_allclose(a.stacked(), b.stacked(), rtol=0.0, atol=ROUNDING_M)


@pytest.mark.parametrize("bad", [0.0, -0.1, math.nan, math.inf])
def test_impossible_radii_are_refused(bad: float) -> None:
    with pytest.raises(BadInputError, match="left radius"):
        end_of_route(find_route("corridor"), BELIEVED, Axle(bad, 0.1, 0.7))


def test_unlike_lengths_are_refused() -> None:
    with pytest.raises(BadInputError, match="unlike lengths"):
        end_of_route(find_route("corridor"), BELIEVED, Axle(np.full(3, 0.1), np.full(4, 0.1), 0.7))
