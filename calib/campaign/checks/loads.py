"""Wheel loads: physical, permitted, and as the payload asks for."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.campaign.checks.common import SIDES, listed, note
from calib.campaign.model import Campaign, Note
from calib.campaign.read import loads_from_payload


def wheel_loads(campaign: Campaign) -> Iterator[Note]:
    """Find loads that no rolling wheel has, and loads beyond the permitted one."""
    runs = campaign.runs
    for side in SIDES:
        load = runs.number(f"load_{side}_N")
        for run in np.flatnonzero(load <= 0):
            text = (
                f"found {load[run]:.4g} N; expected more than 0, or the wheel would lift off; check payload and place"
            )
            yield note(campaign, run, f"load_{side}_N", text, "impossible_load", "wrong")
        permitted = campaign.vehicle.max_wheel_load_N
        for run in np.flatnonzero(load > permitted):
            text = f"found {load[run]:.5g} N; {permitted:g} N is permitted; check the unit (kg or kN in a column of N?)"
            yield note(campaign, run, f"load_{side}_N", text, "excess_load")
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
        yield note(
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
