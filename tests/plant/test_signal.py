"""The signal is what it says: checked against repeated noisy drives and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.plant import Cause, Noise, build_world, draw_noise, quiet
from calib.plant.design import good_design
from calib.plant.drive import drive
from calib.plant.effects import ALL, find
from calib.plant.make import as_causes, make_campaign, random_model
from calib.plant.signal import (
    alternatives,
    covariance,
    lacks,
    outputs,
    recalibration,
    rivals,
    strength,
    strengths,
    to_signal,
)

NORMAL = Noise(tail=np.inf, stated_ratio=1.0)


def test_the_linear_covariance_is_that_of_noisy_drives() -> None:
    """240 noisy drives of the same runs scatter as the propagated covariance says, channel by channel."""
    rng = np.random.default_rng(4)
    once = good_design(rng, n_runs=24, needs={"front"})
    model = random_model(once, rng)
    runs = np.array(
        [int(np.flatnonzero(np.char.startswith(once.kind, kind))[0]) for kind in ("corridor", "square", "route")]
    )
    design = replace(once.select(np.repeat(runs, 240)), log_period_s=0.24)
    world = build_world(design, model)
    draw = draw_noise(NORMAL, len(design), rng)
    record = drive(world, draw)
    out = outputs(world, draw, record, quantise=True).reshape(3, 240, 6)
    expected = covariance(world, NORMAL, record).reshape(3, 240, 6, 6)[:, 0]
    for one in range(3):
        seen = np.isfinite(out[one, 0])
        scatter = np.cov(out[one][:, seen].T)
        # rtol: a standard deviation from 240 draws is known to 4.6 %; five times that over 15 comparisons
        np.testing.assert_allclose(
            np.sqrt(np.diag(scatter)), np.sqrt(np.diag(expected[one]))[seen], rtol=0.23, atol=2e-4
        )
        # the lateral and heading errors hang together as the path's lever says
        correlation = np.corrcoef(out[one][:, 2], out[one][:, 3])[0, 1]
        said = expected[one][2, 3] / np.sqrt(expected[one][2, 2] * expected[one][3, 3])
        assert correlation == pytest.approx(said, abs=0.25)  # three times the scatter of a correlation of 240


def test_a_late_steering_angle_shows_by_the_motion_alone() -> None:
    """The turn by steering is the integral of v tan(angle) / L: late, of the angle of then beside the way of now.

    With the log as it is written, however coarse: the front wheel rolls v / cos(angle) of now.
    """
    rng = np.random.default_rng(3)
    once = good_design(rng, n_runs=24, needs={"front"})
    chosen = once.select(np.flatnonzero(np.char.startswith(once.kind, "square"))[:2])
    design = replace(chosen, speed_mps=np.array([0.35, 0.5]), flying=np.ones(2, dtype=bool), log_period_s=0.1)
    model, delay_s = random_model(once, rng), 0.08
    change = strengths(design, model, NORMAL, [Cause("steering_delay", delay_s)]).change[0]
    fine = replace(design, log_period_s=0.02)
    record = drive(build_world(fine, model), quiet(2), quantise=False)
    for run in range(2):
        time, angle, v = (x[: record.frames[run], run] for x in (record.t_s, record.steer_rad, record.v_mps))
        excess = np.sin(np.interp(time - delay_s, time, angle)) - np.sin(angle)
        expected = np.trapezoid(v / np.cos(angle) * excess, time) / design.vehicle.wheelbase_m
        assert abs(expected) > 0.01
        # rtol: sums over a log of 0.1 s, in which the angle turns by 0.1 rad: some per cent of what a bend does
        assert change[run, 5] == pytest.approx(expected, rel=0.1)


def test_a_recalibration_hides_a_wrong_track_entirely() -> None:
    """What a mis-set track does lies in the span of the recalibration; nothing is left of it."""
    rng = np.random.default_rng(1)
    design = good_design(rng, n_runs=24)
    model = random_model(design, rng)
    found = strengths(design, model, NORMAL, [Cause("track_width", 1e-4)], step_s=0.1)
    whole = strength(found.change[0], found.cov, None)
    left = strength(found.change[0], found.cov, found.absorbed)
    assert whole > 1.0
    assert left < 0.02 * whole  # second order of 1e-4 times a full turn


def test_the_signal_of_a_rangefinder_offset_is_in_closed_form() -> None:
    """Each distance is off by the same: the norm is offset / sigma over the runs, nothing projected out."""
    rng = np.random.default_rng(2)
    design = good_design(rng, n_runs=30, needs={"laser", "lengths"})
    only = replace(design, poses="none")
    model = random_model(only, rng)
    found = strengths(only, model, NORMAL, [Cause("rangefinder_offset", 0.004)], step_s=0.1)
    sigma = np.sqrt(found.cov[only.corridor, 0, 0])
    expected = 0.004 * np.sqrt(np.sum(1 / sigma**2))
    # rtol: without a pose the only channel is the distance, so whitening is a division; rounding only
    assert strength(found.change[0], found.cov, None) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("form", ALL, ids=lambda form: f"{form.effect}/{form.form}")
def test_every_form_shows_on_a_design_with_what_it_needs(form: object) -> None:
    found = find(form.effect, form.form)  # type: ignore[attr-defined]
    rng = np.random.default_rng(8)
    design = good_design(rng, n_runs=24, needs=found.needs)
    assert not lacks(design, found.needs)
    if found.effect in ("encoder_gross", "integration_scheme"):
        # two short runs: nothing is asked of them but what is recorded
        design = replace(design.select(np.flatnonzero(design.corridor)[:2]), length_m=4.0)
        campaign = make_campaign(design, {f"{found.effect}/{found.form}": 1.0}, rng, noise=NORMAL)
        plain = make_campaign(design, {}, rng, noise=NORMAL)
        assert set(campaign.runs.numbers) == set(plain.runs.numbers)
        return
    model = random_model(design, rng)
    causes = as_causes({f"{found.effect}/{found.form}": float("nan")}, design, rng)
    reached = strengths(design, model, NORMAL, causes, step_s=0.1)
    assert reached.alone[0] > 0.5


@pytest.mark.parametrize("effect", ["load_radius/power", "side_slip", "beam_misalignment", "reference_latency"])
def test_a_cause_is_scaled_to_the_wanted_signal(effect: str) -> None:
    """Also where it acts with the square of its size, and where the noise has to be lowered for it."""
    rng = np.random.default_rng(8)
    design = good_design(rng, n_runs=24, needs=find(*effect.split("/")).needs)
    model = random_model(design, rng)
    made, noise, reached = to_signal(design, model, NORMAL, as_causes({effect: float("nan")}, design, rng), [10.0])
    assert noise.laser_m <= 3 * NORMAL.laser_m
    assert abs(made[0].size) <= 6 * find(*effect.split("/")).typical
    # rtol: three rounds of scaling; what is left is curvature and the last round's 2 %
    assert reached.alone[0] == pytest.approx(10.0, rel=0.06)


def test_a_cause_that_a_recalibration_takes_up_whole_is_scaled_by_what_it_does_alone() -> None:
    """Where nothing but a laser measures, a rangefinder's scale is one of the radii: no size of it would be left."""
    rng = np.random.default_rng(4)
    design = replace(good_design(rng, n_runs=24, needs=find("rangefinder_scale").needs), poses="none")
    design = design.select(np.flatnonzero(design.corridor))
    model = random_model(design, rng)
    made, _, reached = to_signal(design, model, NORMAL, [Cause("rangefinder_scale", 1.5e-3)], [12.0])
    assert reached.alone[0] == pytest.approx(12.0, rel=0.06)
    assert abs(made[0].size) < 1e-2


def test_rivals_know_the_exact_alias() -> None:
    """A misaligned beam is a rangefinder scale: its distance is zero, and no other effect comes near."""
    rng = np.random.default_rng(6)
    design = good_design(rng, n_runs=24, needs=find("beam_misalignment").needs)
    model = random_model(design, rng)
    made, noise, _ = to_signal(design, model, NORMAL, [Cause("beam_misalignment", 0.05)], [15.0])
    found = rivals(alternatives(design, model, noise, made[0]))
    (nearest, distance), (_, next_distance) = found[:2]
    assert nearest == "rangefinder_scale"
    assert distance < 0.05
    assert next_distance > 1.0


def test_the_levers_of_the_recalibration_are_its_derivatives() -> None:
    """A radius 0.01 % larger in the model moves the outputs as the first column says."""
    rng = np.random.default_rng(3)
    design = good_design(rng, n_runs=24)
    model = random_model(design, rng)
    world = build_world(design, model)
    draw = draw_noise(replace(NORMAL, texture_m=0.0, common=0.0, differential=0.0), len(design), rng)
    record = drive(world, draw, quantise=False)
    columns = recalibration(world, record)
    found = strengths(design, model, NORMAL, [Cause("radius_scale", 1e-4)])
    predicted = 1e-4 * (columns[:, :, 0] + columns[:, :, 1])
    seen = np.isfinite(found.change[0])
    # atol: the two drives differ by their start heading noise and by second order, micrometres
    np.testing.assert_allclose(found.change[0][seen], predicted[seen], atol=6e-5)
