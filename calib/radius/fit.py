"""From a campaign to the laws of both wheels: radii, regression, checks, bounds, and comparison with a model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from calib.campaign.check import implausible, notes_for_results
from calib.campaign.checks.design import assumed_settings
from calib.campaign.checks.measurements import factor_reason, off
from calib.campaign.model import Campaign
from calib.errors import BadInputError, ImplausibleError, RefusedError
from calib.radius.budget import declared_sources, observed_components, systematic_components, with_systematic
from calib.radius.checks import with_checks, with_temperature_check
from calib.radius.effective import EffectiveRadii, effective_radii
from calib.radius.law import RadiusLaw
from calib.radius.regression import FAILED, Check, WheelFit, fit_wheel
from calib.radius.result import PLAUSIBLE, Fit, Setup

#: the reference load may lie beyond the largest load driven by this factor; further out the line has no digits left
MAX_REFERENCE_RATIO: Final = 1e4
#: share of the radius by which load may change it over the measured range, and by which single runs may scatter
MAX_LOAD_CHANGE: Final = 0.2
MAX_SCATTER: Final = 0.03
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
    carried over from the campaign. The fit has the checks of both wheels. Raises RefusedError with fewer than three
    runs.
    """
    wheels = {}
    for wheel, load, radius in (
        ("left", radii.load_left_N, radii.radius_left_m),
        ("right", radii.load_right_N, radii.radius_right_m),
    ):
        unchecked = fit_wheel(wheel, load, radius, radii.session, reference_load_N=reference_load_N)
        wheels[wheel] = with_checks(unchecked, radii.session, radii.direction, radii.run_id)
    radii = replace(radii, budget=(*radii.budget, *observed_components(radii, wheels["left"], wheels["right"])))
    return Fit(
        name=name, simulated=simulated, left=wheels["left"], right=wheels["right"], radii=radii, notes=radii.notes
    )


def fit_campaign(campaign: Campaign, *, reference_load_N: float | None = None) -> Fit:
    """Return the fit of a campaign: effective radii, both laws, and the static radius where it was measured.

    `campaign`: static radii are taken from the columns ``static_radius_left_m`` and ``static_radius_right_m``, where
    there are; `reference_load_N`: load on which the coefficients are centred; without it the one of the campaign's
    model. Raises RefusedError where fewer than three runs can be used; ImplausibleError where that is
    so because of units or settings that cannot be.
    """
    reference = campaign.model.reference_load_N if reference_load_N is None else reference_load_N
    if not np.isfinite(reference) or reference < 0:
        raise BadInputError(f"reference load: found {reference:g} N; expected a load of zero or more; correct it")
    findings = [f"{note.where}: {note.text}" for note in implausible(campaign)]
    try:
        radii = effective_radii(campaign)
        _refuse_far(reference, radii)
        fit = fit_law(radii, reference_load_N=reference, name=campaign.name, simulated=campaign.simulated)
    except RefusedError as error:
        if findings:
            raise ImplausibleError(campaign.name, findings) from error
        raise
    sources = declared_sources(campaign)
    used = campaign.select(np.isin(campaign.runs.run_id, radii.run_id)).runs
    nominal = None if "vehicle.wheel_radius_m" in campaign.assumed else campaign.vehicle.wheel_radius_m
    wheels = {}
    for name, line in fit.wheels.items():
        wheel = with_systematic(line, radii, sources)
        wheel = replace(wheel, checks=(*_implausible(wheel, findings, nominal), *wheel.checks))
        wheels[name] = with_temperature_check(wheel, used.number("temperature_C"), used.label("session"))
    static, notes = _static(campaign, reference)
    spans = {name: used.number(name) for name in CONDITIONS}
    return replace(
        fit,
        left=wheels["left"],
        right=wheels["right"],
        radii=replace(fit.radii, budget=(*fit.radii.budget, *systematic_components(wheels, radii, sources))),
        static=static,
        notes=(*notes_for_results(campaign), *fit.notes, *notes),
        setup=Setup(
            vehicle=campaign.vehicle,
            encoder=campaign.encoder,
            model=campaign.model,
            rangefinder=campaign.rangefinder,
            reference=campaign.reference,
            conditions={
                name: (float(np.nanmin(column)), float(np.nanmax(column)))
                for name, column in spans.items()
                if np.isfinite(column).any()
            },
            assumed=assumed_settings(campaign),
        ),
    )


def _refuse_far(reference_load_N: float, radii: EffectiveRadii) -> None:
    """Refuse a reference load so far from the loads driven that the radius has no digits there."""
    loads = np.append(radii.load_left_N, radii.load_right_N)
    largest = float(np.max(loads[np.isfinite(loads)], initial=1.0))
    if reference_load_N > MAX_REFERENCE_RATIO * largest:
        raise BadInputError(
            f"reference load: found {reference_load_N:g} N; expected a load near those driven, up to {largest:g} N; "
            "correct it"
        )


def _static(campaign: Campaign, reference_load_N: float) -> tuple[dict[str, WheelFit], tuple[str, ...]]:
    """Return the fits of the static radius against load, and notes on those that were not fitted."""
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
        fits[wheel] = with_checks(unchecked, session, runs.label("direction")[good], runs.run_id[good])
    return fits, tuple(notes)


def _implausible(wheel: WheelFit, findings: list[str], nominal_m: float | None) -> tuple[Check, ...]:
    """Return a failed check ``plausible`` for each finding beyond the bounds of a vehicle.

    `findings`: of the campaign; `nominal_m`: nominal radius, None where it was assumed.
    """
    other = "right" if wheel.wheel == "left" else "left"
    own = [text for text in findings if f"the {other} wheel" not in text]
    radius_named = any(f"the {wheel.wheel} wheel's radius" in text for text in own)
    texts = dict.fromkeys([*own, *_beyond_bounds(wheel, nominal_m, radius_named=radius_named)])
    return tuple(Check(PLAUSIBLE, FAILED, text if text.endswith((".", "?")) else f"{text}.") for text in texts)


def _beyond_bounds(wheel: WheelFit, nominal_m: float | None, *, radius_named: bool) -> Iterator[str]:
    radius = wheel.law.radius_ref_m
    if not (np.isfinite(radius) and radius > 0):
        yield f"the radius at the reference load comes out as {radius:.4g} m; expected one above zero; check the loads"
        return
    if nominal_m is not None and off(radius / nominal_m) and not radius_named:
        yield (
            f"the radius comes out {radius / nominal_m:.2f} times nominal ({1e3 * radius:.4g} mm for "
            f"{1e3 * nominal_m:.4g} mm): {factor_reason(radius / nominal_m)}"
        )
    change = wheel.law.slope_m_per_N * (wheel.law.load_max_N - wheel.law.load_min_N) / radius
    if wheel.model == "line" and abs(change) > MAX_LOAD_CHANGE:
        yield (
            f"load changes the radius by {100 * change:.3g} % over the loads driven; expected less than "
            f"{100 * MAX_LOAD_CHANGE:.0f} %; check loads and distances"
        )
    if wheel.run_std_m > MAX_SCATTER * radius:
        yield (
            f"single runs scatter by {100 * wheel.run_std_m / radius:.2g} % of the radius; expected less than "
            f"{100 * MAX_SCATTER:.0f} %; check that distances, counts and loads are those of the same runs"
        )


@dataclass(frozen=True, slots=True)
class Difference:
    """A coefficient of one wheel, fitted minus that of a model."""

    wheel: str
    #: ``radius_ref`` in m, or ``slope`` in m/N
    quantity: str
    fitted: float
    model: float
    #: 95 % interval of the fitted coefficient
    fitted_ci95: tuple[float, float]

    @property
    def difference(self) -> float:
        """Fitted minus model."""
        return self.fitted - self.model

    @property
    def ci95(self) -> tuple[float, float]:
        """95 % interval of the difference; the model counts as known."""
        return self.fitted_ci95[0] - self.model, self.fitted_ci95[1] - self.model

    @property
    def inside(self) -> bool:
        """Whether the model lies within the fit's 95 % interval."""
        return self.ci95[0] <= 0.0 <= self.ci95[1]


@dataclass(frozen=True, slots=True)
class ModelComparison:
    """Both wheels' fitted laws against a model's; a wheel without a slope has its radius alone."""

    #: load at which the radii are compared
    reference_load_N: float
    differences: tuple[Difference, ...]

    @property
    def inside(self) -> bool:
        """Whether the model lies within every interval."""
        return all(one.inside for one in self.differences)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values: the key ``model_comparison`` of ``calib fit --model --json``."""
        wheels: dict[str, dict[str, object]] = {side: {"radius_ref": None, "slope": None} for side in ("left", "right")}
        for one in self.differences:
            unit = "m" if one.quantity == "radius_ref" else "m_per_N"
            values = {name: getattr(one, name) for name in ("fitted", "model", "difference")}
            values |= {"difference_ci95": list(one.ci95)}
            document = {f"{name}_{unit}": value for name, value in values.items()}
            wheels[one.wheel][one.quantity] = document | {"model_inside": one.inside}
        return {"reference_load_N": self.reference_load_N, "model_inside": self.inside, "wheels": wheels}


def compare_laws(left: WheelFit, right: WheelFit, model: RadiusLaw) -> ModelComparison:
    """Return the differences of fitted laws from a model, at the fit's reference load.

    The intervals are the fit's own: a model of the same runs shares their errors, so it counts as known.
    """
    differences = []
    for wheel, law in ((left, model.left), (right, model.right)):
        at_load, own = float(law.radius_m(wheel.reference_load_N)), wheel.law
        differences.append(Difference(wheel.wheel, "radius_ref", own.radius_ref_m, at_load, wheel.radius_ref_ci95_m))
        if interval := wheel.slope_ci95_m_per_N:
            differences.append(Difference(wheel.wheel, "slope", own.slope_m_per_N, law.slope_m_per_N, interval))
    return ModelComparison(left.reference_load_N, tuple(differences))
