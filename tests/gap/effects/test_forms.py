"""When an effect is offered at all, and what its forms look at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.gap.data.from_campaign import observations_of
from calib.gap.data.observations import Observations
from calib.gap.effects.braking_skid import stops
from calib.gap.effects.encoder_gross import find_gross
from calib.gap.effects.floor_zone import CELL_M, MOST_FORMS
from calib.gap.effects.library import library
from calib.gap.effects.path_weave import sine_excess
from calib.gap.effects.shapes import driven_speed_mps, end_motion
from calib.gap.predict.path import predict
from tests.gap.effects.making import ROUTE, SQUARE, STRAIGHT, Motion, Run, campaign, motion_of, situation


def offered(s: Observations, effect: str) -> list[str]:
    return [form.label for e in library(s) if e.id == effect for form in e.forms(s)]


def test_stops_are_counted_in_the_log_one_without_a_log_none_when_read_rolling() -> None:
    runs = [Run(STRAIGHT, stops=True) for _ in range(12)]
    runs[1] = Run(STRAIGHT, stops=False)
    runs[2] = Run(STRAIGHT, log=False)
    # a second stop in run 0: its counters rest for two seconds half way
    made = campaign(runs)
    first = made.logs.offsets[0] + 50
    columns = {name: np.insert(column, first, column[first - 1]) for name, column in made.logs.columns.items()}
    columns["t_s"][first : made.logs.offsets[1] + 1] += 2.0
    offsets = made.logs.offsets + (np.arange(len(made.logs.offsets)) > 0)
    s = observations_of(replace(made, logs=replace(made.logs, offsets=offsets, columns=columns)))
    np.testing.assert_array_equal(s.total(stops(s))[:4], [2, 0, 1, 1])


def test_the_driven_speed_is_the_mean_over_the_way() -> None:
    """From rest to v over a fifth of the way at constant acceleration: v = sqrt(s) there, 2/3 of v on its mean."""
    s = situation([Run(STRAIGHT, speed_mps=0.6, ramp=True, steps=400) for _ in range(12)])
    # sums over 400 steps
    np.testing.assert_allclose(driven_speed_mps(s), 0.6 * (0.8 + 0.2 * 2 / 3), rtol=1e-3)


def test_the_motion_at_the_end_is_that_of_the_log() -> None:
    s = situation(
        [Run(ROUTE[:2], kind="bend", speed_mps=0.6) for _ in range(11)] + [Run(STRAIGHT, speed_mps=0.6, stops=True)]
    )
    speed, rate = end_motion(s)
    # the counts carry the steps exactly
    np.testing.assert_allclose(speed[:11], 0.6, rtol=1e-9)
    np.testing.assert_allclose(rate[:11], 0.2, rtol=1e-9)
    assert speed[11] == 0.0


def test_latency_is_silent_where_every_run_stands_still_when_it_is_read() -> None:
    assert offered(situation([Run(STRAIGHT, stops=True) for _ in range(12)]), "reference_latency") == []


def test_a_lever_arm_is_silent_on_closed_squares_and_straights() -> None:
    """R(theta) l - l vanishes at 0 and at 2 pi."""
    assert offered(situation([Run(SQUARE, kind="square") for _ in range(12)]), "reference_lever_arm") == []
    assert offered(situation([Run(ROUTE, kind="route") for _ in range(12)]), "reference_lever_arm") == [""]


@pytest.mark.parametrize("share", [-0.03, 0.03])
def test_ordinary_errors_are_no_gross_fault(share: float) -> None:
    """Radii off by 3 %, unequal radii of 3 %, a track off by 6 % on 40 m and on squares."""

    def truth(run: Run, now: Motion) -> None:
        now.left, now.right, now.track = share, 0.0, 2 * share

    runs = [Run([(40.0, 0.0)]) for _ in range(6)] + [Run(SQUARE, kind="square") for _ in range(6)]
    s = situation(runs, truth=truth)
    assert find_gross(s, predict(s)) is None


def test_floor_zones_stay_within_their_number_on_a_large_floor() -> None:
    runs = [Run([(20.0 + 7 * (i % 9), 0.02 * (i % 5))], kind=f"way{i % 5}", steps=400) for i in range(60)]
    s = situation(runs)
    found = next(e for e in library(s) if e.id == "floor_zone").forms(s)
    assert len(found) == MOST_FORMS
    assert all(form.tries == MOST_FORMS for form in found)


def test_a_floor_zone_that_all_runs_cross_alike_is_left_out() -> None:
    assert offered(situation([Run(STRAIGHT) for _ in range(12)]), "floor_zone") == []


def test_a_zone_on_the_way_back_lies_where_it_lay_on_the_way_out() -> None:
    runs = [Run(STRAIGHT, direction="back" if i % 2 else "out", steps=200) for i in range(12)]
    s = situation(runs)
    forms = next(e for e in library(s) if e.id == "floor_zone").forms(s)
    form = next(f for f in forms if f.settings["x_m"] == 2.0)
    part = form.pushes(predict(s))[0].left
    assert part is not None
    for number, run in enumerate(runs):
        x = motion_of(run).x_m
        inside = x[part[s.starts[number] : s.starts[number + 1]] > 0]
        middle = 8.0 if run.direction == "back" else 2.0
        # to half a step of 5 cm
        assert inside.mean() == pytest.approx(middle, abs=0.03)
        assert np.ptp(inside) == pytest.approx(CELL_M, abs=0.11)


def test_windows_of_a_recording_have_no_place_on_the_floor() -> None:
    s = replace(situation([Run(ROUTE, kind="a" if i % 2 else "b") for i in range(12)]), windowed=True)
    assert offered(s, "floor_zone") == [] and offered(s, "floor_slope") == []


def test_lanes_by_column_come_before_kinds() -> None:
    runs = [
        Run(STRAIGHT, kind="corridor" if i % 2 else "corridor_b", numbers={"lane": float(i % 3)}) for i in range(12)
    ]
    assert offered(situation(runs), "floor_undulation") == ["lane 0", "lane 1", "lane 2"]


@pytest.mark.parametrize(
    ("amplitude_m", "wavelength_m", "percent"),
    # surplus of a sine's length over its line, as published for the corridor runs
    [(0.05, 40.0, 0.001542), (0.50, 40.0, 0.154035), (0.10, 5.0, 0.393623), (1.00, 5.0, 32.065823)],
)
def test_the_surplus_of_a_sine_is_that_of_fig_9(amplitude_m: float, wavelength_m: float, percent: float) -> None:
    # half a unit in the last printed digit
    excess = sine_excess(np.array([amplitude_m]), np.array([wavelength_m]))
    assert 100 * float(excess[0]) == pytest.approx(percent, abs=5e-7)


def test_session_steps_count_from_the_first_session_driven() -> None:
    runs = [Run(STRAIGHT, session=("zeta", "alpha", "mid")[i // 4]) for i in range(12)]
    s = situation(runs)
    (form,) = next(e for e in library(s) if e.id == "session_step").forms(s)
    assert [p.name for p in form.parameters] == ["left_alpha", "right_alpha", "left_mid", "right_mid"]
