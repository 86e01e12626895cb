"""Logs: the clock, steps of the counters, speed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.checks.common import note
from calib.campaign.model import Campaign, Note
from calib.campaign.wheels import odometry_source, on_one_axle


def clock(campaign: Campaign) -> Iterator[Note]:
    """Find gaps (the vehicle moved on), clock jumps (it did not), and time that stands or runs backwards."""
    for run in np.flatnonzero(campaign.logs.lengths >= 5):
        log = campaign.logs.of(int(run))
        time = log["t_s"]
        step = np.diff(time)
        usual = float(np.median(step))
        back = np.flatnonzero(step < 0)
        if len(back):
            text = (
                f"time runs backwards {len(back)} time(s), first in sample {back[0] + 2} by "
                f"{-step[back[0]]:.4g} s; the "
                "clock jumped or files were joined; check the logger"
            )
            yield note(campaign, run, "log t_s", text, "clock_jump")
        still = int((step == 0).sum())
        if still:
            yield note(
                campaign, run, "log t_s", f"{still} sample(s) repeat the time of the one before", "repeated_time"
            )
        if usual <= 0:
            continue
        long = np.flatnonzero(step > max(3.5 * usual, 0.0))
        if not len(long):
            continue
        moved = np.sum([np.abs(np.diff(log[name])) for name in _wheels(log)], axis=0)
        rate = float(np.median((moved / np.where(step > 0, step, np.nan))[step > 0]))
        # while driving, a real gap goes with as many counts as its time asks for
        jumped = [at for at in long if rate > 0 and moved[at] < 0.35 * rate * step[at] and _driving(moved, int(at))]
        gaps = [at for at in long if at not in jumped]
        if gaps:
            text = (
                f"{len(gaps)} gap(s), {step[gaps].sum():.4g} s in all, the longest {step[gaps].max():.4g} s at "
                f"{time[gaps[int(np.argmax(step[gaps]))]]:.4g} s, where samples come every {usual:.4g} s; "
                "counts go on, so "
                "that totals hold, but the path in the gap is not known"
            )
            yield note(campaign, run, "log t_s", text, "gap")
        if jumped:
            text = (
                f"the clock jumped {len(jumped)} time(s), first at {time[jumped[0]]:.4g} s by {step[jumped[0]]:.4g} s, "
                "while the counts went on as in one sample; speeds of this log are not to be trusted"
            )
            yield note(campaign, run, "log t_s", text, "clock_jump")


def _wheels(log: Mapping[str, FloatArray]) -> list[str]:
    """Return the columns of a log that count a wheel."""
    return [name for name in log if name.startswith("counts_")]


def _driving(moved: FloatArray, at: int) -> bool:
    """Return whether the wheels turned just before and just after a step."""
    return bool(moved[max(0, at - 3) : at].any() and moved[at + 1 : at + 4].any())


def count_jumps(campaign: Campaign) -> Iterator[Note]:
    """Find steps of a counter far beyond all others of the log, as a lost or disturbed encoder makes them."""
    for run in np.flatnonzero(campaign.logs.lengths >= 20):
        log = campaign.logs.of(int(run))
        time_step = np.diff(log["t_s"])
        usual_time = max(float(np.median(time_step)), 1e-9)
        for name in _wheels(log):
            # a gap in time may hold many counts; it is named as a gap
            step = np.diff(log[name]) / np.maximum(1.0, time_step / usual_time)
            usual = float(np.percentile(np.abs(step), 95))
            far = np.flatnonzero(np.abs(step) > 6 * usual + 50)
            if len(far) and len(far) <= max(5, 0.01 * len(step)):
                text = (
                    f"{len(far)} jump(s), first in sample {far[0] + 2} by {step[far[0]]:.0f} counts where "
                    f"{usual:.0f} are "
                    "usual; the encoder may have lost contact, or the counter was reset"
                )
                yield note(campaign, run, f"log {name}", text, "count_jump")


def _can_stand_in(campaign: Campaign) -> bool:
    """Return whether wheels on one axle can stand in for others: mecanum wheels need their l + w."""
    return odometry_source(campaign) != "wheels" or campaign.vehicle.half_length_plus_half_width_m is not None


def log_speed(campaign: Campaign) -> Iterator[Note]:
    """Compare the set speed with what the log's counts say while driving."""
    campaign = on_one_axle(campaign) if _can_stand_in(campaign) else campaign
    logs, speed = campaign.logs, campaign.runs.number("speed_mps")
    ratios = np.full(len(speed), np.nan)
    per_count = 2 * np.pi * campaign.vehicle.wheel_radius_m / campaign.encoder.counts_per_rev_left
    for run in np.flatnonzero((logs.lengths >= 20) & (speed > 0)):
        log = logs.of(int(run))
        if "counts_left" not in log:
            continue
        stride = max(1, len(log["t_s"]) // 50)
        time, counts = log["t_s"][::stride], log["counts_left"][::stride]
        step = np.diff(time)
        if (step > 0).all():
            ratios[run] = np.median(np.abs(np.diff(counts)) / step) * per_count / speed[run]
    known = np.isfinite(ratios) & (ratios > 0)
    # a route with turns or pauses is legitimately slower than its set speed; only a factor is odd
    if known.sum() and not 0.4 < (usual := float(np.median(ratios[known]))) < 1.6:
        hint = "km/h look like m/s; name the column speed_kmh" if 0.22 < usual < 0.34 else "check speed and clock"
        text = f"the logs drive at {usual:.3g} times the set speed; {hint}"
        yield Note("suspicious", "runs, column speed_mps", text, "speed_disagrees")
