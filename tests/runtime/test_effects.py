"""The effects on a vehicle's own loop move its wheels as the diagnosis does, effect by effect and all together."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.coefficients.build import Header, from_law
from calib.coefficients.file import CoefficientFile
from calib.coefficients.sections import EffectSection
from calib.gap.effects.applied import applied_perturbations, section_of
from calib.gap.effects.library import every_effect
from calib.gap.observations.arrays import Observations
from calib.gap.observations.from_campaign import observations_of
from calib.gap.steps import steps_of, total_perturbation
from calib.radius.law import RadiusLaw, WheelLaw
from calib.runtime import CoefficientError, Effects, Run
from calib.runtime.effects import _ACTS, _OTHER_FORMS
from tests.gap.effects.making import campaign, rich_runs

#: of a wheel's travel in a step: both compute in doubles
AGREES = 1e-9
RUNS = 6


@pytest.fixture(scope="module")
def driven() -> tuple[Campaign, Observations]:
    """Runs under several loads, speeds, temperatures and curvatures; the wheels' angles known without steps."""
    made = campaign(rich_runs())
    numbers = {**made.runs.numbers, "tyre_bar": np.linspace(1.8, 2.4, len(made.runs))}
    made = replace(made, runs=replace(made.runs, numbers=numbers))
    model = replace(made.model, slope_left_m_per_N=8e-7, slope_right_m_per_N=-5e-7)
    return made, replace(observations_of(made, model), count_rad=(1e-12, 1e-12))


def _file(made: Campaign, s: Observations, sections: list[EffectSection]) -> CoefficientFile:
    def law(radius_m: float, slope: float) -> WheelLaw:
        covariance = np.diag([1e-12, 1e-18])
        return WheelLaw(s.model.reference_load_N, radius_m, slope, covariance, 9.0, 1e-5, 0.0, 5000.0, 9)

    laws = RadiusLaw(
        law(s.model.radius_left_m, s.model.slope_left_m_per_N), law(s.model.radius_right_m, s.model.slope_right_m_per_N)
    )
    vehicle = replace(s.vehicle, track_m=s.model.track_m)
    return from_law(laws, vehicle, made.encoder, Header("sim", True, "clamp"), effects=sections, load_margin_N=0.0)


def _run_of(s: Observations, number: int) -> Run:
    def value(name: str) -> float:
        return float(s.number(name)[number])

    steps = slice(int(s.starts[number]), int(s.starts[number + 1]))
    way = np.abs(s.path_m[steps])
    return Run(
        load_left_N=value("load_left_N"),
        load_right_N=value("load_right_N"),
        payload_kg=np.nan_to_num(value("payload_kg")),
        temperature_C=value("temperature_C"),
        speed_mps=float((way * np.abs(s.speed_mps[steps])).sum() / way.sum()),
        travelled_km=value("travelled_km"),
        minutes_under_load=value("minutes_under_load") + 0.5 * float(s.duration_s[steps].sum()) / 60.0,
        direction=str(s.labels["direction"][number]),
        phase_left_rad=float(s.phase_left_rad[steps][0] - s.roll_left_rad[steps][0]),
        phase_right_rad=float(s.phase_right_rad[steps][0] - s.roll_right_rad[steps][0]),
        covariates={"tyre_bar": value("tyre_bar")},
    )


def _assert_agrees(made: Campaign, s: Observations, sections: list[EffectSection], tmp_path: Path) -> None:
    perturbations, notes = applied_perturbations(s, sections)
    assert notes == []
    total = total_perturbation(s, perturbations)
    steps = steps_of(s, total)
    track = np.broadcast_to(steps.track_m, s.unit.shape)
    turn = steps.turn_rad
    aside = np.zeros(len(s.unit)) if total.lateral_m is None else total.lateral_m
    path = tmp_path / "c.json"
    path.write_bytes(_file(made, s, sections).to_bytes())
    effects = Effects.from_file(path)
    assert effects.left_out == ()
    logged = np.flatnonzero(s.from_log)
    for number in logged[np.linspace(0, len(logged) - 1, RUNS).astype(int)].tolist():
        effects.begin(_run_of(s, number))
        for at in range(int(s.starts[number]), int(s.starts[number + 1])):
            motion = effects.step(float(s.roll_left_rad[at]), float(s.roll_right_rad[at]), float(s.duration_s[at]))
            found = [motion.left_m, motion.right_m, motion.track_m, motion.aside_m, motion.turn_rad]
            wanted = [steps.ds_left_m[at], steps.ds_right_m[at], track[at], aside[at], turn[at]]
            assert found == pytest.approx(wanted, rel=AGREES, abs=1e-12)


@pytest.mark.parametrize("name", [*_ACTS, "covariate:tyre_bar"])
def test_each_effect_moves_the_wheels_as_in_the_diagnosis(
    name: str, driven: tuple[Campaign, Observations], tmp_path: Path
) -> None:
    """Every form that acts on motion, at its typical size."""
    made, s = driven
    forms = [form for form in every_effect(s)[name].forms(s) if not any(words in form.label for words in _OTHER_FORMS)]
    assert forms
    for form in forms:
        theta = np.array([(1.0 if p.sign >= 0 else -1.0) * p.typical for p in form.parameters])
        _assert_agrees(made, s, [section_of(form, theta)], tmp_path)


def test_several_effects_act_together(driven: tuple[Campaign, Observations], tmp_path: Path) -> None:
    made, s = driven
    library = every_effect(s)
    sections = []
    for name in ("temperature_radius", "curve_scrub", "side_slip", "load_dependent_track", "wheel_eccentricity"):
        form = library[name].forms(s)[-1]
        sections.append(section_of(form, np.array([2.0 * p.typical for p in form.parameters])))
    _assert_agrees(made, s, sections, tmp_path)


def test_effects_that_do_not_act_on_motion_are_named(driven: tuple[Campaign, Observations], tmp_path: Path) -> None:
    made, s = driven
    form = every_effect(s)["reference_yaw"].forms(s)[0]
    path = tmp_path / "c.json"
    path.write_bytes(_file(made, s, [section_of(form, np.array([0.01]))]).to_bytes())
    effects = Effects.from_file(path)
    assert effects.left_out == ("reference_yaw",)
    with pytest.raises(CoefficientError, match="expected begin"):
        effects.step(0.1, 0.1, 0.02)


def test_a_file_with_a_broken_section_is_refused(driven: tuple[Campaign, Observations], tmp_path: Path) -> None:
    made, s = driven
    form = every_effect(s)["curve_scrub"].forms(s)[0]
    document = json.loads(_file(made, s, [section_of(form, np.array([0.01]))]).to_bytes())
    document["effects"][0]["parameters"]["widening"]["value"] = 0.5
    path = tmp_path / "c.json"
    path.write_text(json.dumps(document))
    with pytest.raises(CoefficientError, match="checksum"):
        Effects.from_file(path)
