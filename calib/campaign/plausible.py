"""What cannot be: a campaign held against its nominal vehicle and physical bounds, with the likely unit or setting.

Everything here is an error of units or settings by factors, far beyond what wear, load or a poor nominal value explain;
smaller oddities are the business of `calib.campaign.checks`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import Campaign, Note
from calib.campaign.read import loads_from_payload

__all__ = ["CODE", "MOST_RATIO", "factor_reason", "implausible", "off"]

CODE: Final = "implausible"
SIDES: Final = ("left", "right")
#: a measured radius, track or load may differ from its nominal value by this factor either way
MOST_RATIO: Final = 4.0 / 3.0
#: share of the runs that must agree before a column as a whole is spoken of
_MOST: Final = 0.8
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
#: ratio of loads to those of the vehicle -> unit
_LOAD_UNITS: Final = (
    (1e-3, "kN: name the columns load_left_kN, load_right_kN"),
    (1 / 9.80665, "kg: name the columns load_left_kgf, load_right_kgf"),
    (1 / 4.44822, "pounds-force"),
    (9.80665, "N times 9.81"),
    (1e3, "mN"),
    (0.5, "half the load"),
    (2.0, "the load of both wheels in each column"),
)
_FACTOR_TOLERANCE: Final = 0.08
_HALL: Final = (-50.0, 60.0)
_LEAST_RUNS: Final = 4


def implausible(campaign: Campaign) -> Iterator[Note]:
    """Yield what cannot be, as notes of level ``wrong``; nothing for a campaign within all bounds.

    Parameters
    ----------
    campaign : Campaign
        Rows that are flagged as excluded are passed over.
    """
    kept = campaign.included()
    for check in _CHECKS:
        yield from check(kept)


def off(ratio: float) -> bool:
    """Return whether a ratio of measured to nominal value is beyond what a vehicle can differ by."""
    return not 1 / MOST_RATIO <= ratio <= MOST_RATIO


def factor_reason(ratio: float) -> str:
    """Return the unit or setting that a ratio of radius to nominal radius points to; a general hint where none does."""
    for factor, text in _FACTORS:
        if abs(ratio / factor - 1) < _FACTOR_TOLERANCE:
            return f"{text}?"
    return "check counts_per_rev, wheel_radius_m and the unit of the distance"


def _note(where: str, text: str) -> Note:
    return Note("wrong", where, text, CODE)


def _stated(campaign: Campaign, key: str) -> bool:
    return key not in campaign.assumed and key.partition(".")[0] not in campaign.assumed


def _settings(campaign: Campaign) -> Iterator[Note]:
    for name, (section, low, high, unit) in _BOUNDS.items():
        value = getattr(getattr(campaign, section), name)
        if value is not None and not low <= value <= high:
            yield _note(
                f"campaign.toml, {section}.{name}",
                f"found {value:g} {unit}; expected {low:g} to {high:g} {unit}; {_unit_hint(value, low, high, unit)}",
            )
    vehicle = campaign.vehicle
    if vehicle.track_m > 0 and not 0.5 < vehicle.track_m / vehicle.wheel_radius_m < 200:
        yield _note(
            "campaign.toml, vehicle.track_m",
            f"found a track of {vehicle.track_m:g} m with wheels of {vehicle.wheel_radius_m:g} m radius; expected 0.5 "
            "to 200 radii; check the units of both",
        )
    if abs(vehicle.cog_x_m) > 2 * vehicle.wheelbase_m:
        yield _note(
            "campaign.toml, vehicle.cog_x_m",
            f"found {vehicle.cog_x_m:g} m with a wheelbase of {vehicle.wheelbase_m:g} m; expected it within the "
            "vehicle; check the unit",
        )
    for side in SIDES:
        per_rev = getattr(campaign.encoder, f"counts_per_rev_{side}")
        if not 1 <= per_rev <= 1e9:
            yield _note(
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
            yield _note(
                f"campaign.toml, model.{name}",
                f"found {believed:g} where the vehicle has {nominal:g}, {believed / nominal:.3g} times; expected the "
                "same within a third; check the unit, and whether a diameter was given",
            )
    for side in SIDES:
        change = getattr(model, f"slope_{side}_m_per_N") * model.reference_load_N / vehicle.wheel_radius_m
        if abs(change) > 0.25:
            yield _note(
                f"campaign.toml, model.slope_{side}_m_per_N",
                f"found a slope that changes the radius by {100 * change:.3g} % at the reference load; expected less "
                "than 25 %; check the unit (mm/kN, um/N?)",
            )
    loads = np.concatenate([campaign.runs.number(f"load_{side}_N") for side in SIDES])
    loads = loads[loads > 0]
    if len(loads) and not 0.1 * loads.min() <= model.reference_load_N <= 10 * loads.max():
        yield _note(
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
        if good.sum() < _LEAST_RUNS:
            continue
        ratio = float(np.median(radius[good])) / campaign.vehicle.wheel_radius_m
        if off(ratio) and _stated(campaign, "vehicle.wheel_radius_m"):
            yield _note(
                f"runs, column counts_{side}",
                f"the {side} wheel's radius comes out {ratio:.2f} times nominal: {factor_reason(ratio)}",
            )
        yield from _scatter(radius, good, distance, side)
    if (distance <= 0).any():
        yield _note(
            "runs, column distance_m",
            f"found distances of zero or less in {int((distance <= 0).sum())} run(s), as {np.nanmin(distance):.4g} m; "
            "expected distances driven, above zero; check the sign, or flag the run as excluded",
        )
    known = np.isfinite(distance)
    counts = np.abs(campaign.runs.number("counts_left") + campaign.runs.number("counts_right"))
    both = known & np.isfinite(counts) & (counts > 0)
    if both.sum() > _LEAST_RUNS and np.ptp(distance[both]) == 0 and np.ptp(counts[both]) > 2e-3 * counts[both].mean():
        yield _note(
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
            yield _note(
                "runs, column distance_m",
                f"the {side} wheel's radius scatters by {100 * spread:.2g} %, but by {100 * _spread(again[1:-1]):.2g} "
                "% with each distance one row on; expected distance and counts of the same run in a row; is the "
                "column shifted by one row?",
            )
            return
    if spread > 0.03:
        yield _note(
            "runs, columns distance_m, " + f"counts_{side}",
            f"the {side} wheel's radius scatters by {100 * spread:.2g} % from run to run; expected less than 3 %; do "
            "distances and counts belong to the same runs?",
        )


def _spread(values: FloatArray) -> float:
    values = values[np.isfinite(values)]
    return float(1.4826 * np.median(np.abs(values - np.median(values)))) if len(values) > 2 else 0.0


def _loads(campaign: Campaign) -> Iterator[Note]:
    runs, vehicle = campaign.runs, campaign.vehicle
    left, right = (runs.number(f"load_{side}_N") for side in SIDES)
    negative = (left <= 0) | (right <= 0)
    if negative.any():
        yield _note(
            "runs, columns load_left_N, load_right_N",
            f"found loads of zero or less in {int(negative.sum())} run(s), as {np.nanmin([left, right]):.4g} N; "
            "expected loads above zero, or the wheel would lift off; check payload and place, or the sign",
        )
    computed = loads_from_payload(vehicle, runs)
    expected = np.add(*computed)
    unladen = 2 * vehicle.unladen_load_N
    total = left + right
    by_payload = np.isfinite(expected) & (expected > 0)
    against = np.where(by_payload, expected, np.nan)
    good = np.isfinite(total) & (total > 0)
    if not _stated(campaign, "vehicle.mass_kg") or not good.any():
        return
    if (good & by_payload).sum() >= _LEAST_RUNS:
        ratio = float(np.median(total[good & by_payload] / against[good & by_payload]))
        wrong, what = not 0.4 <= ratio <= 2.5, "those of vehicle and payload"
        if not wrong:
            yield from _one_side((left, right), computed)
    else:
        ratio = float(np.min(total[good])) / unladen if unladen > 0 else 1.0
        wrong, what = ratio < 0.3, "that of the empty vehicle"
    if wrong:
        hint = next((text for factor, text in _LOAD_UNITS if abs(ratio / factor - 1) < 0.25), "")
        yield _note(
            "runs, columns load_left_N, load_right_N",
            f"the wheel loads are {ratio:.3g} times {what}; expected the same within a factor of 2; "
            + (f"are they in {hint}?" if hint else "check their unit, mass_kg, cog_x_m and wheelbase_m"),
        )
    most = np.fmax(left, right)[good]
    if np.median(most) > 2 * vehicle.max_wheel_load_N:
        yield _note(
            "runs, columns load_left_N, load_right_N",
            f"found wheel loads of {np.median(most):.5g} N; {vehicle.max_wheel_load_N:g} N is permitted; are payloads "
            "or loads in another unit (g, lb, kg in a column of N)?",
        )
    place = np.abs(runs.number("payload_x_m"))
    if np.nanmax(np.append(place, 0.0)) > 5 * vehicle.wheelbase_m:
        yield _note(
            "runs, column payload_x_m",
            f"found {np.nanmax(place):g} m with a wheelbase of {vehicle.wheelbase_m:g} m; expected a place on the "
            "vehicle; is it in millimetres?",
        )


def _one_side(loads: tuple[FloatArray, FloatArray], computed: tuple[FloatArray, FloatArray]) -> Iterator[Note]:
    for side, load, expected in zip(SIDES, loads, computed, strict=True):
        good = np.isfinite(load) & (load > 0) & (expected > 0)
        ratio = float(np.median(load[good] / expected[good])) if good.sum() >= _LEAST_RUNS else 1.0
        if not 0.1 <= ratio <= 10:
            hint = next((text for factor, text in _LOAD_UNITS if abs(ratio / factor - 1) < 0.25), "")
            yield _note(
                f"runs, column load_{side}_N",
                f"the {side} wheel's load is {ratio:.3g} times that of vehicle and payload; expected the same within a "
                "factor of 2; " + (f"is it in {hint}?" if hint else "check its unit"),
            )


def _conditions(campaign: Campaign) -> Iterator[Note]:
    temperature = campaign.runs.number("temperature_C")
    outside = (temperature < _HALL[0]) | (temperature > _HALL[1])
    if outside.any():
        value = float(np.median(temperature[outside]))
        hint = f"is it Fahrenheit ({(value - 32) / 1.8:.1f} degC)?" if value < 150 else "is it in kelvin?"
        yield _note(
            "runs, column temperature_C",
            f"found {value:.4g} degC in {int(outside.sum())} run(s); expected {_HALL[0]:g} to {_HALL[1]:g}; {hint}",
        )
    speed = np.abs(campaign.runs.number("speed_mps"))
    fast = speed > 20
    if fast.any():
        yield _note(
            "runs, column speed_mps",
            f"found {np.median(speed[fast]):g} m/s in {int(fast.sum())} run(s); expected up to 20; is it in mm/s?",
        )
    amplitude, wavelength = campaign.runs.number("amplitude_m"), campaign.runs.number("wavelength_m")
    steep = (np.abs(amplitude) > 0.5 * wavelength) | (np.abs(amplitude) > 5)
    if steep.any():
        yield _note(
            "runs, columns amplitude_m, wavelength_m",
            f"found a weave of {amplitude[steep][0]:g} m on {wavelength[steep][0]:g} m in {int(steep.sum())} run(s); "
            "expected an amplitude far below the wavelength; is it in millimetres?",
        )


def _reference(campaign: Campaign) -> Iterator[Note]:
    runs = campaign.runs
    x, y, theta = (runs.number(name) for name in ("ref_x_m", "ref_y_m", "ref_theta_rad"))
    arcs = [
        2 * np.pi * campaign.vehicle.wheel_radius_m * runs.number(f"counts_{side}")
        / getattr(campaign.encoder, f"counts_per_rev_{side}")
        for side in SIDES
    ]  # fmt: skip
    distance = np.where(np.isfinite(runs.number("distance_m")), runs.number("distance_m"), np.abs(sum(arcs)) / 2)
    away = np.hypot(x, y)
    good = np.isfinite(away) & np.isfinite(distance) & (distance > 0)
    if good.sum() >= _LEAST_RUNS:
        far = away[good] > 3 * distance[good] + 1
        if far.mean() > _MOST:
            ratio = float(np.median(away[good][far] / distance[good][far]))
            yield _note(
                "runs, columns ref_x_m, ref_y_m",
                f"the end poses lie {ratio:.3g} times as far away as was driven; expected no more than the distance; "
                + ("are they in millimetres?" if ratio > 300 else "check their unit and frame"),
            )
        # a corridor's end lies where the rangefinder says
        straight = good & np.isfinite(runs.number("distance_m")) & (np.abs(y) < 0.2 * np.abs(x))
        if straight.sum() >= _LEAST_RUNS and np.median(away[straight] / distance[straight]) < 0.1:
            yield _note(
                "runs, columns ref_x_m, ref_y_m",
                f"the end poses of straight runs lie {np.median(away[straight] / distance[straight]):.3g} of the "
                "distance away; expected the distance; check the unit (km, or distance_m in mm?)",
            )
        straight &= np.isfinite(theta) & (np.abs(y) < 0.05 * np.abs(x)) & (away > 0.5 * distance)
        askew = float(np.median(np.abs(theta[straight]))) if straight.sum() >= _LEAST_RUNS else 0.0
        if askew > 0.15 and campaign.reference.frame != "map":
            yield _note(
                "runs, column ref_theta_rad",
                f"straight runs that end on their line are turned by {askew:.3g} rad (median); expected below 0.15; "
                "are the headings in degrees?",
            )
    turned = (arcs[1] - arcs[0]) / campaign.vehicle.track_m
    yield from _headings(theta, turned, distance)


def _headings(theta: FloatArray, turned: FloatArray, distance: FloatArray) -> Iterator[Note]:
    """Hold headings against those of the counts; unequal wheels turn the vehicle in proportion to the distance."""
    good = np.isfinite(theta) & np.isfinite(turned) & np.isfinite(distance)
    if good.sum() < 2 * _LEAST_RUNS or np.median(np.abs(turned[good])) < 1.0:
        # nearly straight runs: their headings tell unequal wheels, not units
        return
    design = np.column_stack([turned, distance])[good]
    coefficients, _, rank, _ = np.linalg.lstsq(design, theta[good], rcond=1e-9)
    rest = theta[good] - design @ coefficients
    if rank < 2:
        return
    std = math.sqrt(float(rest @ rest) / (good.sum() - 2) * float(np.linalg.inv(design.T @ design)[0, 0]))
    ratio = float(coefficients[0])
    if std > 0.1 * abs(ratio) or 0.5 <= abs(ratio) <= 2.0:
        return
    degrees = abs(abs(ratio) * math.pi / 180 - 1) < 0.3
    yield _note(
        "runs, column ref_theta_rad",
        f"the headings are {ratio:.3g} times those of the counts; expected the same within a factor of 2; "
        + ("are they in degrees?" if degrees else "check track_m, counts_per_rev and the unit of the heading"),
    )


_CHECKS: Final[tuple[Callable[[Campaign], Iterator[Note]], ...]] = (
    _settings,
    _model,
    _distances,
    _loads,
    _conditions,
    _reference,
)
