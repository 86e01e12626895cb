"""The fit of a campaign: both wheels' laws, the runs behind them, and how to write and read all of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.settings import Encoder, OdometryModel, Rangefinder, Reference
from calib.errors import BadInputError, RefusedError
from calib.radius.effective import Component, EffectiveRadii, effective_radii
from calib.radius.law import RadiusLaw
from calib.radius.regression import WheelFit, fit_wheel
from calib.vehicle import Vehicle

__all__ = ["FORMAT", "Fit", "Setup", "fit_campaign", "fit_law"]

FORMAT: Final = "calib-fit/1"


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


@dataclass(frozen=True, slots=True)
class Setup:
    """What the runs were measured with and under, so that a report needs no campaign.

    Parameters
    ----------
    vehicle, encoder, model, rangefinder, reference
        Sections of ``campaign.toml``.
    conditions : mapping of str to (float, float)
        Smallest and largest value over the runs used, by column of the run table.
    """

    vehicle: Vehicle
    encoder: Encoder
    model: OdometryModel
    rangefinder: Rangefinder
    reference: Reference
    conditions: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """What `calib fit` finds, and all that report and export need.

    Parameters
    ----------
    name : str
        Name of the campaign.
    simulated : bool
        True where a program made the data.
    left, right : WheelFit
        The moving wheels.
    radii : EffectiveRadii
        The runs behind them.
    static : mapping of str to WheelFit
        Static radius against load by wheel, where the run table has it.
    notes : tuple of str
        What the user should know, in sentences.
    provenance : mapping
        ``version`` of calib, ``inputs`` (path -> sha256), ``arguments``; filled by the command line.
    setup : Setup or None
        Vehicle, instruments and conditions; None where the radii came from elsewhere than a campaign.
    """

    name: str
    simulated: bool
    left: WheelFit
    right: WheelFit
    radii: EffectiveRadii
    static: Mapping[str, WheelFit] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    setup: Setup | None = None

    @property
    def law(self) -> RadiusLaw:
        """The law of both wheels."""
        return RadiusLaw(left=self.left.law, right=self.right.law)

    @property
    def wheels(self) -> dict[str, WheelFit]:
        """The moving wheels by name."""
        return {"left": self.left, "right": self.right}

    @property
    def passed(self) -> bool:
        """Whether every check lets the law be used."""
        return all(check.passed for wheel in (self.left, self.right) for check in wheel.checks)

    def to_dict(self) -> dict[str, Any]:
        """Return the fit as plain values: the keys of ``calib fit --json`` and everything `from_dict` needs."""
        from calib.radius.document import fit_to_dict

        return fit_to_dict(self)

    @staticmethod
    def from_dict(value: Mapping[str, Any]) -> Fit:
        """Return the fit that `to_dict` wrote."""
        from calib.radius.document import fit_from_dict

        return fit_from_dict(value)


def fit_law(radii: EffectiveRadii, *, reference_load_N: float, name: str = "", simulated: bool = False) -> Fit:
    """Fit both wheels' laws to effective radii.

    Parameters
    ----------
    radii : EffectiveRadii
        Radii a run and wheel.
    reference_load_N : float
        Load on which the coefficients are centred.
    name, simulated
        Carried over from the campaign.

    Returns
    -------
    Fit
        With the checks of both wheels.

    Raises
    ------
    RefusedError
        With fewer than three runs.
    """
    from calib.radius.residual_checks import checked

    wheels = {}
    for wheel, load, radius in (
        ("left", radii.load_left_N, radii.radius_left_m),
        ("right", radii.load_right_N, radii.radius_right_m),
    ):
        found = fit_wheel(wheel, load, radius, radii.session, reference_load_N=reference_load_N)
        wheels[wheel] = checked(found, radii.session, radii.direction, radii.run_id)
    radii = replace(radii, budget=(*radii.budget, *_observed(radii, wheels["left"], wheels["right"])))
    return Fit(
        name=name, simulated=simulated, left=wheels["left"], right=wheels["right"], radii=radii, notes=radii.notes
    )


def fit_campaign(campaign: Campaign, *, reference_load_N: float | None = None) -> Fit:
    """Return the fit of a campaign: effective radii, both laws, and the static radius where it was measured.

    Parameters
    ----------
    campaign : Campaign
        Static radii are taken from the columns ``static_radius_left_m`` and ``static_radius_right_m``, where there are.
    reference_load_N : float, optional
        Load on which the coefficients are centred; without it the one of the campaign's model.

    Returns
    -------
    Fit
        With its setup.

    Raises
    ------
    RefusedError
        Where fewer than three runs can be used.
    """
    reference = campaign.model.reference_load_N if reference_load_N is None else reference_load_N
    if not np.isfinite(reference) or reference < 0:
        raise BadInputError(
            f"reference load: found {reference:g} N; expected a load of zero or more; see --reference-load"
        )
    radii = effective_radii(campaign)
    fit = fit_law(
        radii,
        reference_load_N=reference,
        name=campaign.name,
        simulated=campaign.simulated,
    )
    static, notes = _static(campaign, reference)
    used = campaign.select(np.isin(campaign.runs.run_id, radii.run_id)).runs
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
        ),
    )


def _static(campaign: Campaign, reference_load_N: float) -> tuple[dict[str, WheelFit], tuple[str, ...]]:
    """Return the fits of the static radius against load, and notes on those that could not be made."""
    from calib.radius.residual_checks import checked

    runs = campaign.included().runs
    fits, notes = {}, []
    for wheel in ("left", "right"):
        radius, load = runs.number(f"static_radius_{wheel}_m"), runs.number(f"load_{wheel}_N")
        good = np.isfinite(radius) & np.isfinite(load)
        if not good.any():
            continue
        session = runs.label("session")[good]
        try:
            found = fit_wheel(wheel, load[good], radius[good], session, reference_load_N=reference_load_N)
        except RefusedError as error:
            notes.append(f"Static radius not fitted: {error}.")
            continue
        fits[wheel] = checked(found, session, runs.label("direction")[good], runs.run_id[good])
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
