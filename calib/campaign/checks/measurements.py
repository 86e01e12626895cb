"""Distances and wheel loads: missing, in another unit, beyond limits, or unlike payload and vehicle."""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from calib.campaign import checks
from calib.campaign.checks import LEAST_RUNS, implausible_column
from calib.campaign.checks.settings import MOST_ODD
from calib.campaign.model import Campaign, Note
from calib.campaign.read import GYRO_TURN, loads_from_payload
from calib.campaign.settings import WHEEL_LOADS
from calib.campaign.wheels import counted_source, logged_columns
from calib.types import GRAVITY_MPS2, BoolArray, FloatArray
from calib.vehicle import Vehicle


def missing_values(campaign: Campaign) -> Iterator[Note]:
    """Say which runs lack counts, and which lack both a distance and an end pose."""
    runs = campaign.runs
    source = counted_source(campaign)
    needs_logs = source != "rear" or "ref_x_m" in campaign.logs.columns
    logged = [campaign.logs.of(run) if needs_logs else {} for run in range(len(runs))]
    for name in logged_columns(source):
        lacking = np.isnan(runs.number(name)) if source == "rear" else np.asarray([name not in log for log in logged])
        if lacking.any():
            what = "counts in table or log" if source == "rear" else f"{name} in their log"
            runs_lacking = checks.listed(runs.run_id[lacking])
            text = f"{int(lacking.sum())} run(s) have no {what} ({runs_lacking}); they cannot be used"
            level = "wrong" if lacking.all() else "suspicious"
            yield checks.column_note(name, text, "missing_counts", level, of="runs" if source == "rear" else "logs")
    trajectory = np.asarray(["ref_x_m" in log for log in logged])
    unmeasured = [np.isnan(runs.number(name)) for name in ("distance_m", "ref_x_m", "ref_theta_rad", GYRO_TURN)]
    if len(lacking := runs.run_id[np.all(unmeasured, axis=0) & ~trajectory]):
        text = f"""{len(lacking)} run(s) have neither a distance nor a reference pose
            ({checks.listed(lacking)}); nothing can be learnt from them. A reference on another clock needs lag_s in the
            mapping"""
        level = "wrong" if len(lacking) == len(runs) else "suspicious"
        yield checks.column_note("distance_m", text, "missing_distance", level)


def distance_span(campaign: Campaign) -> Iterator[Note]:
    """Find distances that a rangefinder cannot have measured."""
    distance = campaign.runs.number("distance_m")
    low, high = campaign.rangefinder.min_m, campaign.rangefinder.max_m
    ratio = checks.raw_radius_ratio(campaign, "left")
    for run in np.flatnonzero(distance <= 0):
        text = f"found {distance[run]:g} m; expected a positive distance; correct it or flag the run as excluded"
        yield checks.cell_note(campaign, run, "distance_m", text, "distance_span", "wrong")
    for run in np.flatnonzero((distance > 0) & ((distance < low) | (distance > high))):
        hint = "name the column distance_mm" if high < distance[run] <= 1e3 * high < 1e6 else ""
        hint = checks.meaning(ratio[run]) or hint or "check the cell, or give rangefinder.min_m and max_m"
        text = f"found {distance[run]:g} m; the rangefinder measures {low:g} to {high:g} m; {hint}"
        yield checks.cell_note(campaign, run, "distance_m", text, "distance_span")


def distance_against_log(campaign: Campaign) -> Iterator[Note]:
    """Compare the table's distance with the last range of the log."""
    distance = campaign.runs.number("distance_m")
    allowed = max(0.02, 8 * campaign.rangefinder.sigma_m)
    starts_m: dict[int, float] = {}
    for run, log in campaign.logs.each(2, "range_m"):
        known = log["range_m"][np.isfinite(log["range_m"])]
        if len(outside := known[(known < -0.5) | (known > campaign.rangefinder.max_m)]):
            text = f"{len(outside)} sample(s) lie outside the rangefinder's span, the first at {outside[0]:g} m"
            yield checks.cell_note(campaign, run, "log range_m", text, "distance_span")
        if min(abs(distance[run] - known[-1]), abs(distance[run] - (known[-1] - known[0]))) > allowed:
            text = f"found {distance[run]:.4f} m; the log ends at {known[-1]:.4f} m; the log may be cut"
            yield checks.cell_note(campaign, run, "distance_m", text, "distance_disagrees")
        elif abs(known[0]) > allowed and abs(distance[run] - known[-1]) <= allowed:
            starts_m[run] = float(known[0])
    if starts_m:
        text = f"""{len(starts_m)} log(s) begin at {min(starts_m.values()):.4g} to {max(starts_m.values()):.4g} m, by
            which their distances are too long ({checks.listed(campaign.runs.run_id[[*starts_m]])}); expected distances
            from the start: subtract the first reading (from_start = true in a mapping)"""
        yield implausible_column("range_m", text, of="logs")


#: factor between a measured radius, track or load and its nominal value
MOST_RATIO: Final = 4.0 / 3.0


def implausible_ratio(ratio: float) -> bool:
    """Return whether measured over nominal is beyond `MOST_RATIO` either way."""
    return not 1 / MOST_RATIO <= ratio <= MOST_RATIO


def factor_reason(ratio: float) -> str:
    """Return the unit or setting that a ratio of radii points to."""
    text = checks.meaning(ratio)
    return f"{text}?" if text else "check counts_per_rev, wheel_radius_m and the unit of the distance"


def odd_sessions(campaign: Campaign, ratio: FloatArray) -> Iterator[tuple[str, float]]:
    """Yield sessions of implausible median ratio beside all runs', (n_runs,), with the factor."""
    for name, runs in checks.runs_by_label(campaign.runs.label("session")):
        known = ratio[runs][ratio[runs] > 0.0]
        factor = float(np.median(known) / np.median(ratio[ratio > 0.0])) if len(known) >= LEAST_RUNS else 1.0
        if implausible_ratio(factor):
            yield name, factor


def implausible_distances(campaign: Campaign) -> Iterator[Note]:
    """Yield radii that no wheel has, and distances that do not fit their counts."""
    distance = campaign.runs.number("distance_m")
    counts = dict(zip(checks.SIDES, checks.both_sides(campaign, "counts_{}"), strict=True))
    for side, other in (checks.SIDES, checks.SIDES[::-1]):
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.abs(distance / checks.rolled_m(campaign, side))
        good = np.isfinite(ratio) & (ratio > 0)
        if good.sum() >= LEAST_RUNS:
            usual = float(np.median(ratio[good]))
            if implausible_ratio(usual) and checks.stated(campaign, "vehicle.wheel_radius_m"):
                text = f"the {side} wheel's radius comes out {usual:.2f} times nominal: {factor_reason(usual)}"
                yield implausible_column(f"counts_{side}", text)
            for name, factor in odd_sessions(campaign, np.where(good, ratio, np.nan)):
                text = f"""in session {name} the {side} wheel's radius comes out {factor:.3g} times that of most runs:
                    {factor_reason(factor)}"""
                yield implausible_column(f"counts_{side}", text)
            log_distance = np.log(np.abs(distance), where=good, out=distance * np.nan)
            yield from _scatter(np.log(ratio[good]), log_distance, good, side, campaign.runs.number(f"load_{side}_N"))
        both = np.isfinite(counts[side] + counts[other]) & (distance > 1)
        if both.sum() >= LEAST_RUNS and (counts[side][both] < 0).all() and (counts[other][both] > 0).all():
            text = f"the {side} wheel counts backwards in every straight run, the {other} one forwards"
            yield implausible_column(f"counts_{side}", f"{text}; negate the column")
    total = np.abs(counts["left"] + counts["right"])
    both = np.isfinite(distance) & np.isfinite(total) & (total > 0)
    if both.sum() > LEAST_RUNS and np.ptp(distance[both]) == 0 and np.ptp(total[both]) > 2e-3 * total[both].mean():
        text = f"""found {distance[both][0]:g} m in all {int(both.sum())} runs, while the counts differ by
            {100 * np.ptp(total[both]) / total[both].mean():.2g} %; expected the distance measured in each run; is it
            the nominal length of the corridor?"""
        yield implausible_column("distance_m", text)


def _scatter(
    log_radius: FloatArray, log_distance: FloatArray, good: BoolArray, side: str, load: FloatArray
) -> Iterator[Note]:
    spread = checks.robust_spread(checks.line_residuals(load[good], log_radius))
    if len(log_radius) < 3 or spread < 0.01:
        return
    for shift in (1, -1):
        moved = (np.roll(log_distance, shift) - log_distance)[good] + log_radius
        again = checks.robust_spread(checks.line_residuals(load[good], moved)[1:-1])
        if again < 0.2 * spread and np.isfinite(moved[1:-1]).sum() > 2:
            text = f"""the {side} wheel's radius scatters by {100 * spread:.2g} %, but by {100 * again:.2g} % with each
                distance one row on; expected distance and counts of the same run in a row; is the column shifted?"""
            yield implausible_column("distance_m", text)
            return
    if spread > 0.03:
        text = f"""the {side} wheel's radius scatters by {100 * spread:.2g} % from run to run; expected less than 3 %;
            do distances and counts belong to the same runs?"""
        yield implausible_column(f"distance_m, counts_{side}", text)


_LOADS: Final = ", ".join(WHEEL_LOADS)


def wheel_loads(campaign: Campaign) -> Iterator[Note]:
    """Find loads that no rolling wheel has, or beyond the permitted one."""
    loads, permitted = checks.both_sides(campaign, "load_{}_N"), campaign.vehicle.max_wheel_load_N
    if permitted == Vehicle().max_wheel_load_N and not checks.stated(campaign, "vehicle.mass_kg"):
        if (largest := float(np.nanmax(loads, initial=0.0))) > permitted:
            text = f"loads of up to {largest:.5g} N are more than the {permitted:g} N that nobody stated; give your own"
            yield checks.setting_note("vehicle.max_wheel_load_N", text, "excess_load")
        permitted = np.inf
    # no wheel carries more than the vehicle and its heaviest payload
    mass_kg = campaign.vehicle.mass_kg + np.max(campaign.runs.number("payload_kg"), initial=0.0)
    known = checks.stated(campaign, "vehicle.mass_kg") and np.isfinite(mass_kg)
    weight_N = _REAR_SHARE[1] * GRAVITY_MPS2 * mass_kg if known else np.inf
    for name, load in zip(WHEEL_LOADS, loads, strict=True):
        logged = f"log {name}", *checks.logged_range(campaign, name), min(permitted, weight_N)
        for column, least, most, limit in ((name, load, load, permitted), logged):
            for run in np.flatnonzero(least <= 0):
                text = f"found {least[run]:.4g} N; expected above 0, or the wheel lifts off; check payload and place"
                yield checks.cell_note(campaign, run, column, text, "impossible_load", "wrong")
            for run in np.flatnonzero(most > limit):
                what = "is permitted" if limit == permitted else "is the weight of vehicle and payload"
                text = f"found {most[run]:.5g} N; {limit:g} N {what}; check the unit (kg or kN in a column of N?)"
                yield checks.cell_note(campaign, run, column, text, "excess_load")
    if len(lacking := campaign.runs.run_id[np.isnan(loads.sum(axis=0))]):
        text = f"""{len(lacking)} run(s) have no wheel load and no payload with its place to compute it from
            ({checks.listed(lacking)})"""
        yield checks.column_note(_LOADS, text, "missing_load")


#: robust spreads beyond which a load does not scatter by the payload's place
_LOAD_SPREADS: Final = 6.0
#: contradicted loads, all to one side, that have a common cause (by chance 2 in 2^8)
_TO_ONE_SIDE: Final = 8
#: relative error of static loads: a centre of mass is known to 1 to 2 cm
_STATICS: Final = 0.02
#: least and largest share of a weight on the rear wheels, with 5 % for the scales
_REAR_SHARE: Final = (0.2, 1.05)


def _allowed(total: FloatArray) -> FloatArray:
    return np.maximum(15.0, 0.05 * np.abs(total))


def loads_against_payload(campaign: Campaign) -> Iterator[Note]:
    """Compare weighed loads with the static loads of the payload (Eqs 1 and 2)."""
    runs = campaign.runs
    if "payload_kg" not in runs.numbers:
        return
    weighed = checks.both_sides(campaign, "load_{}_N")
    if not checks.stated(campaign, "vehicle.mass_kg"):
        yield from _unit_by_payload(runs.number("payload_kg"), weighed.sum(axis=0))
    computed = np.stack(loads_from_payload(campaign.vehicle, runs))
    known = np.isfinite(weighed + computed).all(axis=0)
    if known.any() and not all(checks.stated(campaign, f"vehicle.{name}") for name in _OF_OWN_LOAD):
        # the vehicle's own part is as weighed
        computed += np.median((weighed - computed)[:, known], axis=1, keepdims=True)
    allowed = _allowed(computed.sum(axis=0))
    off = np.asarray((np.abs(weighed - computed) > allowed).any(axis=0))
    swapped = off & (np.abs(weighed - computed[::-1]) <= allowed).all(axis=0)
    heavier = (weighed.sum(axis=0) > computed.sum(axis=0))[off]
    whole = off.sum() > max(3, checks.MOST_OF_THE_RUNS * known.sum())
    whole |= len(heavier) >= _TO_ONE_SIDE and heavier.mean() in {0.0, 1.0}
    of = off if whole else known & (computed > 0.0).all(axis=0)
    ratios = (weighed / computed)[:, of]
    alike = False
    if checks.stated(campaign, "vehicle.mass_kg") and of.sum() >= checks.MIN_LINE_RUNS:
        spreads = np.maximum(_STATICS, [_LOAD_SPREADS * checks.robust_spread(ratio) for ratio in ratios])[:, None]
        middle = np.median(ratios, axis=1, keepdims=True)
        # those that differ as all others do have a common cause
        common = (np.abs(ratios - middle) <= spreads)[:, off[of]].all()
        alike = bool(common and (np.abs(middle - 1.0) > spreads).any())
    if whole or alike:
        hint, code = _SWAPPED if swapped.sum() > checks.MOST_OF_THE_RUNS * off.sum() else _CONTRADICTED
        left, right = np.median(ratios, axis=1)
        text = f"""in {ratios.shape[1]} runs ({checks.listed(runs.run_id[of])}) left and right loads are {left:.4g} and
            {right:.4g} times those of vehicle and payload; {hint}"""
        yield checks.column_note(f"{_LOADS}, payload_kg", text, code, "suspicious" if off.any() else "info")
        return
    for run in np.flatnonzero(off):
        hint, code = _SWAPPED if swapped[run] else _CONTRADICTED
        text = f"""found {weighed[0, run]:.0f} and {weighed[1, run]:.0f} N; vehicle and payload ask for
            {computed[0, run]:.0f} and {computed[1, run]:.0f} N; {hint}"""
        yield checks.cell_note(campaign, run, _LOADS, text, code)
    yield from _off_the_line(campaign, np.where(np.isfinite(computed.sum(axis=0)), np.nan, weighed.sum(axis=0)))


def _unit_of_shares(shares: FloatArray) -> str:
    low, high = _REAR_SHARE
    for factor in (1.0 / GRAVITY_MPS2, GRAVITY_MPS2) if len(shares) else ():
        if np.mean(np.abs(shares / factor - 0.5 * (low + high)) <= 0.5 * (high - low)) > checks.MOST_OF_THE_RUNS:
            return checks.meaning(factor, checks.LOAD_UNITS)
    return ""


def _unit_by_payload(payload: FloatArray, total: FloatArray) -> Iterator[Note]:
    known = np.isfinite(payload + total)
    slopes = checks.pair_slopes(payload[known], total[known])
    if unit := _unit_of_shares(slopes / GRAVITY_MPS2):
        text = f"""each kg of payload adds {np.median(slopes):.3g} N to both wheels in sum; expected
            {_REAR_SHARE[0] * GRAVITY_MPS2:.2g} to {GRAVITY_MPS2:g} N; are they in {unit}?"""
        yield checks.column_note(f"{_LOADS}, payload_kg", text, "load_unit")


def _off_the_line(campaign: Campaign, total: FloatArray) -> Iterator[Note]:
    payload = campaign.runs.number("payload_kg")
    runs = np.flatnonzero(np.isfinite(total + payload))
    if len(runs) < checks.MIN_LINE_RUNS:
        return
    away = checks.line_residuals(payload[runs], total[runs])
    expected = total.copy()
    expected[runs] -= away
    far = np.abs(away) > np.maximum(_allowed(expected[runs]), _LOAD_SPREADS * checks.robust_spread(away))
    others = payload[runs[~far]]
    for run in runs[far] if far.sum() <= MOST_ODD * len(runs) else ():
        if others.min() <= payload[run] <= others.max():
            text = f"""found {total[run]:.0f} N on both wheels with {payload[run]:g} kg; the other runs ask for
                {expected[run]:.0f} N; check payload_kg and the weighing: it may be the load of another run"""
            yield checks.cell_note(campaign, int(run), f"{_LOADS}, payload_kg", text, "contradicted_load")


def reference_load(campaign: Campaign) -> Iterator[Note]:
    """Find a reference load that is none of those driven or usual."""
    loads, load_N = checks.both_sides(campaign, "load_{}_N"), campaign.model.reference_load_N
    loads = loads[np.isfinite(loads)]
    if not checks.stated(campaign, "model.reference_load_N") or not len(loads):
        return
    usual = np.array([campaign.vehicle.unladen_load_N, loads.mean(), *np.unique(loads)])
    if np.abs(usual - load_N).min() > _SAME_LOAD * load_N:
        text = f"""found {load_N:g} N; expected the load of the empty vehicle ({usual[0]:.4g} N), one that was driven
            ({loads.min():.4g} to {loads.max():.4g} N) or their mean, since radii are stated at it; check the
            value"""
        yield checks.setting_note("model.reference_load_N", text, "reference_load", "info")


#: relative difference within which a reference load is a usual load
_SAME_LOAD: Final = 0.05
_OF_OWN_LOAD: Final = ("mass_kg", "cog_x_m", "wheelbase_m")
_SWAPPED: Final = ("left and right loads look swapped, or payload_y_m counts from the right", "swapped_loads")
_CONTRADICTED: Final = (
    "check payload, its place and the weighing, and the vehicle's mass_kg, cog_x_m and wheelbase_m",
    "contradicted_load",
)
#: plausible factor between a payload's weight and what it adds to the loads
_MOST_PAYLOAD: Final = 1.6
#: plausible share of the weighed in the computed load of the empty vehicle
_LIGHTEST: Final = 0.3


def implausible_loads(campaign: Campaign) -> Iterator[Note]:
    """Yield loads below zero, in another unit, or not those of their payload."""
    runs, vehicle = campaign.runs, campaign.vehicle
    weighed, computed = checks.both_sides(campaign, "load_{}_N"), np.stack(loads_from_payload(vehicle, runs))
    total, expected = weighed.sum(axis=0), computed.sum(axis=0)
    good = np.isfinite(total) & (total > 0)
    if not checks.stated(campaign, "vehicle.mass_kg") or not good.any():
        return
    shares = total / (GRAVITY_MPS2 * (vehicle.mass_kg + np.nan_to_num(runs.number("payload_kg"))))
    light = good & (shares < _REAR_SHARE[0])
    if LEAST_RUNS <= light.sum() < good.sum() and (unit := _unit_of_shares(shares[light])):
        what = f"the weight of vehicle and payload in {light.sum()} runs ({checks.listed(runs.run_id[light])})"
        yield _in_another_unit(_LOADS, float(np.median(shares[light])), what, unit)
    by_payload = good & (expected > 0)
    if by_payload.sum() >= LEAST_RUNS:
        ratios, loads = (total / expected)[by_payload], expected[by_payload]
        # the lightest runs test the vehicle's mass, all of them the payload's
        medians = [float(np.median(part)) for part in (ratios, ratios[loads <= np.quantile(loads, 0.25)])]
        ratio = max(medians, key=lambda part: abs(math.log(part)))
        if 0.4 <= ratio <= 2.5:
            yield from _one_side(weighed, computed)
            yield from _payload_weight(total, expected, by_payload)
            yield from _swapped_loads(weighed, computed)
        else:
            yield _in_another_unit(_LOADS, ratio, "those of vehicle and payload")
    else:
        yield from _of_the_empty_vehicle(campaign, total, good)
    top, permitted = float(np.max(np.fmax(*weighed)[good])), vehicle.max_wheel_load_N
    # a limit below the unladen load is wrong
    if top > permitted > vehicle.unladen_load_N:
        text = f"""found wheel loads up to {top:.5g} N; {permitted:g} N is permitted; are payloads or loads in another
            unit (g, lb, N for kg), or is vehicle.max_wheel_load_N another?"""
        yield implausible_column(_LOADS, text)
    place = float(np.nanmax(np.append(np.abs(runs.number("payload_x_m")), 0.0)))
    if place > 5 * vehicle.wheelbase_m:
        text = f"""found {place:g} m with a wheelbase of {vehicle.wheelbase_m:g} m; expected a place on the vehicle; in
            mm?"""
        yield implausible_column("payload_x_m", text)


def _of_the_empty_vehicle(campaign: Campaign, total: FloatArray, good: BoolArray) -> Iterator[Note]:
    vehicle, empty = campaign.vehicle, good & (campaign.runs.number("payload_kg") == 0)
    weight_N = float(np.median(total[empty]) if empty.any() else total[good].min())
    share = weight_N / (vehicle.mass_kg * GRAVITY_MPS2)
    ratio, least, what = share, _REAR_SHARE[0], "the weight of the empty vehicle"
    known = all(checks.stated(campaign, f"vehicle.{key}") for key in ("cog_x_m", "wheelbase_m"))
    if known and vehicle.unladen_load_N > 0:
        ratio, least, what = weight_N / (2.0 * vehicle.unladen_load_N), _LIGHTEST, "that of the empty vehicle"
    if ratio < least or (empty.any() and ratio > 1.0 / _LIGHTEST):
        yield _in_another_unit(_LOADS, ratio, what, _unit_of_shares(np.array([share])))


def _in_another_unit(columns: str, ratio: float, what: str, unit: str = "") -> Note:
    hint = unit or checks.meaning(ratio, checks.LOAD_UNITS, 0.25)
    hint = f"are they in {hint}?" if hint else "check their unit, mass_kg, cog_x_m and wheelbase_m"
    expected = "a fifth of it to all of it" if "weight" in what else "the same within a factor of 2"
    return implausible_column(columns, f"the wheel loads are {ratio:.3g} times {what}; expected {expected}; {hint}")


def _one_side(weighed: FloatArray, computed: FloatArray) -> Iterator[Note]:
    for side, load, expected in zip(checks.SIDES, weighed, computed, strict=True):
        good = (load > 0) & (expected > 0)
        ratio = float(np.median(load[good] / expected[good])) if good.sum() >= LEAST_RUNS else 1.0
        if not 0.1 <= ratio <= 10:
            yield _in_another_unit(f"load_{side}_N", ratio, "those of vehicle and payload")


def _payload_weight(total: FloatArray, expected: FloatArray, good: BoolArray) -> Iterator[Note]:
    x, y = expected[good], total[good]
    if np.ptp(x) < 0.2 * np.median(x):
        return
    slope, intercept = np.polyfit(x, y, 1)
    unexplained = float(np.std(y - slope * x - intercept))
    ratio = 1 / float(slope) if slope > 0 else math.inf
    # a unit only where loads follow the payload; mixed places scatter
    if 1 / _MOST_PAYLOAD <= ratio <= _MOST_PAYLOAD or unexplained > 0.1 * float(np.std(y)):
        return
    hint = "is it in pounds?" if abs(ratio / 2.20462 - 1) < 0.1 else "check its unit and its place"
    text = f"""the payload adds {ratio:.3g} times what the weighed loads say; expected the same within
        {100 * (_MOST_PAYLOAD - 1):.0f} %; {hint}"""
    yield implausible_column("payload_kg", text)


def _swapped_loads(weighed: FloatArray, computed: FloatArray) -> Iterator[Note]:
    difference_N, expected = weighed[0] - weighed[1], computed[0] - computed[1]
    good = np.isfinite(difference_N) & (np.abs(expected) > 0.1 * np.abs(computed.sum(axis=0)))
    opposite = difference_N[good] / expected[good] < -0.5
    if good.sum() >= LEAST_RUNS and opposite.mean() > checks.MOST_OF_THE_RUNS:
        text = f"""in {int(opposite.sum())} of {int(good.sum())} runs with the payload on one side the other wheel
            carries more; expected the wheel beside it to; are the loads swapped, or is payload_y_m positive to the
            right?"""
        yield implausible_column(_LOADS, text)
