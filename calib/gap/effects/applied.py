"""Effects written down in a coefficient file, looked up again on a campaign."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.read import SETTINGS
from calib.campaign.settings import OdometryModel
from calib.gap.effects.effect import Centre, Form
from calib.gap.effects.encoder import Blunder, EncoderBlunder, corrected
from calib.gap.effects.library import every_effect
from calib.gap.effects.radii import Wear
from calib.gap.effects.reference import ReferenceLatency
from calib.gap.observations.arrays import Observations
from calib.gap.predict import Path, predict
from calib.gap.steps import Perturbation
from calib.radius.law import within_law
from calib.types import FloatArray

if TYPE_CHECKING:
    from calib.coefficients.file import CoefficientFile
    from calib.coefficients.sections import EffectSection

#: settings of where a covariate's effect is zero
CENTRE: Final = "centre"
SPREAD: Final = "spread"
#: ends the form of what counts through another campaign
ELSEWHERE: Final = " of other runs"
#: parameter of a geometry: by how much the reference reads late
DELAY: Final = "delay_s"


def model_of(path: FilePath | str, campaign: Campaign) -> tuple[OdometryModel, tuple[EffectSection, ...]]:
    """Return what a coefficient file believes: the odometry's model, and the effects to add to it.

    The law is centred on the reference load of the campaign's model. Wear counts in the campaign that was diagnosed.
    """
    from calib.coefficients.file import believed_model, load_coefficients

    file = load_coefficients(path)
    file.refuse_other_vehicle(campaign)
    known = {one.sha256 for one in file.inputs}
    same = all(digest in known for name, digest in campaign.hashes.items() if name != SETTINGS)
    effects = [
        one if same or one.effect != Wear.id else one.model_copy(update={"form": one.form + ELSEWHERE})
        for one in file.effects
    ]
    return believed_model(file, campaign.model.reference_load_N), (*effects, *_delay_of(file))


def with_sensor_of(path: FilePath | str, campaign: Campaign) -> Campaign:
    """Return the campaign with the reference's sensor where a geometry in a coefficient file found it.

    Without one the campaign's own statement holds.
    """
    from calib.coefficients.file import load_coefficients

    return replace(campaign, reference=load_coefficients(path).sensor(campaign.reference))


def beyond_law(path: FilePath | str, observations: Observations) -> tuple[str, ...]:
    """Return one sentence where loads lie outside the valid range of a coefficient file."""
    from calib.coefficients.file import load_coefficients

    file = load_coefficients(path)
    if within_law(file.law, *observations.loads_N).all():
        return ()
    said = "wheel loads lie outside the valid range of the model: its law is extended to them"
    return (f"{said} (on a vehicle: {file.outside})",)


def _delay_of(file: CoefficientFile) -> tuple[EffectSection, ...]:
    """Return a delay of the reference that a geometry determined, else nothing."""
    from calib.coefficients.sections import EffectSection, Quantity

    together = file.joint_geometry
    if together is None or not together.values.get(DELAY) or all(entry.first != DELAY for entry in together.covariance):
        return ()
    latency = {"latency": Quantity(value=together.values[DELAY], unit="s")}
    return (EffectSection(effect=ReferenceLatency.id, form=ReferenceLatency.OF_POSE, parameters=latency),)


def with_effects(
    observations: Observations, sections: Sequence[EffectSection], declared: object = ()
) -> tuple[Observations, tuple[str, ...]]:
    """Return the campaign as a simulator with the effects would predict it, and notes on what could not be applied.

    The prediction stands where an outside simulator's would; units that one predicted stay as they are. The
    observations have the file's model already; `declared`: the campaign's ``[[effects]]`` tables.
    """
    notes: list[str] = []
    for section in sections:
        if section.effect == EncoderBlunder.id:
            factors = {name: quantity.value for name, quantity in section.parameters.items()}
            fault = Blunder.from_factors(section.form, factors)
            if fault is None:
                notes.append("the model's encoder fault lacks its factors and was omitted")
            else:
                observations = corrected(observations, fault)
    others = [section for section in sections if section.effect != EncoderBlunder.id]
    if not others:
        return observations, tuple(notes)
    perturbations, left_out = applied_perturbations(observations, others, declared=declared)
    path = predict(observations, perturbations)
    own = observations.usable & ~np.isfinite(observations.simulated)
    simulated = np.where(own, path.reading, observations.simulated)
    return replace(observations, simulated=simulated), (*notes, *left_out)


def applied_perturbations(
    observations: Observations, sections: Sequence[EffectSection], path: Path | None = None, declared: object = ()
) -> tuple[list[Perturbation], list[str]]:
    """Return what written-down effects do, times their sizes, and notes on what could not be applied.

    Effects are looked up by id, form and settings, parameters by name. A covariate's deviation is from the mean in the
    file. They act about `path`, by default the path that they give.
    """
    everywhere = replace(observations, applied=True)
    effects = every_effect(everywhere, declared=declared)
    notes: list[str] = []
    chosen: list[tuple[EffectSection, Form]] = []
    for section in sections:
        effect = effects.get(section.effect)
        form = None if effect is None else matching_form(effect.forms(everywhere), section.form, section.settings)
        if form is None:
            which = f"{section.effect} ({section.form or 'its only form'})"
            notes.append(f"the model's effect {which} has nothing to act on in these runs and was omitted")
            continue
        stated = section.settings
        centre = Centre(stated[CENTRE], stated.get(SPREAD, 1.0) or 1.0) if CENTRE in stated else None
        chosen.append((section, form.with_settings(stated).centred_at(centre)))
    if path is not None:
        return _perturbations(chosen, path), notes
    # what an effect does depends a little on the path that it itself bends
    about = predict(observations)
    for _ in range(2):
        about = predict(observations, _perturbations(chosen, about))
    return _perturbations(chosen, about), notes


def _perturbations(chosen: Sequence[tuple[EffectSection, Form]], path: Path) -> list[Perturbation]:
    scaled = []
    for section, form in chosen:
        for parameter, perturbation in zip(form.parameters, form.perturbations(path), strict=True):
            size = section.parameters.get(parameter.name)
            if size is not None and size.value != 0.0:
                scaled.append(perturbation.scaled(size.value))
    return scaled


def section_of(form: Form, theta: FloatArray) -> EffectSection:
    """Return a fitted form as a coefficient file holds it: id, label, settings, where it is zero, and its sizes."""
    from calib.coefficients.sections import EffectSection, Quantity

    settings = {name: float(value) for name, value in form.settings.items()}
    if form.centre is not None:
        settings |= {CENTRE: form.centre.mean, SPREAD: form.centre.spread}
    parameters = {
        parameter.name: Quantity(value=float(value), unit=parameter.unit)
        for parameter, value in zip(form.parameters, theta, strict=True)
    }
    return EffectSection(effect=form.effect, form=form.label, settings=settings, parameters=parameters)


def matching_form(forms: Sequence[Form], label: str, settings: Mapping[str, float]) -> Form | None:
    """Return the form of a label, where several bear it the one with the nearest settings; None where there is none."""

    def off(form: Form) -> float:
        return sum(abs(form.settings[key] - settings[key]) for key in form.settings.keys() & settings.keys())

    alike = [form for form in forms if form.label == label]
    # older files name the speed itself, which the settings hold
    alike = alike or [form for form in forms if form.label.partition(" above")[0] == label.partition(" above")[0]]
    return min(alike, key=off, default=None)
