"""End poses: in another unit or frame, or inconsistent with distances, counts and logs."""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from calib.campaign import checks
from calib.campaign.checks import LEAST_RUNS, column_note, implausible_column, robust_spread, rolled_m
from calib.campaign.checks.measurements import implausible_ratio
from calib.campaign.model import REFERENCE_POSE, Campaign, Note
from calib.types import BoolArray, FloatArray, IntArray, StrArray, evenly

#: fewest straight runs for a finding, and standard errors beyond which their median is one
_LEAST_STRAIGHT_RUNS: Final = 8
_SIGMAS: Final = 6.0
#: allowed difference of distance and end pose: in standard uncertainties, and at least
_UNCERTAINTIES, _LEAST_DIFFERENCE_M = 5.0, 0.005
#: difference from which they belong to different runs: in metres, and in allowed differences
_OF_ANOTHER_RUN_M, _OF_ANOTHER_RUN = 0.1, 4.0
#: factor by which an uncertainty is overstated
_OVERSTATED: Final = 4.0
#: factor of an understated one (two readings: 1.41), and its standard deviations
_UNDERSTATED, _UNDERSTATED_SIGMAS = 1.5, 6.0
#: largest angle between a straight run's start heading and its end
_MOST_BEARING_RAD: Final = 0.3
#: relative error from which a track is reported
_TRACK_TOLERANCE: Final = 0.05
#: robust spreads beyond which a run is omitted: its log may be damaged
_OUTLIER_SPREADS: Final = 5.0
#: runs; offset of the end by the reference, half its heading times the distance, bow by the log, in m
_Bows = tuple[IntArray, FloatArray, FloatArray, FloatArray]
#: most straight runs whose bows are computed, to save time
_MOST_STRAIGHT_RUNS: Final = 200
#: standard uncertainty of placing a vehicle on its start mark
_LEAST_ANGLE_RAD: Final = 0.01
#: largest share of the scatter that remains once y is mirrored back
_CLEARER: Final = 0.5
#: positions over what was driven -> their unit
POSITION_UNITS: Final = (
    (1e3, "millimetres"),
    (1e2, "centimetres"),
    (3.28084, "feet"),
    (39.3701, "inches"),
    (1e-3, "kilometres, or is distance_m in millimetres"),
)
#: a smaller ratio is degrees on the globe: a metre is 9e-6 degrees of latitude
_MAX_DEGREES_PER_M: Final = 1e-4
#: smallest turn of a run for a gyro's scale
_LEAST_GYRO_TURN_RAD: Final = 0.5
#: headings that turn against the counts: significance in standard errors, and largest ratio
_OPPOSED_SIGMAS, _OPPOSED_RATIO = 6.0, -0.3


def position_unit_hint(ratio: float, otherwise: str) -> str:
    """Return a hint at the unit of positions `ratio` times too large, or another."""
    unit = checks.meaning(ratio, POSITION_UNITS)
    unit = "degrees of latitude and longitude" if ratio < _MAX_DEGREES_PER_M else unit
    return f"are they in {unit}?" if unit else otherwise


def distance_against_pose(campaign: Campaign) -> Iterator[Note]:
    """Compare the distance of nearly straight runs with their end pose."""
    uncertainty = math.hypot(campaign.rangefinder.sigma_m, campaign.reference.sigma_xy_m)
    allowed = max(_LEAST_DIFFERENCE_M, _UNCERTAINTIES * uncertainty)
    excess = _distance_excess_m(campaign, 0.05)
    for where, n_runs, median, error in _shared_offsets(excess, campaign.runs.label("session"), allowed):
        text = f"""the distance is {1e3 * abs(median):.3g} mm {"longer" if median > 0 else "shorter"} than that of the
            reference's end pose {where} (median of {n_runs} straight runs, standard error {1e3 * error:.3g} mm);
            expected the same within {1e3 * allowed:.3g} mm; check zero and scale of the rangefinder, and what each is
            measured from"""
        yield column_note("distance_m", text, "distance_against_pose")
    excess = _distance_excess_m(campaign, 0.5)
    if np.isfinite(excess).sum() < _LEAST_STRAIGHT_RUNS:
        return
    distance, apart = campaign.runs.number("distance_m"), excess - np.nanmedian(excess)
    for run in np.flatnonzero(np.abs(apart) > max(_OF_ANOTHER_RUN_M, _OF_ANOTHER_RUN * allowed)):
        text = f"""found {distance[run]:.4g} m with an end pose {distance[run] - excess[run]:.4g} m away,
            {apart[run]:+.3g} m against the other straight runs; do distance and end pose belong to the same run?"""
        yield checks.cell_note(campaign, run, "distance_m", text, "pose_of_another_run")


def _distance_excess_m(campaign: Campaign, most: float) -> FloatArray:
    # distance less that of the end pose, of straight runs where it is a share below `most`
    runs = campaign.runs
    distance, away = runs.number("distance_m"), np.hypot(runs.number("ref_x_m"), runs.number("ref_y_m"))
    return np.where(_straight(campaign) & (np.abs(distance - away) < most * away), distance - away, np.nan)


def _shared_offsets(values: FloatArray, session: StrArray, allowed: float) -> Iterator[tuple[str, int, float, float]]:
    # where all runs, or a session's, are off alike: number, median and its standard error
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < _LEAST_STRAIGHT_RUNS:
        return
    for name, members in (("", known), *checks.runs_by_label(session[known])):
        offsets = values[known[members]] if name else values[known]
        if len(offsets) < LEAST_RUNS:
            continue
        median = float(np.median(offsets))
        error = 1.2533 * robust_spread(offsets) / math.sqrt(len(offsets))
        if abs(median) > max(allowed, _SIGMAS * error):
            yield f"in session {name}" if name else "in all sessions", len(offsets), median, error
            if not name:
                return


def _bows(campaign: Campaign) -> _Bows:
    # unequal radii leave the offset less half the heading times the distance, a wrong track scales it
    runs, logs = campaign.runs, campaign.logs
    theta = runs.number("ref_theta_rad")
    used = np.flatnonzero(_straight(campaign) & np.isfinite(theta) & (np.abs(theta) < 0.3) & (logs.lengths >= 20))
    if len(used) < _LEAST_STRAIGHT_RUNS or not {"counts_left", "counts_right"} <= set(logs.columns):
        used = used[:0]
    used = used[evenly(len(used), _MOST_STRAIGHT_RUNS)]
    sensor = campaign.reference
    # offset of the vehicle, from the sensor's pose relative to its start
    along, aside = runs.number("ref_x_m"), runs.number("ref_y_m")
    offset = np.sin(sensor.sensor_yaw_rad) * along + np.cos(sensor.sensor_yaw_rad) * aside
    offset -= sensor.sensor_x_m * np.sin(theta) + sensor.sensor_y_m * (np.cos(theta) - 1.0)
    distance = runs.number("distance_m")
    counted = np.array([_bow(campaign, int(run), float(distance[run]), float(theta[run])) for run in used])
    known = np.isfinite(counted)
    known &= known.sum() >= _LEAST_STRAIGHT_RUNS
    used = used[known]
    return used, offset[used], (0.5 * distance * theta)[used], counted[known]


def _bow(campaign: Campaign, run: int, distance_m: float, turned_rad: float) -> float:
    log = campaign.logs.of(run)
    left, right = (rolled_m(campaign, side, log[f"counts_{side}"] - log[f"counts_{side}"][0]) for side in checks.SIDES)
    along = (left + right) / 2
    if not np.isfinite(along).all() or along[-1] <= 0.0:
        return math.nan
    scale = distance_m / along[-1]
    heading = scale * (right - left) / campaign.vehicle.track_m
    # turned as the reference has it: of unequal radii, however far off, nothing is left
    heading += (turned_rad - heading[-1]) * along / along[-1]
    return float(scale * np.diff(along) @ np.sin((heading[1:] + heading[:-1]) / 2) - 0.5 * distance_m * turned_rad)


def mirrored_ends(campaign: Campaign) -> Iterator[Note]:
    """Find end poses whose y has the wrong sign."""
    runs, offset, turned, counted = _bows(campaign)
    if not len(runs):
        return
    _, error = _slope(counted, offset - turned)
    mirrored, mirrored_error = _slope(counted, -offset - turned)
    if mirrored_error < _CLEARER * error and abs(mirrored - 1.0) < max(0.1, _SIGMAS * mirrored_error):
        text = f"""the ends of {len(offset)} straight runs lie to a side that neither their headings nor their counts
            say; expected y positive to the left; check the sign of ref_y_m"""
        yield column_note("ref_y_m", text, "mirrored_ends")


def track_against_bows(campaign: Campaign) -> Iterator[Note]:
    """Compare the bows of nearly straight runs by log and by reference."""
    runs, offset, turned, counted = _bows(campaign)
    if not len(runs):
        return
    # noise of what divides flattens a slope: the ratio lies between that over the counts and over the reference
    bowed = offset - turned
    ratio, error = _slope(counted, bowed)
    above = ratio > 1.0
    far, error = (ratio, error) if above else _slope(bowed, counted)
    if error > 0.1 * abs(far) or 0.0 <= far < 1.0 + max(_TRACK_TOLERANCE, _SIGMAS * error):
        return
    ratio, error = (far, error) if above else (1.0 / far, error / far**2)
    track = campaign.vehicle.track_m
    hint = f"is the track {track / ratio:.3g} m?" if 0.5 < ratio < 2.0 else "check track_m and the reference's frame"
    text = f"""{len(offset)} straight runs bow out {ratio:.3g} times as far as their counts say with a track of
        {track:g} m (standard error {error:.2g}); expected the same within {100 * _TRACK_TOLERANCE:g} %; {hint}"""
    yield checks.setting_note("vehicle.track_m", text, "track_against_bows")


def stated_uncertainties(campaign: Campaign) -> Iterator[Note]:
    """Compare the scatter of straight runs with the uncertainties stated."""
    excess, reference = _distance_excess_m(campaign, 0.05), campaign.reference
    sigma_m = math.hypot(campaign.rangefinder.sigma_m, reference.sigma_xy_m)
    for names, values, sigma, unit in (
        (("rangefinder.sigma_m", "reference.sigma_xy_m"), excess[np.isfinite(excess)], sigma_m, "m"),
        (("reference.sigma_theta_rad",), _frame_angles_rad(campaign)[1], reference.sigma_theta_rad, "rad"),
    ):
        if len(values) < _LEAST_STRAIGHT_RUNS or not all(checks.stated(campaign, name) for name in names):
            continue
        scatter = robust_spread(values)
        # headings scatter by an uneven floor, too
        understated = unit == "m" and _beyond_stated(values, sigma, scatter)
        if scatter < sigma / _OVERSTATED or understated:
            most = _UNDERSTATED if understated else _OVERSTATED
            text = f"""found {sigma:.2g} {unit} in all, while {len(values)} straight runs scatter by {scatter:.2g}
                {unit}; expected the same within {most:g} times; check the unit and the value"""
            yield checks.setting_note(" and ".join(names), text, "stated_uncertainties")


def _beyond_stated(values: FloatArray, sigma: float, scatter: float) -> bool:
    apart = values - np.median(values)
    squares = (apart[np.abs(apart) <= _OUTLIER_SPREADS * scatter] / sigma) ** 2
    excess = (squares.mean() - 1.0) / math.sqrt(2.0 / len(squares)) if len(squares) else 0.0
    return scatter > _UNDERSTATED * sigma and excess > _UNDERSTATED_SIGMAS


def bearing_of_ends(campaign: Campaign) -> Iterator[Note]:
    """Find straight runs that end off the direction of their start heading."""
    runs, turned = campaign.runs, checks.turned_rad(campaign)
    x, y, distance = (runs.number(name) for name in ("ref_x_m", "ref_y_m", "distance_m"))
    away = np.hypot(x, y)
    straight = ~runs.excluded & (distance > 1.0) & (np.abs(turned) < _MOST_BEARING_RAD)
    straight &= np.abs(away - distance) < 0.1 * distance
    if straight.sum() < _LEAST_STRAIGHT_RUNS or campaign.reference.frame == "map":
        return
    bearing = float(np.median((np.arctan2(y, x) - 0.5 * turned)[straight]))
    if abs(bearing) > _MOST_BEARING_RAD:
        text = f"""{int(straight.sum())} straight runs end {bearing:+.3g} rad off their start heading (median); expected
            within {_MOST_BEARING_RAD:g} rad, each run in the frame of its own start pose; are x and y exchanged, or is
            the frame turned, or one for all runs (frame = "map")?"""
        yield column_note("ref_x_m, ref_y_m", text, "bearing_of_ends")


def turned_frame(campaign: Campaign) -> Iterator[Note]:
    """Compare the headings of straight runs with where they end."""
    runs, angle = _frame_angles_rad(campaign)
    for where, n_runs, median, error in _shared_offsets(angle, campaign.runs.label("session")[runs], _LEAST_ANGLE_RAD):
        text = f"""the ends of {n_runs} straight runs {where} lie {abs(median):.3g} rad further to the
            {"left" if median > 0 else "right"} than their headings say (standard error {error:.2g} rad); expected the
            same; is the frame of the reference turned, or its heading off (sensor_yaw_rad)?"""
        yield column_note("ref_theta_rad, ref_y_m", text, "turned_frame")


def _frame_angles_rad(campaign: Campaign) -> tuple[IntArray, FloatArray]:
    runs, offset, turned, counted = _bows(campaign)
    return runs, 2.0 * (offset - turned - counted) / campaign.runs.number("distance_m")[runs]


def _straight(campaign: Campaign) -> BoolArray:
    runs = campaign.runs
    x, y, distance = (runs.number(name) for name in ("ref_x_m", "ref_y_m", "distance_m"))
    own_frame = campaign.reference.frame != "map"
    return own_frame & ~runs.excluded & (distance > 1.0) & (x > 0.5 * distance) & (np.abs(y) < 0.05 * x)


def _slope(counted: FloatArray, measured: FloatArray) -> tuple[float, float]:
    used = np.ones(len(counted), dtype=bool)
    for _ in range(2):
        square = max(float(counted[used] @ counted[used]), 1e-300)
        slope = float(counted[used] @ measured[used]) / square
        residual = measured - slope * counted
        near = np.abs(residual) <= _OUTLIER_SPREADS * max(robust_spread(residual), 1e-12)
        used = near if near.sum() >= _LEAST_STRAIGHT_RUNS else used
    square = max(float(counted[used] @ counted[used]), 1e-300)
    return slope, math.sqrt(float(residual[used] @ residual[used]) / (used.sum() - 1) / square)


def gyro_against_reference(campaign: Campaign) -> Iterator[Note]:
    """Compare the turns by gyro and by reference."""
    runs = campaign.runs
    turn, heading = runs.number("gyro_theta_rad"), runs.number("ref_theta_rad")
    both = ~runs.excluded & np.isfinite(heading) & (np.abs(turn) > _LEAST_GYRO_TURN_RAD)
    if both.sum() < _LEAST_STRAIGHT_RUNS or campaign.reference.frame == "map":
        return
    # headings may be wrapped, turns are not
    apart = (turn - heading + np.pi)[both] % (2.0 * np.pi) - np.pi
    scale, error = _slope(turn[both] - apart, apart)
    if abs(scale) > _SIGMAS * error:
        text = f"""{int(both.sum())} runs turn by {100 * abs(scale):.2g} % {"more" if scale > 0 else "less"} by the gyro
            than by the reference (standard error {100 * error:.1g} %); expected the same; correct the gyro's scale
            where the vehicle navigates by it"""
        yield column_note("gyro_theta_rad", text, "gyro_against_reference")


def implausible_poses(campaign: Campaign) -> Iterator[Note]:
    """Yield end poses and headings in another unit."""
    campaign = checks.on_axle(campaign)
    runs, own_frame = campaign.runs, campaign.reference.frame != "map"
    theta, measured = (runs.number(name) for name in ("ref_theta_rad", "distance_m"))
    x, y = _ends_m(campaign)
    rolled = np.abs(rolled_m(campaign, "left") + rolled_m(campaign, "right")) / 2
    distance = np.where(np.isfinite(measured), measured, rolled)
    away = np.hypot(x, y)
    good = np.isfinite(away) & np.isfinite(distance) & (distance > 0)
    if good.sum() >= LEAST_RUNS:
        far = good & (away > 3 * distance + 1)
        beyond = good & (away > 1.1 * distance + 0.5)
        straight = good & np.isfinite(measured) & (np.abs(y) < 0.2 * np.abs(x))
        ratio = float(np.median(away[straight] / distance[straight])) if straight.sum() >= LEAST_RUNS else 1.0
        expected = "the distance"
        if far.sum() > max(checks.MOST_OF_THE_RUNS * beyond.sum(), LEAST_RUNS - 1):
            ratio, expected = float(np.median(away[far] / distance[far])), "the distance at most"
        if implausible_ratio(ratio):
            hint = position_unit_hint(1e3 if ratio > 300 else ratio, "check their unit and frame")
            text = f"the end poses lie {ratio:.3g} times as far away as was driven; expected {expected}; {hint}"
            yield implausible_column("ref_x_m, ref_y_m", text)
        straight &= np.isfinite(theta) & (np.abs(y) < 0.05 * np.abs(x)) & (away > 0.5 * distance)
        askew = float(np.median(np.abs(theta[straight]))) if straight.sum() >= LEAST_RUNS else 0.0
        if askew > 0.15 and own_frame:
            text = f"""straight runs that end on their line are turned by {askew:.3g} rad (median); expected below 0.15;
                are the headings in degrees?"""
            yield implausible_column("ref_theta_rad", text)
    yield from _headings(campaign, distance)
    yield from _logged_headings(campaign)


def _ends_m(campaign: Campaign) -> tuple[FloatArray, FloatArray]:
    x, y = campaign.runs.number("ref_x_m"), campaign.runs.number("ref_y_m")
    if campaign.reference.frame != "map":
        return x, y
    end = np.full(len(x), complex(math.nan, math.nan))
    for run, log in campaign.logs.each(2, *REFERENCE_POSE):
        pose = np.array([log[name] for name in REFERENCE_POSE])
        start_x, start_y, heading = pose[:, np.argmax(np.isfinite(pose).all(axis=0))]
        end[run] = complex(x[run] - start_x, y[run] - start_y) * np.exp(-1j * heading)
    return end.real, end.imag


def _headings(campaign: Campaign, distance: FloatArray) -> Iterator[Note]:
    columns = checks.wheel_columns(campaign)
    steered = "steer_rad" in columns
    # unequal wheels turn in proportion to the distance: a nuisance column
    theta, turned = checks.reference_turns(campaign)[0], checks.turned_rad(campaign)
    good = np.isfinite(theta) & np.isfinite(turned) & np.isfinite(distance)
    if good.sum() < 2 * LEAST_RUNS:
        return
    if (np.abs(turned[good]) >= 1.0).sum() >= LEAST_RUNS:
        ratio, std, _ = checks.partial_slope(theta[good], turned[good], distance[good, None])
        if std > 0.1 * abs(ratio) or 0.5 <= ratio <= 2.0:
            return
        if not -2.0 <= ratio <= -0.5:
            degrees = abs(abs(ratio) * math.pi / 180 - 1) < 0.3
            length = "wheelbase_m" if steered else "track_m"
            hint = "are they in degrees?" if degrees else f"check {length}, counts_per_rev and the heading's unit"
            text = f"the headings are {ratio:.3g} times those of the counts; expected the same within 2 times; {hint}"
            yield implausible_column("ref_theta_rad", text)
            return
    elif campaign.reference.frame != "map":
        loads = [campaign.runs.number(f"load_{side}_N")[good] for side in checks.SIDES]
        by_load = [distance[good] * load for load in loads if np.isfinite(load).all()]
        nuisance = np.column_stack([distance[good], *by_load])
        ratio, std, _ = checks.partial_slope(theta[good], turned[good], nuisance)
        back, back_std, _ = checks.partial_slope(turned[good], theta[good], nuisance)
        if _OPPOSED_SIGMAS * back_std < back < 1.5 * math.pi / 180.0:
            text = f"""the counts turn {back:.3g} times as far as the headings; are these in degrees? Name the column
                ref_theta_deg"""
            yield implausible_column("ref_theta_rad", text)
            return
        if not ratio < min(_OPPOSED_RATIO, -_OPPOSED_SIGMAS * std):
            return
    else:
        return
    swapped = "do counts fall driving ahead, is steer_rad" if steered else "are the wheels' counts swapped,"
    text = f"""the headings turn against the counts ({ratio:.3g} times); expected the same sense; {swapped} or is
        ref_theta_rad positive to the right?"""
    yield implausible_column(columns, text)


def _logged_headings(campaign: Campaign) -> Iterator[Note]:
    ratios = []
    columns = ("counts_left", "counts_right", "ref_theta_rad")
    for _, log in campaign.logs.each(2, *columns):
        known = np.isfinite(log["ref_theta_rad"])
        left, right, heading = (log[name][known] for name in columns)
        turned = np.diff(checks.turned_rad(campaign, left, right))
        fast = np.abs(turned) > 0.5 * np.nanmax(np.abs(turned), initial=0.0)
        if np.nansum(np.abs(turned)) >= 1.0:
            ratios.append(float(np.nanmedian(np.diff(heading)[fast] / turned[fast])))
    if len(ratios) >= LEAST_RUNS and abs(abs(ratio := float(np.median(ratios))) * math.pi / 180 - 1) < 0.3:
        text = f"headings along the path turn {ratio:.3g} times as far as the counts; are they in degrees?"
        yield implausible_column("ref_theta_rad", text, of="logs")
