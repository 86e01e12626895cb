"""Wheel loads held against vehicle and payload."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.campaign.model import Campaign, Note
from calib.campaign.plausible_terms import LEAST_RUNS, SIDES, meaning, note, stated
from calib.campaign.read import loads_from_payload

#: the payload's weight may differ by this factor from what the scales say it adds
_MOST_PAYLOAD: Final = 1.6
#: share of the runs that must agree
_MOST: Final = 0.8
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


def implausible_loads(campaign: Campaign) -> Iterator[Note]:
    """Yield what no vehicle weighs: loads below zero, in another unit, or not those of its payload."""
    runs, vehicle = campaign.runs, campaign.vehicle
    left, right = (runs.number(f"load_{side}_N") for side in SIDES)
    negative = (left <= 0) | (right <= 0)
    if negative.any():
        yield note(
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
    if not stated(campaign, "vehicle.mass_kg") or not good.any():
        return
    if (good & by_payload).sum() >= LEAST_RUNS:
        ratios = total[good & by_payload] / against[good & by_payload]
        # the lightest runs tell most of the vehicle's own mass, all of them most of the payload
        lightest = against[good & by_payload] <= np.quantile(against[good & by_payload], 0.25)
        ratio = max(
            (float(np.median(part)) for part in (ratios, ratios[lightest])), key=lambda part: abs(math.log(part))
        )
        wrong, what = not 0.4 <= ratio <= 2.5, "those of vehicle and payload"
        if not wrong:
            yield from _one_side((left, right), computed)
            yield from _payload(total, expected, good & by_payload)
            yield from _swapped((left, right), computed)
    else:
        ratio = float(np.min(total[good])) / unladen if unladen > 0 else 1.0
        wrong, what = ratio < 0.3, "that of the empty vehicle"
    if wrong:
        hint = meaning(ratio, _LOAD_UNITS, 0.25)
        yield note(
            "runs, columns load_left_N, load_right_N",
            f"the wheel loads are {ratio:.3g} times {what}; expected the same within a factor of 2; "
            + (f"are they in {hint}?" if hint else "check their unit, mass_kg, cog_x_m and wheelbase_m"),
        )
    most = np.fmax(left, right)[good]
    if np.median(most) > 2 * vehicle.max_wheel_load_N:
        yield note(
            "runs, columns load_left_N, load_right_N",
            f"found wheel loads of {np.median(most):.5g} N; {vehicle.max_wheel_load_N:g} N is permitted; are payloads "
            "or loads in another unit (g, lb, kg in a column of N)?",
        )
    place = np.abs(runs.number("payload_x_m"))
    if np.nanmax(np.append(place, 0.0)) > 5 * vehicle.wheelbase_m:
        yield note(
            "runs, column payload_x_m",
            f"found {np.nanmax(place):g} m with a wheelbase of {vehicle.wheelbase_m:g} m; expected a place on the "
            "vehicle; is it in millimetres?",
        )


def _one_side(loads: tuple[FloatArray, FloatArray], computed: tuple[FloatArray, FloatArray]) -> Iterator[Note]:
    for side, load, expected in zip(SIDES, loads, computed, strict=True):
        good = np.isfinite(load) & (load > 0) & (expected > 0)
        ratio = float(np.median(load[good] / expected[good])) if good.sum() >= LEAST_RUNS else 1.0
        if not 0.1 <= ratio <= 10:
            hint = meaning(ratio, _LOAD_UNITS, 0.25)
            yield note(
                f"runs, column load_{side}_N",
                f"the {side} wheel's load is {ratio:.3g} times that of vehicle and payload; expected the same within a "
                "factor of 2; " + (f"is it in {hint}?" if hint else "check its unit"),
            )


def _payload(total: FloatArray, expected: FloatArray, good: BoolArray) -> Iterator[Note]:
    """Hold what the payload adds against what the scales say it adds, apart from the vehicle's own weight."""
    x, y = expected[good], total[good]
    if np.ptp(x) < 0.2 * np.median(x):
        return
    design = np.column_stack([x, np.ones(len(x))])
    (slope, _), _, _, _ = np.linalg.lstsq(design, y, rcond=None)
    rest = float(np.std(y - design @ np.linalg.lstsq(design, y, rcond=None)[0]))
    ratio = 1 / float(slope) if slope > 0 else math.inf
    # only where the scales follow the payload closely, so that a unit and no mixture of places is the reason
    if 1 / _MOST_PAYLOAD <= ratio <= _MOST_PAYLOAD or rest > 0.1 * float(np.std(y)):
        return
    hint = "is it in pounds?" if abs(ratio / 2.20462 - 1) < 0.1 else "check its unit and its place"
    yield note(
        "runs, column payload_kg",
        f"the payload adds {ratio:.3g} times what the weighed loads say; expected the same within "
        f"{100 * (_MOST_PAYLOAD - 1):.0f} %; {hint}",
    )


def _swapped(loads: tuple[FloatArray, FloatArray], computed: tuple[FloatArray, FloatArray]) -> Iterator[Note]:
    """Hold the side that carries more against the side on which the payload lies."""
    weighed, expected = loads[0] - loads[1], computed[0] - computed[1]
    good = np.isfinite(weighed) & np.isfinite(expected) & (np.abs(expected) > 0.1 * np.abs(computed[0] + computed[1]))
    if good.sum() < LEAST_RUNS:
        return
    ratio = weighed[good] / expected[good]
    if (ratio < -0.5).mean() > _MOST:
        yield note(
            "runs, columns load_left_N, load_right_N",
            f"in {int((ratio < -0.5).sum())} of {int(good.sum())} runs with the payload on one side the other wheel "
            "carries more; expected the wheel beside it to; are the loads swapped, or is payload_y_m positive to the "
            "right?",
        )
