"""A diagnosed effect added to the model, as a coefficient file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from calib.campaign.model import Campaign
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


def applied_model(diagnosis: Diagnosis, campaign: Campaign, given: Sequence[EffectSection] = ()) -> CoefficientFile:
    """Return the campaign's model with the named causes added, as a coefficient file; refused where none is named.

    The fitted recalibration goes into radii and track, a load effect into the slopes of the law; others are written by
    id, form, settings and parameters, which `model_of` and `with_effects` of `calib.gap.effects.applied` take back. The
    diagnosed model's own (`given`) are kept.
    """
    fitted = diagnosis.correction.at_end()
    if not diagnosis.causes:
        why = "there is no gap" if diagnosis.kind is VerdictKind.NO_GAP else f"the verdict is {diagnosis.kind.value}"
        raise RefusedError(
            f"{diagnosis.campaign}: {why}, so there is no effect to add to the model; "
            "drive the runs that 'calib plan' names, or leave the model as it is"
        )
    observations = diagnosis.observations
    model = observations.model
    slopes, sections = _slopes_and_sections(fitted, diagnosis.corrected_causes)

    def law(number: int, side: str) -> WheelLaw:
        grown = 1.0 + float(fitted.calibration[number])
        radius_m = getattr(model, f"radius_{side}_m") * grown
        slope, variance = slopes[side]
        load_N = observations.wheel_loads_N[number]
        return WheelLaw(
            reference_load_N=model.reference_load_N,
            radius_ref_m=radius_m,
            slope_m_per_N=getattr(model, f"slope_{side}_m_per_N") * grown + slope,
            covariance=np.diag([fitted.covariance[number, number] * radius_m**2, variance]),
            dof=max(float(diagnosis.noise.dof), 1.0),
            residual_std_m=float(diagnosis.noise.scales.get("radius_scatter", 0.0)) * radius_m,
            load_min_N=float(np.nanmin(load_N)),
            load_max_N=float(np.nanmax(load_N)),
            n_runs=len(observations),
        )

    return from_law(
        RadiusLaw(left=law(0, "left"), right=law(1, "right")),
        observations.vehicle,
        campaign.encoder,
        Header(campaign.name, campaign.simulated, "clamp", inputs=campaign.hashes),
        load_table=load_points(*observations.wheel_loads_N),
        effects=[*given, *sections],
        noise=PoseNoise(track_std_m=float(np.sqrt(fitted.covariance[2, 2])) * model.track_m),
    ).calibrated(track=model.track_m * (1.0 + float(fitted.calibration[2])))


def _slopes_and_sections(
    fitted: Fitted, causes: Sequence[Cause]
) -> tuple[dict[str, tuple[float, float]], list[EffectSection]]:
    """Return slope and its variance, by side, that the causes add to the law; the other causes written down."""
    named = {cause.effect for cause in causes}
    slopes = {"left": (0.0, 0.0), "right": (0.0, 0.0)}
    sections: list[EffectSection] = []
    # the covariance begins with the four of the calibration
    variances = iter(np.diag(fitted.covariance)[4:])
    for form, theta in zip(fitted.forms, fitted.theta, strict=True):
        squares = [float(next(variances)) for _ in theta]
        kind = effect_class(form.effect)
        if form.effect in named and kind is not None and kind.carries_law_slope:
            sides = [parameter.name.removeprefix("slope_") for parameter in form.parameters]
            slopes |= dict(zip(sides, zip(map(float, theta), squares, strict=True), strict=True))
        elif form.effect in named:
            sections.append(section_of(form, theta))
    for cause in causes:
        kind = effect_class(cause.effect)
        if kind is not None and kind.found_before_search:
            sizes = {name: Quantity(value=q.value, unit=q.unit) for name, q in cause.parameters.items()}
            settings = dict(cause.settings)
            sections.append(EffectSection(effect=cause.effect, form=cause.form, settings=settings, parameters=sizes))
    return slopes, sections
