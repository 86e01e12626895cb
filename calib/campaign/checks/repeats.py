"""Runs against their repeats."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from calib.campaign.checks.common import SIDES, load_label, note, raw_radius_ratio, robust_spread
from calib.campaign.model import Campaign, Note

_FAR: Final = 6.0


def far_from_repeats(campaign: Campaign) -> Iterator[Note]:
    """Find runs whose radius lies far from runs of the same kind, load and speed.

    Distance from the group's median, against a spread pooled over all groups by the median absolute deviation, so that
    the runs sought do not widen it.
    """
    runs = campaign.runs
    speed = np.round(runs.number("speed_mps"), 3)
    label = load_label(campaign)
    group_of = np.asarray([f"{k}|{w}|{v:g}" for k, w, v in zip(runs.label("kind"), label, speed, strict=True)])
    names, group = np.unique(group_of, return_inverse=True)
    for side in SIDES:
        ratio = raw_radius_ratio(campaign, side)
        ratio = np.where(np.abs(np.abs(ratio) - 1) < 0.15, ratio, np.nan)
        away = np.full(len(ratio), np.nan)
        for number in range(len(names)):
            members = (group == number) & np.isfinite(ratio)
            if members.sum() >= 3:
                away[members] = ratio[members] - np.median(ratio[members])
        known = np.isfinite(away)
        if known.sum() < 5:
            continue
        # the rangefinder's own share keeps exact data from flagging its last digit
        floor = campaign.rangefinder.sigma_m / float(np.nanmedian(runs.number("distance_m")))
        spread = max(robust_spread(away[known]) * 1.2, floor)
        for run in np.flatnonzero(known & (np.abs(np.nan_to_num(away)) > _FAR * spread)):
            text = (
                f"the {side} radius lies {100 * away[run]:+.3f} % from its repeats, "
                f"{abs(away[run]) / spread:.0f} times "
                "their spread; look for slip, a wrong distance or a wrong load, and set excluded with a "
                "reason if found"
            )
            yield note(campaign, run, f"distance_m, counts_{side}", text, "far_from_repeats")


def pasted_rows(campaign: Campaign) -> Iterator[Note]:
    """Find runs whose measured values are all those of an earlier run."""
    runs = campaign.runs
    seen: dict[tuple[float, ...], int] = {}
    for run, row in enumerate(
        zip(*(runs.number(name).tolist() for name in ("distance_m", "counts_left", "counts_right")), strict=True)
    ):
        if any(math.isnan(value) or value == 0 for value in row):
            continue
        if row in seen:
            text = f"all three are those of run {runs.run_id[seen[row]]}; one row may have been pasted twice"
            yield note(campaign, run, "distance_m, counts_left, counts_right", text, "pasted_row")
        seen.setdefault(row, run)
