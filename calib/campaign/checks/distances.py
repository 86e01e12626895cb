"""Distances and end poses: present, in their unit, and in agreement with rangefinder, counts and logs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.campaign.checks.design import LEAST_RUNS, SIDES, cell_note, implausible_note, listed, per_rev, robust_spread
from calib.campaign.model import Campaign, Note
from calib.campaign.references import GYRO_TURN
from calib.campaign.wheels import STEERED, WHEEL_COLUMNS, odometry_source, without_rear_wheels
from calib.types import BoolArray, FloatArray


def missing_values(campaign: Campaign) -> Iterator[Note]:
    """Say which runs lack counts, and which lack both a distance and an end pose."""
    runs = campaign.runs
    source = odometry_source(campaign) if without_rear_wheels(campaign) else "rear"
    needed = (*WHEEL_COLUMNS[source], *(("steer_rad",) if source in STEERED else ()))
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
    headed = np.isfinite(runs.number("ref_theta_rad")) | np.isfinite(runs.number(GYRO_TURN))
    lacking = np.isnan(runs.number("distance_m")) & np.isnan(runs.number("ref_x_m")) & ~trajectory & ~headed
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
        yield cell_note(campaign, run, "distance_m", text, "distance_span", "wrong")
    for run in np.flatnonzero((distance > 0) & ((distance < low) | (distance > high))):
        hint = "it looks like millimetres; name the column distance_mm" if distance[run] / 1e3 <= high < 1e3 else ""
        hint = hint if distance[run] > high else ""
        text = (
            f"found {distance[run]:g} m; the rangefinder measures {low:g} to {high:g} m; "
            f"{hint or 'check the cell, or give rangefinder.min_m and max_m'}"
        )
        yield cell_note(campaign, run, "distance_m", text, "distance_span")


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
            yield cell_note(campaign, run, "log range_m", text, "distance_span")
        allowed = max(0.02, 8 * campaign.rangefinder.sigma_m)
        if abs(distance[run] - known[-1]) > allowed and abs(distance[run] - (known[-1] - known[0])) > allowed:
            text = (
                f"found {distance[run]:.4f} m in the table but {known[-1]:.4f} m at the end of the log; "
                "the log may be cut"
            )
            yield cell_note(campaign, run, "distance_m", text, "distance_disagrees")


#: runs that must agree, and standard errors beyond which they do
_LEAST_STRAIGHT_RUNS: Final = 8
_SIGMAS: Final = 6.0
#: a distance is that of the end pose within so many stated uncertainties, and at least so many metres
_UNCERTAINTIES, _LEAST_DIFFERENCE_M = 5.0, 0.005
#: share by which a track may differ before it is spoken of
_TRACK_TOLERANCE: Final = 0.05
#: a run far from the others, in robust spreads, is left aside: its log may be damaged
_OUTLIER_SPREADS: Final = 5.0


def distance_against_pose(campaign: Campaign) -> Iterator[Note]:
    """Compare the distance of nearly straight runs with how far away the reference saw them end."""
    runs = campaign.runs
    distance, away = runs.number("distance_m"), np.hypot(runs.number("ref_x_m"), runs.number("ref_y_m"))
    # what is off by more is another unit or another row, which is told elsewhere
    straight = _straight(campaign) & (np.abs(distance - away) < 0.05 * away)
    if straight.sum() < _LEAST_STRAIGHT_RUNS:
        return
    longer = (distance - away)[straight]
    median = float(np.median(longer))
    error = 1.2533 * robust_spread(longer) / math.sqrt(len(longer))
    stated = math.hypot(campaign.rangefinder.sigma_m or 0.0, campaign.reference.sigma_xy_m or 0.0)
    allowed = max(_LEAST_DIFFERENCE_M, _UNCERTAINTIES * stated)
    if abs(median) > max(allowed, _SIGMAS * error):
        text = (
            f"the distance is {1e3 * abs(median):.3g} mm {'longer' if median > 0 else 'shorter'} than the way to the "
            f"reference's end pose (median of {len(longer)} straight runs, standard error {1e3 * error:.2g} mm); "
            f"expected the same within {1e3 * allowed:.2g} mm; check the rangefinder's zero and scale, and what each "
            "is measured from"
        )
        yield Note("suspicious", "runs, column distance_m", text, "distance_against_pose")


@dataclass(frozen=True, slots=True, eq=False)
class _Bows:
    """How far nearly straight runs bow out: the end's offset less half the end's heading times the distance.

    Wheels of unequal radius, which scatter from run to run, turn a run in proportion to the distance and leave its bow
    alone; what is left is turned by the track.
    """

    offset_m: FloatArray  #: end to the side by the reference, shape (n,)
    turned_m: FloatArray  #: half the end's heading times the distance
    counted_m: FloatArray  #: bow by the log

    @property
    def slope(self) -> tuple[float, float]:
        """Measured bow over the counted one, and its standard error."""
        return _slope(self.counted_m, self.offset_m - self.turned_m)

    @property
    def mirrored_slope(self) -> tuple[float, float]:
        """The same with the reference's y of the other sign."""
        return _slope(self.counted_m, -self.offset_m - self.turned_m)


def _bows(campaign: Campaign) -> _Bows | None:
    """Return the bows of the straight runs, None where too few were measured and logged."""
    runs, logs = campaign.runs, campaign.logs
    theta = runs.number("ref_theta_rad")
    used = np.flatnonzero(_straight(campaign) & np.isfinite(theta) & (np.abs(theta) < 0.3) & (logs.lengths >= 20))
    if len(used) < _LEAST_STRAIGHT_RUNS or not {"counts_left", "counts_right"} <= set(logs.columns):
        return None
    used = used[:_MOST_STRAIGHT_RUNS]
    sensor = campaign.reference
    offset = runs.number("ref_y_m") - sensor.sensor_x_m * np.sin(theta) - sensor.sensor_y_m * (np.cos(theta) - 1.0)
    distance = runs.number("distance_m")
    counted = np.array([_bow(campaign, int(run), float(distance[run])) for run in used])
    kept = np.isfinite(counted)
    if kept.sum() < _LEAST_STRAIGHT_RUNS:
        return None
    used = used[kept]
    return _Bows(offset[used], 0.5 * (distance * theta)[used], counted[kept])


def mirrored_ends(campaign: Campaign) -> Iterator[Note]:
    """Find a y of the other sign: ends that neither headings nor counts explain, and do with the sign changed."""
    bows = _bows(campaign)
    if bows is None:
        return
    (_, error), (mirrored, mirrored_error) = bows.slope, bows.mirrored_slope
    if mirrored_error < _CLEARER * error and abs(mirrored - 1.0) < max(0.1, _SIGMAS * mirrored_error):
        text = (
            f"the ends of {len(bows.offset_m)} straight runs lie to a side that neither their headings nor their "
            "counts say; expected y positive to the left; check the sign of ref_y_m"
        )
        yield Note("suspicious", "runs, column ref_y_m", text, "mirrored_ends")


def track_against_bows(campaign: Campaign) -> Iterator[Note]:
    """Compare how far nearly straight runs bow out by their logs with how far the reference saw them bow."""
    bows = _bows(campaign)
    if bows is None:
        return
    ratio, error = bows.slope
    if error > 0.1 or abs(ratio - 1.0) < max(_TRACK_TOLERANCE, _SIGMAS * error):
        return
    track = campaign.vehicle.track_m
    text = (
        f"{len(bows.offset_m)} straight runs bow out {ratio:.3g} times as far as their counts say with a track of "
        f"{track:g} m (standard error {error:.2g}); expected the same within {100 * _TRACK_TOLERANCE:g} %; "
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
        near = np.abs(rest) <= _OUTLIER_SPREADS * max(robust_spread(rest), 1e-12)
        kept = near if near.sum() >= _LEAST_STRAIGHT_RUNS else kept
    spread = float(rest[kept] @ rest[kept]) / (kept.sum() - 1)
    return slope, math.sqrt(spread / max(float(counted[kept] @ counted[kept]), 1e-300))


#: straight runs whose bows are looked at: more tell no more, and large campaigns need not wait
_MOST_STRAIGHT_RUNS: Final = 200
#: a mirrored y leaves less than this share of the scatter where it is mirrored back
_CLEARER: Final = 0.5
#: share of the runs that must agree
_AGREEING_SHARE: Final = 0.8
#: nearly straight runs turn against their counts beyond doubt: so many standard errors, and at least so many times
_OPPOSED_SIGMAS, _OPPOSED_RATIO = 6.0, -0.3


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
        if far.mean() > _AGREEING_SHARE:
            ratio = float(np.median(away[good][far] / distance[good][far]))
            yield implausible_note(
                "runs, columns ref_x_m, ref_y_m",
                f"the end poses lie {ratio:.3g} times as far away as was driven; expected no more than the distance; "
                + ("are they in millimetres?" if ratio > 300 else "check their unit and frame"),
            )
        # a corridor's end lies where the rangefinder says
        straight = good & np.isfinite(runs.number("distance_m")) & (np.abs(y) < 0.2 * np.abs(x))
        if straight.sum() >= LEAST_RUNS and np.median(away[straight] / distance[straight]) < 0.1:
            yield implausible_note(
                "runs, columns ref_x_m, ref_y_m",
                f"the end poses of straight runs lie {np.median(away[straight] / distance[straight]):.3g} of the "
                "distance away; expected the distance; check the unit (km, or distance_m in mm?)",
            )
        straight &= np.isfinite(theta) & (np.abs(y) < 0.05 * np.abs(x)) & (away > 0.5 * distance)
        askew = float(np.median(np.abs(theta[straight]))) if straight.sum() >= LEAST_RUNS else 0.0
        if askew > 0.15 and campaign.reference.frame != "map":
            yield implausible_note(
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
    yield implausible_note(
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
    # loads may come in step with each other: what they explain is set aside at any rank
    explained, _, rank, _ = np.linalg.lstsq(wheels, both, rcond=1e-9)
    counted, measured = (both - wheels @ explained).T
    free, spread = int(good.sum() - rank) - 1, float(counted @ counted)
    if free < LEAST_RUNS or spread <= 0.0:
        return
    ratio = float(counted @ measured) / spread
    rest = measured - ratio * counted
    std = math.sqrt(float(rest @ rest) / free / spread)
    if ratio < _OPPOSED_RATIO and ratio < -_OPPOSED_SIGMAS * std:
        yield _against(ratio)


def _against(ratio: float) -> Note:
    return implausible_note(
        "runs, columns counts_left, counts_right",
        f"the headings turn against the counts ({ratio:.3g} times); expected the same sense; are the wheels' "
        "counts swapped, or is ref_theta_rad positive to the right?",
    )
