"""Distances: present, in their unit, and in agreement with rangefinder, counts and logs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from calib.campaign.checks.design import (
    LEAST_RUNS,
    SIDES,
    cell_note,
    column_note,
    implausible_column,
    listed,
    meaning,
    robust_spread,
    rolled_m,
    stated,
)
from calib.campaign.model import Campaign, Note
from calib.campaign.references import GYRO_TURN
from calib.campaign.wheels import STEERED, WHEEL_COLUMNS, odometry_source, without_rear_wheels
from calib.types import BoolArray, FloatArray


def missing_values(campaign: Campaign) -> Iterator[Note]:
    """Say which runs lack counts, and which lack both a distance and an end pose."""
    runs = campaign.runs
    source = odometry_source(campaign) if without_rear_wheels(campaign) else "rear"
    needs_logs = source != "rear" or "ref_x_m" in campaign.logs.columns
    logged = [campaign.logs.of(run) if needs_logs else {} for run in range(len(runs))]
    for name in (*WHEEL_COLUMNS[source], *(("steer_rad",) if source in STEERED else ())):
        lacking = np.isnan(runs.number(name)) if source == "rear" else np.asarray([name not in log for log in logged])
        if lacking.any():
            what = "counts in table or log" if source == "rear" else f"{name} in their log"
            text = f"{int(lacking.sum())} run(s) have no {what} ({listed(runs.run_id[lacking])}); they cannot be used"
            where = f"{'runs' if source == 'rear' else 'logs'}, column {name}"
            yield Note("suspicious", where, text, "missing_counts")
    trajectory = np.asarray(["ref_x_m" in log for log in logged])
    unmeasured = [np.isnan(runs.number(name)) for name in ("distance_m", "ref_x_m", "ref_theta_rad", GYRO_TURN)]
    lacking = np.all(unmeasured, axis=0) & ~trajectory
    if lacking.any():
        text = (
            f"{int(lacking.sum())} run(s) have neither a distance nor a reference pose "
            f"({listed(runs.run_id[lacking])}); nothing can be learnt from them"
        )
        yield column_note("distance_m", text, "missing_distance")


def distance_span(campaign: Campaign) -> Iterator[Note]:
    """Find distances that a rangefinder cannot have measured."""
    distance = campaign.runs.number("distance_m")
    low, high = campaign.rangefinder.min_m, campaign.rangefinder.max_m
    for run in np.flatnonzero(distance <= 0):
        text = f"found {distance[run]:g} m; expected a positive distance; correct it or flag the run as excluded"
        yield cell_note(campaign, run, "distance_m", text, "distance_span", "wrong")
    for run in np.flatnonzero((distance > 0) & ((distance < low) | (distance > high))):
        millimetres = high < distance[run] <= 1e3 * high < 1e6
        hint = "name the column distance_mm" if millimetres else "check the cell, or give rangefinder.min_m and max_m"
        text = f"found {distance[run]:g} m; the rangefinder measures {low:g} to {high:g} m; {hint}"
        yield cell_note(campaign, run, "distance_m", text, "distance_span")


def distance_against_log(campaign: Campaign) -> Iterator[Note]:
    """Compare the table's distance with the last range of the log."""
    distance = campaign.runs.number("distance_m")
    allowed = max(0.02, 8 * campaign.rangefinder.sigma_m)
    for run in np.flatnonzero(campaign.logs.present) if "range_m" in campaign.logs.columns else ():
        log = campaign.logs.of(int(run)).get("range_m", np.zeros(0))
        known = log[np.isfinite(log)]
        if not len(known):
            continue
        outside = known[(known < -0.5) | (known > campaign.rangefinder.max_m)]
        if len(outside):
            text = f"{len(outside)} sample(s) lie outside the rangefinder's span, the first at {outside[0]:g} m"
            yield cell_note(campaign, run, "log range_m", text, "distance_span")
        if min(abs(distance[run] - known[-1]), abs(distance[run] - (known[-1] - known[0]))) > allowed:
            text = f"found {distance[run]:.4f} m; the log ends at {known[-1]:.4f} m; the log may be cut"
            yield cell_note(campaign, run, "distance_m", text, "distance_disagrees")


#: a measured radius, track or load may differ from its nominal value by this factor either way
MOST_RATIO: Final = 4.0 / 3.0


def off(ratio: float) -> bool:
    """Return whether a ratio of measured to nominal value is beyond what a vehicle can differ by."""
    return not 1 / MOST_RATIO <= ratio <= MOST_RATIO


def factor_reason(ratio: float) -> str:
    """Return the unit or setting that a ratio of radius to nominal radius points to; a general hint where none does."""
    text = meaning(ratio)
    return f"{text}?" if text else "check counts_per_rev, wheel_radius_m and the unit of the distance"


def implausible_distances(campaign: Campaign) -> Iterator[Note]:
    """Yield radii that no wheel has, and distances that do not belong to their counts."""
    distance = campaign.runs.number("distance_m")
    counts = {side: campaign.runs.number(f"counts_{side}") for side in SIDES}
    for side, other in (SIDES, SIDES[::-1]):
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.abs(distance / rolled_m(campaign, side))
        good = np.isfinite(ratio) & (ratio > 0)
        if good.sum() >= LEAST_RUNS:
            usual = float(np.median(ratio[good]))
            if off(usual) and stated(campaign, "vehicle.wheel_radius_m"):
                text = f"the {side} wheel's radius comes out {usual:.2f} times nominal: {factor_reason(usual)}"
                yield implausible_column(f"counts_{side}", text)
            yield from _scatter(
                np.log(ratio[good]), np.log(np.abs(distance), where=good, out=distance * np.nan), good, side
            )
        both = np.isfinite(counts[side] + counts[other]) & (distance > 1)
        if both.sum() >= LEAST_RUNS and (counts[side][both] < 0).all() and (counts[other][both] > 0).all():
            text = (
                f"the {side} wheel counts backwards in every straight run, the {other} one forwards; negate the column"
            )
            yield implausible_column(f"counts_{side}", text)
    total = np.abs(counts["left"] + counts["right"])
    both = np.isfinite(distance) & np.isfinite(total) & (total > 0)
    if both.sum() > LEAST_RUNS and np.ptp(distance[both]) == 0 and np.ptp(total[both]) > 2e-3 * total[both].mean():
        text = (
            f"found {distance[both][0]:g} m in all {int(both.sum())} runs, while the counts differ by "
            f"{100 * np.ptp(total[both]) / total[both].mean():.2g} %; expected the distance measured in each run; is "
            "it the nominal length of the corridor?"
        )
        yield implausible_column("distance_m", text)


def _scatter(radius: FloatArray, distance: FloatArray, good: BoolArray, side: str) -> Iterator[Note]:
    """Yield a note where radii scatter as no wheel's do; logarithms of the good runs' radii, of all runs' distances."""
    spread = robust_spread(radius)
    if len(radius) < 3 or spread < 0.01:
        return
    for shift in (1, -1):
        moved = (np.roll(distance, shift) - distance)[good] + radius
        again = robust_spread(moved[1:-1])
        if again < 0.2 * spread and np.isfinite(moved[1:-1]).sum() > 2:
            text = (
                f"the {side} wheel's radius scatters by {100 * spread:.2g} %, but by {100 * again:.2g} % with each "
                "distance one row on; expected distance and counts of the same run in a row; is the column shifted?"
            )
            yield implausible_column("distance_m", text)
            return
    if spread > 0.03:
        text = (
            f"the {side} wheel's radius scatters by {100 * spread:.2g} % from run to run; expected less than 3 %; do "
            "distances and counts belong to the same runs?"
        )
        yield implausible_column(f"distance_m, counts_{side}", text)
