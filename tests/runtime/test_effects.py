"""The effects on a vehicle's own loop move its wheels as the diagnosis does, effect by effect and all together."""

from __future__ import annotations

import json
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.coefficients.sections import EffectSection
from calib.gap import Steps, total_perturbation
from calib.gap.effects.library import applied_perturbations, every_effect, section_of
from calib.gap.observations import Observations
from calib.runtime import CoefficientError, Effects, Run
from calib.runtime.effects import _ACTS
from tests.runtime.driving import coefficient_file, driven_runs, run_of, sections_of

#: of a wheel's travel in a step: both compute in doubles
AGREES = 1e-9
RUNS = 4


@pytest.fixture(scope="module")
def driven() -> tuple[Campaign, Observations]:
    return driven_runs()


def _assert_agrees(made: Campaign, s: Observations, sections: list[EffectSection], tmp_path: Path) -> None:
    perturbations, notes = applied_perturbations(s, sections)
    assert notes == []
    total = total_perturbation(s, perturbations)
    steps = Steps(s, total)
    track = np.broadcast_to(steps.track_m, s.unit.shape)
    turn = steps.turn_rad
    aside = np.zeros(len(s.unit)) if total.lateral_m is None else total.lateral_m
    path = tmp_path / "c.json"
    path.write_bytes(coefficient_file(made, s, sections).to_bytes())
    effects = Effects.from_file(path)
    assert effects.left_out == ()
    logged = np.flatnonzero(s.from_log)
    for number in logged[np.linspace(0, len(logged) - 1, RUNS).astype(int)].tolist():
        effects.begin(run_of(s, number))
        part = slice(int(s.starts[number]), int(s.starts[number + 1]))
        steps_taken = zip(s.roll_left_rad[part], s.roll_right_rad[part], s.duration_s[part], strict=True)
        motions = [effects.step(float(left), float(right), float(lasts_s)) for left, right, lasts_s in steps_taken]
        found = np.array([[one.left_m, one.right_m, one.track_m, one.aside_m, one.turn_rad] for one in motions]).T
        wanted = np.stack([steps.ds_left_m, steps.ds_right_m, track, aside, turn])[:, part]
        assert np.all(np.abs(found - wanted) <= np.maximum(AGREES * np.abs(wanted), 1e-12))


@pytest.mark.parametrize("name", [*_ACTS, "covariate:tyre_bar"])
def test_each_effect_moves_the_wheels_as_in_the_diagnosis(
    name: str, driven: tuple[Campaign, Observations], tmp_path: Path
) -> None:
    """Every form that acts on motion, at its typical size."""
    made, s = driven
    sections = sections_of(name, s)
    assert sections
    for section in sections:
        _assert_agrees(made, s, [section], tmp_path)


def test_several_effects_act_together(driven: tuple[Campaign, Observations], tmp_path: Path) -> None:
    made, s = driven
    library = every_effect(s)
    sections = []
    for name in ("temperature_radius", "curve_scrub", "side_slip", "load_dependent_track", "wheel_eccentricity"):
        form = library[name].forms(s)[-1]
        sections.append(section_of(form, np.array([2.0 * p.typical for p in form.parameters])))
    _assert_agrees(made, s, sections, tmp_path)


def test_loads_outside_the_valid_range_are_taken_as_the_odometer_takes_them(
    driven: tuple[Campaign, Observations], tmp_path: Path
) -> None:
    """Clamped to the nearest valid load, 4000 N, law and effects alike, or refused, as is always what none can be."""
    made, s = driven
    made_file = coefficient_file(made, s, [sections_of("load_creep", s)[0], sections_of("load_dependent_track", s)[0]])
    wheels = made_file.to_dict()["wheels"]
    wheels["left"]["valid_load"]["max"]["value"] = 4000.0
    clamping = made_file.changed(wheels=wheels)
    effects, moved = {}, {}
    for file in (clamping, clamping.changed(outside="refuse")):
        path = tmp_path / f"{file.outside}.json"
        path.write_bytes(file.to_bytes())
        effects[file.outside] = Effects.from_file(path)
    for load_N in (4000.0, 5000.0):
        effects["clamp"].begin(Run(load_left_N=load_N, load_right_N=300.0, minutes_under_load=20.0))
        moved[load_N] = effects["clamp"].step(0.1, 0.1, 0.02)
    assert moved[4000.0] == moved[5000.0]
    for outside, load_N in [("refuse", 4500.0), *product(("refuse", "clamp"), (np.nan, np.inf, 9000.0, -1.0))]:
        with pytest.raises(CoefficientError, match=r"load_left_N: .*; expected 0 to 4000 N"):
            effects[outside].begin(Run(load_left_N=load_N, load_right_N=300.0))
        with pytest.raises(CoefficientError, match="expected begin"):
            effects[outside].step(0.1, 0.1, 0.02)


def test_nothing_creeps_before_the_load_is_put_on(driven: tuple[Campaign, Observations], tmp_path: Path) -> None:
    made, s = driven
    path = tmp_path / "c.json"
    path.write_bytes(coefficient_file(made, s, [sections_of("load_creep", s)[0]]).to_bytes())
    effects, moved = Effects.from_file(path), []
    for minutes in (-30.0, 0.0):
        effects.begin(Run(load_left_N=900.0, load_right_N=300.0, minutes_under_load=minutes))
        moved.append(effects.step(0.1, 0.1, 0.02))
    assert moved[0] == moved[1]


def test_effects_that_do_not_act_on_motion_are_named(driven: tuple[Campaign, Observations], tmp_path: Path) -> None:
    made, s = driven
    form = every_effect(s)["reference_yaw"].forms(s)[0]
    path = tmp_path / "c.json"
    path.write_bytes(coefficient_file(made, s, [section_of(form, np.array([0.01]))]).to_bytes())
    effects = Effects.from_file(path)
    assert effects.left_out == ("reference_yaw",)
    with pytest.raises(CoefficientError, match="expected begin"):
        effects.step(0.1, 0.1, 0.02)


def test_a_file_with_a_broken_section_is_refused(driven: tuple[Campaign, Observations], tmp_path: Path) -> None:
    made, s = driven
    form = every_effect(s)["curve_scrub"].forms(s)[0]
    document = json.loads(coefficient_file(made, s, [section_of(form, np.array([0.01]))]).to_bytes())
    document["effects"][0]["parameters"]["widening"]["value"] = 0.5
    path = tmp_path / "c.json"
    path.write_text(json.dumps(document))
    with pytest.raises(CoefficientError, match="checksum"):
        Effects.from_file(path)


def test_effects_that_follow_what_is_not_known_of_a_run_are_named(
    driven: tuple[Campaign, Observations], tmp_path: Path
) -> None:
    """They act as in the mean of the runs, and a vehicle may ask which: a broken thermometer is no 20 degrees."""
    made, s = driven
    sections = [*sections_of("temperature_radius", s), *sections_of("radius_scale", s)]
    path = tmp_path / "c.json"
    path.write_bytes(coefficient_file(made, s, sections).to_bytes())
    effects = Effects.from_file(path)
    loads = {"load_left_N": float(s.number("load_left_N")[0]), "load_right_N": float(s.number("load_right_N")[0])}
    effects.begin(Run(**loads))
    assert set(effects.unknown) == {"temperature_radius"}
    effects.begin(Run(**loads, temperature_C=20.0))
    assert effects.unknown == ()
