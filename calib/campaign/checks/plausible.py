"""Blunders in units and settings: a campaign against its nominal vehicle and physical bounds.

Everything here is a factor far beyond what wear, load or a poor nominal value explain; the other checks find smaller
deviations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Final, get_type_hints

import numpy as np

from calib.campaign.checks.design import SIDES, implausible_column, implausible_setting, per_rev, setting_note
from calib.campaign.checks.distances import implausible_distances, off
from calib.campaign.checks.loads import implausible_loads
from calib.campaign.checks.poses import implausible_poses
from calib.campaign.model import Campaign, Note
from calib.campaign.settings import OdometryModel
from calib.units import split_suffix
from calib.vehicle import Usual, Vehicle


def implausible(campaign: Campaign) -> Iterator[Note]:
    """Yield what cannot be, as notes of level ``wrong``; nothing for a campaign within all bounds.

    `campaign`: rows that are flagged as excluded are passed over.
    """
    kept = campaign.included()
    for check in _CHECKS:
        yield from check(kept)


def _settings(campaign: Campaign) -> Iterator[Note]:
    for section in ("vehicle", "rangefinder", "reference"):
        part = getattr(campaign, section)
        for name, hint in get_type_hints(type(part), include_extras=True).items():
            value, unit = getattr(part, name), split_suffix(name)[1]
            for usual in getattr(hint, "__metadata__", ()):
                if isinstance(usual, Usual) and not usual.low <= value <= usual.high:
                    reason = _unit_hint(value, usual, str(unit))
                    text = f"found {value:g} {unit}; expected {usual.low:g} to {usual.high:g} {unit}; {reason}"
                    yield implausible_setting(f"{section}.{name}", text)
    vehicle = campaign.vehicle
    if not 0.5 < vehicle.track_m / vehicle.wheel_radius_m < 200:
        text = (
            f"found a track of {vehicle.track_m:g} m with wheels of {vehicle.wheel_radius_m:g} m radius; expected 0.5 "
            "to 200 radii; check the units of both"
        )
        yield implausible_setting("vehicle.track_m", text)
    for side in SIDES:
        if not 1 <= (counts := per_rev(campaign, side)) <= 1e9:
            text = f"found {counts:g}; expected counts of one turn of the wheel, 1 to 1e9; correct it"
            yield implausible_setting(f"encoder.counts_per_rev_{side}", text)


def _unit_hint(value: float, usual: Usual, unit: str) -> str:
    if unit == "rad":
        return "is it in degrees?" if usual.low <= math.radians(value) <= usual.high else "check the unit"
    for factor, text in ((1e-3, "thousandths"), (1e-2, "hundredths"), (1e3, "thousands")):
        if usual.low <= value * factor <= usual.high:
            return f"is it in {text} of {unit}?"
    return "check the unit"


def _against_vehicle(model: OdometryModel, vehicle: Vehicle) -> dict[str, tuple[float, float]]:
    """Return what the simulator believes and the nominal value of the lengths that both have."""
    return {
        "radius_left_m": (model.radius_left_m, vehicle.wheel_radius_m),
        "radius_right_m": (model.radius_right_m, vehicle.wheel_radius_m),
        "track_m": (model.track_m, vehicle.track_m),
    }


def model_against_vehicle(campaign: Campaign) -> Iterator[Note]:
    """Compare what the simulator believes with the nominal vehicle."""
    for name, (believed, nominal) in _against_vehicle(campaign.model, campaign.vehicle).items():
        if abs(believed / nominal - 1) > 0.2:
            text = f"found {believed:g} where the vehicle has {nominal:g}; check the unit, and whether it is a diameter"
            yield setting_note(f"model.{name}", text, "model_differs")


def _model(campaign: Campaign) -> Iterator[Note]:
    model, vehicle = campaign.model, campaign.vehicle
    for name, (believed, nominal) in _against_vehicle(model, vehicle).items():
        if off(believed / nominal):
            text = (
                f"found {believed:g} where the vehicle has {nominal:g}, {believed / nominal:.3g} times; expected the "
                "same within a third; check the unit, and whether a diameter was given"
            )
            yield implausible_setting(f"model.{name}", text)
    for side, slope in zip(SIDES, (model.slope_left_m_per_N, model.slope_right_m_per_N), strict=True):
        change = slope * model.reference_load_N / vehicle.wheel_radius_m
        if abs(change) > 0.25:
            text = (
                f"found a slope that changes the radius by {100 * change:.3g} % at the reference load; expected less "
                "than 25 %; check the unit (mm/kN, um/N?)"
            )
            yield implausible_setting(f"model.slope_{side}_m_per_N", text)
    loads = np.concatenate([campaign.runs.number(f"load_{side}_N") for side in SIDES])
    loads = loads[loads > 0]
    if len(loads) and not 0.1 * loads.min() <= model.reference_load_N <= 10 * loads.max():
        text = (
            f"found {model.reference_load_N:g} N for wheel loads of {loads.min():g} to {loads.max():g} N; expected a "
            "load near these; check the unit (kN or kg?)"
        )
        yield implausible_setting("model.reference_load_N", text)


#: column -> what a run can have, and what lies behind another value; 1e-9: anything above zero
_COLUMNS: Final[dict[str, tuple[Usual, str]]] = {
    "temperature_C": (Usual(-50.0, 60.0), "is it in Fahrenheit or kelvin?"),
    "speed_mps": (Usual(-20.0, 20.0), "is it in mm/s?"),
    "amplitude_m": (Usual(-5.0, 5.0), "is it in millimetres?"),
    "distance_m": (Usual(1e-9, math.inf), "check the sign, or flag the run as excluded"),
    "load_left_N": (Usual(1e-9, math.inf), "check payload and place, or the sign: below zero the wheel lifts off"),
    "load_right_N": (Usual(1e-9, math.inf), "check payload and place, or the sign: below zero the wheel lifts off"),
}


def _columns(campaign: Campaign) -> Iterator[Note]:
    for name, (usual, hint) in _COLUMNS.items():
        values = campaign.runs.number(name)
        outside = values[(values < usual.low) | (values > usual.high)]
        if len(outside):
            found = f"found {np.median(outside):.4g} {split_suffix(name)[1]} in {len(outside)} run(s)"
            most = f"above {usual.low:.0f}" if usual.high == math.inf else f"{usual.low:g} to {usual.high:g}"
            yield implausible_column(name, f"{found}; expected {most}; {hint}")
    amplitude, wavelength = campaign.runs.number("amplitude_m"), campaign.runs.number("wavelength_m")
    steep = np.abs(amplitude) > 0.5 * wavelength
    if steep.any():
        text = (
            f"found a weave of {amplitude[steep][0]:g} m on {wavelength[steep][0]:g} m in {int(steep.sum())} run(s); "
            "expected an amplitude far below the wavelength; is it in millimetres?"
        )
        yield implausible_column("amplitude_m, wavelength_m", text)


_CHECKS: Final[tuple[Callable[[Campaign], Iterator[Note]], ...]] = (
    _settings,
    _model,
    implausible_distances,
    implausible_loads,
    _columns,
    implausible_poses,
)
