"""Planned runs separate the effects that they name, and a plan that varies nothing has no detection limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import calib
from calib.campaign.checks.design import sessions_of_loads
from calib.campaign.model import Campaign
from calib.errors import BadFileError
from calib.gap.effects.library import library
from calib.gap.inference.fit import fit
from calib.gap.inference.linear_model import WhitenedSystem
from calib.gap.inference.noise import Noise
from calib.gap.observations.arrays import Observations
from calib.gap.observations.from_campaign import observations_of
from calib.gap.plan.identifiability import noise_at, outlook_of, undetectable
from calib.gap.plan.next_runs import _Task, next_runs, read_plan, with_next
from calib.gap.plan.planned_runs import (
    Measured,
    PlannedRun,
    default_candidates,
    drive,
    joined,
    usual_temperature_C,
)
from calib.gap.predict import predict, residuals
from calib.plant.design import poor_design
from calib.plant.make import make_campaign
from tests.gap.effects.making import STRAIGHT, Run, campaign
from tests.kinematics.campaigns import mecanum, tricycle

ROOT = Path(__file__).resolve().parents[3]


def base(seed: int = 1, name: str = "load_a_session") -> Campaign:
    rng = np.random.default_rng(seed)
    return make_campaign(poor_design(name, rng), {}, rng)


def noise_of(campaign: Campaign) -> tuple[Observations, Noise]:
    s = observations_of(campaign)
    return s, noise_at(predict(s), {})


def test_a_run_driven_as_the_model_says_has_no_gap() -> None:
    """Counts, laser and reference of a planned run agree with the odometry of the model."""
    campaign = base()
    runs = [PlannedRun("corridor", "out", stops=2), PlannedRun("figure8", payload_kg=100, payload_x_m=0.3)]
    runs += [PlannedRun("square_cw", speed_mps=0.3), PlannedRun("route_left", read_rolling=True)]
    s = observations_of(drive(campaign, runs, Measured(front=True)))
    nominal = predict(s)
    gap = residuals(nominal, nominal)
    # a log of 0.1 s cuts corners by fractions of a millimetre
    np.testing.assert_allclose(gap[:, :4], 0.0, atol=1e-3)
    # the front wheel of the straight run; where a route's curvature jumps no steered wheel could follow exactly
    np.testing.assert_allclose(gap[0, 4:], 0.0, atol=1e-9)


@pytest.mark.parametrize("make", [tricycle, mecanum])
def test_planned_runs_turn_the_wheels_that_the_vehicle_counts(make: Callable[[np.random.Generator], Campaign]) -> None:
    """Front wheel alone, or four wheels: joined with what was driven every run counts, and planned ones have no gap."""
    driven = make(np.random.default_rng(2))
    kinds = ("corridor", "square_cw", "square_ccw", "figure8", "route_left")
    planned = drive(driven, [PlannedRun(kind) for kind in kinds], Measured())
    whole = observations_of(joined(driven, planned))
    assert len(whole) == len(driven.runs) + len(kinds)
    nominal = predict(observations_of(planned))
    gap = residuals(nominal, nominal)
    # where the curvature jumps by 2 / m, a steering angle read every 5 cm is off for half of that: 0.05 rad, and m
    limit = 0.06 if make is tricycle else 1e-3
    np.testing.assert_allclose(np.nan_to_num(gap[:, :4]), 0.0, atol=limit)


def test_planned_speeds_and_stops_are_driven() -> None:
    """Kinematics: 20 m at 0.5 m/s with ramps of 0.5 m/s^2 and the closing pause take 20 / 0.5 + 0.5 / 0.5 + 0.5 s."""
    campaign = drive(base(), [PlannedRun("corridor", "out", speed_mps=0.5)], Measured())
    assert campaign.logs.of(0)["t_s"][-1] == pytest.approx(20 / 0.5 + 0.5 / 0.5 + 0.5, rel=1e-9)


def test_a_laden_run_beside_an_unladen_one_separates_load_and_session() -> None:
    """One load a session cannot tell them; two loads in one session do, which the first run must bring."""
    campaign = base()
    _, noise = noise_of(campaign)
    s, _ = noise_of(campaign)
    runs = next_runs(campaign, library(s), noise, [("load_radius", "session_step")])
    assert runs
    assert (runs[0].payload_kg or 0.0) > 0
    assert "load_radius from session_step" in runs[0].why


def test_another_curvature_separates_track_and_scrub() -> None:
    """Squares of one corner radius cannot tell a wrong track from scrub; no straight run can either."""
    campaign = base(2, "squares_one_load")
    s, noise = noise_of(campaign)
    tie = [("track_width", "curve_scrub")]
    runs = next_runs(campaign, library(s), noise, tie)
    assert runs
    assert runs[0].kind not in {"corridor", "corridor_short", "corridor_b"}
    straight = [PlannedRun("corridor", direction, speed_mps=v) for direction in ("out", "back") for v in (0.3, 0.7)]
    assert next_runs(campaign, library(s), noise, tie, candidates=straight) == []


def test_without_candidates_nothing_is_named() -> None:
    campaign = base()
    s, noise = noise_of(campaign)
    assert next_runs(campaign, library(s), noise, [("load_radius", "session_step")], candidates=[]) == []


def test_the_detection_limit_has_a_signal_of_five() -> None:
    """Independent: the whitened norm of the effect, its best-fitting recalibration subtracted by least squares."""
    campaign = base(3, "corridor_only")
    s = observations_of(campaign)
    path = predict(s)
    noise = noise_at(path, {})
    bench = WhitenedSystem(path, path, noise)
    form = next(e for e in library(s) if e.id == "travel_direction").forms(s)[0]
    columns, calibration = bench.columns(form), bench.calibration
    left = columns - calibration @ np.linalg.lstsq(calibration, columns, rcond=1e-9)[0]
    expected = 5.0 / np.linalg.norm(left) * form.parameters[0].typical
    limit = outlook_of(campaign).smallest["travel_direction"]
    # two digits are printed; the prior of the recalibration is wide
    assert float(limit.smallest.split()[0]) == pytest.approx(expected, rel=0.06)


def test_an_effect_that_a_recalibration_absorbs_has_no_detection_limit() -> None:
    """Squares at one speed and one load: nothing varies that speed, load or session could act through."""
    campaign = base(2, "squares_one_load")
    s = observations_of(campaign)
    path = predict(s)
    limits = undetectable(WhitenedSystem(path, path, noise_at(path, {})), library(s))
    never = {limit.effect for limit in limits if limit.never}
    assert {"load_radius", "speed_radius"} <= never


def test_joined_campaigns_hold_all_runs_in_order() -> None:
    campaign = base()
    more = drive(campaign, [PlannedRun("corridor", "out", columns={"humidity": 40.0})], Measured())
    whole = joined(campaign, more)
    assert len(whole.runs) == len(campaign.runs) + 1
    np.testing.assert_array_equal(whole.logs.of(len(campaign.runs))["t_s"], more.logs.of(0)["t_s"])
    assert np.isnan(whole.runs.number("humidity")[:-1]).all()
    assert fit(predict(observations_of(campaign)), noise_of(campaign)[1]).chi_square > 0


def isolable(runs: list[PlannedRun]) -> set[str]:
    outlook = outlook_of(drive(base(), runs, Measured(front=True)))
    return {name for name, yes in zip(outlook.effects, outlook.told_apart, strict=True) if yes}


def test_mixed_runs_separate_more_than_straight_ones_and_these_more_than_squares_at_one_load() -> None:
    """The order in trials: squares at one load hide most, straight runs less, mixtures least."""
    loads = [0.0, 100.0, 200.0]
    squares = [PlannedRun(kind, payload_kg=100, payload_x_m=0.3) for kind in ("square_cw", "square_ccw")] * 10
    straight = [
        PlannedRun("corridor", direction, payload_kg=m, payload_x_m=0.3, payload_y_m=y)
        for direction in ("out", "back")
        for m in loads
        for y in (-0.15, 0.15)
    ] * 2
    mixed = [
        PlannedRun(kind, direction, payload_kg=m, payload_x_m=0.3, speed_mps=v, temperature_C=t)
        for kind, direction in (("corridor", "out"), ("corridor", "back"), ("square_cw", ""), ("figure8", ""))
        for m, v, t in ((0.0, 0.3, 10.0), (100.0, 0.8, 20.0), (200.0, 0.5, 30.0))
    ] * 2
    counts = [len(isolable(runs)) for runs in (squares, straight, mixed)]
    assert counts == sorted(counts)
    assert counts[2] >= counts[0] + 5


@pytest.mark.parametrize(
    ("text", "column"),
    [
        ("", "runs"),
        ("[[runs]]\ndirection = 'out'", "kind"),
        ("[[runs]]\nkind = 'moon'", "kind"),
        ("[[runs]]\nkind = 'corridor'\ncount = 0", "count"),
        ("[[runs]]\nkind = 'corridor'\ncount = true", "count"),
        ("[[runs]]\nkind = 'corridor'\nhumidity = 'wet'", "humidity"),
        ("[[runs]]\nkind = 'corridor'\nhumidity = inf", "humidity"),
        ("[[runs]]\nkind = 'corridor'\nstops = 101", "stops"),
        ("runs = [3]", "runs"),
        ("[measured]\nheight = true\n[[runs]]\nkind = 'corridor'", "measured.height"),
        ("[[runs]]\nkind = 'corridor'\nspeed_mps = -1", "speed_mps"),
        ("[[runs]]\nkind = 'corridor'\ndirection = 'up'", "direction"),
        ("[measured]\nposes = 3\n[[runs]]\nkind = 'corridor'", "measured.poses"),
        ("[measured]\nposes = false\ndistance = false\n[[runs]]\nkind = 'corridor'", "measured"),
        ("format = 'calib-campaign/1'\n[[runs]]\nkind = 'corridor'", "format"),
    ],
)
def test_an_error_in_a_plan_names_its_place(tmp_path: Path, text: str, column: str) -> None:
    path = tmp_path / "PLAN.toml"
    path.write_text(text)
    with pytest.raises(BadFileError, match=column):
        read_plan(path)


def test_three_chosen_runs_separate_more_than_four_at_random() -> None:
    """From 20 straight runs under varied load; in earlier trials 7 effects of 20 became 17 with 3 runs, 13 with 4."""
    campaign = base()
    loads = [(0.0, 0.0), (50.0, 0.15), (100.0, -0.15), (150.0, 0.0), (200.0, 0.1)]
    straight = [
        PlannedRun("corridor", ("out", "back")[k % 2], "s1", mass, 0.3, y, temperature_C=20.0, minutes_under_load=10.0)
        for mass, y in loads
        for k in range(4)
    ]
    driven = drive(campaign, straight, Measured(front=True))
    names = np.array([f"driven{k}" for k in range(len(straight))])
    driven = replace(driven, runs=replace(driven.runs, labels={**driven.runs.labels, "run_id": names}))
    offered = default_candidates(driven)
    s = observations_of(driven)
    chosen = next_runs(driven, library(s), noise_at(predict(s), {}), candidates=offered, most=3)
    by_content = {repr(run.to_dict()): run for run in offered}
    told = {"why", "distance", "count", "size"}
    planned = [{key: value for key, value in run.to_dict().items() if key not in told} for run in chosen]
    first = PlannedRun("corridor", "out", temperature_C=20.0)

    def count(extra: list[PlannedRun]) -> int:
        whole = joined(driven, drive(driven, [first, *extra], Measured(front=True))) if extra else driven
        return int(outlook_of(whole).told_apart.sum())

    rng = np.random.default_rng(0)
    at_random = [count([offered[k] for k in rng.choice(len(offered), 4, replace=False)]) for _ in range(5)]
    before, after = count([]), count([by_content[repr(run)] for run in planned])
    assert after > np.median(at_random)
    assert after >= 2 * before


def test_a_light_robot_is_offered_a_light_payload() -> None:
    """Where nothing was carried, no more than twice what the vehicle weighs, within its own length."""
    driven = base()
    numbers = {name: column for name, column in driven.runs.numbers.items() if not name.startswith("payload")}
    small = replace(
        driven,
        vehicle=replace(driven.vehicle, mass_kg=0.7, wheelbase_m=0.2, cog_x_m=0.05),
        runs=replace(driven.runs, numbers=numbers),
    )
    offered = default_candidates(small)
    assert max(run.payload_kg for run in offered) == pytest.approx(1.4)
    assert max(abs(run.payload_x_m) for run in offered) < 0.2


def test_a_law_of_one_day_gets_a_second_load_on_another_day() -> None:
    """So that with the unladen repeat two sessions have two loads; of the sample, where all sessions have, nothing."""
    crossed = calib.read(ROOT / "sample_runs" / "corridor_crossed").included()
    day = crossed.select(crossed.runs.label("session") == "s1")
    first = calib.plan(day, most=1).runs[0]
    assert (first.kind, first.payload_kg) == ("corridor", 200.0)
    assert "another day" in first.why
    assert len(sessions_of_loads(with_next(day, [first]))) == 2
    assert not any("another day" in each.why for each in calib.plan(crossed, most=2).runs)
    # what tells confounded effects apart comes before it
    s, noise = noise_of(day)
    lanes = [PlannedRun("corridor_short"), PlannedRun("corridor", payload_kg=200.0, payload_x_m=0.3)]
    ties = [("rangefinder_scale", "rangefinder_offset")]
    told, law = next_runs(day, library(s), noise, ties, candidates=lanes)
    assert "tells rangefinder_scale" in told.why and "another day" in law.why


def test_another_hall_temperature_is_a_session_of_its_own() -> None:
    """No hall changes by 10 K within a session: a step of the session may do what the temperature does."""
    driven = base()
    usual_C = usual_temperature_C(driven)
    offered = default_candidates(driven)
    others = {run.session for run in offered if run.temperature_C != usual_C}
    assert np.isfinite(usual_C) and len(others) == 2 and "next" not in others
    s, noise = noise_of(driven)
    warm = [run for run in offered if run.temperature_C > usual_C]
    (run,) = next_runs(driven, library(s), noise, [("temperature_radius", "wear")], candidates=warm)
    assert "a session of its own" in run.why


def test_where_the_repeat_alone_tells_it_is_what_is_proposed() -> None:
    """At one temperature in a session to come wheels that wear go on, and those that follow the temperature do not."""
    temperatures_C = {"s1": 16.0, "s2": 20.0, "s3": 24.0}
    runs = [
        Run(STRAIGHT, session=session, front=False, numbers={"temperature_C": each})
        for session, each in temperatures_C.items()
        for _ in range(4)
    ]
    driven = campaign(runs)
    s, noise = noise_of(driven)
    worn = next(
        form for effect in library(s) if effect.id == "wear" for form in effect.forms(s) if "session" in form.label
    )
    known = fit(predict(s), noise, [worn])
    fitted = replace(known, theta=(np.array([-1e-3, -1e-3]),))
    ties, candidates = [("wear", "temperature_radius")], [PlannedRun("square_cw", temperature_C=20.0)]
    (run,) = next_runs(driven, library(s), noise, ties, fitted, candidates=candidates)
    assert (run.kind, run.direction, run.size) == ("corridor", "out", "10 m")
    assert "wear from temperature_radius" in run.why


def test_counts_lost_with_the_speed_are_told_from_radii_by_a_second_speed() -> None:
    """Radii off by shares of their own do together at one speed what a counter does that loses counts."""
    driven = campaign([Run(STRAIGHT, front=False, direction=way) for way in ("out", "back") for _ in range(6)])
    s, noise = noise_of(driven)
    candidates = [PlannedRun("corridor", "out", speed_mps=speed) for speed in (0.5, 0.25)]
    ties = [("radius_scale", "unequal_radii", "lost_counts")]
    runs = next_runs(driven, library(s), noise, ties, candidates=candidates)
    assert [run.speed_mps for run in runs] == [0.25]
    assert "tells lost_counts from radius_scale" in runs[0].why


@pytest.mark.parametrize(
    ("after", "why"), [([4.7, 1.4], "shows b better"), ([4.7, 3.2], "shows b"), ([5.0, 0.7], "shows a better")]
)
def test_a_run_is_named_by_what_the_runs_before_did_not_show(after: list[float], why: str) -> None:
    """An effect that shows already is no reason for a run that adds to another one."""
    task = object.__new__(_Task)
    task.pairs, task.truths, task.signatures = [], [0, 1], SimpleNamespace(names=("a", "b"))
    assert task.why(np.array([4.5, 0.7]), np.array(after)) == why
