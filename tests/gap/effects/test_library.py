"""What holds of every effect."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib.gap.effects as package
from calib.coefficients.file import OF_INSTRUMENTS
from calib.gap.effects import Effect, Family, Form
from calib.gap.effects.library import REGISTRY, every_effect, library
from calib.gap.effects.radii import DIRECTIONS, NAMES, TYPICAL
from calib.gap.observations import Observations
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict, signature
from tests.gap.effects.making import campaign, rich_runs, situation, with_outside_simulator
from tests.gap.effects.truths.cases import SLOPED


def kinds_of(path: Path) -> dict[str, str]:
    """Effects of a file that state their id: id -> name of the class."""
    kinds = {}
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef):
            stated = {part.targets[0].id: part.value for part in node.body if isinstance(part, ast.Assign)}
            kinds |= {stated["id"].value: node.name} if "id" in stated else {}
    return kinds


#: the effects of the files, without those made of a campaign's columns
IDS = {name for path in Path(package.__file__).parent.glob("*.py") for name in kinds_of(path)}


@pytest.fixture(scope="module")
def rich() -> Observations:
    # every other straight run goes along a second lane
    runs = [replace(run, kind="corridor_b") if number % 6 == 3 else run for number, run in enumerate(rich_runs())]
    made = observations_of(with_outside_simulator(campaign(runs, model=SLOPED)))
    # a gyro measured the turns of every fourth
    return replace(made, by_gyro=np.arange(len(made)) % 4 == 0)


def test_effects_on_instruments_are_known_by_their_ids() -> None:
    """A coefficient file, which knows ids alone, says of all others that they act on the vehicle."""
    ours = {name for name, kind in REGISTRY.items() if kind.family in (Family.INSTRUMENT, Family.REFERENCE)}
    assert ours == {name for name in REGISTRY if name.startswith(OF_INSTRUMENTS)}


def test_every_effect_class_is_registered() -> None:
    """The library is its files: 38 effects or more, each class under its id."""
    assert set(REGISTRY) == IDS and len(IDS) >= 38
    for path in Path(package.__file__).parent.glob("*.py"):
        for name, kind in kinds_of(path).items():
            registered = REGISTRY[name]
            assert (registered.__module__, registered.__name__) == (f"calib.gap.effects.{path.stem}", kind)


def test_an_effect_bears_the_id_under_which_it_is_registered(rich: Observations) -> None:
    assert list(every_effect(rich)) == [*REGISTRY, "covariate:humidity"]


def test_what_is_found_before_the_search_is_no_part_of_it(rich: Observations) -> None:
    assert {e.id for e in library(rich)} == {*IDS, "covariate:humidity"} - {"encoder_gross"}


def test_excluded_effects_are_left_out_covariates_as_well(rich: Observations) -> None:
    left = {e.id for e in library(rich, exclude=("wear", "covariate:humidity"))}
    assert left == IDS - {"wear", "encoder_gross"}


def every_form(s: Observations) -> list[Form]:
    return [form for effect in library(s) for form in effect.forms(s)]


def with_its_drive(rich: Observations, name: str) -> Observations:
    """The runs as driven by a vehicle that can have the effect: of two driven wheels where these are meant."""
    drive = "differential" if name == "wheel_slip" else "tricycle"
    return replace(rich, vehicle=replace(rich.vehicle, drive=drive))


def test_every_effect_shows_in_a_campaign_that_varies_everything(rich: Observations) -> None:
    assert [effect.id for effect in library(rich) if not effect.forms(with_its_drive(rich, effect.id))] == []


def test_free_wheels_do_not_slip(rich: Observations) -> None:
    assert REGISTRY["wheel_slip"]().forms(rich) == []


def test_parameters_have_names_units_and_sizes(rich: Observations) -> None:
    for form in every_form(rich):
        assert form.parameters
        names = [p.name for p in form.parameters]
        assert len(set(names)) == len(names), form.effect
        for p in form.parameters:
            assert p.name and p.unit, form.effect
            assert 0.0 < p.typical <= p.largest, form.effect
            assert p.sign in (-1, 0, 1)
        assert form.tries >= 1


def test_forms_of_an_effect_have_labels_that_differ_and_pay_for_each_other(rich: Observations) -> None:
    for effect in library(rich):
        forms = effect.forms(rich)
        labels = [form.label for form in forms]
        assert len(set(labels)) == len(labels), effect.id
        assert all(form.effect == effect.id for form in forms)
        # one prior for all of them, even but for a step at any session, which was sought at each
        assert not forms or sum(1.0 / form.tries for form in forms) == pytest.approx(1.0), effect.id


def test_titles_and_suspicions_are_clauses(rich: Observations) -> None:
    for effect in library(rich):
        assert effect.title and not effect.title.endswith("."), effect.id
        assert effect.implausible and not effect.implausible.endswith("."), effect.id


def test_an_effect_says_its_family_what_it_needs_and_which_run_separates_it() -> None:
    for name, kind in REGISTRY.items():
        assert kind.family is not Family.OWN, name
        for words in (kind.needs, kind.separates, kind.family.words):
            assert words and not words.endswith("."), name
        assert (kind.family is Family.CALIBRATION) == (kind.calibration_direction is not None) == bool(kind.hides_in)


def test_what_an_effect_shifts_is_the_calibrations_own(rich: Observations) -> None:
    for effect in library(rich):
        assert set(effect.shifts) <= set(NAMES), effect.id


def test_the_directions_of_the_calibration_are_what_its_effects_do(rich: Observations) -> None:
    """A unit of each effect is its stated change of left radius, right radius and track; sizes are the forms'."""
    path = predict(rich)
    for name, direction, typical in zip(NAMES, DIRECTIONS, TYPICAL, strict=True):
        (form,) = next(e for e in library(rich) if e.id == name).forms(rich)
        (perturbation,) = form.perturbations(path)
        np.testing.assert_allclose(signature(path, perturbation), path.calibration @ direction, rtol=1e-12, atol=1e-12)
        assert form.typical[0] == typical


def rotated(path_frame: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Changes of readings with x and y turned into along and lateral of the end frame."""
    made = change.copy()
    c, s = np.cos(path_frame), np.sin(path_frame)
    made[:, 1], made[:, 2] = c * change[:, 1] + s * change[:, 2], c * change[:, 2] - s * change[:, 1]
    return made


#: a turn within one step bends the one before by a 24th of its angle, as if it turned steadily; its way is 0.25 m here
TURN_AT_ONCE = 0.25 / 24.0 + 1e-3


@pytest.mark.parametrize("name", [*sorted(IDS - {"encoder_gross"}), "covariate:humidity"])
def test_a_signature_is_the_derivative_of_the_prediction(rich: Observations, name: str) -> None:
    rich = with_its_drive(rich, name)
    path = predict(rich)
    for form in next(e for e in library(rich) if e.id == name).forms(rich):
        perturbations = form.perturbations(path)
        assert len(perturbations) == len(form.parameters)
        for parameter, perturbation in zip(form.parameters, perturbations, strict=True):
            stepped = 1e-3 * parameter.typical
            up, down = (predict(rich, [perturbation.scaled(h)]).reading for h in (stepped, -stepped))
            numeric = rotated(path.frame, (up - down) / (2 * stepped))
            # only channels that were measured count; a laser's line is no distance on a curved route
            numeric, analytic = (np.where(rich.usable, one, 0.0) for one in (numeric, signature(path, perturbation)))
            scale = np.abs(numeric).max()
            assert scale > 0.0, f"{form.label}: {parameter.name} does nothing"
            # chords against arcs and the mean heading's share in the line's length are of second order in a step's
            # turn (0.04 rad here): 3e-3 of the largest change
            atol = (TURN_AT_ONCE if name == "braking_skid" else 3e-3) * scale
            np.testing.assert_allclose(analytic, numeric, rtol=0, atol=atol, err_msg=form.label)


def test_a_campaign_of_equal_straight_runs_has_forms_only_where_something_can_show() -> None:
    from tests.gap.effects.making import STRAIGHT, Run

    s = situation([Run(STRAIGHT, front=False) for _ in range(12)])
    offered = {effect.id for effect in library(s) if effect.forms(s)}
    wheels = {"radius_scale", "unequal_radii", "track_width", "wheel_eccentricity", "braking_skid", "wear"}
    lengths = {"rangefinder_scale", "rangefinder_offset", "beam_misalignment", "reference_scale"}
    readings = {"lost_counts", "encoder_gross", "reference_yaw", "reference_latency"}
    assert offered <= {*wheels, *lengths, *readings, "floor_zone"}


@pytest.mark.parametrize("missing", ["temperature_C", "minutes_under_load", "speed_mps", "payload_kg", "load_left_N"])
def test_a_missing_column_silences_effects_and_never_breaks_them(missing: str) -> None:
    made = campaign(rich_runs())
    numbers = {name: column for name, column in made.runs.numbers.items() if name != missing}
    from dataclasses import replace

    s = observations_of(replace(made, runs=replace(made.runs, numbers=numbers)))
    path = predict(s)
    for form in every_form(s):
        for perturbation in form.perturbations(path):
            assert np.isfinite(signature(path, perturbation)).all(), form.effect


def test_an_effect_is_a_subclass_of_the_one_base(rich: Observations) -> None:
    assert all(isinstance(effect, Effect) for effect in library(rich))
