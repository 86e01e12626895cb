"""Planned runs separate the effects that they name, and a plan that varies nothing has no detection limits."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import fields, replace
from functools import cache, partial
from pathlib import Path as FilePath
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import calib
from calib.campaign.checks import sessions_of_loads
from calib.campaign.model import Campaign
from calib.errors import BadFileError
from calib.gap.decision.confounding import apart_on
from calib.gap.decision.diagnosis import Evidence
from calib.gap.effects.library import library
from calib.gap.effects.radii import NAMES
from calib.gap.inference.fit import fit
from calib.gap.inference.least_squares import WhitenedSystem
from calib.gap.inference.local_search import SearchResult
from calib.gap.inference.noise import Noise
from calib.gap.observations import Observations
from calib.gap.observations.from_campaign import observations_of
from calib.gap.plan import SEPARATION_SD, Apart, Task, noise_at, outlook_of, undetectable
from calib.gap.plan.next_runs import next_runs, read_plan, with_next
from calib.gap.plan.planned_runs import (
    Measured,
    PlannedRun,
    default_candidates,
    drive,
    joined,
    usual_temperature_C,
)
from calib.gap.predict import Path, predict, residuals
from calib.plant.design import poor_design
from calib.plant.make import make_campaign
from tests.gap.effects.making import STRAIGHT, Run, campaign
from tests.kinematics.campaigns import mecanum, tricycle

ROOT = FilePath(__file__).resolve().parents[3]


@cache
def base(seed: int = 1, name: str = "load_a_session") -> Campaign:
    """Return a campaign of a poor design, made once; nobody changes it."""
    rng = np.random.default_rng(seed)
    return make_campaign(poor_design(name, rng), {}, rng)


def noise_of(campaign: Campaign) -> tuple[Observations, Noise]:
    s = observations_of(campaign)
    return s, noise_at(predict(s), {})


def called(campaign: Campaign) -> Campaign:
    """The same under ids of their own: those of planned runs are for the next."""
    names = np.array([f"driven{k}" for k in range(len(campaign.runs))])
    return replace(campaign, runs=replace(campaign.runs, labels={**campaign.runs.labels, "run_id": names}))


def named(
    campaign: Campaign, sizes: Mapping[str, float], off: Mapping[str, float] | None = None
) -> Callable[[Path, Noise, Collection[str]], Apart]:
    """How far effects are from named ones: `sizes` of the last forms in typical sizes, `off`: of radii and track."""
    s, noise = noise_of(campaign)
    nominal, off = predict(s), off or {}
    effects = {effect.id: effect for effect in library(s)}
    forms = [effects[name].forms(s)[-1] for name in sizes]
    theta = tuple(size * form.typical for size, form in zip(sizes.values(), forms, strict=True))
    found = replace(fit(nominal, noise, forms), theta=theta)
    parts: dict[str, Any] = dict.fromkeys(field.name for field in fields(SearchResult))
    values = np.array([off.get(name, 0.0) for name in NAMES])
    evidence = Evidence(
        *(None, "", nominal, noise, effects, SearchResult(**parts | {"fitted": found, "forms": {}})),
        *(SimpleNamespace(likeliest=tuple(off), values=values), None, (), None),
    )  # type: ignore[call-arg, arg-type]
    return partial(apart_on, evidence)


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
    """A new session's step is free: one load there tells nothing of the law, two do, and both are proposed."""
    campaign = base()
    s, noise = noise_of(campaign)
    ties, apart = [("load_radius", "session_step")], named(campaign, {"load_radius": 1.0})
    runs = next_runs(campaign, library(s), noise, ties, apart_on=apart)
    assert any("tells load_radius from session_step" in run.why for run in runs)
    assert {run.payload_kg > 0.0 for run in runs} == {True, False}
    assert {run.session for run in runs} == {"next"}
    # each of them is needed
    for left_out in runs:
        others = [run for run in runs if run is not left_out]
        path = predict(observations_of(with_next(campaign, others)))
        (((name,), near),) = apart(path, noise_at(path, noise.scales), ["session_step"])(np.ones(len(path.s)))
        assert name == "load_radius" and near["session_step"] < SEPARATION_SD


@pytest.mark.parametrize("most", [1, 2])
def test_no_more_runs_are_named_than_asked_for(most: int) -> None:
    """The unladen run counts; where one alone is asked for, the run that tells is named and says what it needs."""
    campaign = base()
    s, noise = noise_of(campaign)
    ties, apart = [("load_radius", "session_step")], named(campaign, {"load_radius": 1.0})
    runs = next_runs(campaign, library(s), noise, ties, apart_on=apart, most=most)
    assert 1 <= len(runs) <= most
    assert runs[0].payload_kg > 0.0 and "tells load_radius from session_step" in runs[0].why
    assert ("beside the same session without load" in runs[0].why) == (most == 1)
    untied = next_runs(campaign, library(s), noise, most=most)
    assert 1 <= len(untied) <= most


def test_another_curvature_separates_track_and_scrub() -> None:
    """Squares of one corner radius cannot tell a wrong track from scrub; no straight run can either."""
    campaign = base(2, "squares_one_load")
    s, noise = noise_of(campaign)
    tie, apart = [("track_width", "curve_scrub")], named(campaign, {}, {"track_width": 0.01})
    runs = next_runs(campaign, library(s), noise, tie, apart_on=apart)
    assert runs
    assert runs[0].kind not in {"corridor", "corridor_short", "corridor_b"}
    straight = [PlannedRun("corridor", direction, speed_mps=v) for direction in ("out", "back") for v in (0.3, 0.7)]
    assert next_runs(campaign, library(s), noise, tie, apart_on=apart, candidates=straight) == []


def test_a_closed_square_does_not_tell_the_track_from_the_scale_of_the_radii() -> None:
    """It closes by any size of both that turns it as far; a length does tell them, and comes first."""
    loops = [PlannedRun(kind, loop="closed", session="s1") for kind in ("square_cw", "square_ccw") for _ in range(4)]
    driven = called(drive(base(), loops, Measured(distance=False, position=False, heading=False)))
    s, noise = noise_of(driven)
    tie, apart = [("track_width", "radius_scale")], named(driven, {}, {"track_width": 0.01})
    (square, length) = PlannedRun("square_ccw", loop="closed", speed_mps=0.3), PlannedRun("corridor", tape=True)
    told = next_runs(driven, library(s), noise, tie, apart_on=apart, candidates=[square, length])
    assert {run.kind for run in told} == {"corridor"} and "tells track_width from radius_scale" in told[-1].why
    # the unladen run of the session is a length
    assert next_runs(driven, library(s), noise, tie, apart_on=apart, candidates=[square])[0].kind == "corridor"


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
def test_an_error_in_a_plan_names_its_place(tmp_path: FilePath, text: str, column: str) -> None:
    path = tmp_path / "PLAN.toml"
    path.write_text(text)
    with pytest.raises(BadFileError, match=column):
        read_plan(path)


def test_four_chosen_runs_separate_more_than_four_at_random() -> None:
    """From 20 straight runs under various loads; once 7 effects of 20 became 17 with 3 and one unladen, 13 with 4."""
    campaign = base()
    loads = [(0.0, 0.0), (50.0, 0.15), (100.0, -0.15), (150.0, 0.0), (200.0, 0.1)]
    straight = [
        PlannedRun("corridor", ("out", "back")[k % 2], "s1", mass, 0.3, y, temperature_C=20.0, minutes_under_load=10.0)
        for mass, y in loads
        for k in range(4)
    ]
    driven = called(drive(campaign, straight, Measured(front=True)))
    offered = default_candidates(driven)
    s = observations_of(driven)
    chosen = next_runs(driven, library(s), noise_at(predict(s), {}), candidates=offered, most=4)
    by_content = {repr(run.to_dict()): run for run in offered}
    told = {"why", "distance", "count", "size"}
    planned = [{key: value for key, value in run.to_dict().items() if key not in told} for run in chosen]
    first = PlannedRun("corridor", "out", temperature_C=20.0)

    def count(extra: list[PlannedRun]) -> int:
        whole = joined(driven, drive(driven, [first, *extra], Measured(front=True))) if extra else driven
        return int(outlook_of(whole).told_apart.sum())

    rng = np.random.default_rng(0)
    at_random = [count([offered[k] for k in rng.choice(len(offered), 4, replace=False)]) for _ in range(3)]
    before, after = count([]), count([by_content[repr(run)] for run in planned if repr(run) in by_content])
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
    crossed = crossed.select(np.arange(0, len(crossed.runs), 2))
    day = crossed.select(crossed.runs.label("session") == "s1")
    runs = calib.plan(day, most=2).runs
    assert {(run.kind, run.payload_kg) for run in runs} == {("corridor", 0.0), ("corridor", 200.0)}
    assert any("another day" in run.why for run in runs if run.payload_kg)
    assert len(sessions_of_loads(with_next(day, runs))) == 2
    assert not any("another day" in each.why for each in calib.plan(crossed, most=2).runs)
    # what tells confounded effects apart comes before it
    s, noise = noise_of(day)
    lanes = [PlannedRun("corridor_short"), PlannedRun("corridor", payload_kg=200.0, payload_x_m=0.3)]
    ties = [("rangefinder_scale", "rangefinder_offset")]
    apart = named(day, {"rangefinder_scale": 3.0})
    whys = [run.why for run in next_runs(day, library(s), noise, ties, apart_on=apart, candidates=lanes)]
    told, law = (next(n for n, why in enumerate(whys) if said in why) for said in ("tells range", "another day"))
    assert told < law


def test_another_hall_temperature_is_a_session_of_its_own() -> None:
    """No hall changes by 10 K within a session: a step of the session may do what the temperature does."""
    driven = base()
    usual_C = usual_temperature_C(driven)
    offered = default_candidates(driven)
    others = {run.session for run in offered if run.temperature_C != usual_C}
    assert np.isfinite(usual_C) and len(others) == 2 and "next" not in others
    s, noise = noise_of(driven)
    warm = [run for run in offered if run.temperature_C > usual_C]
    ties, apart = [("temperature_radius", "wear")], named(driven, {"temperature_radius": 3.0})
    runs = next_runs(driven, library(s), noise, ties, apart_on=apart, candidates=warm)
    assert any("a session of its own" in run.why for run in runs)


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
    ties, candidates = [("wear", "temperature_radius")], [PlannedRun("square_cw", temperature_C=20.0)]
    worn = named(driven, {"wear": 3.0})
    (run,) = next_runs(driven, library(s), noise, ties, apart_on=worn, candidates=candidates)
    assert (run.kind, run.direction, run.size) == ("corridor", "out", "10 m")
    assert "wear from temperature_radius" in run.why


def test_no_run_of_the_same_wheels_tells_a_share_of_lost_counts_from_that_wheels_radius() -> None:
    """A constant share is an exact alias at every speed and load: nothing is promised, and nothing proposed."""
    driven = campaign([Run(STRAIGHT, front=False, direction=way) for way in ("out", "back") for _ in range(6)])
    s, noise = noise_of(driven)
    ties = [("radius_scale", "unequal_radii", "lost_counts")]
    left = named(driven, {}, {"radius_scale": 1e-3, "unequal_radii": -2e-3})
    assert next_runs(driven, library(s), noise, ties, apart_on=left) == []


def test_loads_that_went_with_the_direction_are_to_be_driven_both_ways() -> None:
    """Laden out and unladen back: the runs to come have the largest payload out and back, beside it unladen."""
    runs = [
        PlannedRun("corridor", way, f"s{k % 2}", payload_kg=kg, payload_x_m=0.3)
        for k in range(8)
        for way, kg in (("out", 160.0), ("back", 0.0))
    ]
    driven = called(drive(base(), runs, Measured()))
    s, noise = noise_of(driven)
    ties, apart = [("travel_direction", "load_radius")], named(driven, {"travel_direction": 4.0})
    told = next_runs(driven, library(s), noise, ties, apart_on=apart)
    assert any("tells travel_direction from load_radius" in run.why for run in told)
    assert {run.direction for run in told if run.payload_kg == 160.0} == {"out", "back"}
    assert all("drive each load both ways" in run.why for run in told if run.payload_kg)
    assert any(not run.payload_kg for run in told)
    crossed = called(drive(base(), [*runs, *(replace(run, direction="back") for run in runs)], Measured()))
    assert not any("both ways" in run.why for run in next_runs(crossed, library(s), noise, most=1))


@pytest.mark.parametrize(
    ("after", "why"), [([4.7, 1.4], "shows b better"), ([4.7, 3.2], "shows b"), ([5.0, 0.7], "shows a better")]
)
def test_a_run_is_named_by_what_the_runs_before_did_not_show(after: list[float], why: str) -> None:
    """An effect that shows already is no reason for a run that adds to another one."""
    task = Task(lambda _sets: np.zeros((0, 2)), ("a", "b"), tied=False)
    assert task.why(np.array([4.5, 0.7]), np.array(after), np.array(after)) == why
