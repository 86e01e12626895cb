"""Distances and end poses: present, in their unit, and in agreement with rangefinder, counts and logs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from calib.campaign.checks.design import (
    LEAST_RUNS,
    MOST_OF_THE_RUNS,
    SIDES,
    cell_note,
    column_note,
    implausible_column,
    listed,
    meaning,
    robust_spread,
    rolled_m,
    setting_note,
    stated,
    turned_rad,
)
from calib.campaign.model import Campaign, Note
from calib.campaign.references import GYRO_TURN
from calib.campaign.wheels import STEERED, WHEEL_COLUMNS, odometry_source, without_rear_wheels
from calib.types import BoolArray, FloatArray


def missing_values(campaign: Campaign) -> Iterator[Note]:
    """Say which runs lack counts, and which lack both a distance and an end pose."""
    runs = campaign.runs
    source = odometry_source(campaign) if without_rear_wheels(campaign) else "rear"
    logged = [campaign.logs.of(run) for run in range(len(runs))]
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


#: runs that must agree, and standard errors beyond which they do
_LEAST_STRAIGHT_RUNS: Final = 8
_SIGMAS: Final = 6.0
#: a distance is that of the end pose within so many stated uncertainties, and at least so many metres
_UNCERTAINTIES, _LEAST_DIFFERENCE_M = 5.0, 0.005
#: share by which a track may differ before it is reported
_TRACK_TOLERANCE: Final = 0.05
#: a run far from the others, in robust spreads, is left aside: its log may be damaged
_OUTLIER_SPREADS: Final = 5.0
#: end's offset by the reference, half its heading times the distance, and the bow by the log, in m
_Bows = tuple[FloatArray, FloatArray, FloatArray]
#: straight runs whose bows are looked at: more tell no more, and large campaigns need not wait
_MOST_STRAIGHT_RUNS: Final = 200
#: a mirrored y leaves less than this share of the scatter where it is mirrored back
_CLEARER: Final = 0.5
#: nearly straight runs turn against their counts beyond doubt: so many standard errors, and at least so many times
_OPPOSED_SIGMAS, _OPPOSED_RATIO = 6.0, -0.3


def distance_against_pose(campaign: Campaign) -> Iterator[Note]:
    """Compare the distance of nearly straight runs with how far away the reference saw them end, by session too."""
    runs = campaign.runs
    distance, away = runs.number("distance_m"), np.hypot(runs.number("ref_x_m"), runs.number("ref_y_m"))
    # what is off by more is another unit or another row, which other checks report
    straight = _straight(campaign) & (np.abs(distance - away) < 0.05 * away)
    uncertainty = math.hypot(campaign.rangefinder.sigma_m, campaign.reference.sigma_xy_m)
    allowed = max(_LEAST_DIFFERENCE_M, _UNCERTAINTIES * uncertainty)
    session = runs.label("session")
    groups = {"": straight} | {f" in session {name}": straight & (session == name) for name in np.unique(session)}
    for where, group in groups.items():
        if group.sum() < (LEAST_RUNS if where else _LEAST_STRAIGHT_RUNS):
            continue
        longer = (distance - away)[group]
        median = float(np.median(longer))
        error = 1.2533 * robust_spread(longer) / math.sqrt(len(longer))
        if abs(median) > max(allowed, _SIGMAS * error):
            text = (
                f"the distance is {1e3 * abs(median):.3g} mm {'longer' if median > 0 else 'shorter'} than that of the "
                f"reference's end pose{where} (median of {len(longer)} straight runs, standard error {1e3 * error:.2g} "
                f"mm); expected the same within {1e3 * allowed:.2g} mm; check zero and scale of the rangefinder, and "
                "what each is measured from"
            )
            yield column_note("distance_m", text, "distance_against_pose")
            if not where:
                return


def _bows(campaign: Campaign) -> _Bows | None:
    """Return how far nearly straight runs bow out; None where too few were measured and logged.

    The bow is the end's offset less half the end's heading times the distance. Wheels of unequal radius, which scatter
    from run to run, turn a run in proportion to the distance and leave its bow alone; a wrong track scales it.
    """
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
    known = np.isfinite(counted)
    if known.sum() < _LEAST_STRAIGHT_RUNS:
        return None
    return offset[used[known]], 0.5 * (distance * theta)[used[known]], counted[known]


def _bow(campaign: Campaign, run: int, distance_m: float) -> float:
    """Return the bow of one run by its log, its wheels as large as the distance says."""
    log = campaign.logs.of(run)
    left, right = (rolled_m(campaign, side, log[f"counts_{side}"] - log[f"counts_{side}"][0]) for side in SIDES)
    along = (left + right) / 2
    if not np.isfinite(along).all() or along[-1] <= 0.0:
        return math.nan
    scale = distance_m / along[-1]
    heading = scale * (right - left) / campaign.vehicle.track_m
    middle = (heading[1:] + heading[:-1]) / 2
    return float(scale * np.diff(along) @ np.sin(middle) - 0.5 * distance_m * heading[-1])


def mirrored_ends(campaign: Campaign) -> Iterator[Note]:
    """Find a y of the other sign: ends that neither headings nor counts explain, and do with the sign changed."""
    bows = _bows(campaign)
    if bows is None:
        return
    offset, turned, counted = bows
    _, error = _slope(counted, offset - turned)
    mirrored, mirrored_error = _slope(counted, -offset - turned)
    if mirrored_error < _CLEARER * error and abs(mirrored - 1.0) < max(0.1, _SIGMAS * mirrored_error):
        text = (
            f"the ends of {len(offset)} straight runs lie to a side that neither their headings nor their counts say; "
            "expected y positive to the left; check the sign of ref_y_m"
        )
        yield column_note("ref_y_m", text, "mirrored_ends")


def track_against_bows(campaign: Campaign) -> Iterator[Note]:
    """Compare how far nearly straight runs bow out by their logs with how far the reference saw them bow."""
    bows = _bows(campaign)
    if bows is None:
        return
    offset, turned, counted = bows
    ratio, error = _slope(counted, offset - turned)
    if error > 0.1 or abs(ratio - 1.0) < max(_TRACK_TOLERANCE, _SIGMAS * error):
        return
    track = campaign.vehicle.track_m
    hint = f"is the track {track / ratio:.3g} m?" if 0.5 < ratio < 2.0 else "check track_m and the reference's frame"
    text = (
        f"{len(offset)} straight runs bow out {ratio:.3g} times as far as their counts say with a track of {track:g} m "
        f"(standard error {error:.2g}); expected the same within {100 * _TRACK_TOLERANCE:g} %; {hint}"
    )
    yield setting_note("vehicle.track_m", text, "track_against_bows")


def _straight(campaign: Campaign) -> BoolArray:
    """Return which runs ended nearly straight ahead of where they began, in a frame of their own."""
    runs = campaign.runs
    x, y, distance = (runs.number(name) for name in ("ref_x_m", "ref_y_m", "distance_m"))
    own_frame = campaign.reference.frame != "map"
    return own_frame & ~runs.excluded & (distance > 1.0) & (x > 0.5 * distance) & (np.abs(y) < 0.05 * x)


def _slope(counted: FloatArray, measured: FloatArray) -> tuple[float, float]:
    """Return the slope of a line through the origin and its standard error, runs far from it left aside."""
    kept = np.ones(len(counted), dtype=bool)
    for _ in range(2):
        square = max(float(counted[kept] @ counted[kept]), 1e-300)
        slope = float(counted[kept] @ measured[kept]) / square
        residual = measured - slope * counted
        near = np.abs(residual) <= _OUTLIER_SPREADS * max(robust_spread(residual), 1e-12)
        kept = near if near.sum() >= _LEAST_STRAIGHT_RUNS else kept
    square = max(float(counted[kept] @ counted[kept]), 1e-300)
    return slope, math.sqrt(float(residual[kept] @ residual[kept]) / (kept.sum() - 1) / square)


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


def implausible_poses(campaign: Campaign) -> Iterator[Note]:
    """Yield end poses and headings in another unit."""
    runs, own_frame = campaign.runs, campaign.reference.frame != "map"
    x, y, theta, measured = (runs.number(name) for name in ("ref_x_m", "ref_y_m", "ref_theta_rad", "distance_m"))
    rolled = np.abs(rolled_m(campaign, "left") + rolled_m(campaign, "right")) / 2
    distance = np.where(np.isfinite(measured), measured, rolled)
    away = np.hypot(x, y)
    good = np.isfinite(away) & np.isfinite(distance) & (distance > 0)
    if good.sum() >= LEAST_RUNS:
        far = good & (away > 3 * distance + 1)
        if far.sum() > MOST_OF_THE_RUNS * good.sum():
            ratio = float(np.median(away[far] / distance[far]))
            hint = "are they in millimetres?" if ratio > 300 else "check their unit and frame"
            text = (
                f"the end poses lie {ratio:.3g} times as far away as was driven; expected the distance at most; {hint}"
            )
            yield implausible_column("ref_x_m, ref_y_m", text)
        # a corridor's end lies where the rangefinder says
        straight = good & np.isfinite(measured) & (np.abs(y) < 0.2 * np.abs(x))
        share = float(np.median(away[straight] / distance[straight])) if straight.sum() >= LEAST_RUNS else 1.0
        if share < 0.1:
            text = (
                f"the end poses of straight runs lie {share:.3g} of the distance away; expected the distance; check "
                "the unit (km, or distance_m in mm?)"
            )
            yield implausible_column("ref_x_m, ref_y_m", text)
        straight &= np.isfinite(theta) & (np.abs(y) < 0.05 * np.abs(x)) & (away > 0.5 * distance)
        askew = float(np.median(np.abs(theta[straight]))) if straight.sum() >= LEAST_RUNS else 0.0
        if askew > 0.15 and own_frame:
            text = (
                f"straight runs that end on their line are turned by {askew:.3g} rad (median); expected below 0.15; "
                "are the headings in degrees?"
            )
            yield implausible_column("ref_theta_rad", text)
    yield from _headings(campaign, distance)


def _headings(campaign: Campaign, distance: FloatArray) -> Iterator[Note]:
    """Hold headings against those of the counts, unequal wheels set aside: they turn in proportion to the distance.

    Radii that scatter with the load make the small headings of nearly straight runs follow the counts less than once,
    and never the other way round.
    """
    theta, turned = campaign.runs.number("ref_theta_rad"), turned_rad(campaign)
    good = np.isfinite(theta) & np.isfinite(turned) & np.isfinite(distance)
    if good.sum() < 2 * LEAST_RUNS:
        return
    if np.median(np.abs(turned[good])) >= 1.0:
        ratio, std = _partial_slope(theta[good], turned[good], [distance[good]])
        if std > 0.1 * abs(ratio) or 0.5 <= ratio <= 2.0:
            return
        if not -2.0 <= ratio <= -0.5:
            degrees = abs(abs(ratio) * math.pi / 180 - 1) < 0.3
            hint = "are they in degrees?" if degrees else "check track_m, counts_per_rev and the heading's unit"
            text = f"the headings are {ratio:.3g} times those of the counts; expected the same within 2 times; {hint}"
            yield implausible_column("ref_theta_rad", text)
            return
    elif campaign.reference.frame != "map":
        loads = [campaign.runs.number(f"load_{side}_N")[good] for side in SIDES]
        by_load = [distance[good] * load for load in loads if np.isfinite(load).all()]
        ratio, std = _partial_slope(theta[good], turned[good], [distance[good], *by_load])
        if not ratio < min(_OPPOSED_RATIO, -_OPPOSED_SIGMAS * std):
            return
    else:
        return
    text = (
        f"the headings turn against the counts ({ratio:.3g} times); expected the same sense; are the wheels' counts "
        "swapped, or is ref_theta_rad positive to the right?"
    )
    yield implausible_column("counts_left, counts_right", text)


def _partial_slope(measured: FloatArray, counted: FloatArray, nuisance: Sequence[FloatArray]) -> tuple[float, float]:
    """Return the slope of `measured` over `counted` beside nuisance columns, and its standard error; else 0 and inf."""
    design = np.column_stack(nuisance)
    design = design / np.maximum(np.abs(design).max(axis=0), 1e-300)
    # loads may come in step with each other: what they explain is set aside at any rank
    both = np.column_stack([counted, measured])
    explained, _, rank, _ = np.linalg.lstsq(design, both, rcond=1e-9)
    counted, measured = (both - design @ explained).T
    free, square = len(measured) - int(rank) - 1, float(counted @ counted)
    if free < LEAST_RUNS or square <= 0.0:
        return 0.0, math.inf
    slope = float(counted @ measured) / square
    residual = measured - slope * counted
    return slope, math.sqrt(float(residual @ residual) / free / square)
