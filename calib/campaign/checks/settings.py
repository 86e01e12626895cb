"""What changes every answer and shows in no single cell: counts per revolution, clocks, logs that begin late."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from calib.campaign.checks.design import LEAST_RUNS, SIDES, cell_note, per_rev, raw_radius_ratio
from calib.campaign.checks.distances import mirrored_ends
from calib.campaign.model import Campaign, Note
from calib.campaign.read import log_totals

#: both radii further from nominal than this, alike to `ALIKE`, are a setting rather than two worn wheels
FAR_FROM_NOMINAL: Final = 0.012
ALIKE: Final = 0.003
#: further off, the wheel is another one than stated (a published robot rolls 6 % short of nominal), and the check of
#: plausible radii says it
MOST_FAR: Final = 0.05
#: a clock in other units makes a log so many times as fast or slow as the others
CLOCK_FACTORS: Final = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
#: runs of one campaign are driven within this factor of the usual speed
SPEED_FACTOR: Final = 30.0
#: wheels and reference agree on a heading to this, and only a few runs are a turn off
NEAR_TURN_RAD: Final = 1.0
MOST_ODD: Final = 0.2
#: a distance so many times what the wheels of other runs make of their counts belongs to another run or unit
ODD_RATIO: Final = 1.3
#: steps of so many times the reference's uncertainty are not its noise; all are multiples of one to `STEP_ERROR`
COARSE: Final = 3.0
STEP_ERROR: Final = 0.02
#: poses looked at
MOST_POSES: Final = 10_000
#: the log begins so many counts late in every run, to the count
MOST_SCATTER_COUNTS: Final = 1.0


def counts_per_revolution(campaign: Campaign) -> Iterator[Note]:
    """Find counts per revolution that are one off a round number, and radii that are off together."""
    stated = "encoder.counts_per_rev" not in campaign.assumed
    for side in SIDES if stated else ():
        value = per_rev(campaign, side)
        near = [value + step for step in (-1.0, 1.0) if _is_round(value + step)]
        if near and not _is_round(value):
            text = f"found {value:.10g}, one off {near[0]:.10g}; encoders have a round number of counts; check it"
            yield Note("suspicious", f"campaign.toml, encoder, counts_per_rev_{side}", text, "counts_per_rev")
    if "vehicle.wheel_radius_m" in campaign.assumed:
        return
    ratios = [raw_radius_ratio(campaign, side) for side in SIDES]
    usual = [float(np.nanmedian(ratio)) if np.isfinite(ratio).sum() >= LEAST_RUNS else np.nan for ratio in ratios]
    left, right = usual
    if abs(left - right) < ALIKE and FAR_FROM_NOMINAL < abs(left - 1.0) < MOST_FAR:
        text = (
            f"both wheels roll as if their radius were {100 * (left - 1):+.2g} % off the nominal one; expected within "
            f"{100 * FAR_FROM_NOMINAL:.2g} %; check counts_per_rev, a gear ratio, and the nominal radius"
        )
        yield Note("suspicious", "campaign.toml, encoder and vehicle", text, "counts_per_rev")


def _is_round(counts: float) -> bool:
    """Return whether encoders have so many counts: a power of two, or a multiple of a hundred."""
    whole = round(counts)
    return abs(counts - whole) < 1e-9 and whole > 0 and (whole & (whole - 1) == 0 or whole % 100 == 0)


def log_clock(campaign: Campaign) -> Iterator[Note]:
    """Find logs whose times are in other units than those of the others."""
    logs = campaign.logs
    speeds = np.full(len(campaign.runs), np.nan)
    name = next((column for column in logs.columns if column.startswith("counts_")), None)
    duration_s = log_totals(logs, "t_s")
    present = logs.present & (duration_s > 0.0)
    if name is not None and present.any():
        way = np.concatenate(([0.0], np.nancumsum(np.abs(np.diff(logs.columns[name])))))
        counts = way[logs.offsets[1:][present] - 1] - way[logs.offsets[:-1][present]]
        speeds[present] = counts / duration_s[present]
    usual = float(np.nanmedian(speeds)) if np.isfinite(speeds).sum() >= LEAST_RUNS else 0.0
    if not usual > 0.0:
        return
    usual_s = float(np.median(duration_s[present]))
    for factor, unit in CLOCK_FACTORS.items():
        long = duration_s > usual_s * factor / SPEED_FACTOR
        near = (speeds * factor > usual / SPEED_FACTOR) & (speeds * factor < usual * SPEED_FACTOR)
        # a vehicle that stands for most of a log is slow, too, but its log is no longer than the others
        slow = np.flatnonzero(near & long)
        if len(slow):
            names = ", ".join(map(str, campaign.runs.run_id[slow][:5]))
            text = (
                f"in {len(slow)} logs ({names}) the wheels turn {factor:.0e} times slower than in the others: t_s "
                f"looks like {unit}; name the column t_ms, t_us or t_ns there, or divide it"
            )
            yield Note("suspicious", "logs, column t_s", text, "clock_unit")


def odd_lengths(campaign: Campaign) -> Iterator[Note]:
    """Find runs whose distance is far from what their wheels rolled, and logs whose time does not rise."""
    ratio = 0.5 * (raw_radius_ratio(campaign, SIDES[0]) + raw_radius_ratio(campaign, SIDES[1]))
    if np.isfinite(ratio).sum() >= LEAST_RUNS:
        usual = float(np.nanmedian(ratio))
        with np.errstate(invalid="ignore"):
            odd = (ratio > ODD_RATIO * usual) | (ratio < usual / ODD_RATIO)
        for run in np.flatnonzero(odd):
            text = (
                f"the distance is {ratio[run] / usual:.3g} times what the wheels rolled; check it, or exclude the run"
            )
            yield cell_note(campaign, int(run), "distance_m", text, "odd_distance")
    logs = campaign.logs
    if "t_s" in logs.columns:
        fell = np.flatnonzero(np.diff(logs.columns["t_s"]) < 0.0)
        within = np.setdiff1d(fell + 1, logs.offsets)
        runs = np.unique(np.searchsorted(logs.offsets, within, side="right") - 1)
        if len(runs):
            names = ", ".join(map(str, campaign.runs.run_id[runs][:5]))
            yield Note("suspicious", "logs, column t_s", f"time runs backwards in {len(runs)} logs ({names})", "clock")


def heading_turns(campaign: Campaign) -> Iterator[Note]:
    """Find end headings of a few runs that are a whole turn off what the wheels say."""
    runs = campaign.runs
    if not {"counts_left", "counts_right", "ref_theta_rad"} <= set(runs.numbers):
        return
    rolled = [runs.number(f"counts_{side}") * 2 * np.pi / per_rev(campaign, side) for side in SIDES]
    heading = (rolled[1] - rolled[0]) * campaign.vehicle.wheel_radius_m / campaign.vehicle.track_m
    apart = heading - runs.number("ref_theta_rad")
    turns = np.round(apart / (2 * np.pi))
    near = np.isfinite(apart) & (np.abs(apart - 2 * np.pi * turns) < NEAR_TURN_RAD)
    odd = near & (turns != 0.0)
    # headings within half a turn throughout are wrapped by their instrument, which is no fault
    wrapped = bool((np.abs(runs.number("ref_theta_rad")[near]) <= np.pi + 0.05).all())
    if wrapped or odd.sum() > MOST_ODD * near.sum():
        return
    for run in np.flatnonzero(odd):
        text = f"the heading is {turns[run]:+.0f} turn(s) off what the wheels say; correct the cell"
        yield cell_note(campaign, int(run), "ref_theta_rad", text, "heading_turn")


def pose_resolution(campaign: Campaign) -> Iterator[Note]:
    """Find positions that come in steps coarser than the reference: single precision far from the origin."""
    sources = (("runs", campaign.runs.numbers), ("logs", campaign.logs.columns))
    for where, columns in sources:
        for name in ("ref_x_m", "ref_y_m"):
            values = columns.get(name)
            values = np.zeros(0) if values is None else np.unique(values[np.isfinite(values)][:MOST_POSES])
            steps = np.diff(values)
            if len(steps) < LEAST_RUNS or not steps.min() > COARSE * campaign.reference.sigma_xy_m:
                continue
            step_m = float(steps.min())
            if np.abs(steps / step_m - np.round(steps / step_m)).max() < STEP_ERROR:
                text = (
                    f"the positions come in steps of {1e3 * step_m:.3g} mm, far above the stated sigma_xy_m; single "
                    "precision far from the origin does this: subtract the origin before the file is written"
                )
                yield Note("suspicious", f"{where}, column {name}", text, "pose_resolution")


def late_logs(campaign: Campaign) -> Iterator[Note]:
    """Find logs that begin after the vehicle moved: the table has a constant few counts more in every run."""
    apart = [campaign.runs.number(f"counts_{side}") - log_totals(campaign.logs, f"counts_{side}") for side in SIDES]
    for side, difference in zip(SIDES, apart, strict=True):
        known = difference[np.isfinite(difference)]
        if len(known) < LEAST_RUNS:
            continue
        usual = float(np.median(known))
        if abs(usual) > MOST_SCATTER_COUNTS and np.mean(np.abs(known - usual) <= MOST_SCATTER_COUNTS) > 0.9:
            text = (
                f"the table counts {usual:+.0f} against the logs in every run: the logs begin or end at another place "
                "than the distance; let the log begin before the vehicle moves"
            )
            yield Note("suspicious", f"runs, column counts_{side}", text, "late_logs")


#: notes of the reading that change a result: columns not used, rows that are no runs, sessions joined
_OF_READING: Final = frozenset({"no_unit", "look_alike", "summary_row", "session_spelling"})


def notes_for_results(campaign: Campaign) -> tuple[str, ...]:
    """Return what a fit or a diagnosis says of its data first: each changes the answer, and the answer shows none."""
    found = [note for note in campaign.notes if note.code in _OF_READING]
    for check in (
        counts_per_revolution,
        late_logs,
        log_clock,
        heading_turns,
        pose_resolution,
        odd_lengths,
        mirrored_ends,
    ):
        found.extend(check(campaign))
    return tuple(f"{note.where}: {note.text}." for note in found)
