"""Conditions follow what was driven: names do not matter, lengths, turns, loads and speeds do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.gap.observations.from_campaign import observations_of
from calib.gap.observations.routes import levels, row_numbers, speed_width_mps
from tests.gap.effects.making import ROUTE, SQUARE, STRAIGHT, Run, campaign
from tests.gap.observations.paths import Truth, campaign_of

LEFT = [(length, kappa) for length, kappa in SQUARE]
RIGHT = [(length, -kappa) for length, kappa in SQUARE]


def partition(labels: np.ndarray) -> set[frozenset[int]]:
    """Groups of units, no matter what their numbers."""
    return {frozenset(np.flatnonzero(labels == label).tolist()) for label in np.unique(labels)}


def rich() -> list[Run]:
    runs = []
    for pieces, kind in ((STRAIGHT, "corridor"), (LEFT, "square_ccw"), (RIGHT, "square_cw"), (ROUTE, "route_left")):
        for load in (300.0, 500.0):
            runs += [Run(pieces, kind=kind, load_left_N=load, load_right_N=load, speed_mps=v) for v in (0.4, 0.8)] * 2
    return runs


def test_names_of_routes_do_not_matter() -> None:
    """With its labels, without them, and with made-up ones a campaign has the same routes, conditions and cells."""
    made = campaign(rich())
    rng = np.random.default_rng(1)
    plain = observations_of(made)
    assert len(partition(plain.kind)) == 4
    assert len(partition(plain.condition)) == 16
    for kind in (None, rng.choice(["a", "b"], len(made.runs)), made.runs.run_id):
        labels = {name: column for name, column in made.runs.labels.items() if name not in ("kind", "session")}
        labels |= {} if kind is None else {"kind": kind}
        other = observations_of(replace(made, runs=replace(made.runs, labels=labels)))
        for name in ("kind", "condition", "cell"):
            assert partition(getattr(other, name)) == partition(getattr(plain, name)), name


def test_the_order_of_the_runs_does_not_matter() -> None:
    made = campaign(rich())
    order = np.random.default_rng(2).permutation(len(made.runs))
    plain, shuffled = observations_of(made), observations_of(made.select(order))
    assert partition(shuffled.condition) == partition(np.asarray(plain.condition)[order])


def test_wheels_of_unlike_radii_make_no_other_route() -> None:
    """A straight of 40 m with one wheel 1 % too large seems to turn by half a radian: it is a straight all the same."""
    straight = Truth([(40.0, 0.0)])
    logs = []
    for k in range(12):
        counts = straight.counts()
        logs.append(counts | {"counts_left": counts["counts_left"] * (1.01 if k % 2 else 1.0)})
    observations = observations_of(campaign_of(logs, numbers={"distance_m": np.full(12, 40.0)}))
    assert len(partition(observations.kind)) == 1


def test_straights_and_bows_are_two_routes_where_the_heading_is_measured() -> None:
    truths = [Truth([(10.0, 0.08 * (k % 2))]) for k in range(12)]
    ends = np.array([t.end() for t in truths])
    numbers = dict(zip(("ref_x_m", "ref_y_m", "ref_theta_rad"), ends.T, strict=True))
    observations = observations_of(campaign_of([t.counts() for t in truths], numbers=numbers))
    assert partition(observations.kind) == {frozenset(range(0, 12, 2)), frozenset(range(1, 12, 2))}


@given(st.lists(st.floats(-50, 50), min_size=1, max_size=30), st.floats(0.5, 5))
def test_levels_split_where_there_is_a_step_and_are_never_wide(values: list[float], width: float) -> None:
    """Two values of one level differ by twice the width at most; neighbours in size apart by more than it are two."""
    array = np.array(values)
    level = levels(array, width)
    # the ends of the bins are rounded
    assert all(np.ptp(array[level == number]) <= 2 * width * (1 + 1e-9) for number in np.unique(level))
    order = np.argsort(array)
    apart = np.diff(array[order]) > width
    assert (level[order][1:][apart] != level[order][:-1][apart]).all()


def test_levels_keep_scattered_set_values_together_wherever_they_lie() -> None:
    """300 N and 305 N with scatter of 1 N and a width of 3 N are two levels; what is unknown is a third."""
    rng = np.random.default_rng(3)
    for base in np.linspace(300, 305, 11):
        values = np.concatenate([base + rng.uniform(-1, 1, 20), base + 6 + rng.uniform(-1, 1, 20), [np.nan]])
        assert partition(levels(values, 3.0)) == {frozenset(range(20)), frozenset(range(20, 40)), frozenset([40])}


def test_joined_numbers_rows_in_the_order_of_first_appearance() -> None:
    columns = [np.array([5, 5, 1, 1, 5]), np.array(["b", "a", "b", "b", "b"])]
    assert row_numbers(columns).tolist() == [0, 1, 2, 2, 0]


@pytest.mark.parametrize(("speed", "width"), [(0.04, 0.004), (0.5, 0.05), (2.0, 0.05)])
def test_what_counts_as_another_speed_follows_the_speed(speed: float, width: float) -> None:
    assert speed_width_mps(np.full(5, speed)) == pytest.approx(width)
