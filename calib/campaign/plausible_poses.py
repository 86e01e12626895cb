"""End poses held against the distance driven and the counts."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import Campaign, Note
from calib.campaign.plausible_terms import LEAST_RUNS, SIDES, note

#: share of the runs that must agree
_MOST: Final = 0.8
#: nearly straight runs turn against their counts beyond doubt: so many standard errors, and at least so many times
_SIGMAS, _RATIO = 6.0, -0.3


def implausible_poses(campaign: Campaign) -> Iterator[Note]:
    """Yield end poses and headings in another unit."""
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
    if good.sum() >= LEAST_RUNS:
        far = away[good] > 3 * distance[good] + 1
        if far.mean() > _MOST:
            ratio = float(np.median(away[good][far] / distance[good][far]))
            yield note(
                "runs, columns ref_x_m, ref_y_m",
                f"the end poses lie {ratio:.3g} times as far away as was driven; expected no more than the distance; "
                + ("are they in millimetres?" if ratio > 300 else "check their unit and frame"),
            )
        # a corridor's end lies where the rangefinder says
        straight = good & np.isfinite(runs.number("distance_m")) & (np.abs(y) < 0.2 * np.abs(x))
        if straight.sum() >= LEAST_RUNS and np.median(away[straight] / distance[straight]) < 0.1:
            yield note(
                "runs, columns ref_x_m, ref_y_m",
                f"the end poses of straight runs lie {np.median(away[straight] / distance[straight]):.3g} of the "
                "distance away; expected the distance; check the unit (km, or distance_m in mm?)",
            )
        straight &= np.isfinite(theta) & (np.abs(y) < 0.05 * np.abs(x)) & (away > 0.5 * distance)
        askew = float(np.median(np.abs(theta[straight]))) if straight.sum() >= LEAST_RUNS else 0.0
        if askew > 0.15 and campaign.reference.frame != "map":
            yield note(
                "runs, column ref_theta_rad",
                f"straight runs that end on their line are turned by {askew:.3g} rad (median); expected below 0.15; "
                "are the headings in degrees?",
            )
    turned = (arcs[1] - arcs[0]) / campaign.vehicle.track_m
    yield from _headings(theta, turned, distance)
    if campaign.reference.frame != "map":
        yield from _little_turned(theta, turned, distance, [runs.number(f"load_{side}_N") for side in SIDES])


def _headings(theta: FloatArray, turned: FloatArray, distance: FloatArray) -> Iterator[Note]:
    """Hold headings against those of the counts; unequal wheels turn the vehicle in proportion to the distance."""
    good = np.isfinite(theta) & np.isfinite(turned) & np.isfinite(distance)
    if good.sum() < 2 * LEAST_RUNS or np.median(np.abs(turned[good])) < 1.0:
        # nearly straight runs: their headings tell unequal wheels, not units
        return
    design = np.column_stack([turned, distance])[good]
    coefficients, _, rank, _ = np.linalg.lstsq(design, theta[good], rcond=1e-9)
    rest = theta[good] - design @ coefficients
    if rank < 2:
        return
    std = math.sqrt(float(rest @ rest) / (good.sum() - 2) * float(np.linalg.inv(design.T @ design)[0, 0]))
    ratio = float(coefficients[0])
    if std > 0.1 * abs(ratio) or 0.5 <= ratio <= 2.0:
        return
    if -2.0 <= ratio <= -0.5:
        yield _against(ratio)
        return
    degrees = abs(abs(ratio) * math.pi / 180 - 1) < 0.3
    yield note(
        "runs, column ref_theta_rad",
        f"the headings are {ratio:.3g} times those of the counts; expected the same within a factor of 2; "
        + ("are they in degrees?" if degrees else "check track_m, counts_per_rev and the unit of the heading"),
    )


def _little_turned(
    theta: FloatArray, turned: FloatArray, distance: FloatArray, loads: list[FloatArray]
) -> Iterator[Note]:
    """Hold the small headings of nearly straight runs against the counts, unequal wheels under any load set aside.

    Radii that scatter make the headings follow the counts less than once, and never the other way round.
    """
    good = np.isfinite(theta) & np.isfinite(turned) & np.isfinite(distance)
    if good.sum() < 2 * LEAST_RUNS or np.median(np.abs(turned[good])) >= 1.0:
        return
    by_load = [distance * load for load in loads if np.isfinite(load[good]).all()]
    wheels = np.column_stack([distance, *by_load])[good]
    wheels = wheels / np.maximum(np.abs(wheels).max(axis=0), 1e-300)
    both = np.column_stack([turned[good], theta[good]])
    # loads may come in step with each other: what they explain is set aside whatever their rank
    explained, _, rank, _ = np.linalg.lstsq(wheels, both, rcond=1e-9)
    counted, measured = (both - wheels @ explained).T
    free, spread = int(good.sum() - rank) - 1, float(counted @ counted)
    if free < LEAST_RUNS or spread <= 0.0:
        return
    ratio = float(counted @ measured) / spread
    rest = measured - ratio * counted
    std = math.sqrt(float(rest @ rest) / free / spread)
    if ratio < _RATIO and ratio < -_SIGMAS * std:
        yield _against(ratio)


def _against(ratio: float) -> Note:
    return note(
        "runs, columns counts_left, counts_right",
        f"the headings turn against the counts ({ratio:.3g} times); expected the same sense; are the wheels' "
        "counts swapped, or is ref_theta_rad positive to the right?",
    )
