"""Errors that no single cell shows: counts per revolution, clocks, senses, late logs, copied or rounded values."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from calib.campaign import checks
from calib.campaign.checks import LEAST_RUNS, SIDES, column_note, listed, raw_radius_ratio, setting_note, stated
from calib.campaign.model import Campaign, Note
from calib.campaign.read import CLOSED, log_totals
from calib.campaign.settings import WHEEL_LOADS
from calib.campaign.wheels import SOURCE_NAMES, STEERED, odometry_source, without_rear_wheels
from calib.types import BoolArray, FloatArray, IntArray, few_digits

#: relative departure of both radii from nominal beyond wear (1 %), and that of another wheel
FAR_FROM_NOMINAL: Final = 0.012
MOST_FAR: Final = 0.05
UNLIKE_LOADS: Final = 0.1  #: share of their sum by which loads of wheels not compared differ
#: factor by which a log's clock is too fast -> the unit of its times
CLOCK_FACTORS: Final = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
SPEED_FACTOR: Final = 30.0  #: a campaign's runs are within this factor of the usual speed
#: largest share of runs reported one by one; more have a common cause
MOST_ODD: Final = 0.2
#: factor between distance and counts that means another run or unit
ODD_RATIO: Final = 1.3
#: steps of values: coarse from so many standard uncertainties, multiples to this share
COARSE, STEP_ERROR = 3.0, 0.02
REPEATED_VALUES, MOST_REPEATED = 8, 0.8  #: number and share that show rounding by themselves
MOST_VALUES: Final = 10_000  #: values examined
_SAME_LOADS: Final = float(np.log(2.0))  #: logarithm of the factor within which loads of log and run table agree
MOST_SCATTER_COUNTS: Final = 1.0  #: within which the counts missing in the logs are the same in every run


def counts_per_revolution(campaign: Campaign) -> Iterator[Note]:
    """Find counts per revolution one off a round number, and radii off alike."""
    for side in SIDES if stated(campaign, "encoder.counts_per_rev") else ():
        value = campaign.encoder.per_rev(side)
        near = [value + step for step in (-1.0, 1.0) if _is_round(value + step)]
        if near and not _is_round(value):
            text = f"found {value:.10g}, one off {near[0]:.10g}; encoders have a round number of counts; check it"
            yield setting_note(f"encoder, counts_per_rev_{side}", text, "counts_per_rev")
    if not stated(campaign, "vehicle.wheel_radius_m"):
        return
    ratios = np.stack([raw_radius_ratio(campaign, side) for side in SIDES])
    if np.isfinite(ratios).sum(axis=1).min() < LEAST_RUNS:
        return
    over_model = np.stack([_over_model(campaign, side) for side in SIDES])
    for whose, radii in (("nominal one", ratios), ("model's", ratios * over_model)):
        left, right = np.nanmedian(radii, axis=1) - 1.0
        if left * right > 0.0 and FAR_FROM_NOMINAL < min(abs(left), abs(right)) < MOST_FAR:
            text = f"""both wheels roll as if their radii were {100 * left:+.2g} % and {100 * right:+.2g} % off the
                {whose}; expected within {100 * FAR_FROM_NOMINAL:.2g} %; check counts_per_rev, a gear ratio, and the
                nominal radius"""
            yield setting_note("encoder and vehicle", text, "count_scale" if radii is ratios else "counts_per_rev")
            return
    left_N, right_N = checks.both_sides(campaign, "load_{}_N")
    level = np.isfinite(ratios).all(axis=0) & ~(np.abs(left_N - right_N) > UNLIKE_LOADS * (left_N + right_N))
    if level.sum() < LEAST_RUNS:
        return
    excess = [float(np.median((left / right)[level])) - 1.0 for left, right in (ratios, ratios * over_model)]
    if min(map(abs, excess)) > FAR_FROM_NOMINAL:
        text = f"""the left wheel rolls as if its radius were {100 * excess[0]:+.2g} % off the right one's; expected
            {100 * FAR_FROM_NOMINAL:.2g} % at most; check counts_per_rev of each, and whether an encoder loses counts"""
        yield setting_note("encoder and vehicle", text, "unlike_wheels")


def _over_model(campaign: Campaign, side: str) -> FloatArray:
    model, load = campaign.model, campaign.runs.number(f"load_{side}_N")
    slope, radius = getattr(model, f"slope_{side}_m_per_N"), getattr(model, f"radius_{side}_m")
    changes = slope * np.nan_to_num(load - model.reference_load_N)
    return np.asarray(campaign.vehicle.wheel_radius_m / np.maximum(radius + changes, 0.1 * radius))


def _is_round(counts: float) -> bool:
    whole = round(counts)
    return abs(counts - whole) < 1e-9 and whole > 0 and (whole & (whole - 1) == 0 or whole % 100 == 0)


def log_clock(campaign: Campaign) -> Iterator[Note]:
    """Find logs whose times are in other units than the others'."""
    logs = campaign.logs
    name = next((column for column in logs.columns if column.startswith("counts_")), None)
    duration_s = log_totals(logs, "t_s")
    present = logs.present & (duration_s > 0.0)
    if name is None or present.sum() < LEAST_RUNS:
        return
    distance = np.concatenate(([0.0], np.nancumsum(np.abs(np.diff(logs.columns[name])))))
    ends, starts = np.maximum(logs.offsets[1:] - 1, 0), np.minimum(logs.offsets[:-1], len(distance) - 1)
    speeds = np.where(present, distance[ends] - distance[starts], np.nan) / duration_s
    usual, usual_s = float(np.median(speeds[present])), float(np.median(duration_s[present]))
    for factor, unit in CLOCK_FACTORS.items() if usual > 0.0 else ():
        # of a vehicle that mostly stands it is slow, not long
        long = duration_s > usual_s * factor / SPEED_FACTOR
        log_ratio = np.abs(np.log(np.maximum(speeds, 1e-300) * factor / usual))
        if len(slow := np.flatnonzero(long & (log_ratio < np.log(SPEED_FACTOR)))):
            text = f"""in {len(slow)} logs ({listed(campaign.runs.run_id[slow], 5)}) the wheels turn {factor:.0e} times
                slower than in the others: t_s looks like {unit}; name the column t_ms, t_us or t_ns there"""
            yield column_note("t_s", text, "clock_unit", of="logs")


def odd_lengths(campaign: Campaign) -> Iterator[Note]:
    """Find distances far from what the wheels rolled, and logs whose time does not rise."""
    ratio = 0.5 * (raw_radius_ratio(campaign, SIDES[0]) + raw_radius_ratio(campaign, SIDES[1]))
    if np.isfinite(ratio).sum() >= LEAST_RUNS and not stated(campaign, "vehicle.wheel_radius_m"):
        ratio = ratio / float(np.nanmedian(ratio))
        for run in np.flatnonzero((ratio > ODD_RATIO) | (ratio < 1.0 / ODD_RATIO)):
            text = f"the distance is {ratio[run]:.3g} times what the wheels rolled; check it, or exclude the run"
            yield checks.cell_note(campaign, int(run), "distance_m", text, "odd_distance")
    logs = campaign.logs
    fell = np.flatnonzero(np.diff(logs.columns.get("t_s", np.zeros(0))) < 0.0) + 1
    runs = np.unique(np.searchsorted(logs.offsets, np.setdiff1d(fell, logs.offsets), side="right") - 1)
    if len(runs):
        text = f"time runs backwards in {len(runs)} logs ({listed(campaign.runs.run_id[runs], 5)})"
        yield column_note("t_s", text, "clock", of="logs")


#: ending of a kind's name -> sense of its turns
_SENSE_OF_KIND: Final = {"ccw": 1.0, "left": 1.0, "cw": -1.0, "right": -1.0}


def turns_of_kinds(campaign: Campaign) -> Iterator[Note]:
    """Compare the sense of turning by counts with the kind's name, without a reference."""
    turned, measured = checks.turned_rad(campaign), checks.reference_turns(campaign)[0]
    kinds = campaign.runs.label("kind").tolist()
    sense = np.array([_SENSE_OF_KIND.get(kind.rpartition("_")[2], 0.0) for kind in kinds])
    # the reference of a closed loop says nothing of the sense
    measured = np.where(campaign.runs.label("loop") == CLOSED, np.nan, measured)
    clear = np.isnan(measured) & np.isnan(checks.logged_turns(campaign)) & (sense != 0.0) & (np.abs(turned) > 1.0)
    if (against := clear & (sense * turned < 0.0)).any():
        which = f"{int(against.sum())} of {int(clear.sum())} runs ({listed(campaign.runs.run_id[against])})"
        text = f"in {which} the counts turn otherwise than the kind says; are left and right swapped?"
        yield column_note("counts_left, counts_right, kind", text, "swapped_wheels")


def heading_turns(campaign: Campaign) -> Iterator[Note]:
    """Find end headings of a few runs a whole turn off the wheels'."""
    turns = checks.reference_turns(campaign)[1]
    odd = np.isfinite(turns) & (turns != 0.0)
    few = odd.sum() <= MOST_ODD * np.isfinite(turns).sum()
    for _, runs in checks.runs_by_label(campaign.runs.label("session")) if few else ():
        for run in runs[odd[runs]] if np.isinf(turns[runs]).mean() <= MOST_ODD else ():
            text = f"the heading is {turns[run]:+.0f} turn(s) off what the wheels say"
            text = f"{text}; correct the cell, or omit a run that lost counts"
            yield checks.cell_note(campaign, int(run), "ref_theta_rad", text, "heading_turn")


#: factors on the turns by left wheel, right wheel and reference, and what they correct
Senses = tuple[tuple[float, float, float, str], ...]
_SENSES: Final[Senses] = (
    (1.0, 1.0, 1.0, ""),
    (-1.0, 1.0, 1.0, "the left wheel counts backwards; negate counts_left"),
    (1.0, -1.0, 1.0, "the right wheel counts backwards; negate counts_right"),
    (1.0, 1.0, np.pi / 180.0, "the headings are in degrees; name the column ref_theta_deg"),
)
_STEERED_SENSES: Final[Senses] = (
    _SENSES[0],
    (1.0, 1.0, -1.0, "steer_rad or ref_theta_rad is positive to the right; negate it, or the counts, if they fall"),
    _SENSES[-1],
)
#: largest steering angle, and share of samples that may exceed it by faults of the sensor
_MOST_STEERED_RAD, _SINGLE_SAMPLES = 2.0 * np.pi, 0.01
#: largest steering angle of a car
_MOST_CAR_RAD: Final = 1.0
#: difference of headings and counts that is a finding, and the share that may remain
_MIN_DIFFERENCE_RAD, _CORRECTED_SHARE = 1.0, 0.1
#: what remains of a single run: by noise, and as a share of its turn
_SINGLE_RAD, _SINGLE_SHARE = 0.05, 0.06


def implausible_senses(campaign: Campaign) -> Iterator[Note]:
    """Yield wheels that count backwards and headings in degrees, of all runs or a session, by their turns."""
    steered = odometry_source(campaign) in STEERED
    angle_rad = np.abs(campaign.logs.columns.get("steer_rad", np.zeros(0)) if steered else np.zeros(0))
    if (beyond := angle_rad > _MOST_STEERED_RAD).sum() > _SINGLE_SAMPLES * len(beyond):
        text = f"""found {np.nanmax(angle_rad):.3g} rad, and {beyond.sum()} samples beyond a whole turn; expected less;
            are they in degrees (name the column steer_deg), or of the steering wheel?"""
        yield checks.implausible_column("steer_rad", text, of="logs")
        return
    if campaign.vehicle.drive == "ackermann" and len(angle_rad) and (half := np.nanmedian(angle_rad)) > _MOST_CAR_RAD:
        text = f"found {half:.3g} rad and more in half of all samples; expected less of a car; is it 0 straight ahead?"
        yield checks.implausible_column("steer_rad", text, of="logs")
        return
    campaign = checks.on_axle(campaign)
    senses = _STEERED_SENSES if steered else _SENSES
    known, difference, _ = _disagreement_rad(campaign, senses)
    for where, runs in (("all runs", np.arange(len(known))), *checks.runs_by_label(campaign.runs.label("session"))):
        runs = runs[known[runs]]
        words = _correction(np.median(difference[:, runs], axis=1), senses) if len(runs) >= LEAST_RUNS else ""
        if words:
            text = f"in {where} counts and headings are {words}"
            yield checks.implausible_column(f"{checks.wheel_columns(campaign)}, ref_theta_rad", text)
            if where == "all runs":
                return


def odd_runs(campaign: Campaign) -> Iterator[Note]:
    """Find single runs of another sense or unit: by headings, or ends farther away than driven."""
    campaign = checks.on_axle(campaign)
    senses = _STEERED_SENSES if odometry_source(campaign) in STEERED else _SENSES
    known, difference, turned = _disagreement_rad(campaign, senses)
    factor = np.array([of_reference for *_, of_reference, _ in senses])[difference.argmin(axis=0)]
    near = np.flatnonzero(known & (difference.min(axis=0) < _SINGLE_RAD + _SINGLE_SHARE * np.abs(factor * turned)))
    corrections = {run: words for run in near.tolist() if (words := _correction(difference[:, run], senses))}
    for run, words in corrections.items() if len(corrections) <= MOST_ODD * known.sum() else ():
        text = f"counts and heading are {words.partition(';')[0]}; correct the row"
        yield checks.cell_note(campaign, run, f"{checks.wheel_columns(campaign)}, ref_theta_rad", text, "odd_run")
    rolled = np.mean([np.abs(checks.rolled_m(campaign, side)) for side in SIDES], axis=0)
    away = np.hypot(campaign.runs.number("ref_x_m"), campaign.runs.number("ref_y_m"))
    # less may come from wheels 50 % larger and a sensor on the vehicle's edge
    far = np.flatnonzero((away > 1.5 * rolled + 1.0) & (campaign.reference.frame != "map"))
    for run in far.tolist() if len(far) <= MOST_ODD * np.isfinite(away + rolled).sum() else ():
        text = f"""the run ends {few_digits(away[run])} m away after {few_digits(rolled[run])} m driven; is it in
            another unit, or another run's?"""
        yield checks.cell_note(campaign, run, "ref_x_m, ref_y_m", text, "odd_run")


def _disagreement_rad(campaign: Campaign, senses: Senses) -> tuple[BoolArray, FloatArray, FloatArray]:
    # turns (n_runs,); difference of headings and counts by sense (n_senses, n_runs)
    turned = checks.reference_turns(campaign)[0]
    left, right = (checks.rolled_m(campaign, side) / campaign.vehicle.track_m for side in SIDES)
    differences = []
    for by_left, by_right, by, _ in senses:
        difference = np.abs(by * turned - by_right * right + by_left * left)
        # only a wheel that counts backwards is negated; wheels that hardly turn fit any unit
        excluded = (left * right < 0) & (by_left * left < 0) & (by_right * right < 0)
        excluded |= (abs(by) < 1.0) & (np.abs(by * turned - right + left) > _CORRECTED_SHARE * np.abs(right - left))
        differences.append(np.where(excluded, np.inf, difference))
    return np.isfinite(turned + left + right), np.array(differences), turned


def _correction(difference_rad: FloatArray, senses: Senses) -> str:
    best = int(np.argmin(difference_rad))
    if difference_rad[0] <= _MIN_DIFFERENCE_RAD or difference_rad[best] >= _CORRECTED_SHARE * difference_rad[0]:
        return ""
    return f"{difference_rad[0]:.3g} rad apart, or {difference_rad[best]:.2g} if {senses[best][-1]}"


def unused_slopes(campaign: Campaign) -> Iterator[Note]:
    """Find load laws of the rear wheels where the odometry counts another."""
    source, model = odometry_source(campaign), campaign.model
    slopes = model.slope_left_m_per_N, model.slope_right_m_per_N
    if any(slopes) and source == "front" and without_rear_wheels(campaign):
        text = f"""found slopes of the radius against load, and an odometry by {SOURCE_NAMES[source]}, whose
            load is not theirs; they are not applied"""
        yield setting_note("model.slope_left_m_per_N, slope_right_m_per_N", text, "unused_slopes")


def pose_resolution(campaign: Campaign) -> Iterator[Note]:
    """Find positions in steps coarser than the reference."""
    for where, columns in (("runs", campaign.runs.numbers), ("logs", campaign.logs.columns)):
        for name in ("ref_x_m", "ref_y_m"):
            if step_m := _coarse_step(columns.get(name, np.zeros(0)), campaign.reference.sigma_xy_m):
                text = f"""the positions come in steps of {1e3 * step_m:.3g} mm, far above the stated sigma_xy_m; single
                    precision far from the origin does this: subtract the origin before the file is written"""
                yield column_note(name, text, "pose_resolution", of=where)


def rounded_values(campaign: Campaign) -> Iterator[Note]:
    """Find distances, headings and counts in steps far above their uncertainty."""
    sigma_m = campaign.rangefinder.sigma_m
    resolutions = {"distance_m": sigma_m, "ref_theta_rad": campaign.reference.sigma_theta_rad}
    resolutions |= {f"counts_{side}": sigma_m / float(checks.rolled_m(campaign, side, np.ones(1))[0]) for side in SIDES}
    driven = campaign.runs.label("loop") != CLOSED
    for name, resolution in resolutions.items():
        if step := _coarse_step(campaign.runs.number(name)[driven], resolution):
            text = f"""the values come in steps of {step:.4g}; expected steps below {COARSE * resolution:.2g},
                {COARSE:g} standard uncertainties; are they rounded, or nominal?"""
            yield column_note(name, text, "rounded_values")


def _coarse_step(values: FloatArray, resolution: float) -> float | None:
    distinct, times = np.unique(values[np.isfinite(values)][:MOST_VALUES], return_counts=True)
    steps = np.diff(distinct)
    repeated = len(steps) > 0 and int(times[times > 1].sum()) >= max(REPEATED_VALUES, MOST_REPEATED * times.sum())
    if not (len(steps) >= LEAST_RUNS or repeated) or not steps.min() > COARSE * resolution:
        return None
    multiples = steps / steps.min()
    return float(steps.min()) if np.abs(multiples - np.round(multiples)).max() < STEP_ERROR else None


#: least scatter of a measured distance about the counts', in standard uncertainties
_COPIED: Final = 0.25


def copied_distances(campaign: Campaign) -> Iterator[Note]:
    """Find distances that were computed from the wheels' counts, as an odometer's."""
    distance, radii = campaign.runs.number("distance_m"), [raw_radius_ratio(campaign, side) for side in SIDES]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(campaign.runs.label("loop") != CLOSED, 2.0 / (1.0 / radii[0] + 1.0 / radii[1]), np.nan)
    known = np.isfinite(ratio)
    # simulated distances may have no noise
    if known.sum() < 2 * LEAST_RUNS or campaign.simulated:
        return
    usual = float(np.mean(ratio[known]))
    scatter_m = float(np.std(distance[known] * (ratio[known] / usual - 1.0)))
    if scatter_m < _COPIED * (sigma_m := campaign.rangefinder.sigma_m):
        text = f"""the distances are what the wheels rolled to within {1e3 * scatter_m:.2g} mm, at any load; expected
            scatter of {1e3 * sigma_m:.2g} mm; an odometer says nothing of the radii: give those of the rangefinder"""
        yield column_note("distance_m", text, "copied_distance")


def shifted_sessions(campaign: Campaign) -> Iterator[Note]:
    """Find session labels that are a row off."""
    session = np.unique(campaign.runs.label("session"), return_inverse=True)[1]
    conditions = {"load": checks.load_label(campaign), "temperature_C": campaign.runs.number("temperature_C")}
    for name, values in conditions.items():
        group = np.unique(values, return_inverse=True)[1]
        if len(np.unique(session)) < 2 or len(np.unique(group)) < 2 or _constant_within(session, group):
            continue
        for by, moved, inner in ((-1, session[1:], group[:-1]), (1, session[:-1], group[1:])):
            if _constant_within(moved, inner):
                text = f"""each session has one {name} if its labels move by one row {"up" if by == -1 else "down"}, and
                    as they stand it has not; are the labels a row off?"""
                yield column_note("session", text, "shifted_sessions")
                return


def _constant_within(session: IntArray, group: IntArray) -> bool:
    pairs = np.unique(np.stack([session, group]), axis=1).shape[1]
    return bool(pairs == len(np.unique(session)) <= len(session) / 2)


def late_logs(campaign: Campaign) -> Iterator[Note]:
    """Find logs that begin after the vehicle moved."""
    for side in SIDES:
        difference = campaign.runs.number(f"counts_{side}") - log_totals(campaign.logs, f"counts_{side}")
        known = difference[np.isfinite(difference)]
        usual = float(np.median(known)) if len(known) >= LEAST_RUNS else 0.0
        if abs(usual) > MOST_SCATTER_COUNTS and np.mean(np.abs(known - usual) <= MOST_SCATTER_COUNTS) > 0.9:
            text = f"""the table counts {usual:+.0f} against the logs in every run: the logs begin or end at another
                place than the distance; let the log begin before the vehicle moves"""
            yield column_note(f"counts_{side}", text, "late_logs")


def logged_loads(campaign: Campaign) -> Iterator[Note]:
    """Find logged wheel loads in another unit than the run table's, that stop, or of one wheel alone."""
    known, n_logs = np.zeros((2, len(campaign.runs)), dtype=np.bool_), int(campaign.logs.present.sum())
    for wheel, name in enumerate(WHEEL_LOADS):
        table, gaps = campaign.runs.number(name), []
        ratio = np.full(len(table), np.nan)
        for run, log in campaign.logs.each(2, name):
            known[wheel, run], at = True, np.flatnonzero(np.isfinite(log[name]))
            low, high = np.nanmin(log[name]), np.nanmax(log[name])
            # logged from the start, it is the run table's
            if at[0] == 0 and min(table[run], low) > 0.0:
                ratio[run] = np.clip(table[run], low, high) / table[run]
            # gaps in loads of every sample alone
            if len(at) < len(log[name]) and len(at) >= LEAST_RUNS and np.median(np.diff(at)) == 1.0:
                gaps.append(run)
        if len(off := np.flatnonzero(np.abs(np.log(ratio)) > _SAME_LOADS)):
            usual = float(np.median(ratio[off]))
            unit = checks.meaning(usual, checks.LOAD_UNITS, 0.25)
            hint = f"are they in {unit}?" if unit else "check the unit, and that log and run belong together"
            text = f"""in {len(off)} log(s) ({listed(campaign.runs.run_id[off])}) the load is {usual:.3g} times the run
                table's; expected the same within a factor of 2; {hint}"""
            level = "wrong" if len(off) > checks.MOST_OF_THE_RUNS * n_logs else "suspicious"
            yield column_note(name, text, "load_unit", level, of="logs")
        if gaps:
            text = f"""{len(gaps)} log(s) lack the load in some samples ({listed(campaign.runs.run_id[gaps])}), where
                the last one is taken to hold; did the load cell fail?"""
            yield column_note(name, text, "missing_load", of="logs")
    for name, lacking in zip(WHEEL_LOADS, (known[1] & ~known[0], known[0] & ~known[1]), strict=True):
        if lacking.any():
            text = f"""{int(lacking.sum())} log(s) have the load of the other wheel alone
                ({listed(campaign.runs.run_id[lacking])}), beside which that of the run table holds all the way; log
                both"""
            yield column_note(name, text, "missing_load", of="logs")


_OUTLIER_SPREADS: Final = 6.0  #: of outliers from the line over load


def far_from_line(campaign: Campaign) -> Iterator[Note]:
    """Find runs whose radius lies far from the line over load of the runs of their kind."""
    for side in SIDES:
        ratio, load = np.abs(raw_radius_ratio(campaign, side)), campaign.runs.number(f"load_{side}_N")
        load = load if np.isfinite(load).any() else np.zeros(len(load))
        ratio = np.where(np.abs(ratio - 1) < 0.15, ratio, np.nan)
        away = np.full(len(ratio), np.nan)
        for _, of in checks.runs_by_label(campaign.runs.label("kind")):
            of = of[np.isfinite(ratio + load)[of]]
            if len(of) >= checks.MIN_LINE_RUNS:
                x = load[of] - load[of].mean()
                # leverage makes residuals smaller far from other loads
                away[of] = checks.line_residuals(x, ratio[of]) * np.sqrt(1.0 - x**2 / max(float(x @ x), 1e-300))
        # no less than the rangefinder's share, for exact data and short runs
        with np.errstate(divide="ignore"):
            noise = campaign.rangefinder.sigma_m / campaign.runs.number("distance_m")
        spread = np.maximum(checks.robust_spread(away) * 1.2, noise)
        for run in np.flatnonzero(np.abs(away) > _OUTLIER_SPREADS * spread):
            text = f"""the {side} radius lies {100 * away[run]:+.3f} % from the others' line by load,
                {abs(away[run]) / spread[run]:.0f} times their spread; look for slip, a wrong distance or load, or a law
                that bends"""
            yield checks.cell_note(campaign, run, f"distance_m, counts_{side}", text, "far_from_line")
