"""Terms that the checks share: notes on a cell, raw radii, robust spread, labels of the load."""

from __future__ import annotations

from collections.abc import Sequence
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
