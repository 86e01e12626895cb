"""Where a rangefinder alone measures lengths, the run that tells its scale from the radii is a corridor by tape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.plan.next_runs import _measured, size_of
from calib.gap.plan.planned_runs import Dimensions, Measured, PlannedRun, drive, route_of
from tests.gap.effects.making import SQUARE, STRAIGHT, Motion, Run, campaign

INSTRUMENT = {"rangefinder_scale", "beam_misalignment", "rangefinder_offset"}


def by_laser(taped: int = 0) -> Campaign:
    """Squares that a reference sees and straights of two lengths that a laser alone does, which reads 0.3 % too much.

    `taped`: so many straights whose end a tape gives.
    """
    rng = np.random.default_rng(3)

    def truth(run: Run, now: Motion) -> None:
        now.end_x_m, now.end_y_m, now.end_rad = rng.normal(0.0, (2e-3, 2e-3, 1e-3))
        now.laser_m = 3e-3 * run.pieces[0][0] + rng.normal(0.0, 1.5e-3)

    turned = [(length, -kappa) for length, kappa in SQUARE]
    straights = [Run([(length, 0.0)], direction="", front=False) for length in (10.0, 20.0)]
    squares = [
        Run(pieces, kind=kind, direction="", front=False)
        for pieces, kind in ((SQUARE, "square_ccw"), (turned, "square_cw"))
    ]
    made = campaign([*[*straights, *squares] * 6, *[Run(STRAIGHT, direction="", front=False)] * taped], truth=truth)
    bare = np.isfinite(made.runs.number("distance_m")) & (np.arange(len(made.runs)) < 24)
    unseen = {name: np.where(bare, np.nan, made.runs.number(name)) for name in ("ref_x_m", "ref_y_m", "ref_theta_rad")}
    return replace(made, runs=replace(made.runs, numbers=dict(made.runs.numbers) | unseen))


def test_a_laser_of_wrong_scale_is_told_from_the_radii_and_track_by_a_tape(
    diagnosing: Callable[..., Diagnosis],
) -> None:
    """What a recalibration absorbs is confounded with that, not with the library; the run proposed settles it."""
    before = diagnosing(by_laser())
    named = {cause.effect for cause in before.causes}
    (group,) = (set(group) for group in before.groups)
    assert named <= INSTRUMENT and group <= INSTRUMENT | {"radius_scale", "track_width"} and "radius_scale" in group
    assert not before.recommended
    assert any(run.tape and "ref_x_m" in run.why and run.size.endswith(" m") for run in before.next_runs)
    after = diagnosing(by_laser(taped=3))
    assert {cause.effect for cause in after.causes} <= INSTRUMENT and after.groups == ()


def test_beside_a_laser_a_tape_gives_the_place_of_the_end() -> None:
    """Runs that the reference does not see have no place but by tape."""
    runs = [PlannedRun("corridor", tape=True), PlannedRun("corridor"), PlannedRun("square_cw")]
    made = drive(by_laser(), runs, Measured(beside=False))
    assert np.isfinite(made.runs.number("ref_x_m")).tolist() == [True, False, True]
    assert np.isfinite(made.runs.number("distance_m")).tolist() == [True, True, False]


@pytest.mark.parametrize(
    ("kind", "words"),
    [("corridor_short", "15 m"), ("square_cw", "4 m and radius 0.5 m"), ("figure8", "radius 2 m")],
)
def test_a_route_is_stated_in_metres(kind: str, words: str) -> None:
    assert size_of(route_of(kind, Dimensions(25.0))) == words


@pytest.mark.parametrize("turned", [False, True])
def test_a_tape_beside_a_laser_makes_no_lab_with_a_tracker(turned: bool) -> None:
    """It measures the place of an end, no heading: open routes have no reference but by a tracker."""
    made = by_laser(taped=3)
    taped = np.isfinite(made.runs.number("distance_m")) & np.isfinite(made.runs.number("ref_x_m"))
    seen = {name: np.where(taped, made.runs.number(name), np.nan) for name in ("ref_x_m", "ref_y_m", "ref_theta_rad")}
    seen["ref_theta_rad"] *= 1.0 if turned else np.nan
    found = _measured(replace(made, runs=replace(made.runs, numbers=dict(made.runs.numbers) | seen)))
    assert (found.distance, found.position, found.heading, found.beside) == (True, turned, turned, turned)
