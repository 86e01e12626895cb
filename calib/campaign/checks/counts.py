"""Encoder counts and logs: sign, scale, overflow, swapped wheels, the clock, jumps, speed."""

import math
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from calib.campaign import checks
from calib.campaign.checks.measurements import factor_reason
from calib.campaign.checks.settings import CLOCK_FACTORS
from calib.campaign.logs import WIDTHS
from calib.campaign.model import Campaign, Note
from calib.campaign.read import log_totals
from calib.campaign.wheels import steered_itself_m
from calib.types import BoolArray, FloatArray, grouped

#: largest relative departure from the nominal radius: of a run, and of all by wear and load
_MAX_RUN_DEPARTURE: Final = 0.15
_MAX_WEAR: Final = 0.06
#: loads within this share are equal
_EQUAL_LOADS: Final = 0.05


def reversed_wheels(campaign: Campaign) -> Iterator[Note]:
    """Find wheels that count backwards although the vehicle drives forward."""
    runs = campaign.runs
    # an end behind the start: driven backward
    forward = (runs.number("distance_m") > 1.0) & ~(runs.number("ref_x_m") < 0.0)
    backward = {side: (runs.number(f"counts_{side}") < 0) & forward for side in checks.SIDES}
    if whole := [side for side in checks.SIDES if backward[side].sum() > checks.MOST_OF_THE_RUNS * forward.sum()]:
        text = f"""the {" and ".join(whole)} wheel counts backwards in {int(backward[whole[0]].sum())} runs that drive
            forward; negate the column, or correct the encoder's direction"""
        yield checks.column_note(", ".join(f"counts_{side}" for side in whole), text, "reversed_wheels")
    for side in checks.SIDES:
        for run in np.flatnonzero(backward[side]) if side not in whole else ():
            text = "found negative counts; expected positive ones, as in other runs; check whether it drove backward"
            yield checks.cell_note(campaign, run, f"counts_{side}", text, "reversed_wheels")


def steered_by_itself(campaign: Campaign) -> Iterator[Note]:
    """Find a vehicle that steered by its counts: its wheels rolled alike in every run."""
    if (apart_m := steered_itself_m(campaign)) >= 0.0:
        text = f"""the wheels of all runs along a line rolled alike to within {1e3 * apart_m:.2g} mm: the vehicle seems
            to have steered by its own counts, which hides what its radii differ by; measure ref_theta_rad at the end"""
        yield checks.column_note("counts_left, counts_right", text, "steered_by_itself")


def dead_counters(campaign: Campaign) -> Iterator[Note]:
    """Find wheels without a count while the vehicle moves."""
    runs, turn, reference = campaign.runs, checks.turned_rad(campaign), checks.reference_turns(campaign)[0]
    moved = np.abs(turn - reference) > 0.5 * np.abs(turn)
    moved |= (runs.number("distance_m") > 1.0) & np.isnan(reference)
    for side, other in (checks.SIDES, checks.SIDES[::-1]):
        counts = runs.number(f"counts_{other}")
        turned = np.abs(counts) > campaign.encoder.per_rev(other)
        dead = (runs.number(f"counts_{side}") == 0.0) & turned & moved
        remedy = "expected counts of both wheels; check encoder, cable and column, or exclude"
        if dead.sum() > max(1.0, checks.MOST_OF_THE_RUNS * turned.sum()):
            text = f"found 0 counts in {int(dead.sum())} runs in which the {other} wheel counts; {remedy} them"
            yield checks.column_note(f"counts_{side}", text, "dead_counter")
            continue
        for run in np.flatnonzero(dead):
            text = f"found 0 counts while the {other} wheel counts {counts[run]:.0f}; {remedy} the run"
            yield checks.cell_note(campaign, run, f"counts_{side}", text, "dead_counter")


def count_scale(campaign: Campaign) -> Iterator[Note]:
    """Find counts off by a factor, and overflowed totals."""
    for side in checks.SIDES:
        ratio = np.abs(checks.raw_radius_ratio(campaign, side))
        if not (known := np.isfinite(ratio)).any():
            continue
        odd = known & (np.abs(ratio - 1) > _MAX_RUN_DEPARTURE)
        usual = float(np.nanmedian(ratio))
        alike = checks.robust_spread(ratio) < 0.02 * usual
        if alike and abs(usual - 1) > _MAX_WEAR and checks.stated(campaign, "vehicle.wheel_radius_m"):
            odd = known
        if alike and odd.sum() > checks.MOST_OF_THE_RUNS * known.sum():
            text = f"""the {side} wheel's radius is {usual:.4g} times the nominal one in nearly every run;
                {factor_reason(usual)}"""
            yield checks.column_note(f"counts_{side}", text, "count_scale")
            continue
        yield from (_odd_run(campaign, int(run), side, float(ratio[run])) for run in np.flatnonzero(odd))


def _odd_run(campaign: Campaign, run: int, side: str, ratio: float) -> Note:
    total = float(campaign.runs.number(f"counts_{side}")[run])
    expected = abs(total) * ratio
    for bits in (16, 32):
        full = 2.0**bits
        turns = round((expected - total) / full)
        if turns and abs(total) < full and abs(total + turns * full - expected) < 0.05 * expected:
            text = f"""found {total:.0f}; expected about {expected:.0f}; {abs(turns)} overflow(s) of a {bits}-bit
                counter give this; give encoder.wrap_bits = {bits} to have them undone"""
            return checks.cell_note(campaign, run, f"counts_{side}", text, "wrapped_total")
    text = f"""found {total:.0f}, a radius {ratio:.4g} times the nominal one; expected about {expected:.0f};
        {factor_reason(ratio)}"""
    return checks.cell_note(campaign, run, f"counts_{side}", text, "count_scale")


def counts_against_log(campaign: Campaign) -> Iterator[Note]:
    """Compare the table's counts with those of the log."""
    logged = {side: log_totals(campaign.logs, f"counts_{side}") for side in checks.SIDES}
    for side, other in (checks.SIDES, checks.SIDES[::-1]):
        table = campaign.runs.number(f"counts_{side}")
        allowed = np.maximum(5.0, 5e-5 * np.abs(table))
        for run in np.flatnonzero(np.abs(table - logged[side]) > allowed):
            count, log = float(table[run]), float(logged[side][run])
            if abs(count - logged[other][run]) <= allowed[run]:
                hint = f"the table agrees with the log's {other} wheel, so that the wheels look swapped in one of them"
                code = "swapped_wheels"
            elif abs(count + log) <= allowed[run]:
                hint, code = "the sign differs", "reversed_wheels"
            else:
                hint = checks.meaning(abs(log / count)) if count else ""
                hint, code = hint or "the log may be cut, or belong to another run", "counts_disagree"
            text = f"found {count:.0f} in the table but {log:.0f} in the log; {hint}"
            yield checks.cell_note(campaign, run, f"counts_{side}", text, code)


def swapped_wheels(campaign: Campaign) -> Iterator[Note]:
    """Find runs whose ratio of counts fits the loads only with the wheels swapped."""
    left, right = (campaign.runs.number(f"counts_{side}") / campaign.encoder.per_rev(side) for side in checks.SIDES)
    usable = np.flatnonzero((left > 0) & (right > 0) & (campaign.runs.number("distance_m") > 1.0))
    if len(usable) < 5:
        return
    ratio, loads = np.log(right[usable] / left[usable]), checks.both_sides(campaign, "load_{}_N")[:, usable].T
    away = checks.line_residuals(loads.sum(axis=1), checks.line_residuals(loads[:, 0] - loads[:, 1], ratio))
    fitted, spread = ratio - away, max(checks.robust_spread(away), 2e-5)
    mirrored = (np.abs(ratio + fitted) < 5 * spread) & (np.abs(ratio - fitted) > 8 * spread)
    for at in np.flatnonzero(mirrored):
        # not swapped: other runs of these loads have the same ratio
        equal = ~(np.abs(loads - loads[at]) > _EQUAL_LOADS * loads[at]).any(axis=1)
        if equal.sum() > 1 and abs(ratio[at] - np.median(ratio[equal])) < 8 * spread:
            continue
        text = f"""right over left is {math.exp(ratio[at]):.5f}; expected {math.exp(fitted[at]):.5f}, as in the other
            runs; left and right look swapped; check this run (when it is ingested: swapped = [...] in the mapping's
            [log])"""
        yield checks.cell_note(campaign, usable[at], "counts_left, counts_right", text, "swapped_wheels")


def turn_direction(campaign: Campaign) -> Iterator[Note]:
    """Compare the sense of turning by counts with reference heading and steering angle."""
    turned, (reference, _) = checks.turned_rad(campaign), checks.reference_turns(campaign)
    reference = np.where(np.isnan(reference), checks.logged_turns(campaign), reference)
    clear = (np.abs(reference) > 0.5) & (np.abs(turned) > 0.25)
    against = clear & (np.abs(turned + reference) < 0.3 * np.abs(turned - reference))
    yield from _turns(campaign, clear, against, "ref_theta_rad", "the reference turns the other way")
    agreement = np.zeros(len(campaign.runs))
    for run, log in campaign.logs.each(2, "steer_rad", "counts_left", "counts_right"):
        rate = np.diff(checks.turned_rad(campaign, log["counts_left"], log["counts_right"]))
        angle = log["steer_rad"][1:]
        scale = np.sqrt(np.nansum(rate**2) * np.nansum(angle**2))
        if scale > 0 and np.nanmax(np.abs(angle)) > 0.1:
            agreement[run] = np.nansum(rate * angle) / scale
    clear, against = np.abs(agreement) > 0.5, agreement < -0.5
    yield from _turns(campaign, clear, against, "steer_rad", "the steering angle turns the other way")


def _turns(campaign: Campaign, clear: BoolArray, against: BoolArray, column: str, finding: str) -> Iterator[Note]:
    columns = f"counts_left, counts_right, {column}"
    if against.any():  # a turn by counts that jumped is none
        against = against & ~np.isin(np.arange(len(against)), [run for run, *_ in jumps(campaign)])
    if against.sum() > max(1.0, checks.MOST_OF_THE_RUNS * clear.sum()):
        text = f"""in {int(against.sum())} of {int(clear.sum())} turning runs
            ({checks.listed(campaign.runs.run_id[against])}) {finding}; left and right look swapped throughout, or the
            reference counts clockwise"""
        yield checks.column_note(columns, text, "swapped_wheels")
        return
    said = f"{finding} than the counts say; left and right look swapped in this"
    for session, runs in checks.runs_by_label(campaign.runs.label("session")):
        those = runs[against[runs]]
        if len(those) > max(1.0, checks.MOST_OF_THE_RUNS * clear[runs].sum()):
            text = f"in session {session} ({checks.listed(campaign.runs.run_id[those])}) {said} session"
            yield checks.column_note(columns, text, "swapped_wheels", "wrong")
        else:
            yield from (checks.cell_note(campaign, int(run), columns, f"{said} run", "swapped_wheels") for run in those)


#: DAQ programs sample at up to 100 kHz; smaller steps are days taken for seconds
SHORTEST_STEP_S: Final = 9e-6


def clock(campaign: Campaign) -> Iterator[Note]:
    """Find gaps, clock jumps, and time that stands or runs back."""
    uneven: list[Note] = []
    for run, log in campaign.logs.each(5):
        time, step = log["t_s"], np.diff(log["t_s"])
        usual = float(np.median(step))
        if 0.0 < usual < SHORTEST_STEP_S:
            text = f"samples come every {usual:.3g} s, which no logger can; correct the unit of the times (ms, day)"
            yield checks.column_note("t_s", text, "sample_rate", "wrong", "logs")
            return
        if len(back := np.flatnonzero(step < 0)):
            text = f"""time runs backwards {len(back)} time(s), first in sample {back[0] + 2} by {-step[back[0]]:.4g} s;
                the clock jumped or files were joined; check the logger"""
            yield checks.cell_note(campaign, run, "log t_s", text, "clock_jump")
        if still := int((step == 0).sum()):
            text = f"{still} sample(s) repeat the time of the one before"
            yield checks.cell_note(campaign, run, "log t_s", text, "repeated_time")
        if usual <= 0 or not len(long := np.flatnonzero(step > 3.5 * usual)):
            continue
        moved = np.sum([np.abs(np.diff(log[name])) for name in log if name.startswith("counts_")], axis=0)
        rate = float(np.median((moved / np.where(step > 0, step, np.nan))[step > 0]))
        # a gap holds the counts of its duration, a jump of the clock those of one sample
        jumped = [at for at in long if rate > 0 and moved[at] < 0.35 * rate * step[at]]
        jumped = [at for at in jumped if moved[max(0, at - 3) : at].any() and moved[at + 1 : at + 4].any()]
        if gaps := [at for at in long if at not in jumped]:
            text = f"""{len(gaps)} gap(s), {step[gaps].sum():.4g} s in all, the longest {step[gaps].max():.4g} s at
                {time[gaps[np.argmax(step[gaps])]]:.4g} s, where samples come every {usual:.4g} s; counts go on, so
                that totals hold, but the path in the gap is not known"""
            uneven.append(checks.cell_note(campaign, run, "log t_s", text, "gap"))
        if jumped:
            text = f"""the clock jumped {len(jumped)} time(s), first at {time[jumped[0]]:.4g} s by {step[jumped[0]]:.4g}
                s, while the counts went on as in one sample; speeds of this log are not to be trusted"""
            uneven.append(checks.cell_note(campaign, run, "log t_s", text, "clock_jump"))
    odd, n_logs = len({note.run_id for note in uneven}), int((campaign.logs.lengths >= 5).sum())
    if odd < max(checks.LEAST_RUNS, checks.MOST_OF_THE_RUNS * n_logs):
        yield from uneven
        return
    text = f"""samples of {odd} of {n_logs} logs come unevenly; does the logger write changes alone, or lose samples? In
        run {uneven[0].run_id} {uneven[0].text}"""
    yield checks.column_note("t_s", text, uneven[0].code, of="logs")


def count_jumps(campaign: Campaign) -> Iterator[Note]:
    """Find steps of a counter far beyond all others of the log, and overflows."""
    found = list(jumps(campaign))
    for (name, bits), runs in grouped(((name, bits), run) for run, name, bits, _ in found if bits).items():
        text = f"""a {bits}-bit counter overflows in {len(runs)} run(s) ({checks.listed(campaign.runs.run_id[runs])});
            give encoder.wrap_bits = {bits} to have the jumps undone"""
        yield checks.column_note(name, text, "count_jump", of="logs")
    for run, name, bits, text in found:
        if not bits:
            text += "; the encoder may have lost contact, or the counter was reset"
            yield checks.cell_note(campaign, run, f"log {name}", text, "count_jump")


def jumps(campaign: Campaign) -> Iterator[tuple[int, str, int, str]]:
    """Yield the run of each of `jumps_of` its log."""
    return ((run, *jump) for run, log in campaign.logs.each(20) for jump in jumps_of(log))


def jumps_of(log: Mapping[str, FloatArray]) -> Iterator[tuple[str, int, str]]:
    """Yield counter, width of one that overflows so (else 0) and size of steps far beyond all others of a log."""
    for name in (name for name in log if name.startswith("counts_")):
        counted, time_step = np.diff(log[name]), np.diff(log.get("t_s", np.arange(len(log[name]))))
        # a gap in time may hold many counts
        stretch = np.maximum(1.0, time_step / max(float(np.median(time_step)), 1e-9))
        usual = float(np.percentile(np.abs(counted / stretch), 95))
        limit = (6 * usual + 50) * stretch
        far = np.flatnonzero(np.abs(counted) > limit)
        if 0 < len(far) <= max(5, 0.01 * len(counted)):
            first, span = float(counted[far[0]]), np.ptp(log[name])
            near = (b for b in WIDTHS if span < 2.0**b and abs(abs(first) - 2.0**b) < limit[far[0]])
            size = f"first in sample {far[0] + 2} by {first:.0f} counts where {usual:.0f} are usual"
            yield name, next(near, 0), f"{len(far)} jump(s), {size}"


#: slowest and fastest plausible speed of a vehicle
_PLAUSIBLE_MPS: Final = (0.005, 30.0)


def _speed_note(speed: float) -> Iterator[Note]:
    low, high = _PLAUSIBLE_MPS
    if not low <= speed <= high:
        units = (CLOCK_FACTORS if speed < low else {1.0 / 86400.0: "days"}).items()
        unit = next((f"is it in {unit}?" for factor, unit in units if low <= speed * factor <= high), "check its unit")
        text = f"the wheels drive at {speed:.2g} m/s; expected {low:g} to {high:g} m/s; {unit} Or check counts_per_rev"
        yield checks.column_note("t_s", text, "clock_unit", of="logs")


def log_speed(campaign: Campaign) -> Iterator[Note]:
    """Compare the log's speed with the set speed, and with what vehicles drive at."""
    campaign = checks.on_axle(campaign)
    speed = campaign.runs.number("speed_mps")
    ratios, driven = np.full(len(speed), np.nan), np.full(len(speed), np.nan)
    for run, log in campaign.logs.each(20, "counts_left"):
        stride = max(1, len(log["t_s"]) // 50)
        step = np.diff(log["t_s"][::stride])
        if (step > 0).all():
            way = checks.rolled_m(campaign, "left", log["counts_left"][::stride])
            rates = np.abs(np.diff(way)) / step
            ratios[run] = np.median(rates) / speed[run] if speed[run] > 0 else np.nan
            driven[run] = np.median(rates[rates > 0]) if np.ptp(way) > campaign.vehicle.wheel_radius_m else np.nan
    yield from _speed_note(float(np.nanmedian(driven)) if np.isfinite(driven).any() else 1.0)
    known = np.isfinite(ratios) & (ratios > 0)
    # turns and pauses are slower than set
    if known.any() and not 0.4 < (usual := float(np.median(ratios[known]))) < 1.6:
        hint = "km/h look like m/s; name the column speed_kmh" if 0.22 < usual < 0.34 else "check speed and clock"
        text = f"the logs drive at {usual:.3g} times the set speed; {hint}"
        yield checks.column_note("speed_mps", text, "speed_disagrees")


#: fewest interruptions of a log; largest relative change of the counts at each, and fewest counts
_MIN_INTERRUPTIONS, _MAX_STEP_CHANGE, _MIN_STEP_COUNTS = 5, 0.25, 20
_GAP: Final = 1.5  #: time steps that lack a row, over the usual one


def interrupted_counts(campaign: Campaign) -> Iterator[Note]:
    """Yield counts that stand still, or missing rows, again and again at full speed, never made up for."""
    for interruptions, what, why in (
        (_interruptions, "the counts stand still", "steps are lost before they are added up: check encoder and cable"),
        (_missing_rows, "rows are missing", "increments of a missing row are in no other"),
    ):
        stops = {name: list[tuple[int, float]]() for name in campaign.logs.columns if name.startswith("counts_")}
        n_logs = int((campaign.logs.lengths >= 20).sum())
        for _, log in campaign.logs.each(20):
            for name in stops.keys() & log.keys():
                times, share = interruptions(np.abs(np.diff(log[name])), log)
                stops[name] += [(times, share)] if times >= _MIN_INTERRUPTIONS else []
        odd = [name for name in stops if len(stops[name]) >= max(checks.LEAST_RUNS, checks.MOST_OF_THE_RUNS * n_logs)]
        if odd:
            times, share = np.median([each for name in odd for each in stops[name]], axis=0)
            n_odd = max(len(stops[name]) for name in odd)
            text = f"""{what} {times:.0f} times a log, for {100 * share:.2g} % of the way, in {n_odd} of {n_logs} logs,
                between samples at full speed; expected counts as long as it rolls; {why}; log the total"""
            yield checks.implausible_column(", ".join(odd), text, of="logs")


def _missing_rows(step: FloatArray, log: Mapping[str, FloatArray]) -> tuple[int, float]:
    step_s = np.diff(log.get("t_s", np.arange(len(step) + 1.0)))
    usual_s = float(np.median(step_s))
    gaps = np.flatnonzero(step_s[1:-1] > _GAP * usual_s) + 1
    before, after = (step[gaps + side] / np.maximum(step_s[gaps + side], 1e-12) for side in (-1, 1))
    rate, counted = 0.5 * (before + after), float(step[gaps].sum())
    # counts expected in the gaps: of their duration, and of one sample, the others lost
    whole, single = float(rate @ step_s[gaps]), float(rate.sum()) * usual_s
    # scattering time stamps have as many short steps as long ones
    missing = len(gaps) > 2 * (step_s < (2.0 - _GAP) * usual_s).sum()
    lost = missing and _MIN_STEP_COUNTS * len(gaps) < 2.0 * single and counted < 0.5 * (whole + single)
    return (len(gaps), (whole - counted) / float(step.sum())) if lost else (0, 0.0)


def _interruptions(step: FloatArray, log: Mapping[str, FloatArray]) -> tuple[int, float]:
    edge = np.diff(np.concatenate([[True], step != 0.0, [True]]).astype(np.int8))
    # stretches without a count: first sample, and that after the last; none at an end
    first, after = np.flatnonzero(edge == -1), np.flatnonzero(edge == 1)
    inner = (first > 0) & (after < len(step))
    first, after = first[inner], after[inner]
    least, most = np.sort([step[first - 1], step[after]], axis=0)
    fast = least >= max(_MIN_STEP_COUNTS, 0.5 * float(np.median(step[step > 0]))) if len(first) else least > 0.0
    x = log.get("ref_x_m", np.full(len(step) + 1, math.nan))
    y = log.get("ref_y_m", x)
    stood = (x[after] == x[first]) & (y[after] == y[first])
    interrupted = (most - least <= _MAX_STEP_CHANGE * most) & fast & ~stood
    lost = float((after - first)[interrupted].sum())
    return int(interrupted.sum()), lost / (float((step > 0).sum()) + lost) if lost else 0.0
