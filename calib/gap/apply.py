"""A diagnosed effect added to the model, as a coefficient file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.settings import OdometryModel
from calib.coefficients.build import Header, PoseNoise, from_law, load_points
from calib.coefficients.file import CoefficientFile
from calib.coefficients.sections import EffectSection, Quantity
from calib.errors import RefusedError
from calib.gap.decision.diagnosis import VerdictKind
from calib.gap.effects.applied import section_of
from calib.gap.effects.library import effect_class
from calib.gap.inference.fit import Fitted
from calib.radius.law import RadiusLaw, WheelLaw

if TYPE_CHECKING:
    from calib.gap.decision.diagnosis import Cause, Diagnosis

SIDES = ("left", "right")


@dataclass
class _Line:
    """What the fit makes of the radius law, by side: radius at the reference load, slope and the slope's variance."""

    radius_m: dict[str, float]
    slope_m_per_N: dict[str, float]
    slope_variance: dict[str, float] = field(default_factory=lambda: dict.fromkeys(SIDES, 0.0))


def applied_model(diagnosis: Diagnosis, campaign: Campaign, given: Sequence[EffectSection] = ()) -> CoefficientFile:
    """Return the campaign's model with the named causes added, as a coefficient file; refused where none is named.

    The recalibration that was fitted beside the causes goes into radii and track, a load effect into the slopes of the
    law; every other effect is written down by its id, form, settings and parameters. `model_of` and `with_effects` of
    `calib.gap.effects.applied` take them back. Effects that the diagnosed model had already (`given`) are kept.
    """
    fitted = diagnosis.correction
    _refuse_without_cause(diagnosis)
    observations = diagnosis.observations
    model = observations.model
    line, sections = _line_and_sections(model, fitted, diagnosis.corrected_causes)
    sections = [*given, *sections]
    loads = {side: observations.number(f"load_{side}_N") for side in SIDES}
    scatter = float(diagnosis.noise.scales.get("radius_scatter", 0.0))
    laws = {
        side: WheelLaw(
            reference_load_N=model.reference_load_N,
            radius_ref_m=line.radius_m[side],
            slope_m_per_N=line.slope_m_per_N[side],
            covariance=np.diag(
                [fitted.covariance[number, number] * line.radius_m[side] ** 2, line.slope_variance[side]]
            ),
            dof=max(float(diagnosis.noise.dof), 1.0),
            residual_std_m=scatter * line.radius_m[side],
            load_min_N=float(np.nanmin(loads[side])),
            load_max_N=float(np.nanmax(loads[side])),
            n_runs=len(observations),
        )
        for number, side in enumerate(SIDES)
    }
    return from_law(
        RadiusLaw(left=laws["left"], right=laws["right"]),
        replace(observations.vehicle, track_m=model.track_m * (1.0 + float(fitted.calibration[2]))),
        campaign.encoder,
        Header(campaign.name, campaign.simulated, "clamp", inputs=campaign.hashes),
        load_table=load_points(loads["left"], loads["right"]),
        effects=sections,
        noise=PoseNoise(track_std_m=float(np.sqrt(fitted.covariance[2, 2])) * model.track_m),
    )


def _refuse_without_cause(diagnosis: Diagnosis) -> None:
    if diagnosis.causes:
        return
    why = "there is no gap" if diagnosis.kind is VerdictKind.NO_GAP else f"the verdict is {diagnosis.kind.value}"
    raise RefusedError(
        f"{diagnosis.campaign}: {why}, so there is no effect to add to the model; "
        "drive the runs that 'calib plan' names, or leave the model as it is"
    )


def _line_and_sections(
    model: OdometryModel, fitted: Fitted, causes: Sequence[Cause]
) -> tuple[_Line, list[EffectSection]]:
    """Return the radius law with recalibration and load effect in it, and the other named effects written down."""
    left, right = (float(value) for value in fitted.calibration[:2])
    line = _Line(
        radius_m={"left": model.radius_left_m * (1 + left), "right": model.radius_right_m * (1 + right)},
        slope_m_per_N={
            "left": model.slope_left_m_per_N * (1 + left),
            "right": model.slope_right_m_per_N * (1 + right),
        },
    )
    named = {cause.effect for cause in causes}
    sections: list[EffectSection] = []
    # the covariance begins with the four of the calibration
    position = 4
    for form, theta in zip(fitted.forms, fitted.theta, strict=True):
        variance = np.diag(fitted.covariance)[position : position + len(theta)]
        position += len(theta)
        if form.effect not in named:
            continue
        kind = effect_class(form.effect)
        if kind is None or not kind.carries_law_slope:
            sections.append(section_of(form, theta))
            continue
        for parameter, value, square in zip(form.parameters, theta, variance, strict=True):
            side = parameter.name.removeprefix("slope_")
            line.slope_m_per_N[side] += float(value)
            line.slope_variance[side] = float(square)
    for cause in causes:
        kind = effect_class(cause.effect)
        if kind is not None and kind.found_before_search:
            parameters = {name: Quantity(value=q.value, unit=q.unit) for name, q in cause.parameters.items()}
            settings = dict(cause.settings)
            sections.append(
                EffectSection(effect=cause.effect, form=cause.form, settings=settings, parameters=parameters)
            )
    return line, sections
