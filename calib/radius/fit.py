"""From a campaign to the laws of both wheels: effective radii, regression, checks, static radii, budget."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from calib.campaign.checks.assumed import stand_ins
from calib.campaign.model import Campaign
from calib.errors import BadInputError, RefusedError
from calib.radius.effective import Component, EffectiveRadii, effective_radii
from calib.radius.fitted import Fit, Setup
from calib.radius.plausible import held_against_bounds, refuse_implausible
from calib.radius.regression import WheelFit, fit_wheel
from calib.radius.residual_checks import checked
from calib.radius.systematic import declared_sources, systematic_components, with_systematic
from calib.radius.temperature_check import against_temperature

#: the reference load may lie beyond the largest load driven by this factor; further out the line has no digits left
MOST_REFERENCE: Final = 1e4
#: columns whose span tells the conditions of a campaign
CONDITIONS: Final = (
    "distance_m",
    "speed_mps",
    "temperature_C",
    "payload_kg",
    "payload_x_m",
    "payload_y_m",
    "minutes_under_load",
    "load_left_N",
    "load_right_N",
)


def fit_law(radii: EffectiveRadii, *, reference_load_N: float, name: str = "", simulated: bool = False) -> Fit:
    """Fit both wheels' laws to effective radii.

    `radii`: radii a run and wheel; `reference_load_N`: load on which the coefficients are centred; `name`, `simulated`:
    carried over from the campaign. With the checks of both wheels. Raises RefusedError with fewer than three runs.
    """
    wheels = {}
    for wheel, load, radius in (
        ("left", radii.load_left_N, radii.radius_left_m),
        ("right", radii.load_right_N, radii.radius_right_m),
    ):
        unchecked = fit_wheel(wheel, load, radius, radii.session, reference_load_N=reference_load_N)
        wheels[wheel] = checked(unchecked, radii.session, radii.direction, radii.run_id)
    radii = replace(radii, budget=(*radii.budget, *_observed(radii, wheels["left"], wheels["right"])))
    return Fit(
        name=name, simulated=simulated, left=wheels["left"], right=wheels["right"], radii=radii, notes=radii.notes
    )


def fit_campaign(campaign: Campaign, *, reference_load_N: float | None = None) -> Fit:
    """Return the fit of a campaign: effective radii, both laws, and the static radius where it was measured.

    `campaign`: static radii are taken from the columns ``static_radius_left_m`` and ``static_radius_right_m``, where
    there are; `reference_load_N`: load on which the coefficients are centred; without it the one of the campaign's
    model. With its setup. Raises RefusedError where fewer than three runs can be used; ImplausibleError where that is
    so because of units or settings that cannot be.
    """
    reference = campaign.model.reference_load_N if reference_load_N is None else reference_load_N
    if not np.isfinite(reference) or reference < 0:
        raise BadInputError(f"reference load: found {reference:g} N; expected a load of zero or more; correct it")
    try:
        radii = effective_radii(campaign)
        _refuse_far(reference, radii)
        fit = fit_law(radii, reference_load_N=reference, name=campaign.name, simulated=campaign.simulated)
    except RefusedError:
        refuse_implausible(campaign)
        raise
    sources = declared_sources(campaign)
    fit = replace(
        fit,
        left=with_systematic(fit.left, fit.radii, sources),
        right=with_systematic(fit.right, fit.radii, sources),
        radii=replace(fit.radii, budget=(*fit.radii.budget, *systematic_components(fit.wheels, fit.radii, sources))),
    )
    fit = held_against_bounds(fit, campaign)
    static, notes = _static(campaign, reference)
    used = campaign.select(np.isin(campaign.runs.run_id, radii.run_id)).runs
    warmth, session = used.number("temperature_C"), used.label("session")
    fit = replace(
        fit,
        left=against_temperature(fit.left, warmth, session),
        right=against_temperature(fit.right, warmth, session),
    )
    conditions = {}
    for name in CONDITIONS:
        column = used.number(name)
        if np.isfinite(column).any():
            conditions[name] = (float(np.nanmin(column)), float(np.nanmax(column)))
    return replace(
        fit,
        static=static,
        notes=(*fit.notes, *notes),
        setup=Setup(
            vehicle=campaign.vehicle,
            encoder=campaign.encoder,
            model=campaign.model,
            rangefinder=campaign.rangefinder,
            reference=campaign.reference,
            conditions=conditions,
            assumed=stand_ins(campaign),
        ),
    )


def _refuse_far(reference_load_N: float, radii: EffectiveRadii) -> None:
    """Refuse a reference load so far from the loads driven that nothing of the radius is left there."""
    loads = np.append(radii.load_left_N, radii.load_right_N)
    largest = float(np.max(loads[np.isfinite(loads)], initial=1.0))
    if reference_load_N > MOST_REFERENCE * largest:
        raise BadInputError(
            f"reference load: found {reference_load_N:g} N; expected a load near those driven, up to {largest:g} N; "
            "correct it"
        )


def _static(campaign: Campaign, reference_load_N: float) -> tuple[dict[str, WheelFit], tuple[str, ...]]:
    """Return the fits of the static radius against load, and notes on those that could not be made."""
    runs = campaign.included().runs
    fits, notes = {}, []
    for wheel in ("left", "right"):
        radius, load = runs.number(f"static_radius_{wheel}_m"), runs.number(f"load_{wheel}_N")
        good = np.isfinite(radius) & np.isfinite(load)
        if not good.any():
            continue
        session = runs.label("session")[good]
        try:
            unchecked = fit_wheel(wheel, load[good], radius[good], session, reference_load_N=reference_load_N)
        except RefusedError as error:
            notes.append(f"Static radius not fitted: {error}.")
            continue
        fits[wheel] = checked(unchecked, session, runs.label("direction")[good], runs.run_id[good])
    return fits, tuple(notes)


def _observed(radii: EffectiveRadii, left: WheelFit, right: WheelFit) -> tuple[Component, ...]:
    """Return the type A lines of the budget: what the runs scatter beyond what the instruments explain."""
    explained = [float(np.sqrt(np.mean(np.nan_to_num(std) ** 2))) for std in (radii.std_left_m, radii.std_right_m)]
    rest = [
        float(np.sqrt(max(wheel.run_std_m**2 - known**2, 0.0)))
        for wheel, known in zip((left, right), explained, strict=True)
    ]
    lines = [
        Component(
            "other_run_to_run",
            "A",
            "t",
            "scatter of runs within a session beyond the above",
            rest[0],
            rest[1],
            left.estimate.dof_within,
        )
    ]
    if left.estimate.dof_between > 0:
        lines.append(
            Component(
                "session_to_session",
                "A",
                "t",
                "scatter of sessions beyond their runs",
                left.session_std_m,
                right.session_std_m,
                left.estimate.dof_between,
            )
        )
    return tuple(lines)
