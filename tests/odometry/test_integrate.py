"""Odometry against closed forms, plain loops and the laws of geometry."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.errors import BadInputError
from calib.odometry import SCHEMES, end_poses, integrate
from calib.odometry.poses import Poses
from calib.types import FloatArray
from tests.odometry.frames import moved

ROUNDING_M = 1e-11  # a few hundred additions of numbers of the order of 10 m, in double precision
TRACK_M = 0.7


def loop(left: FloatArray, right: FloatArray, track: float, start: tuple[float, float, float], scheme: str) -> Poses:
    """The equations sample by sample in plain Python; the exact arc by the chord between two points of a circle."""
    x, y, theta = start
    made = []
    for a, b in zip(left.tolist(), right.tolist(), strict=True):
        turn, path = (b - a) / track, 0.5 * (a + b)
        if scheme == "exact" and abs(turn) > 1e-6:
            radius = path / turn
            x += radius * (math.sin(theta + turn) - math.sin(theta))
            y -= radius * (math.cos(theta + turn) - math.cos(theta))
        else:
            heading = theta + {"end_point": 1.0, "euler": 0.0, "mid_point": 0.5, "exact": 0.5}[scheme] * turn
            x, y = x + path * math.cos(heading), y + path * math.sin(heading)
        theta += turn
        made.append((x, y, theta))
    return Poses.from_stacked(np.array(made).reshape(-1, 3))


def steps(n: int, seed: int = 0, turn: float = 0.02) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    return 0.02 + turn * rng.standard_normal(n), 0.02 + turn * rng.standard_normal(n)


def close(a: Poses, b: Poses, atol: float = ROUNDING_M) -> None:
    np.testing.assert_allclose(a.stacked(), b.stacked(), rtol=0.0, atol=atol)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("turn", [0.0, 1e-4, 0.005, 0.05, 1.0])
def test_arrays_say_what_the_equations_say_sample_by_sample(scheme: str, turn: float) -> None:
    left, right = steps(400, turn=turn)
    start = (1.0, -2.0, 0.3)
    # the loop's own chord formula loses digits as the turn goes to 1e-6: 1e-16 / 1e-6 of a step
    close(integrate(left, right, TRACK_M, start=start, scheme=scheme), loop(left, right, TRACK_M, start, scheme), 2e-10)


@pytest.mark.parametrize("block", [1, 7, 64])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_runs_laid_end_to_end_are_each_integrated_on_their_own(
    block: int, scheme: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For any block borders cut, empty runs at the beginning, in the middle and at the end included."""
    monkeypatch.setattr("calib.odometry.BLOCK", block)
    lengths = [0, 3, 1, 0, 0, 40, 7, 130, 2, 0]
    offsets = np.concatenate(([0], np.cumsum(lengths)))
    left, right = steps(offsets[-1])
    starts = np.random.default_rng(1).standard_normal((len(lengths), 3))
    flat = integrate(left, right, TRACK_M, offsets=offsets, start=starts, scheme=scheme)
    ends = end_poses(left, right, TRACK_M, offsets=offsets, start=starts, scheme=scheme)
    for run, (a, b) in enumerate(pairwise(offsets)):
        alone = loop(left[a:b], right[a:b], TRACK_M, tuple(starts[run]), scheme)
        close(flat[a:b], alone, 2e-10)
        last = alone[-1] if b > a else Poses.from_stacked(starts[run])
        close(ends[run], last, 2e-10)


def test_a_stack_of_runs_is_the_runs_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calib.odometry.BLOCK", 100)
    left, right = (part.reshape(8, 50) for part in steps(400))
    whole = integrate(left, right, TRACK_M)
    assert whole.shape == (8, 50)
    close(whole[:, -1], end_poses(left, right, TRACK_M))
    for run in range(8):
        close(whole[run], integrate(left[run], right[run], TRACK_M))


@pytest.mark.parametrize("lengths", [[300], [10, 0, 280, 10], [150, 150], [3] * 100, [1, 0, 1], [2], [0, 299, 1]])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_blocks_give_the_poses_of_the_whole(lengths: list[int], scheme: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever one ends: within a run, between two, next to an empty one."""
    offsets = np.concatenate(([0], np.cumsum(lengths)))
    left, right = steps(offsets[-1])
    starts = np.random.default_rng(1).standard_normal((len(lengths), 3))
    for track in (TRACK_M, np.linspace(0.6, 0.8, offsets[-1])):
        arguments = {"offsets": offsets, "start": starts, "scheme": scheme}
        whole = integrate(left, right, track, **arguments)  # type: ignore[arg-type]
        with monkeypatch.context() as small:
            small.setattr("calib.odometry.BLOCK", 16)
            close(whole, integrate(left, right, track, **arguments))  # type: ignore[arg-type]


def test_the_track_may_change_from_sample_to_sample() -> None:
    left, right = steps(300)
    track = np.linspace(0.6, 0.8, 300)
    pieces = [(0.0, 0.0, 0.0)]
    for i in range(300):
        end = loop(left[i : i + 1], right[i : i + 1], float(track[i]), pieces[-1], "mid_point").stacked()[0]
        pieces.append(tuple(end))
    got = integrate(left, right, track, scheme="mid_point")
    np.testing.assert_allclose(got.stacked(), pieces[1:], rtol=0.0, atol=ROUNDING_M)


@pytest.mark.parametrize("block", [7, 64])
def test_a_reading_that_is_not_a_number_spoils_nothing_before_it(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """And nothing of the runs in other blocks."""
    monkeypatch.setattr("calib.odometry.BLOCK", block)
    left, right = steps(256)
    left[100] = np.nan
    broken, whole = integrate(left, right, TRACK_M), integrate(*steps(256), TRACK_M)
    close(broken[:100], whole[:100])
    assert np.isnan(broken.stacked()[100:]).all()


def test_one_log_ends_in_one_pose_and_an_empty_one_where_it_starts() -> None:
    assert end_poses([], [], TRACK_M, start=(1.0, 2.0, 3.0)).stacked().tolist() == [1.0, 2.0, 3.0]
    left, right = steps(20_000)
    close(end_poses(left, right, TRACK_M), integrate(left, right, TRACK_M)[-1], 1e-9)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"travel_left_m": [1.0, 2.0], "travel_right_m": [1.0]}, "shapes"),
        ({"track_m": [0.7, 0.7, 0.7]}, "broadcasts"),
        ({"offsets": [0, 1]}, "offsets"),
        ({"start": [0.0, 0.0]}, "start"),
        ({"scheme": "runge"}, "exact, mid_point"),
    ],
)
def test_shapes_that_do_not_fit_are_refused_in_words(arguments: dict[str, object], words: str) -> None:
    good: dict[str, object] = {"travel_left_m": [1.0, 2.0], "travel_right_m": [1.0, 2.0], "track_m": 0.7}
    with pytest.raises(BadInputError, match=words):
        integrate(**(good | arguments))  # type: ignore[arg-type]


PATHS = st.lists(st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)), min_size=1, max_size=30).map(np.array)


@settings(max_examples=100, deadline=None)
@given(path=PATHS, scheme=st.sampled_from(SCHEMES))
def test_swapping_the_wheels_mirrors_the_path(path: FloatArray, scheme: str) -> None:
    seen = integrate(path[:, 0], path[:, 1], TRACK_M, scheme=scheme)
    swapped = integrate(path[:, 1], path[:, 0], TRACK_M, scheme=scheme)
    close(Poses(seen.x_m, -seen.y_m, -seen.theta_rad), swapped)


@settings(max_examples=100, deadline=None)
@given(path=PATHS, factor=st.floats(0.01, 100.0), scheme=st.sampled_from(SCHEMES))
def test_scaling_all_lengths_scales_the_path_and_leaves_the_headings(
    path: FloatArray, factor: float, scheme: str
) -> None:
    seen = integrate(path[:, 0], path[:, 1], TRACK_M, scheme=scheme)
    scaled = integrate(factor * path[:, 0], factor * path[:, 1], factor * TRACK_M, scheme=scheme)
    close(Poses(factor * seen.x_m, factor * seen.y_m, seen.theta_rad), scaled, ROUNDING_M * max(1.0, factor))


@settings(max_examples=100, deadline=None)
@given(path=PATHS, scheme=st.sampled_from(["exact", "mid_point"]))
def test_driving_the_steps_back_in_reverse_order_leads_home(path: FloatArray, scheme: str) -> None:
    """Only the symmetric schemes have this property."""
    there = end_poses(path[:, 0], path[:, 1], TRACK_M, scheme=scheme)
    back = end_poses(-path[::-1, 0], -path[::-1, 1], TRACK_M, start=there.stacked(), scheme=scheme)
    np.testing.assert_allclose(back.stacked(), 0.0, rtol=0.0, atol=ROUNDING_M)


@settings(max_examples=100, deadline=None)
@given(path=PATHS, pieces=st.integers(2, 20))
def test_the_exact_arc_does_not_depend_on_the_sampling(path: FloatArray, pieces: int) -> None:
    coarse = integrate(path[:, 0], path[:, 1], TRACK_M)
    fine = integrate(np.repeat(path[:, 0] / pieces, pieces), np.repeat(path[:, 1] / pieces, pieces), TRACK_M)
    close(fine[pieces - 1 :: pieces], coarse)


def test_turning_the_start_turns_the_whole_path() -> None:
    left, right = steps(200)
    start = Poses.from_stacked([3.0, -1.0, 2.0])
    close(moved(integrate(left, right, TRACK_M), start), integrate(left, right, TRACK_M, start=start.stacked()))


def test_ten_million_steps_of_a_circle_keep_the_heading_and_the_place() -> None:
    """A thousand laps of 10 m circumference: rounding stays far below a micrometre."""
    n, laps, track = 10_000_000, 1000, TRACK_M
    step, turn = laps * 10.0 / n, laps * 2 * math.pi / n
    left, right = np.full(n, step - 0.5 * track * turn), np.full(n, step + 0.5 * track * turn)
    end = end_poses(left, right, track)
    # the inputs themselves are rounded: 1e-16 relative to each, times 1e4 m over the track
    assert abs(float(end.theta_rad) - laps * 2 * math.pi) < 1e-9
    assert math.hypot(float(end.x_m), float(end.y_m)) < 1e-8
