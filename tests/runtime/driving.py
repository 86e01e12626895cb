"""Runs and coefficient files on which the effects of the runtime are tried."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.campaign.model import Campaign
from calib.coefficients.build import Header, from_law
from calib.coefficients.file import CoefficientFile
from calib.coefficients.sections import EffectSection
from calib.gap.effects.library import every_effect, section_of
from calib.gap.observations import Observations
from calib.gap.observations.from_campaign import observations_of
from calib.radius.law import RadiusLaw, WheelLaw
from calib.runtime import Run
from calib.runtime.effects import _OTHER_FORMS
from tests.gap.effects.making import campaign, rich_runs


def driven_runs() -> tuple[Campaign, Observations]:
    """Runs under several loads, speeds, temperatures and curvatures; the wheels' angles known without steps."""
    made = campaign(rich_runs())
    numbers = {**made.runs.numbers, "tyre_bar": np.linspace(1.8, 2.4, len(made.runs))}
    made = replace(made, runs=replace(made.runs, numbers=numbers))
    model = replace(made.model, slope_left_m_per_N=8e-7, slope_right_m_per_N=-5e-7)
    return made, replace(observations_of(made, model), count_rad=(1e-12, 1e-12))


def coefficient_file(made: Campaign, s: Observations, sections: list[EffectSection]) -> CoefficientFile:
    """Return the model of the runs with effects as a coefficient file."""

    def law(radius_m: float, slope: float) -> WheelLaw:
        covariance = np.diag([1e-12, 1e-18])
        return WheelLaw(s.model.reference_load_N, radius_m, slope, covariance, 9.0, 1e-5, 0.0, 5000.0, 9)

    laws = RadiusLaw(
        law(s.model.radius_left_m, s.model.slope_left_m_per_N), law(s.model.radius_right_m, s.model.slope_right_m_per_N)
    )
    vehicle = replace(s.vehicle, track_m=s.model.track_m)
    return from_law(laws, vehicle, made.encoder, Header("sim", True, "clamp"), effects=sections, load_margin_N=0.0)


def run_of(s: Observations, number: int) -> Run:
    """Return what holds during an observation."""

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


def sections_of(name: str, s: Observations) -> list[EffectSection]:
    """Return every form of an effect that acts on motion, at its typical size."""
    forms = [form for form in every_effect(s)[name].forms(s) if not any(words in form.label for words in _OTHER_FORMS)]
    sizes = [np.array([(1.0 if p.sign >= 0 else -1.0) * p.typical for p in form.parameters]) for form in forms]
    return [section_of(form, theta) for form, theta in zip(forms, sizes, strict=True)]
