"""Blunders in units and settings: a campaign against its nominal vehicle and physical bounds.

Everything here is a factor far beyond what wear, load or a poor nominal value explain; the other checks find smaller
deviations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

from calib.campaign.checks.design import LEAST_RUNS, SIDES, implausible_note, meaning, stated
from calib.campaign.checks.distances import implausible_poses
from calib.campaign.checks.loads import implausible_loads
from calib.campaign.model import Campaign, Note
from calib.types import FloatArray

#: a measured radius, track or load may differ from its nominal value by this factor either way
MOST_RATIO: Final = 4.0 / 3.0
#: ratio of radius to nominal -> what lies behind it
_FACTORS: Final = (
    (4.0, "counts are quadrature edges, or counts_per_rev is given with them"),
    (0.25, "counts are quadrature edges and counts_per_rev is not, four times too many"),
    (2.0, "one edge counted instead of two, or a diameter given as wheel_radius_m"),
    (0.5, "both edges counted, or a radius given as a diameter"),
    (math.pi, "a circumference given for a diameter"),
    (1 / math.pi, "a circumference given for a diameter"),
    (2 * math.pi, "counts of a turn given for counts of a radian"),
    (1 / (2 * math.pi), "counts of a radian given for counts of a turn"),
    (1e3, "distance in millimetres: name the column distance_mm"),
    (1e2, "distance in centimetres: name the column distance_cm"),
    (1e-3, "distance in kilometres, or wheel_radius_m in millimetres"),
    (1e-2, "wheel_radius_m in centimetres"),
    (3.28084, "distance in feet"),
    (39.3701, "distance in inches"),
    (0.3048, "wheel_radius_m in feet"),
    (0.0254, "wheel_radius_m in inches"),
)
#: setting -> least and largest value that a wheeled vehicle has
_BOUNDS: Final[dict[str, tuple[str, float, float, str]]] = {
    "track_m": ("vehicle", 0.02, 20.0, "m"),
    "wheelbase_m": ("vehicle", 0.02, 50.0, "m"),
    "wheel_radius_m": ("vehicle", 0.003, 3.0, "m"),
    "mass_kg": ("vehicle", 0.05, 5e5, "kg"),
    "cog_x_m": ("vehicle", -25.0, 25.0, "m"),
    "cog_y_m": ("vehicle", -10.0, 10.0, "m"),
    "sigma_m": ("rangefinder", 0.0, 0.5, "m"),
    "sigma_xy_m": ("reference", 0.0, 0.5, "m"),
    "sigma_theta_rad": ("reference", 0.0, 0.2, "rad"),
}
_FACTOR_TOLERANCE: Final = 0.08
_HALL: Final = (-50.0, 60.0)


def implausible(campaign: Campaign) -> Iterator[Note]:
    """Yield what cannot be, as notes of level ``wrong``; nothing for a campaign within all bounds.

    `campaign`: rows that are flagged as excluded are passed over.
    """
    kept = campaign.included()
    for check in _CHECKS:
        yield from check(kept)


def off(ratio: float) -> bool:
    """Return whether a ratio of measured to nominal value is beyond what a vehicle can differ by."""
    return not 1 / MOST_RATIO <= ratio <= MOST_RATIO


def factor_reason(ratio: float) -> str:
    """Return the unit or setting that a ratio of radius to nominal radius points to; a general hint where none does."""
    text = meaning(ratio, _FACTORS, _FACTOR_TOLERANCE)
    return f"{text}?" if text else "check counts_per_rev, wheel_radius_m and the unit of the distance"


def _settings(campaign: Campaign) -> Iterator[Note]:
    for name, (section, low, high, unit) in _BOUNDS.items():
        value = getattr(getattr(campaign, section), name)
        if value is not None and not low <= value <= high:
            yield implausible_note(
                f"campaign.toml, {section}.{name}",
                f"found {value:g} {unit}; expected {low:g} to {high:g} {unit}; {_unit_hint(value, low, high, unit)}",
            )
    vehicle = campaign.vehicle
    if vehicle.track_m > 0 and not 0.5 < vehicle.track_m / vehicle.wheel_radius_m < 200:
        yield implausible_note(
            "campaign.toml, vehicle.track_m",
            f"found a track of {vehicle.track_m:g} m with wheels of {vehicle.wheel_radius_m:g} m radius; expected 0.5 "
            "to 200 radii; check the units of both",
        )
    if abs(vehicle.cog_x_m) > 2 * vehicle.wheelbase_m:
        yield implausible_note(
            "campaign.toml, vehicle.cog_x_m",
            f"found {vehicle.cog_x_m:g} m with a wheelbase of {vehicle.wheelbase_m:g} m; expected it within the "
            "vehicle; check the unit",
        )
    for side in SIDES:
        per_rev = getattr(campaign.encoder, f"counts_per_rev_{side}")
        if not 1 <= per_rev <= 1e9:
            yield implausible_note(
                f"campaign.toml, encoder.counts_per_rev_{side}",
                f"found {per_rev:g}; expected counts of one turn of the wheel, 1 to 1e9; correct it",
            )


def _unit_hint(value: float, low: float, high: float, unit: str) -> str:
    for factor, text in ((1e-3, "thousandths"), (1e-2, "hundredths"), (math.pi / 180, "degrees"), (1e3, "thousands")):
        if low <= value * factor <= high and (text == "degrees") == (unit == "rad"):
            return f"is it in {text}{'' if unit == 'rad' else f' of {unit}'}?"
    return "check the unit"


def _model(campaign: Campaign) -> Iterator[Note]:
    model, vehicle = campaign.model, campaign.vehicle
    pairs = (
        ("radius_left_m", model.radius_left_m, vehicle.wheel_radius_m),
        ("radius_right_m", model.radius_right_m, vehicle.wheel_radius_m),
        ("track_m", model.track_m, vehicle.track_m),
    )
    for name, believed, nominal in pairs:
        if off(believed / nominal):
            yield implausible_note(
                f"campaign.toml, model.{name}",
                f"found {believed:g} where the vehicle has {nominal:g}, {believed / nominal:.3g} times; expected the "
                "same within a third; check the unit, and whether a diameter was given",
            )
    for side in SIDES:
        change = getattr(model, f"slope_{side}_m_per_N") * model.reference_load_N / vehicle.wheel_radius_m
        if abs(change) > 0.25:
            yield implausible_note(
                f"campaign.toml, model.slope_{side}_m_per_N",
                f"found a slope that changes the radius by {100 * change:.3g} % at the reference load; expected less "
                "than 25 %; check the unit (mm/kN, um/N?)",
            )
    loads = np.concatenate([campaign.runs.number(f"load_{side}_N") for side in SIDES])
    loads = loads[loads > 0]
    if len(loads) and not 0.1 * loads.min() <= model.reference_load_N <= 10 * loads.max():
        yield implausible_note(
            "campaign.toml, model.reference_load_N",
            f"found {model.reference_load_N:g} N for wheel loads of {loads.min():g} to {loads.max():g} N; expected a "
            "load near these; check the unit (kN or kg?)",
        )


def _distances(campaign: Campaign) -> Iterator[Note]:
    distance = campaign.runs.number("distance_m")
    for side in SIDES:
        turns = campaign.runs.number(f"counts_{side}") / getattr(campaign.encoder, f"counts_per_rev_{side}")
        with np.errstate(divide="ignore", invalid="ignore"):
            radius = np.abs(distance / (2 * np.pi * turns))
        good = np.isfinite(radius) & (radius > 0)
        if good.sum() < LEAST_RUNS:
            continue
        ratio = float(np.median(radius[good])) / campaign.vehicle.wheel_radius_m
        if off(ratio) and stated(campaign, "vehicle.wheel_radius_m"):
            yield implausible_note(
                f"runs, column counts_{side}",
                f"the {side} wheel's radius comes out {ratio:.2f} times nominal: {factor_reason(ratio)}",
            )
        yield from _scatter(radius, good, distance, side)
    ahead = {side: campaign.runs.number(f"counts_{side}") for side in SIDES}
    for side, other in (SIDES, SIDES[::-1]):
        both = np.isfinite(ahead[side]) & np.isfinite(ahead[other]) & (distance > 1)
        if both.sum() >= LEAST_RUNS and (ahead[side][both] < 0).all() and (ahead[other][both] > 0).all():
            yield implausible_note(
                f"runs, column counts_{side}",
                f"the {side} wheel counts backwards in every straight run while the {other} one counts forwards; "
                "expected the same sign; negate the column",
            )
    if (distance <= 0).any():
        yield implausible_note(
            "runs, column distance_m",
            f"found distances of zero or less in {int((distance <= 0).sum())} run(s), as {np.nanmin(distance):.4g} m; "
            "expected distances driven, above zero; check the sign, or flag the run as excluded",
        )
    known = np.isfinite(distance)
    counts = np.abs(campaign.runs.number("counts_left") + campaign.runs.number("counts_right"))
    both = known & np.isfinite(counts) & (counts > 0)
    if both.sum() > LEAST_RUNS and np.ptp(distance[both]) == 0 and np.ptp(counts[both]) > 2e-3 * counts[both].mean():
        yield implausible_note(
            "runs, column distance_m",
            f"found {distance[both][0]:g} m in all {int(both.sum())} runs, while the counts differ by "
            f"{100 * np.ptp(counts[both]) / counts[both].mean():.2g} %; expected the distance measured in each run; "
            "is it the nominal length of the corridor?",
        )


def _scatter(radius: FloatArray, good: np.ndarray, distance: FloatArray, side: str) -> Iterator[Note]:
    """Yield a note where the radii of single runs scatter as no wheel's do."""
    logs = np.log(radius, out=np.full(len(radius), np.nan), where=good)
    spread = _spread(logs)
    if spread < 0.01:
        return
    rows = np.flatnonzero(good)
    for shift in (1, -1):
        moved = np.roll(np.log(np.abs(distance), where=good, out=np.full(len(radius), np.nan)), shift)
        again = moved[rows] - np.log(np.abs(distance))[rows] + logs[rows]
        if _spread(again[1:-1]) < 0.2 * spread:
            yield implausible_note(
                "runs, column distance_m",
                f"the {side} wheel's radius scatters by {100 * spread:.2g} %, but by {100 * _spread(again[1:-1]):.2g} "
                "% with each distance one row on; expected distance and counts of the same run in a row; is the "
                "column shifted by one row?",
            )
            return
    if spread > 0.03:
        yield implausible_note(
            "runs, columns distance_m, " + f"counts_{side}",
            f"the {side} wheel's radius scatters by {100 * spread:.2g} % from run to run; expected less than 3 %; do "
            "distances and counts belong to the same runs?",
        )


def _spread(values: FloatArray) -> float:
    values = values[np.isfinite(values)]
    return float(1.4826 * np.median(np.abs(values - np.median(values)))) if len(values) > 2 else 0.0


def _conditions(campaign: Campaign) -> Iterator[Note]:
    temperature = campaign.runs.number("temperature_C")
    outside = (temperature < _HALL[0]) | (temperature > _HALL[1])
    if outside.any():
        value = float(np.median(temperature[outside]))
        hint = f"is it Fahrenheit ({(value - 32) / 1.8:.1f} degC)?" if value < 150 else "is it in kelvin?"
        yield implausible_note(
            "runs, column temperature_C",
            f"found {value:.4g} degC in {int(outside.sum())} run(s); expected {_HALL[0]:g} to {_HALL[1]:g}; {hint}",
        )
    speed = np.abs(campaign.runs.number("speed_mps"))
    fast = speed > 20
    if fast.any():
        yield implausible_note(
            "runs, column speed_mps",
            f"found {np.median(speed[fast]):g} m/s in {int(fast.sum())} run(s); expected up to 20; is it in mm/s?",
        )
    amplitude, wavelength = campaign.runs.number("amplitude_m"), campaign.runs.number("wavelength_m")
    steep = (np.abs(amplitude) > 0.5 * wavelength) | (np.abs(amplitude) > 5)
    if steep.any():
        yield implausible_note(
            "runs, columns amplitude_m, wavelength_m",
            f"found a weave of {amplitude[steep][0]:g} m on {wavelength[steep][0]:g} m in {int(steep.sum())} run(s); "
            "expected an amplitude far below the wavelength; is it in millimetres?",
        )


_CHECKS: Final[tuple[Callable[[Campaign], Iterator[Note]], ...]] = (
    _settings,
    _model,
    _distances,
    implausible_loads,
    _conditions,
    implausible_poses,
)
