"""Wheel loads: physical, permitted, and in agreement with vehicle and payload."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from calib.campaign.checks.design import LEAST_RUNS, SIDES, cell_note, implausible_note, listed, meaning, stated
from calib.campaign.model import Campaign, Note
from calib.campaign.read import loads_from_payload
from calib.types import BoolArray, FloatArray


def wheel_loads(campaign: Campaign) -> Iterator[Note]:
    """Find loads that no rolling wheel has, and loads beyond the permitted one."""
    runs = campaign.runs
    for side in SIDES:
        load = runs.number(f"load_{side}_N")
        for run in np.flatnonzero(load <= 0):
            text = (
                f"found {load[run]:.4g} N; expected more than 0, or the wheel would lift off; check payload and place"
            )
            yield cell_note(campaign, run, f"load_{side}_N", text, "impossible_load", "wrong")
        permitted = campaign.vehicle.max_wheel_load_N
        for run in np.flatnonzero(load > permitted):
            text = f"found {load[run]:.5g} N; {permitted:g} N is permitted; check the unit (kg or kN in a column of N?)"
            yield cell_note(campaign, run, f"load_{side}_N", text, "excess_load")
    lacking = np.isnan(runs.number("load_left_N")) | np.isnan(runs.number("load_right_N"))
    if lacking.any():
        text = (
            f"{int(lacking.sum())} run(s) have no wheel load and no payload with its place to compute it from "
            f"({listed(runs.run_id[lacking])})"
        )
        yield Note("suspicious", "runs, columns load_left_N, load_right_N", text, "missing_load")


def loads_against_payload(campaign: Campaign) -> Iterator[Note]:
    """Compare weighed loads with the static loads of the payload (Eqs 1 and 2)."""
    runs = campaign.runs
    if "payload_kg" not in runs.numbers:
        return
    left, right = runs.number("load_left_N"), runs.number("load_right_N")
    computed_left, computed_right = loads_from_payload(campaign.vehicle, runs)
    allowed = np.maximum(15.0, 0.05 * (np.abs(computed_left) + np.abs(computed_right)))
    off = (np.abs(left - computed_left) > allowed) | (np.abs(right - computed_right) > allowed)
    swapped = off & (np.abs(left - computed_right) <= allowed) & (np.abs(right - computed_left) <= allowed)
    known = np.isfinite(left + right + computed_left + computed_right)
    if off.sum() > 3 and off.sum() > 0.8 * known.sum():
        what = (
            "left and right loads look swapped, or payload_y_m counts from the right"
            if swapped.sum() > 0.8 * off.sum()
            else "check vehicle.mass_kg, cog_x_m, wheelbase_m and the unit of the loads"
        )
        ratio = float(np.median((left + right)[off] / (computed_left + computed_right)[off]))
        yield Note(
            "suspicious",
            "runs, columns load_left_N, load_right_N, payload_kg",
            f"in {int(off.sum())} runs the loads are not those of vehicle and payload (sum {ratio:.3g} times); {what}",
            "swapped_loads" if swapped.sum() > 0.8 * off.sum() else "contradicted_load",
        )
        return
    for run in np.flatnonzero(off):
        yield cell_note(
            campaign,
            run,
            "load_left_N, load_right_N",
            f"found {left[run]:.0f} and {right[run]:.0f} N; vehicle and payload ask for {computed_left[run]:.0f} and "
            f"{computed_right[run]:.0f} N; "
            + (
                "left and right look swapped, or payload_y_m has the other sign"
                if swapped[run]
                else "check payload, its place and the weighing"
            ),
            "swapped_loads" if swapped[run] else "contradicted_load",
        )


#: the payload's weight may differ by this factor from what the scales say it adds
_MOST_PAYLOAD: Final = 1.6
#: share of the runs that must agree
_AGREEING_SHARE: Final = 0.8
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
        yield implausible_note(
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
            yield from _payload_weight(total, expected, good & by_payload)
            yield from _swapped_loads((left, right), computed)
    else:
        ratio = float(np.min(total[good])) / unladen if unladen > 0 else 1.0
        wrong, what = ratio < 0.3, "that of the empty vehicle"
    if wrong:
        hint = meaning(ratio, _LOAD_UNITS, 0.25)
        yield implausible_note(
            "runs, columns load_left_N, load_right_N",
            f"the wheel loads are {ratio:.3g} times {what}; expected the same within a factor of 2; "
            + (f"are they in {hint}?" if hint else "check their unit, mass_kg, cog_x_m and wheelbase_m"),
        )
    most = np.fmax(left, right)[good]
    if np.median(most) > 2 * vehicle.max_wheel_load_N:
        yield implausible_note(
            "runs, columns load_left_N, load_right_N",
            f"found wheel loads of {np.median(most):.5g} N; {vehicle.max_wheel_load_N:g} N is permitted; are payloads "
            "or loads in another unit (g, lb, kg in a column of N)?",
        )
    place = np.abs(runs.number("payload_x_m"))
    if np.nanmax(np.append(place, 0.0)) > 5 * vehicle.wheelbase_m:
        yield implausible_note(
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
            yield implausible_note(
                f"runs, column load_{side}_N",
                f"the {side} wheel's load is {ratio:.3g} times that of vehicle and payload; expected the same within a "
                "factor of 2; " + (f"is it in {hint}?" if hint else "check its unit"),
            )


def _payload_weight(total: FloatArray, expected: FloatArray, good: BoolArray) -> Iterator[Note]:
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
    yield implausible_note(
        "runs, column payload_kg",
        f"the payload adds {ratio:.3g} times what the weighed loads say; expected the same within "
        f"{100 * (_MOST_PAYLOAD - 1):.0f} %; {hint}",
    )


def _swapped_loads(loads: tuple[FloatArray, FloatArray], computed: tuple[FloatArray, FloatArray]) -> Iterator[Note]:
    """Hold the side that carries more against the side on which the payload lies."""
    weighed, expected = loads[0] - loads[1], computed[0] - computed[1]
    good = np.isfinite(weighed) & np.isfinite(expected) & (np.abs(expected) > 0.1 * np.abs(computed[0] + computed[1]))
    if good.sum() < LEAST_RUNS:
        return
    ratio = weighed[good] / expected[good]
    if (ratio < -0.5).mean() > _AGREEING_SHARE:
        yield implausible_note(
            "runs, columns load_left_N, load_right_N",
            f"in {int((ratio < -0.5).sum())} of {int(good.sum())} runs with the payload on one side the other wheel "
            "carries more; expected the wheel beside it to; are the loads swapped, or is payload_y_m positive to the "
            "right?",
        )
