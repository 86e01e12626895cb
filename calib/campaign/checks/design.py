"""Design of the campaign: assumed settings, loads and sessions, replicates."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from calib.campaign.checks.terms import SIDES, cell_note, load_label, raw_radius_ratio, robust_spread
from calib.campaign.model import Campaign, Note

#: keys that every radius or path scales with
WEIGHTY: Final = ("vehicle.track_m", "vehicle.wheel_radius_m", "encoder.counts_per_rev")
#: section -> columns of the run table or of logs that make its values matter
_NEEDED_BY: Final = {"rangefinder": ("distance_m",), "reference": ("ref_x_m", "ref_y_m", "ref_theta_rad")}


def relevant(campaign: Campaign) -> tuple[str, ...]:
    """Return the assumed keys that matter for what the campaign holds."""
    columns = {*campaign.runs.numbers, *campaign.logs.columns}
    return tuple(
        key
        for key in campaign.assumed
        if (needed := _NEEDED_BY.get(key.partition(".")[0])) is None or columns.intersection(needed)
    )


def assumed_settings(campaign: Campaign) -> dict[str, str]:
    """Return the assumed keys that matter, each with the value that stands in."""
    return {key: value_of(campaign, key) for key in relevant(campaign)}


def value_of(campaign: Campaign, key: str) -> str:
    """Return an assumed value as text; empty where the key is none of the campaign's."""
    section, _, name = key.partition(".")
    part = getattr(campaign, section, None)
    value = getattr(part, "counts_per_rev_left" if name == "counts_per_rev" else name, None)
    return f"{value:.6g}" if isinstance(value, int | float) else ""


def assumed_values(campaign: Campaign) -> Iterator[Note]:
    """Name what nobody stated, with the values that stand in."""
    keys = assumed_settings(campaign)
    if not keys:
        return
    listed = ", ".join(f"{key} = {value}" for key, value in keys.items())
    text = (
        f"assumed, since nobody stated: {listed}; give the vehicle's and the instruments' own and take them out of "
        "'assumed'"
    )
    yield Note("suspicious" if any(key in WEIGHTY for key in keys) else "info", "campaign.toml", text, "assumed")


def load_and_session(campaign: Campaign) -> Iterator[Note]:
    """Say where every session has one load, or loads were driven in one rising or falling order."""
    included = campaign.included()
    label, session = load_label(included), included.runs.label("session")
    loads, sessions = np.unique(label), np.unique(session)
    if len(loads) < 2:
        return
    if len(sessions) >= 2:
        if all(len(np.unique(label[session == name])) == 1 for name in sessions):
            text = (
                f"each of the {len(sessions)} sessions has one load only, so that a drift between "
                "sessions and the effect "
                "of the load cannot be told apart; drive at least two loads in each session"
            )
            yield Note("suspicious", "runs, columns session and load", text, "confounded_load")
        return
    total = included.runs.number("load_left_N") + included.runs.number("load_right_N")
    changes = int((label[1:] != label[:-1]).sum())
    steps = np.diff(total)
    if changes == len(loads) - 1 and len(loads) >= 3 and ((steps >= 0).all() or (steps <= 0).all()):
        text = (
            "the loads were driven in one rising or falling order, so that warming up and the effect of "
            "the load cannot "
            "be told apart; drive some loads again at the end, or in mixed order"
        )
        yield Note("suspicious", "runs, order and load", text, "ordered_load")


def few_loads(campaign: Campaign) -> Iterator[Note]:
    """Say where the loads are too few for a slope, or for a look at its curvature."""
    included = campaign.included()
    for side in SIDES:
        load = included.runs.number(f"load_{side}_N")
        load = np.unique(np.round(load[np.isfinite(load)] / 5.0))
        if len(load) == 1:
            text = "one load only: a radius can be had, its change with load cannot"
        elif len(load) == 2:
            text = "two loads only: a slope can be had, whether the law is straight cannot"
        else:
            continue
        yield Note("suspicious", f"runs, column load_{side}_N", f"{text}; drive three loads or more", "few_loads")


def model_against_vehicle(campaign: Campaign) -> Iterator[Note]:
    """Compare what the simulator believes with the nominal vehicle."""
    model, vehicle = campaign.model, campaign.vehicle
    for name, believed, nominal in (
        ("radius_left_m", model.radius_left_m, vehicle.wheel_radius_m),
        ("radius_right_m", model.radius_right_m, vehicle.wheel_radius_m),
        ("track_m", model.track_m, vehicle.track_m),
    ):
        if abs(believed / nominal - 1) > 0.2:
            text = (
                f"found {believed:g} where the vehicle has {nominal:g}; check the unit, and whether a "
                "diameter was given"
            )
            yield Note("suspicious", f"campaign.toml, model.{name}", text, "model_differs")


#: a radius this many spreads from its replicates is reported
_OUTLIER_SPREADS: Final = 6.0


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
        for run in np.flatnonzero(known & (np.abs(np.nan_to_num(away)) > _OUTLIER_SPREADS * spread)):
            text = (
                f"the {side} radius lies {100 * away[run]:+.3f} % from its repeats, "
                f"{abs(away[run]) / spread:.0f} times "
                "their spread; look for slip, a wrong distance or a wrong load, and set excluded with a "
                "reason if found"
            )
            yield cell_note(campaign, run, f"distance_m, counts_{side}", text, "far_from_repeats")


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
            yield cell_note(campaign, run, "distance_m, counts_left, counts_right", text, "pasted_row")
        seen.setdefault(row, run)
