"""Distances: present, within the rangefinder's span, and as the log has them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.campaign.checks.common import listed, note
from calib.campaign.model import Campaign, Note
from calib.campaign.wheels import WHEEL_COLUMNS, odometry_source, without_rear_wheels


def missing_values(campaign: Campaign) -> Iterator[Note]:
    """Say which runs lack counts, and which lack both a distance and an end pose."""
    runs = campaign.runs
    source = odometry_source(campaign) if without_rear_wheels(campaign) else "rear"
    needed = (*WHEEL_COLUMNS[source], *(("steer_rad",) if source == "front" else ()))
    logged = [campaign.logs.of(run) for run in range(len(runs))] if source != "rear" else []
    for name in needed:
        lacking = np.asarray([name not in log for log in logged]) if logged else np.isnan(runs.number(name))
        if lacking.any():
            yield Note(
                "suspicious",
                f"logs, column {name}" if logged else f"runs, column {name}",
                f"{int(lacking.sum())} run(s) have no {name} in their log ({listed(runs.run_id[lacking])}); "
                "they cannot be used"
                if logged
                else f"{int(lacking.sum())} run(s) have no counts in table or log ({listed(runs.run_id[lacking])}); "
                "they cannot be used",
                "missing_counts",
            )
    trajectory = np.zeros(len(runs), dtype=bool)
    if "ref_x_m" in campaign.logs.columns:
        trajectory = np.asarray(["ref_x_m" in campaign.logs.of(run) for run in range(len(runs))])
    lacking = np.isnan(runs.number("distance_m")) & np.isnan(runs.number("ref_x_m")) & ~trajectory
    if lacking.any():
        text = (
            f"{int(lacking.sum())} run(s) have neither a distance nor a reference pose "
            f"({listed(runs.run_id[lacking])}); nothing can be learnt from them"
        )
        yield Note("suspicious", "runs, column distance_m", text, "missing_distance")


def distance_span(campaign: Campaign) -> Iterator[Note]:
    """Find distances that a rangefinder cannot have measured, and ones far from all others."""
    distance = campaign.runs.number("distance_m")
    low, high = campaign.rangefinder.min_m, campaign.rangefinder.max_m
    for run in np.flatnonzero(distance <= 0):
        text = f"found {distance[run]:g} m; expected a positive distance; correct it or flag the run as excluded"
        yield note(campaign, run, "distance_m", text, "distance_span", "wrong")
    for run in np.flatnonzero((distance > 0) & ((distance < low) | (distance > high))):
        hint = "it looks like millimetres; name the column distance_mm" if distance[run] / 1e3 <= high < 1e3 else ""
        hint = hint if distance[run] > high else ""
        text = (
            f"found {distance[run]:g} m; the rangefinder measures {low:g} to {high:g} m; "
            f"{hint or 'check the cell, or give rangefinder.min_m and max_m'}"
        )
        yield note(campaign, run, "distance_m", text, "distance_span")


def distance_against_log(campaign: Campaign) -> Iterator[Note]:
    """Compare the table's distance with the last range of the log."""
    column = campaign.logs.columns.get("range_m")
    if column is None:
        return
    distance = campaign.runs.number("distance_m")
    for run in np.flatnonzero(campaign.logs.present):
        log = column[campaign.logs.offsets[run] : campaign.logs.offsets[run + 1]]
        known = log[np.isfinite(log)]
        if not len(known):
            continue
        outside = (known < -0.5) | (known > campaign.rangefinder.max_m)
        if outside.any():
            text = (
                f"{int(outside.sum())} sample(s) lie outside the rangefinder's span, the first at "
                f"{known[outside][0]:g} m"
            )
            yield note(campaign, run, "log range_m", text, "distance_span")
        allowed = max(0.02, 8 * campaign.rangefinder.sigma_m)
        if abs(distance[run] - known[-1]) > allowed and abs(distance[run] - (known[-1] - known[0])) > allowed:
            text = (
                f"found {distance[run]:.4f} m in the table but {known[-1]:.4f} m at the end of the log; "
                "the log may be cut"
            )
            yield note(campaign, run, "distance_m", text, "distance_disagrees")
