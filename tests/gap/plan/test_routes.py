"""Planned runs fit the vehicle and the place: sizes and speeds of what was driven."""

from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.gap.effects.library import library
from calib.gap.plan.next_runs import dimensions_of, next_runs
from calib.gap.plan.planned_runs import KINDS, Dimensions, Measured, PlannedRun, default_candidates, drive, route_of
from tests.gap.plan.test_next_runs import base, called, named, noise_of


def small(driven: Campaign, size: float) -> Campaign:
    """The same drives by a vehicle of another size: all lengths and speeds in proportion."""
    runs, logs, lengths = driven.runs, driven.logs, ("radius_left_m", "radius_right_m", "track_m")
    numbers = {
        name: size * column if name in {"distance_m", "ref_x_m", "ref_y_m", "speed_mps"} else column
        for name, column in runs.numbers.items()
    }
    model = replace(driven.model, **{name: size * getattr(driven.model, name) for name in lengths})
    columns = {name: size * c if name in {"ref_x_m", "ref_y_m"} else c for name, c in logs.columns.items()}
    return replace(driven, model=model, runs=replace(runs, numbers=numbers), logs=replace(logs, columns=columns))


def test_planned_runs_are_as_long_and_as_fast_as_the_vehicle_was_driven() -> None:
    """A vehicle a tenth as large gets all in proportion, so that it has room."""
    nominal = base()
    kinds = [PlannedRun(kind, "out", speed_mps=v) for v in (0.2, 0.4) for kind in ("square_cw", "corridor")]
    driven = called(drive(nominal, kinds * 2, Measured(), Dimensions(15.0, scale=0.5, reach_m=0.0)))
    whole, tenth = dimensions_of(driven), dimensions_of(small(driven, 0.1))
    # the ramps slow the mean speed by less than a tenth
    assert whole.corridor_m == pytest.approx(15.0) and whole.speeds_mps == pytest.approx((0.2, 0.4), rel=0.1)
    assert whole.scale == 1.0
    assert tenth.corridor_m == pytest.approx(1.5) and tenth.speeds_mps == pytest.approx((0.02, 0.04), rel=0.1)
    # no route that is proposed leads further than a run did
    for kind in {run.kind for run in default_candidates(driven)}:
        reach_m = np.hypot(*route_of(kind, tenth).divided(0.01).poses().stacked()[:, :2].T).max()
        assert reach_m <= 1.5 * 1.01
    offered = default_candidates(driven, whole)
    assert max(run.speed_mps for run in offered) == whole.speeds_mps[1]


def test_a_car_is_asked_for_no_tighter_turn_than_it_steers() -> None:
    """A steering angle of 34 degrees turns about 1.5 wheelbases."""
    car = Dimensions(least_radius_m=1.5 * 2.7)
    for kind in KINDS:
        route = route_of(kind, car)
        bends = route.turn_rad != 0.0
        assert (np.abs(route.length_m[bends] / route.turn_rad[bends]) >= 1.5 * 2.7 - 1e-9).all()


@pytest.mark.parametrize("with_corridors", [True, False])
def test_new_routes_are_driven_beside_a_corridor_as_before(*, with_corridors: bool) -> None:
    """A step of the new session moves a known run too, and a cause of the new route does not."""
    runs = [PlannedRun(kind, session="s1") for kind in ("square_cw", "square_ccw") for _ in range(4)]
    runs += [PlannedRun("corridor", "out", session="s1")] * (3 * with_corridors)
    driven = called(drive(base(2, "squares_one_load"), runs, Measured()))
    s, noise = noise_of(driven)
    tie, apart = [("track_width", "curve_scrub")], named(driven, {}, {"track_width": 0.01})
    proposed = {run.kind: run.count for run in next_runs(driven, library(s), noise, tie, apart_on=apart)}
    assert proposed.pop("corridor", 0) == with_corridors
    assert set(proposed) and set(proposed).isdisjoint({"square_cw", "square_ccw"})
