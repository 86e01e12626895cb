"""The path that counts and a hypothesis give, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.gap import Perturbation, total_perturbation
from calib.gap.observations import POSE, Channel
from calib.gap.predict import predict, residuals, signature
from tests.gap.effects.making import SQUARE, TRACK_M, Motion, Run, end_pose, rich_runs, situation, steps_of

LINE = [(12.0, 0.0)]
RUNS = 12


def ones(value: float = 1.0) -> np.ndarray:
    return np.full(RUNS, value)


def test_a_straight_with_unequal_radii_turns_by_eps_s_over_b_and_strays_by_eps_s_squared_over_2b() -> None:
    s = situation([Run(LINE) for _ in range(RUNS)])
    eps = 1e-5
    reading = predict(s, [Perturbation(left=ones(-eps / 2), right=ones(eps / 2))]).reading[0]
    # the next terms are of second order in the heading, (2e-4 rad)^2
    assert reading[3] == pytest.approx(eps * 12.0 / TRACK_M, rel=1e-9)
    assert reading[2] == pytest.approx(eps * 12.0**2 / (2 * TRACK_M), rel=1e-6)
    assert reading[1] == pytest.approx(12.0, rel=1e-7)


def test_a_straight_with_unequal_radii_is_an_arc() -> None:
    """At any size: radius b / eps, so x = R sin, y = R (1 - cos)."""
    s = situation([Run(LINE, steps=400) for _ in range(RUNS)])
    eps = 0.05
    theta = eps * 12.0 / TRACK_M
    radius = 12.0 / theta
    reading = predict(s, [Perturbation(left=ones(-eps / 2), right=ones(eps / 2))]).reading[0]
    # chords cut after the second order of 2e-3 rad a step
    np.testing.assert_allclose(
        reading[1:4], [radius * np.sin(theta), radius * (1 - np.cos(theta)), theta], rtol=0, atol=1e-9
    )


def test_a_closed_square_with_a_wrong_track_ends_turned_by_two_pi_db_over_b() -> None:
    s = situation([Run(SQUARE, kind="square_ccw", steps=400) for _ in range(RUNS)])
    share = 1e-3
    reading = predict(s, [Perturbation(track=ones(share))]).reading[0]
    # (2 pi - db/b 2 pi) up to the square of the share
    assert reading[3] - 2 * np.pi == pytest.approx(-2 * np.pi * share, rel=2e-3)


def test_a_square_with_a_wrong_track_opens_by_the_turns_at_its_corners() -> None:
    """Each corner turns short by the same angle; the end point moves by that angle about each corner's arc."""
    s = situation([Run(SQUARE, kind="square_ccw", steps=400) for _ in range(RUNS)])
    share = 1e-4
    reading = predict(s, [Perturbation(track=ones(share))]).reading[0]
    # brute force: the same pieces turned short, by complex numbers
    ds, turn, _ = steps_of(Run(SQUARE, steps=400))
    expected = end_pose(ds, turn / (1.0 + share))
    # the plan's jumps of curvature (0.06 rad a step) may be rounded off within a step of 3 cm: 0.06 / 24 of it each
    np.testing.assert_allclose(reading[1:4], expected, rtol=0, atol=8 * 0.06 / 24 * 0.03)


def test_without_a_hypothesis_the_path_is_that_of_the_counts() -> None:
    runs = rich_runs()
    s = situation(runs)
    path = predict(s)
    for number, run in enumerate(runs):
        if run.log:
            ds, turn, _ = steps_of(run)
            # as above, at up to 0.06 rad a step and eight jumps
            np.testing.assert_allclose(path.end[number], end_pose(ds, turn), rtol=0, atol=8 * 0.06 / 24 * 0.03)


def test_front_wheel_and_rear_wheels_agree_on_a_plain_drive() -> None:
    """Eqs 12 to 14: distance hypot(ds, L dtheta) and heading sin(delta) ds / L of the front wheel."""
    s = situation([Run([(4.0, 0.2)], kind="bend") for _ in range(RUNS)])
    # one curvature throughout: rounding only
    np.testing.assert_allclose(predict(s).reading[:, 4:], 0.0, atol=1e-9)


def test_the_laser_reads_the_projection_on_the_start_heading_where_the_end_poses_say_so() -> None:
    s = situation([Run([(10.0, 0.01)]) for _ in range(RUNS)])
    np.testing.assert_array_equal(s.axis, 1.0)
    # x of an arc of 100 m
    np.testing.assert_allclose(predict(s).reading[:, 0], 100.0 * np.sin(0.1), rtol=1e-9)


def test_the_laser_reads_a_length_of_a_run_driven_backward_too() -> None:
    """Of an arc of 100 m driven backward: what it moved behind its start, and what radii 1 % larger add to that."""
    s = situation([Run([(-10.0 if n % 2 else 10.0, 0.01)]) for n in range(RUNS)])
    np.testing.assert_array_equal(s.axis, np.where(np.arange(RUNS) % 2, -1.0, 1.0))
    path = predict(s)
    np.testing.assert_allclose(path.reading[:, 0], 100.0 * np.sin(0.1), rtol=1e-9)
    np.testing.assert_allclose(residuals(path, path)[:, 0], 0.0, atol=1e-9)
    both = Perturbation(left=np.ones(RUNS), right=np.ones(RUNS))
    step = predict(s, [both.scaled(1e-6)]).reading[:, 0] - path.reading[:, 0]
    # rtol: the second order of a step of 1e-6
    np.testing.assert_allclose(signature(path, both)[:, 0], 1e6 * step, rtol=1e-4)
    assert (step > 0.0).all()


@pytest.mark.parametrize("field", ["left", "right", "track"])
def test_a_push_by_units_is_the_same_as_one_by_steps(field: str) -> None:
    s = situation(rich_runs())
    path = predict(s)
    values = np.linspace(-1.0, 1.0, len(s))
    by_units = signature(path, Perturbation(**{field: values}))
    by_steps = signature(path, Perturbation(**{field: values[s.unit]}))
    # the same sums in another order
    np.testing.assert_allclose(by_units, by_steps, rtol=1e-9, atol=1e-9)


def test_pushes_add_up_whatever_their_shapes() -> None:
    s = situation(rich_runs())
    by_unit, by_step = np.linspace(0.0, 1e-3, len(s)), np.linspace(0.0, 1e-3, len(s.unit))
    both = total_perturbation(s, [Perturbation(left=by_unit), Perturbation(left=by_step), Perturbation(right=by_unit)])
    assert both.left is not None and both.right is not None
    np.testing.assert_allclose(both.left, by_unit[s.unit] + by_step)
    np.testing.assert_allclose(both.right, by_unit)


curvatures = st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=4)
shares = st.floats(-0.02, 0.02)


@given(curvatures, shares, shares, shares)
def test_mirrored_routes_with_mirrored_wheels_end_mirrored(
    bends: list[float], left: float, right: float, track: float
) -> None:
    """Left and right may be exchanged: y, heading and lateral change sign, nothing else."""
    there = situation([Run([(2.0, kappa) for kappa in bends], front=False) for _ in range(RUNS)])
    mirror = situation([Run([(2.0, -kappa) for kappa in bends], front=False) for _ in range(RUNS)])
    one = predict(there, [Perturbation(left=ones(left), right=ones(right), track=ones(track))])
    other = predict(mirror, [Perturbation(left=ones(right), right=ones(left), track=ones(track))])
    signs = np.array([1.0, -1.0, -1.0])
    # rounding over a hundred steps
    np.testing.assert_allclose(one.end, other.end * signs, rtol=0, atol=1e-9)


@given(curvatures, shares, shares)
def test_a_signature_turns_with_its_push(bends: list[float], left: float, right: float) -> None:
    """Linear: the signature of a sum is the sum of the signatures."""
    s = situation([Run([(2.0, kappa) for kappa in bends], front=False) for _ in range(RUNS)])
    path = predict(s)
    whole = signature(path, Perturbation(left=ones(left), right=ones(right)))
    parts = signature(path, Perturbation(left=ones(left))) + signature(path, Perturbation(right=ones(right)))
    np.testing.assert_allclose(whole, parts, rtol=0, atol=1e-12)


@given(curvatures, st.floats(-np.pi, np.pi))
def test_a_turn_at_the_start_swings_the_end_about_the_start(bends: list[float], angle: float) -> None:
    """A perturbation of heading in the first step is a rotation of the whole path about its first step's middle."""
    s = situation([Run([(2.0, kappa) for kappa in bends], front=False, steps=200) for _ in range(RUNS)])
    heading = np.zeros(len(s.unit))
    heading[s.starts[:-1]] = angle
    plain, turned = predict(s), predict(s, [Perturbation(heading_rad=heading)])
    place, moved = (path.end[0, 0] + 1j * path.end[0, 1] for path in (plain, turned))
    first = float(s.path_m[0])
    # the first step itself (0.04 m) bends, the rest turns about its middle: no further off than that step is long
    assert abs(moved - (0.5 * first + (place - 0.5 * first) * np.exp(1j * angle))) <= first
    assert turned.end[0, 2] == pytest.approx(plain.end[0, 2] + angle, abs=1e-9)


#: radii off against each other by so much a run: headings off by 0 to 0.03 rad
BENDS = (0.0, 6e-4, -1e-3, 2e-3)
#: what is left of the second order, a share of it: the third is smaller by the heading in radians
THIRD_ORDER = 0.05


@pytest.mark.parametrize(
    "pieces", [LINE, [(4.0, 0.0), (1.5, 1.0), (4.0, 0.0)], SQUARE], ids=["straight", "bend", "square"]
)
def test_a_run_that_bends_ends_off_by_its_signature_to_second_order(pieces: list[tuple[float, float]]) -> None:
    """A guided vehicle whose radii are off against each other: the square of the bend is of one sign in every run."""
    sizes = iter(BENDS)

    def truth(_: Run, now: Motion) -> None:
        size = next(sizes)
        now.left, now.right = -size / 2, size / 2

    s = situation([Run(pieces, steps=400, front=False) for _ in BENDS], truth=truth)
    nominal = predict(s)
    gap = residuals(nominal, nominal)
    size = np.array(BENDS)
    linear = signature(nominal, Perturbation(left=-size / 2, right=size / 2))
    first = [Channel.DISTANCE, *POSE] if pieces is LINE else list(POSE)
    largest = np.abs(gap[:, Channel.HEADING, None] ** 2 * nominal.bent_m).max()
    # the first run is off by what its steps are chords of arcs
    assert np.abs(gap - gap[0] - linear)[:, first].max() < THIRD_ORDER * largest
    assert largest > 3e-4
