"""A diagnosed effect added to the model: as a coefficient file, and back from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import Campaign
from calib.campaign.settings import OdometryModel
from calib.coefficients.build import from_law, load_points
from calib.coefficients.file import CoefficientFile, load_coefficients
from calib.coefficients.quantities import Quantity
from calib.coefficients.sections import EffectSection
from calib.errors import RefusedError
from calib.gap.data.from_campaign import observations_of
from calib.gap.data.observations import Observations
from calib.gap.effects.effect import Form
from calib.gap.effects.library import library
from calib.gap.effects.shapes import driven_speed_mps
from calib.gap.evidence.fit import fit
from calib.gap.evidence.noise import estimate_noise
from calib.gap.predict.count_faults import GrossFault, corrected
from calib.gap.predict.path import Path, Push, predict
from calib.gap.predict.residuals import residuals
from calib.radius.law import RadiusLaw, WheelLaw

if TYPE_CHECKING:
    from calib.gap.diagnose import Diagnosis

__all__ = ["applied_model", "applied_pushes", "matching_form", "model_of", "with_effects"]

#: settings that say where a covariate's effect is nought, added to a form's own
CENTRE: Final = "centre"
SPREAD: Final = "spread"


def applied_model(diagnosis: Diagnosis, campaign: Campaign, given: Sequence[EffectSection] = ()) -> CoefficientFile:
    """Return the campaign's model with the named causes added, as a coefficient file.

    The recalibration that was fitted beside the causes goes into radii and track, a load effect into the slopes of the
    law; every other effect is written down by its id, form, settings and parameters. `model_of` and `with_effects` take
    them back.

    Parameters
    ----------
    diagnosis : Diagnosis
        From `calib.gap.diagnose.diagnose_in_full` on the same campaign.
    campaign : Campaign
        What was diagnosed.
    given : sequence of EffectSection
        Effects that the diagnosed model had already; they are kept.

    Raises
    ------
    RefusedError
        Where the verdict names no cause.
    """
    verdict = diagnosis.verdict
    if not verdict.causes:
        why = "there is no gap" if verdict.verdict == "no_gap" else f"the verdict is {verdict.verdict}"
        raise RefusedError(
            f"{verdict.campaign}: {why}, so there is no effect to add to the model; "
            "drive the runs that 'calib plan' names, or leave the model as it is"
        )
    s, fitted = diagnosis.situation, diagnosis.fitted
    named = {cause.effect for cause in verdict.causes}
    model = s.model
    left, right, track, _ = (float(value) for value in fitted.calibration)
    slope = {"left": model.slope_left_m_per_N * (1 + left), "right": model.slope_right_m_per_N * (1 + right)}
    radius = {"left": model.radius_left_m * (1 + left), "right": model.radius_right_m * (1 + right)}
    slope_variance = {"left": 0.0, "right": 0.0}
    sections: list[EffectSection] = list(given)
    position = 4
    for form, theta in zip(fitted.forms, fitted.theta, strict=True):
        variance = np.diag(fitted.covariance)[position : position + len(theta)]
        position += len(theta)
        if form.effect not in named:
            continue
        if form.effect == "load_radius":
            for parameter, value, square in zip(form.parameters, theta, variance, strict=True):
                side = parameter.name.removeprefix("slope_")
                slope[side] += float(value)
                slope_variance[side] = float(square)
            continue
        sections.append(_section(s, form, theta))
    sections += [
        EffectSection(effect=cause.effect, form=cause.form, settings=dict(cause.settings), parameters=_plain(cause))
        for cause in verdict.causes
        if cause.effect == "encoder_gross" and not any(form.effect == cause.effect for form in fitted.forms)
    ]
    loads = {side: s.number(f"load_{side}_N") for side in ("left", "right")}
    scatter = float(diagnosis.noise.scales.get("radius_scatter", 0.0))
    laws = {
        side: WheelLaw(
            reference_load_N=model.reference_load_N,
            radius_ref_m=radius[side],
            slope_m_per_N=slope[side],
            covariance=np.diag([fitted.covariance[number, number] * radius[side] ** 2, slope_variance[side]]),
            dof=max(float(diagnosis.noise.dof), 1.0),
            residual_std_m=scatter * radius[side],
            load_min_N=float(np.nanmin(loads[side])),
            load_max_N=float(np.nanmax(loads[side])),
            n_runs=len(s),
        )
        for side, number in (("left", 0), ("right", 1))
    }
    believed = OdometryModel(
        radius_left_m=radius["left"],
        radius_right_m=radius["right"],
        track_m=model.track_m * (1 + track),
        reference_load_N=model.reference_load_N,
        slope_left_m_per_N=slope["left"],
        slope_right_m_per_N=slope["right"],
    )
    scale = _settled(campaign, believed, sections)
    laws = {
        side: replace(
            law,
            radius_ref_m=law.radius_ref_m * float(scale[number]),
            slope_m_per_N=law.slope_m_per_N * float(scale[number]),
        )
        for number, (side, law) in enumerate(laws.items())
    }
    return from_law(
        RadiusLaw(left=laws["left"], right=laws["right"]),
        replace(s.vehicle, track_m=believed.track_m * float(scale[2])),
        campaign.encoder,
        name=campaign.name,
        simulated=campaign.simulated,
        outside="clamp",
        load_table=load_points(loads["left"], loads["right"]),
        inputs=campaign.hashes,
        effects=sections,
        track_std_m=float(np.sqrt(fitted.covariance[2, 2])) * model.track_m,
    )


def _settled(campaign: Campaign, model: OdometryModel, sections: Sequence[EffectSection]) -> FloatArray:
    """Return by which factors left radius, right radius and track still move, shape (3,), once the gap is gone.

    The floor was taken about a path that a large effect bent; without the gap it is finer, and weighs runs otherwise.
    """
    s, _ = with_effects(observations_of(campaign, model), sections, campaign.extra.get("effects", ()))
    nominal = predict(s)
    base = fit(nominal, estimate_noise(nominal, residuals(nominal, nominal)))
    return np.asarray(1.0 + base.calibration[:3])


def _plain(cause: object) -> dict[str, Quantity]:
    parameters = getattr(cause, "parameters", {})
    return {name: Quantity(value=one.value, unit=one.unit) for name, one in parameters.items()}


def _section(s: Observations, form: Form, theta: FloatArray) -> EffectSection:
    settings = {name: float(value) for name, value in form.settings.items()}
    values = _centred_values(form.effect, form.label, s)
    if values is not None:
        settings[CENTRE] = float(np.nanmean(values))
        settings[SPREAD] = float(np.std(values)) if form.effect.startswith("covariate:") else 1.0
    parameters = {
        parameter.name: Quantity(value=float(value), unit=parameter.unit)
        for parameter, value in zip(form.parameters, theta, strict=True)
    }
    return EffectSection(effect=form.effect, form=form.label, settings=settings, parameters=parameters)


def _centred_values(effect: str, label: str, s: Observations) -> FloatArray | None:
    """Return the values of which a form takes the deviation from their mean, shape (n_units,); None where none."""
    if effect.startswith("covariate:"):
        return s.number(effect.partition(":")[2])
    if effect == "temperature_radius":
        return s.number("temperature_C")
    if effect == "speed_radius":
        return driven_speed_mps(s)
    if effect == "wear" and label == "per km":
        return s.number("travelled_km")
    return None


def model_of(path: FilePath | str, campaign: Campaign) -> tuple[OdometryModel, tuple[EffectSection, ...]]:
    """Return what a coefficient file believes: the odometry's model, and the effects to add to it.

    Parameters
    ----------
    path : Path
        Coefficient file of ``calib export`` or ``calib diagnose --apply``.
    campaign : Campaign
        What it shall be held against; the law is centred on the reference load of its model.

    Raises
    ------
    BadFileError
        Where the file cannot be used.
    """
    file = load_coefficients(path)
    law, load = file.law, campaign.model.reference_load_N
    model = OdometryModel(
        radius_left_m=float(law.left.radius_m(load)),
        radius_right_m=float(law.right.radius_m(load)),
        track_m=file.geometry.track_m,
        reference_load_N=load,
        slope_left_m_per_N=law.left.slope_m_per_N,
        slope_right_m_per_N=law.right.slope_m_per_N,
    )
    return model, tuple(file.effects)


def with_effects(
    s: Observations, sections: Sequence[EffectSection], declared: object = ()
) -> tuple[Observations, tuple[str, ...]]:
    """Return the situation as a simulator with the effects would predict it, and notes on what could not be applied.

    The prediction with the effects stands where an outside simulator's would, so the gap is measured minus that.
    Units that an outside simulator predicted stay as they are.

    Parameters
    ----------
    s : Observations
        With the file's model.
    sections : sequence of EffectSection
        From `model_of`.
    declared : object
        The ``[[effects]]`` tables of the campaign.
    """
    gross = [section for section in sections if section.effect == "encoder_gross"]
    notes: list[str] = []
    for section in gross:
        s, said = _without_fault(s, section)
        notes += said
    rest = [section for section in sections if section.effect != "encoder_gross"]
    if not rest:
        return s, tuple(notes)
    pushes, said_of = applied_pushes(s, rest, declared=declared)
    notes += said_of
    path = predict(s, pushes)
    own = s.usable & ~np.isfinite(s.simulated)
    return replace(s, simulated=np.where(own, path.reading, s.simulated)), tuple(notes)


def applied_pushes(
    s: Observations, sections: Sequence[EffectSection], path: Path | None = None, declared: object = ()
) -> tuple[list[Push], list[str]]:
    """Return what written-down effects do on a campaign, and notes on what could not be applied.

    Each effect is looked up in the library by id, form and settings, its parameters by their names. Effects that act on
    a covariate's deviation from its mean act on the deviation from the mean that the file says.

    Parameters
    ----------
    s : Observations
        The campaign.
    sections : sequence of EffectSection
        Effects with their parameters.
    path : Path, optional
        About which the effects act; by default the path that the effects themselves give.
    declared : object
        The ``[[effects]]`` tables of the campaign.

    Returns
    -------
    pushes : list of Push
        Already times their sizes, for `predict`.
    notes : list of str
        Sentences.
    """
    effects = {effect.id: effect for effect in library(s, declared=declared)}
    notes: list[str] = []
    chosen: list[tuple[EffectSection, Form]] = []
    for section in sections:
        effect = effects.get(section.effect)
        form = None if effect is None else matching_form(effect.forms(s), section.form, section.settings)
        if form is None:
            notes.append(
                f"the model's effect {section.effect} ({section.form or 'its only form'}) has nothing to act on in "
                "these runs and was left out"
            )
            continue
        chosen.append((section, form))
    if path is not None:
        return _pushes(s, chosen, path), notes
    # what an effect does depends a little on the path that it itself bends
    about = predict(s)
    for _ in range(2):
        about = predict(s, _pushes(s, chosen, about))
    return _pushes(s, chosen, about), notes


def _pushes(s: Observations, chosen: Sequence[tuple[EffectSection, Form]], path: Path) -> list[Push]:
    made = []
    for section, form in chosen:
        for parameter, push in zip(form.parameters, form.pushes(path), strict=True):
            size = section.parameters.get(parameter.name)
            if size is not None and size.value != 0.0:
                made.append(_recentred(s, section, push).scaled(size.value))
    return made


def _recentred(s: Observations, section: EffectSection, push: Push) -> Push:
    """Return a push whose covariate is counted from the file's mean in the file's standard deviations."""
    values = _centred_values(section.effect, section.form, s)
    if values is None or CENTRE not in section.settings:
        return push
    own = float(np.std(values)) if section.effect.startswith("covariate:") else 1.0
    spread = section.settings.get(SPREAD, 1.0) or 1.0
    shift = (float(np.nanmean(values)) - section.settings[CENTRE]) / spread
    if abs(shift) < 1e-12 and abs(own / spread - 1.0) < 1e-12:
        return push
    scaled = push.scaled(own / spread)
    return replace(
        scaled,
        left=None if scaled.left is None else scaled.left + shift,
        right=None if scaled.right is None else scaled.right + shift,
        heading_rad=None if scaled.heading_rad is None else scaled.heading_rad + shift * s.path_m,
    )


def matching_form(forms: Sequence[Form], label: str, settings: Mapping[str, float]) -> Form | None:
    """Return the form of a label, where several bear it the one with the nearest settings; None where there is none."""
    same = [form for form in forms if form.label == label]
    if not same:
        return None

    def off(form: Form) -> float:
        return sum(abs(form.settings[key] - settings[key]) for key in form.settings.keys() & settings.keys())

    return min(same, key=off)


def _without_fault(s: Observations, section: EffectSection) -> tuple[Observations, list[str]]:
    """Return the situation with the counts put right as the file says."""
    factors = [section.parameters.get(f"factor_{side}") for side in ("left", "right")]
    if factors[0] is None or factors[1] is None or not all(factor and factor.value for factor in factors):
        return s, ["the model's encoder fault lacks its factors and was left out"]
    swapped = section.form.startswith("swapped")
    return corrected(s, GrossFault(section.form, factors[0].value, factors[1].value, swapped)), []
