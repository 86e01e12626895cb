"""Effects that users add, and columns that are candidates by themselves."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import EntryPoint
from typing import ClassVar

import numpy as np
import pytest

from calib.errors import BadFileError, BadInputError, CalibError
from calib.gap import Perturbation
from calib.gap.effects import Centre, Effect, Form, Parameter
from calib.gap.effects.library import check_excluded, library
from calib.gap.effects.quantities import ACTS_ON, covariate_columns, entry_point_effects
from calib.gap.observations import Observations
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict, signature
from tests.gap.effects.making import ROUTE, STRAIGHT, Run, campaign, situation

RUNS = [Run(STRAIGHT, numbers={"tyre_bar": 2.0 + 0.1 * (i % 4), "temperature_C": 20.0 + i}) for i in range(12)]
SOUND = {
    "id": "tyre",
    "title": "soft tyres",
    "column": "tyre_bar",
    "acts_on": "both",
    "typical": 1e-3,
    "largest": 1e-2,
}
BAR = np.array([run.numbers["tyre_bar"] for run in RUNS])


class Foreign(Effect):
    """An effect as another package would offer it."""

    id: ClassVar[str] = "foreign"
    title: ClassVar[str] = "an effect of another package"

    def forms(self, s: Observations) -> list[Form]:
        perturbation = Perturbation(left=np.ones(len(s)))
        return [Form(self.id, "", (Parameter("size", "1", 1e-3, 1e-2),), lambda _: [perturbation])]


class NeedsArguments(Foreign):
    def __init__(self, size: float) -> None:
        self.size = size


def declared(s: Observations, **changes: object) -> Effect:
    entry = {key: value for key, value in {**SOUND, **changes}.items() if value is not None}
    return next(e for e in library(s, declared=[entry]) if e.id == entry["id"])


@pytest.fixture(scope="module")
def s() -> Observations:
    return situation(RUNS)


@pytest.mark.parametrize(
    ("acts_on", "channel", "expected"),
    [
        # ten metres straight: both radii lengthen the way, one does by half and turns, yaw turns, distance adds
        ("both", 1, 10.0 * (BAR - BAR.mean())),
        ("left", 3, -10.0 / 0.7 * (BAR - BAR.mean())),
        ("right", 3, 10.0 / 0.7 * (BAR - BAR.mean())),
        ("yaw", 3, 10.0 * (BAR - BAR.mean())),
        ("distance", 0, BAR - BAR.mean()),
    ],
)
def test_a_declared_effect_acts_where_it_says(
    s: Observations, acts_on: str, channel: int, expected: np.ndarray
) -> None:
    (form,) = declared(s, acts_on=acts_on).forms(s)
    path = predict(s)
    (perturbation,) = form.perturbations(path)
    # sums of a hundred steps
    np.testing.assert_allclose(signature(path, perturbation)[:, channel], expected, rtol=1e-9, atol=1e-9)
    assert form.parameters[0].typical == 1e-3


def test_a_declared_effect_on_the_track_acts_in_turns() -> None:
    bent = situation([replace(run, pieces=[(4.0, 0.5)], kind="bend") for run in RUNS])
    (form,) = declared(bent, acts_on="track").forms(bent)
    path = predict(bent)
    # two radians, each short by the share
    np.testing.assert_allclose(
        signature(path, form.perturbations(path)[0])[:, 3], -2.0 * (BAR - BAR.mean()), rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"id": None}, "effects[0].id"),
        ({"id": "wear"}, "effects[0].id"),
        ({"id": 3}, "effects[0].id"),
        ({"column": "nowhere"}, "effects[0].column"),
        ({"acts_on": "steering"}, "effects[0].acts_on"),
        ({"acts_on": "__import__('os')"}, "effects[0].acts_on"),
        ({"typical": "1e-3"}, "effects[0].typical"),
        ({"typical": -1.0}, "effects[0].typical"),
        ({"typical": True}, "effects[0].typical"),
        ({"typical": float("nan")}, "effects[0].typical"),
        ({"largest": 1e-4}, "effects[0].largest"),
        ({"formula": "2 * tyre_bar"}, "effects[0].formula"),
    ],
)
def test_a_bad_declaration_is_refused_by_file_and_key(s: Observations, changes: dict[str, object], key: str) -> None:
    entry = {name: value for name, value in {**SOUND, **changes}.items() if value is not None}
    with pytest.raises(BadFileError) as caught:
        library(s, declared=[entry])
    assert caught.value.path == "campaign.toml"
    assert caught.value.column == key
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("section", ["text", {"id": "tyre"}, 3, ["tyre"]])
def test_a_section_that_is_no_list_of_tables_is_refused(s: Observations, section: object) -> None:
    with pytest.raises(CalibError, match=r"campaign\.toml, column effects"):
        library(s, declared=section)


def test_two_declarations_of_one_id_are_refused(s: Observations) -> None:
    with pytest.raises(BadFileError, match=r"effects\[1\]\.id"):
        library(s, declared=[SOUND, SOUND])


def test_a_title_may_be_left_out(s: Observations) -> None:
    assert "tyre_bar" in declared(s, title=None).title


def point(name: str) -> EntryPoint:
    return EntryPoint(name=name.lower(), value=f"tests.gap.effects.test_columns:{name}", group="calib.effects")


def test_an_entry_point_adds_its_class() -> None:
    (effect,) = entry_point_effects((), [point("Foreign")])
    assert effect.id == "foreign"


def test_an_installed_package_is_found_by_the_library(s: Observations, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "calib.gap.effects.quantities.entry_points", lambda group: [point("Foreign")] * (group == "calib.effects")
    )
    assert [e.id for e in library(s)][-1] == "foreign"


@pytest.mark.parametrize("name", ["Missing", "RUNS", "NeedsArguments"])
def test_an_entry_point_that_cannot_be_used_is_named(name: str) -> None:
    with pytest.raises(BadInputError, match=f"entry point {name.lower()}"):
        entry_point_effects((), [point(name)])


def test_an_entry_point_may_not_take_an_id_that_is_in_use() -> None:
    with pytest.raises(BadInputError, match="foreign"):
        entry_point_effects(("foreign",), [point("Foreign")])


def test_only_columns_that_no_effect_acts_through_are_covariates(s: Observations) -> None:
    """Of the two further columns one is the way driven, through which wear acts."""
    assert covariate_columns(s) == ("tyre_bar", "travelled_km")
    assert [e.id for e in library(s) if e.id.startswith("covariate:")] == ["covariate:tyre_bar"]


def test_a_covariate_is_standardised(s: Observations) -> None:
    effect = next(e for e in library(s) if e.id == "covariate:tyre_bar")
    form = next(f for f in effect.forms(s) if f.label == "both radii")
    (perturbation,) = form.perturbations(predict(s))
    assert perturbation.left is not None
    # mean 0, standard deviation 1 by definition
    assert abs(perturbation.left.mean()) < 1e-12
    assert perturbation.left.std() == pytest.approx(1.0, rel=1e-12)
    assert form.settings["mean"] == pytest.approx(BAR.mean())


HALF = np.where(np.arange(12) % 2 == 0, np.nan, BAR)


@pytest.mark.parametrize("column", [np.full(12, 2.2), HALF], ids=["same", "gaps"])
def test_a_column_that_is_constant_or_has_many_gaps_is_no_candidate(column: np.ndarray) -> None:
    made = campaign(RUNS)
    numbers = {**made.runs.numbers, "tyre_bar": column}
    s = observations_of(replace(made, runs=replace(made.runs, numbers=numbers)))
    assert next(e for e in library(s) if e.id == "covariate:tyre_bar").forms(s) == []


def test_one_gap_of_a_column_is_filled_with_the_mean_of_its_session() -> None:
    """The other runs speak for the column all the same."""
    made = campaign(RUNS)
    numbers = {**made.runs.numbers, "tyre_bar": np.where(np.arange(12) == 3, np.nan, BAR)}
    s = observations_of(replace(made, runs=replace(made.runs, numbers=numbers)))
    assert next(e for e in library(s) if e.id == "covariate:tyre_bar").forms(s) != []
    alike = made.runs.label("session") == made.runs.label("session")[3]
    alike[3] = False
    assert s.numbers["tyre_bar"][3] == pytest.approx(BAR[alike].mean())


def test_a_declared_column_is_no_candidate_of_its_own_beside_the_declaration(s: Observations) -> None:
    """Two effects of one column would be alike, and make every verdict on it ambiguous."""
    ids = {effect.id for effect in library(s, declared=[SOUND])}
    assert "tyre" in ids
    assert "covariate:tyre_bar" not in ids
    # without the declaration the column speaks for itself again
    assert "covariate:tyre_bar" in {effect.id for effect in library(s, declared=[SOUND], exclude=("tyre",))}


@pytest.mark.parametrize("excluded", ["tyre", "foreign", "covariate:tyre_bar", "wear", "encoder_gross"])
def test_whatever_may_be_named_may_be_excluded(s: Observations, monkeypatch: pytest.MonkeyPatch, excluded: str) -> None:
    monkeypatch.setattr(
        "calib.gap.effects.quantities.entry_points", lambda group: [point("Foreign")] * (group == "calib.effects")
    )
    check_excluded([excluded], s, [SOUND])
    assert excluded not in {effect.id for effect in library(s, declared=[SOUND], exclude=(excluded,))}


@pytest.mark.parametrize("unknown", ["gremlins", "covariate:no_such_column", "user:tyre"])
def test_what_is_no_effect_of_the_campaign_cannot_be_excluded(s: Observations, unknown: str) -> None:
    with pytest.raises(BadInputError, match="expected an effect of the library"):
        check_excluded([unknown], s, [SOUND])


@pytest.mark.parametrize("acts_on", ACTS_ON)
def test_another_zero_of_the_column_looks_like_calibration_and_is_said_to(acts_on: str) -> None:
    """An effect that counts from zero, not from the mean, is the declared one and what it says it shifts."""
    s = situation([replace(run, pieces=ROUTE) if n % 2 else run for n, run in enumerate(RUNS)])
    effect = declared(s, acts_on=acts_on)
    (form,) = effect.forms(s)
    path = predict(s)
    (perturbation,) = form.centred_at(Centre(0.0)).perturbations(path)
    (own,) = form.perturbations(path)
    moved = (signature(path, perturbation) - signature(path, own))[:, :4]
    if acts_on == "distance":
        # an offset of the laser, which no calibration is
        assert effect.shifts == ()
        return
    known = {e.id: e.forms(s)[0].perturbations(path)[0] for e in library(s) if e.calibration}
    matrix = np.stack([signature(path, known[name])[:, :4].ravel() for name in effect.shifts], axis=1)
    left = moved.ravel() - matrix @ np.linalg.lstsq(matrix, moved.ravel(), rcond=None)[0]
    # chords against arcs are of second order in a step's turn (0.04 rad here)
    assert np.abs(left).max() <= 3e-3 * np.abs(moved).max()
