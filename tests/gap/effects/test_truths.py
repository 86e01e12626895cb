"""Every effect explains the campaign in which it is true, at its true size.

The truths are worked out run by run from the plan of the drive, by the effect's physics and without the diagnosis: the
wheels' counts and the instruments' readings follow from how the vehicle really moved. They stand in
`tests.gap.effects.truths`, a file a family.
"""

from __future__ import annotations

import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.settings import OdometryModel
from calib.gap.effects import Form
from calib.gap.effects.library import REGISTRY, library
from calib.gap.observations import Observations
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict
from calib.types import FloatArray
from calib.vehicle import Vehicle
from tests.gap.effects.making import ROUTE, SQUARE, STRAIGHT, Run, campaign, gap, motion_of, situation
from tests.gap.effects.truths.cases import CASES, ROLLING, RUNS, SLOPED, Case

for _family in sorted(Path(__file__).with_name("truths").glob("*.py")):
    importlib.import_module(f"tests.gap.effects.truths.{_family.stem}")

#: what is tried elsewhere: below, in `test_encoder` and in `tests.gap.test_unaided`
ELSEWHERE = {"integration_scheme", "encoder_gross", "gyro_scale"}


def form_of(s: Observations, effect: str, label: str = "") -> Form:
    """The form of an effect whose label starts so."""
    found = [f for e in library(s) if e.id == effect for f in e.forms(s) if f.label.startswith(label)]
    assert found, f"{effect} has no form {label!r}"
    return found[0]


#: gaps without any effect: runs of several cases, which nobody changes, have theirs made once
_PLAIN: dict[tuple[int, str], FloatArray] = {}


def plain_of(runs: list[Run], model: OdometryModel, vehicle: Vehicle | None) -> FloatArray:
    """The gap of runs on which nothing is wrong."""
    key = (id(runs), repr((model, vehicle)))
    if key not in _PLAIN:
        _PLAIN[key] = gap(situation(runs, model=model, vehicle=vehicle))
    return _PLAIN[key]


def test_every_effect_has_a_truth() -> None:
    assert set(REGISTRY) - ELSEWHERE <= {case.effect for case in CASES}


@pytest.mark.parametrize("one", CASES, ids=lambda c: f"{c.effect}-{c.label}".rstrip("-"))
def test_an_effect_closes_the_gap_of_the_campaign_in_which_it_is_true(one: Case) -> None:
    runs = one.runs if one.runs is not None else RUNS
    plain = plain_of(runs, one.model, one.vehicle)
    s = situation(runs, model=one.model, truth=one.truth, vehicle=one.vehicle)
    form = form_of(s, one.effect, one.label)
    assert len(form.parameters) == len(one.sizes)
    before = gap(s) - plain
    path = predict(s)
    for _ in range(3):
        # about the fitted model, as the diagnosis does
        perturbations = [
            perturbation.scaled(size) for perturbation, size in zip(form.perturbations(path), one.sizes, strict=True)
        ]
        path = predict(s, perturbations)
    after = gap(s, perturbations) - plain
    for channel in range(6):
        largest = np.abs(before[:, channel]).max()
        if largest < 1e-3 * np.abs(before).max():
            # nothing to close: nothing may be opened either
            largest = np.abs(before).max()
        assert np.abs(after[:, channel]).max() <= one.within * largest, f"channel {channel}"
    assert np.abs(before).max() > 0.0


@pytest.mark.parametrize(("label", "side"), [("end-point", 1.0), ("start heading", 0.0)])
def test_integration_scheme_is_the_difference_of_the_coarse_simulation(label: str, side: float) -> None:
    """The outside simulator steps along the heading at one end of each log step."""
    runs = ROLLING
    made = campaign(runs)
    numbers = dict(made.runs.numbers)
    poses = []
    for run in runs:
        now = motion_of(run)
        heading = np.concatenate([[0.0], np.cumsum(now.turn_rad)])
        taken = heading[1:] if side else heading[:-1]
        poses.append([np.sum(now.ds_m * np.cos(taken)), np.sum(now.ds_m * np.sin(taken)), heading[-1]])
    for j, name in enumerate(("sim_x_m", "sim_y_m", "sim_theta_rad")):
        numbers[name] = np.array([pose[j] for pose in poses])
    s = observations_of(replace(made, runs=replace(made.runs, numbers=numbers)))
    path = predict(s)
    (perturbation,) = form_of(s, "integration_scheme", label).perturbations(path)
    true_gap = s.measured[:, 1:3] - s.simulated[:, 1:3]
    said = predict(s, [perturbation]).reading[:, 1:3] - path.reading[:, 1:3]
    # calib's own path rounds the plan's jumps of curvature off within a step: 0.06 rad / 24 of 0.03 m at each
    np.testing.assert_allclose(said, true_gap, rtol=0, atol=1e-2 * np.abs(true_gap).max())
    assert np.abs(true_gap).max() > 5e-3


def test_payload_effects_take_the_slope_of_a_load_law_that_the_hypothesis_brings() -> None:
    """With a load law fitted beside it, a share means the same as where the model has that law."""
    of_model, bare = situation(RUNS, model=SLOPED), situation(RUNS)
    law = [push.scaled(1.2e-6) for push in form_of(bare, "load_radius").perturbations(predict(bare))]
    for effect, label in (("payload_mass", "payload of 150"), ("payload_position", "sideways")):
        (known,) = form_of(of_model, effect, label).perturbations(predict(of_model))
        (found,) = form_of(bare, effect, label).perturbations(predict(bare, law))
        # the radius under it differs by 1e-2 at most
        np.testing.assert_allclose(found.left, known.left, rtol=2e-2)
        np.testing.assert_allclose(found.right, known.right, rtol=2e-2)


@pytest.mark.parametrize("size", [-0.3, 0.05, 0.3])
def test_a_payload_effect_does_not_feed_on_itself(size: float) -> None:
    """About its own path it does what it does about the model's: radii that it moves are no load law."""
    bare = situation(RUNS, model=SLOPED)
    for effect, label in (("payload_mass", "payload of 150"), ("payload_position", "sideways")):
        form = form_of(bare, effect, label)
        (first,) = form.perturbations(predict(bare))
        (again,) = form.perturbations(predict(bare, [first.scaled(size)]))
        np.testing.assert_array_equal(again.left, first.left)
        np.testing.assert_array_equal(again.right, first.right)


def test_a_wrong_truth_is_not_closed() -> None:
    """The check above can fail: a right wheel's slope on the left wheel leaves the gap open."""
    s = situation(RUNS, truth=lambda run, now: setattr(now, "left", 1.3e-5 * (run.load_left_N - 300.0)))
    perturbation = form_of(s, "load_radius").perturbations(predict(s))[1]
    assert np.abs(gap(s, [perturbation.scaled(1.3e-6)])).max() > 0.5 * np.abs(gap(s)).max()


def test_routes_are_there() -> None:
    """The campaign of these tests holds straights, bends and squares."""
    assert all(any(run.pieces == pieces for run in RUNS) for pieces in (STRAIGHT, ROUTE, SQUARE))


def test_a_payload_does_nothing_without_a_load_law() -> None:
    """A slope assumed for it would let one misreported payload stand for the law, with one parameter for its two."""
    bare = situation(RUNS)
    path = predict(bare)
    for effect in ("payload_mass", "payload_position"):
        for form in REGISTRY[effect]().forms(bare):
            (perturbation,) = form.perturbations(path)
            assert not np.any(perturbation.left) and not np.any(perturbation.right)
            assert set(form.acts_through) == {"load_radius", "load_radius_nonlinear"}
    assert all(form.acts_through == () for form in REGISTRY["payload_mass"]().forms(situation(RUNS, model=SLOPED)))
