"""Checks of the design: one measurement under two names."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.checks import pasted_rows
from calib.campaign.model import Campaign
from tests.kinematics.campaigns import Truth, campaign, square

#: what a file written anew changes of a position, and what no reference repeats: 2 mm of uncertainty
LAST_DIGIT_M, MEASURED_ANEW_M = 1e-5, 1e-3


def _driven(*, along: bool) -> Campaign:
    """Six squares with noise-free wheels, so that runs of one sense count the same, and a noisy reference."""
    routes = [("square", square(2.0, sense)) for sense in (1, 1, 1, -1, -1, -1)]
    return campaign(routes, Truth(), np.random.default_rng(1), along=along)


def _again(made: Campaign, run: int, moved_m: float, *, logs: bool = True) -> Campaign:
    """A run once more under another name, its positions moved a little."""
    twice = made.select([*range(len(made.runs)), run])
    names = np.append(made.runs.run_id, "again")
    numbers = {name: column.copy() for name, column in twice.runs.numbers.items()}
    columns = dict(twice.logs.columns)
    if "ref_x_m" in numbers:
        numbers["ref_x_m"][-1] += moved_m
    if "ref_x_m" in columns:
        columns["ref_x_m"] = columns["ref_x_m"] + moved_m * (
            np.arange(twice.logs.offsets[-1]) >= twice.logs.offsets[-2]
        )
    runs = replace(twice.runs, labels={**twice.runs.labels, "run_id": names}, numbers=numbers)
    kept = replace(twice.logs, columns=columns) if logs else type(made.logs).empty(len(runs))
    return replace(twice, runs=runs, logs=kept)


@pytest.mark.parametrize("along", [True, False])
@pytest.mark.parametrize("moved_m", [0.0, LAST_DIGIT_M])
def test_a_run_recorded_under_two_names_is_named(along: bool, moved_m: float) -> None:
    """By its log, with a reference along the path or at the end alone."""
    (found,) = pasted_rows(_again(_driven(along=along), 2, moved_m))
    assert (found.run_id, found.level, found.code) == ("again", "suspicious", "pasted_row")
    assert "run r002" in found.text


def test_an_end_pose_pasted_twice_is_named_without_logs() -> None:
    (found,) = pasted_rows(_again(_driven(along=False), 2, 0.0, logs=False))
    assert (found.run_id, "run r002" in found.text) == ("again", True)


@pytest.mark.parametrize("along", [True, False])
def test_counts_alone_repeat_honestly(along: bool) -> None:
    """Wheels without noise count the same in each run of a route; the reference was read anew in each."""
    made = _driven(along=along)
    counts = [made.logs.of(run)["counts_left"] for run in range(3)]
    assert all(np.array_equal(counts[0], other) for other in counts)
    assert list(pasted_rows(made)) == []
    assert list(pasted_rows(_again(made, 2, MEASURED_ANEW_M))) == []
    assert list(pasted_rows(_again(made, 2, MEASURED_ANEW_M, logs=False))) == []


def test_loops_closed_by_their_mark_measured_nothing_of_their_own() -> None:
    """Ends that are 0 by the mark are no measurement that repeats."""
    made = _driven(along=False)
    zero = {name: np.zeros(6) for name in ("ref_x_m", "ref_y_m", "ref_theta_rad")}
    closed = replace(made, runs=replace(made.runs, numbers={**made.runs.numbers, **zero}))
    assert list(pasted_rows(replace(closed, logs=type(made.logs).empty(6)))) == []
