"""Design of the campaign: assumed settings, loads and sessions, replicates."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from calib.campaign.model import Campaign, Note
from calib.types import FloatArray, StrArray

SIDES: Final = ("left", "right")
#: code of the notes about blunders
IMPLAUSIBLE: Final = "implausible"
#: a column as a whole is reported only where at least this many runs agree
LEAST_RUNS: Final = 4

#: number of a run
Run = int | np.signedinteger[Any]


def cell_note(campaign: Campaign, run: Run, column: str, text: str, code: str, level: str = "suspicious") -> Note:
    """Return a note on one cell of the run table.

    Parameters
    ----------
    campaign : Campaign
        Whose table it is.
    run : int
        Number of the run, from 0.
    column : str
        The cell's column.
    text : str
        What was found, what was expected, what to do.
    code : str
        Name of the check.
    level : str
        ``wrong``, ``suspicious`` or ``info``.
    """
    where = f"runs, row {int(campaign.runs.line[run])}, column {column}"
    return Note(level, where, text, code, str(campaign.runs.run_id[run]))


def per_rev(campaign: Campaign, side: str) -> float:
    """Return the counts per wheel revolution of one wheel."""
    return campaign.encoder.counts_per_rev_left if side == "left" else campaign.encoder.counts_per_rev_right


def raw_radius_ratio(campaign: Campaign, side: str) -> FloatArray:
    """Return distance / (2 pi turns) over the nominal radius for each run, shape (n_runs,); NaN where not measured."""
    turns = campaign.runs.number(f"counts_{side}") / per_rev(campaign, side)
    distance = np.where(campaign.runs.number("distance_m") > 0, campaign.runs.number("distance_m"), np.nan)
    with np.errstate(divide="ignore"):
        ratio = distance / (2 * np.pi * turns * campaign.vehicle.wheel_radius_m)
    return np.where(np.isfinite(ratio), ratio, np.nan)


def robust_spread(values: FloatArray) -> float:
    """Return the standard deviation that the median absolute deviation stands for; 0 without values."""
    values = values[np.isfinite(values)]
    return float(1.4826 * np.median(np.abs(values - np.median(values)))) if len(values) else 0.0


def load_label(campaign: Campaign) -> StrArray:
    """Return a label of each run's load, shape (n_runs,): the payload and its place, else the loads to 5 N."""
    runs = campaign.runs
    parts = [name for name in ("payload_kg", "payload_x_m", "payload_y_m") if name in runs.numbers]
    if "payload_kg" in parts and not np.isnan(runs.number("payload_kg")).all():
        columns = [np.round(runs.number(name), 3) for name in parts]
        empty = columns[0] == 0
        columns = [columns[0], *(np.where(empty, 0.0, column) for column in columns[1:])]
    else:
        columns = [np.round(runs.number(f"load_{side}_N") / 5.0) for side in SIDES]
    return np.asarray(["/".join(f"{value:g}" for value in row) for row in zip(*columns, strict=True)], dtype=np.str_)


def listed(names: StrArray | list[str], limit: int = 6) -> str:
    """Return names as text, shortened where there are many."""
    shown = ", ".join(str(name) for name in names[:limit])
    return shown + (f" and {len(names) - limit} more" if len(names) > limit else "")


def implausible_note(where: str, text: str) -> Note:
    """Return a finding: where it stands, and what was found, expected and is likely."""
    return Note("wrong", where, text, IMPLAUSIBLE)


def meaning(ratio: float, factors: Sequence[tuple[float, str]], tolerance: float) -> str:
    """Return what lies behind the factor that a ratio is within a relative `tolerance` of; empty where none does."""
    return next((text for factor, text in factors if abs(ratio / factor - 1) < tolerance), "")


def stated(campaign: Campaign, key: str) -> bool:
    """Return whether a setting was given, rather than assumed by a program."""
    return key not in campaign.assumed and key.partition(".")[0] not in campaign.assumed


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
