"""The rangefinder and the counts of nearly straight runs, held against the reference's end poses."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.campaign.checks.common import per_rev, robust_spread
from calib.campaign.model import Campaign, Note

#: runs that must agree, and standard errors beyond which they do
_LEAST: Final = 8
_SIGMAS: Final = 6.0
#: a distance is that of the end pose within so many stated uncertainties, and at least so many metres
_UNCERTAINTIES, _LEAST_M = 5.0, 0.005
#: share by which a track may differ before it is spoken of
_TRACK: Final = 0.05
#: a run far from the others, in robust spreads, is left aside: its log may be damaged
_FAR: Final = 5.0


def distance_against_pose(campaign: Campaign) -> Iterator[Note]:
    """Compare the distance of nearly straight runs with how far away the reference saw them end."""
    runs = campaign.runs
    distance, away = runs.number("distance_m"), np.hypot(runs.number("ref_x_m"), runs.number("ref_y_m"))
    # what is off by more is another unit or another row, which is told elsewhere
    straight = _straight(campaign) & (np.abs(distance - away) < 0.05 * away)
    if straight.sum() < _LEAST:
        return
    longer = (distance - away)[straight]
    median = float(np.median(longer))
    error = 1.2533 * robust_spread(longer) / math.sqrt(len(longer))
    stated = math.hypot(campaign.rangefinder.sigma_m or 0.0, campaign.reference.sigma_xy_m or 0.0)
    allowed = max(_LEAST_M, _UNCERTAINTIES * stated)
    if abs(median) > max(allowed, _SIGMAS * error):
        text = (
            f"the distance is {1e3 * abs(median):.3g} mm {'longer' if median > 0 else 'shorter'} than the way to the "
            f"reference's end pose (median of {len(longer)} straight runs, standard error {1e3 * error:.2g} mm); "
            f"expected the same within {1e3 * allowed:.2g} mm; check the rangefinder's zero and scale, and what each "
            "is measured from"
        )
        yield Note("suspicious", "runs, column distance_m", text, "distance_against_pose")


def track_against_bows(campaign: Campaign) -> Iterator[Note]:
    """Compare how far nearly straight runs bow out by their logs with how far the reference saw them bow.

    A bow is the end's offset less half the end's heading times the distance. Wheels of unequal radius, which scatter
    from run to run, turn a run in proportion to the distance and leave its bow alone; what is left is turned by the
    track.
    """
    runs, logs = campaign.runs, campaign.logs
    theta = runs.number("ref_theta_rad")
    used = _straight(campaign) & np.isfinite(theta) & (np.abs(theta) < 0.3) & (logs.lengths >= 20)
    if used.sum() < _LEAST or not {"counts_left", "counts_right"} <= set(logs.columns):
        return
    sensor = campaign.reference
    offset = runs.number("ref_y_m") - sensor.sensor_x_m * np.sin(theta) - sensor.sensor_y_m * (np.cos(theta) - 1.0)
    distance = runs.number("distance_m")
    measured = offset - 0.5 * distance * theta
    counted = np.full(len(runs), np.nan)
    for run in np.flatnonzero(used):
        counted[run] = _bow(campaign, int(run), float(distance[run]))
    good = used & np.isfinite(counted)
    if good.sum() < _LEAST:
        return
    ratio, error = _slope(counted[good], measured[good])
    if error > 0.1 or abs(ratio - 1.0) < max(_TRACK, _SIGMAS * error):
        return
    track = campaign.vehicle.track_m
    text = (
        f"{int(good.sum())} straight runs bow out {ratio:.3g} times as far as their counts say with a track of "
        f"{track:g} m (standard error {error:.2g}); expected the same within {100 * _TRACK:g} %; "
        + (f"is the track {track / ratio:.3g} m?" if 0.5 < ratio < 2.0 else "check track_m and the reference's frame")
    )
    yield Note("suspicious", "campaign.toml, vehicle.track_m", text, "track_against_bows")


def _straight(campaign: Campaign) -> BoolArray:
    """Return which runs ended nearly straight ahead of where they began, in a frame of their own."""
    runs = campaign.runs
    x, y, distance = (runs.number(name) for name in ("ref_x_m", "ref_y_m", "distance_m"))
    if campaign.reference.frame == "map":
        return np.zeros(len(runs), dtype=bool)
    return ~runs.excluded & (distance > 1.0) & (x > 0.5 * distance) & (np.abs(y) < 0.05 * x)


def _bow(campaign: Campaign, run: int, distance_m: float) -> float:
    """Return the bow of one run by its log, its wheels as large as the distance says."""
    log = campaign.logs.of(run)
    arcs = [
        2 * np.pi * campaign.vehicle.wheel_radius_m * (log[f"counts_{side}"] - log[f"counts_{side}"][0])
        / per_rev(campaign, side)
        for side in ("left", "right")
    ]  # fmt: skip
    along = (arcs[0] + arcs[1]) / 2
    if not np.isfinite(along).all() or along[-1] <= 0.0:
        return math.nan
    scale = distance_m / along[-1]
    heading = scale * (arcs[1] - arcs[0]) / campaign.vehicle.track_m
    middle = (heading[1:] + heading[:-1]) / 2
    return float(scale * np.diff(along) @ np.sin(middle) - 0.5 * distance_m * heading[-1])


def _slope(counted: FloatArray, measured: FloatArray) -> tuple[float, float]:
    """Return the slope of a line through the origin and its standard error, runs far from it left aside."""
    kept = np.ones(len(counted), dtype=bool)
    for _ in range(2):
        slope = float(counted[kept] @ measured[kept]) / max(float(counted[kept] @ counted[kept]), 1e-300)
        rest = measured - slope * counted
        near = np.abs(rest) <= _FAR * max(robust_spread(rest), 1e-12)
        kept = near if near.sum() >= _LEAST else kept
    spread = float(rest[kept] @ rest[kept]) / (kept.sum() - 1)
    return slope, math.sqrt(spread / max(float(counted[kept] @ counted[kept]), 1e-300))
