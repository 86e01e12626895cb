"""Intervals promised before runs are driven are those that come out, for references without motion capture."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from scipy.stats import t as student

from calib.api.outputs import proposed
from calib.campaign.model import Logs
from calib.campaign.read import read_campaign
from calib.cli.main import run
from calib.gap.plan.next_runs import with_next
from calib.gap.plan.planned_runs import Dimensions, Measured, PlannedRun, drive, joined
from calib.kinematics.assemble import Promise, promised
from calib.kinematics.drives import first_scales
from calib.kinematics.estimate import estimate_geometry
from calib.kinematics.result import Geometry
from tests.kinematics.campaigns import Truth, campaign, mixed
from tests.kinematics.promises import CORRIDOR_M, LABS, NOTHING, ROUTES, SIGMA, Lab, kept, promise, simulated

CAMPAIGNS = 12
#: the squares of so many errors over the promised variance leave these bounds by chance once in a thousand times
BOUNDS = np.sqrt(chi2.ppf([5e-4, 1.0 - 5e-4], CAMPAIGNS) / CAMPAIGNS)
#: a standard deviation from four taped runs is itself known to a third, and the median of twelve to a tenth; in 60
#: campaigns the median widths are 0.98 to 1.23 of those promised, most where a tape has noise at one end alone and
#: the stated one stands for both
WIDTH = 0.4


@pytest.mark.parametrize("lab", ["gyro and tape", "closed loops and tape", "headings", "positions"])
def test_errors_scatter_as_promised(lab: str) -> None:
    """Vehicle, noise and motion of the campaigns are simulated by no code of calib's."""
    done = kept(LABS[lab], CAMPAIGNS)
    assert {"radius_left_m", "radius_right_m", "track_m"} == set(done.error)
    assert all(BOUNDS[0] < error < BOUNDS[1] for error in done.error.values()), done.error
    assert all(abs(width - 1.0) < WIDTH for width in done.width.values()), done.width
    # what is left open was said, and nothing else is
    assert done.as_said > 0.8


def test_what_a_reference_leaves_open_is_said() -> None:
    """A gyro alone its scale, loops and headings the common scale, a tape alone all but the mean radius."""
    assert promise(LABS["gyro and tape"]).undetermined == ("gyro_scale",)
    assert promise(LABS["closed loops"]).undetermined == ("mean_radius_m",)
    assert promise(LABS["headings"]).undetermined == ("mean_radius_m",)
    assert promise(LABS["closed loops and tape"]).undetermined == ()
    assert "track_m" in promise(Lab([PlannedRun("corridor", tape=True)] * 8, NOTHING, SIGMA)).undetermined


def test_four_times_the_runs_halve_the_standard_deviation() -> None:
    lab = Lab([PlannedRun("square_ccw"), PlannedRun("route_left")] * 4, Measured(distance=False), SIGMA)
    once, often = (
        {each.name: each.std for each in promise(Lab(list(lab.runs) * times, lab.measured, lab.sigma)).estimates}
        for times in (1, 4)
    )
    assert {name: once[name] / often[name] for name in once} == pytest.approx(dict.fromkeys(once, 2.0), rel=0.01)


#: intervals by the scatter of 30 runs, beside those by their design: a standard deviation from so many is known to an
#: eighth, and some runs are down-weighted
BY_SCATTER = 0.25


def test_runs_driven_promise_what_geometry_says_of_them() -> None:
    """Of the same observations at the same noise; of a track that nothing tells, nothing is promised."""
    driven = read_campaign("sample_runs/corridor_crossed").included()
    driven = driven.select(np.arange(0, len(driven.runs), 2))
    said = {one.name: one.half_width for one in estimate_geometry(driven).estimates}
    # which runs are proposed is not looked at
    among = [PlannedRun("square_cw")]
    plan = proposed(driven, among=among, most=1, seed=0)
    assert plan.now is not None
    assert {one.name: one.half_width for one in plan.now.estimates} == said
    found = replace(driven.model, **{one.name: one.value for one in plan.now.estimates})
    by_design = promised(replace(driven.included(), model=found), plan.now.scales)
    assert {one.name: one.half_width for one in by_design.estimates} == pytest.approx(said, rel=BY_SCATTER)
    # without end headings the lengths are left, and no wandering of the heading is seen
    numbers = {name: column for name, column in driven.runs.numbers.items() if not name.startswith("ref_")}
    lengths = replace(driven, runs=replace(driven.runs, numbers=numbers), logs=Logs.empty(len(driven.runs)))
    plan = proposed(lengths, among=among, most=1, seed=0)
    assert plan.now is not None
    assert plan.now.undetermined == ("track_m",)
    assert plan.now.scales[2] == first_scales(lengths.reference)[2]


def test_further_runs_promise_narrower_intervals_of_a_driven_campaign() -> None:
    driven = read_campaign("sample_runs/corridor")
    more = with_next(driven, [PlannedRun("square_cw", count=3), PlannedRun("square_ccw", count=3, payload_kg=100.0)])
    assert len(more.runs) == len(driven.included().runs) + 6
    now, then = Promise.of(estimate_geometry(driven)), promised(more)
    track = [next(each.half_width for each in one.estimates if each.name == "track_m") for one in (now, then)]
    assert track[1] < 0.1 * track[0]
    # the loads of planned runs follow from their payload: slopes stay among the parameters
    assert {one.name for one in then.estimates} == {one.name for one in now.estimates}


#: degrees of freedom that a run of much weight takes, where it adds nothing
NO_WIDER = 1.0001


def test_more_runs_promise_no_wider_interval() -> None:
    """Of end poses, and of a reference along the path, whose windows tell more than any design of end poses."""
    along = campaign(mixed(3), Truth(0.0502, 0.05, 0.402), np.random.default_rng(3), along=True)
    for driven in (read_campaign("sample_runs/corridor"), along):
        found = estimate_geometry(driven)
        now, driven = Promise.of(found), replace(driven, model=replace(driven.model, **lengths_of(found)))
        design = promised(driven, now.scales)
        for kind in ("corridor", "square_cw"):
            then = promised(with_next(driven, [PlannedRun(kind, count=3)]), now.scales).after(now, design)
            before = {one.name: one.half_width for one in now.estimates}
            assert {one.name for one in then.estimates} == {name for name in before if name in lengths_of(found)}
            assert all(one.half_width < before[one.name] * NO_WIDER for one in then.estimates), kind


def lengths_of(found: Geometry) -> dict[str, float]:
    return {name: value for name, value in found.values.items() if name.startswith(("radius_", "track_", "slope_"))}


#: three runs beside 32 move intervals by 7 %; in 25 campaigns those found were 0.92 to 1.10 of those promised, by the
#: design alone 0.9 to 1.35
NEAR = 0.13


def test_what_a_driven_campaign_promises_is_found_once_the_next_runs_are_driven() -> None:
    """The part of the runs driven is known; vehicle, noise and motion are simulated by no code of calib's."""
    lab, dimensions, ratios = (
        Lab([*ROUTES, *ROUTES, *ROUTES[:3]], LABS["positions"].measured, SIGMA),
        Dimensions(CORRIDOR_M),
        [],
    )
    for seed in range(2):
        _, made = simulated(lab, np.random.default_rng([seed, 78]))
        driven = made.select(np.arange(len(made.runs)) < 32)
        found = estimate_geometry(driven)
        now, model = Promise.of(found), replace(driven.model, **lengths_of(found))
        driven = replace(driven, model=model)
        planned = drive(driven, lab.runs[32:], lab.measured, dimensions)
        then = promised(joined(driven, planned), now.scales).after(now, promised(driven, now.scales))
        after = {one.name: one.half_width for one in estimate_geometry(made).estimates}
        ratios += [after[one.name] / one.half_width for one in then.estimates]
    assert len(ratios) == 6 and max(np.abs(np.array(ratios) - 1.0)) < NEAR, ratios


def test_degrees_of_freedom_are_those_of_the_interval() -> None:
    """Also where nominal values are part of a result, as closed loops leave the mean radius open."""
    _, made = simulated(LABS["closed loops"], np.random.default_rng([0, 77]))
    found = estimate_geometry(made.select(np.arange(12) % 2 == 0))
    assert found.undetermined == ("mean_radius_m",)
    for one in found.estimates:
        assert one.half_width / one.std == pytest.approx(float(student.ppf(0.975, one.dof)), rel=1e-6), one.name


def test_the_commands_state_the_promise(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["plan", "--from", "sample_runs/plan.toml", "--json", "-"]) == 0
    geometry = json.loads(capsys.readouterr().out)["geometry"]
    assert geometry["undetermined"] == []
    track = geometry["parameters"]["track_m"]
    # a t quantile: wider than the normal one, and few degrees of freedom at the worst
    assert 1.96 < track["half_width95"] / track["sd"] < 5.0
