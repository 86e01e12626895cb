"""Reading a fleet: files of runs to sums by session, and from these a vehicle's record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign.model import Border, Campaign, Logs
from calib.campaign.read import loads_from_payload, read_campaign
from calib.campaign.readers import read_table
from calib.campaign.runs_file import run_table
from calib.campaign.settings_file import read_settings
from calib.errors import CalibError
from calib.fleet.store import Kept, Keys, Part, one_line
from calib.fleet.vehicle import PartSums, VehicleRecord, WheelSums, record_of
from calib.radius.effective import effective_radii
from calib.types import FloatArray, StrArray

#: column of the run table that gives the day of a run; any origin
DAY: Final = "day"


def sums_of_parts(parts: Sequence[Part]) -> list[Kept]:
    """Read files of journeys and add the runs of each up by session; settings that several share are read once.

    Never raises for bad input: what is wrong is in `why`, so that one vehicle's data never stop the fleet.
    """
    settings: dict[Path, Campaign] = {}
    keys = Keys()
    return [Kept.of(_sums_of_part(part, settings, keys)) for part in parts]


def _sums_of_part(part: Part, settings: dict[Path, Campaign], keys: Keys) -> PartSums:
    key = ""
    try:
        key = keys.of(part)
        campaign = campaign_of(part, settings)
        radii = effective_radii(campaign)
    except (CalibError, OSError) as error:
        return PartSums(part.name, key, 0.0, 0.0, None, None, one_line(error))
    day = _days(campaign, radii.run_id, part)
    reference, nominal = campaign.model.reference_load_N, campaign.vehicle.wheel_radius_m
    session = np.where(radii.session == "", part.name, radii.session)
    left = WheelSums.from_runs(session, radii.load_left_N - reference, radii.radius_left_m - nominal, day)
    right = WheelSums.from_runs(session, radii.load_right_N - reference, radii.radius_right_m - nominal, day)
    return PartSums(part.name, key, reference, nominal, left, right)


def campaign_of(part: Part, settings: dict[Path, Campaign] | None = None) -> Campaign:
    """Return the campaign of a file of journeys; tables of a dataset take the fleet's settings and have no logs.

    `settings`: those read before, by folder; those read now are added. Raises CalibError where it cannot be used.
    """
    if part.path.parent == part.settings:
        return read_campaign(part.settings)
    known = {} if settings is None else settings
    if part.settings not in known:
        known[part.settings] = read_settings(part.settings / "campaign.toml", "campaign.toml")
    shared = known[part.settings]
    border = Border(lenient=False)
    runs = run_table(read_table(part.path, part.name), part.name, border)
    computed = dict(zip(("load_left_N", "load_right_N"), loads_from_payload(shared.vehicle, runs), strict=True))
    filled = {name: np.where(np.isnan(runs.number(name)), load, runs.number(name)) for name, load in computed.items()}
    runs = replace(runs, numbers={**runs.numbers, **filled})
    return replace(shared, root=part.settings, runs=runs, logs=Logs.empty(len(runs)), notes=tuple(border.notes))


def _days(campaign: Campaign, run_id: StrArray, part: Part) -> FloatArray:
    """Return the day of each run used, shape (n_runs,); 0 where none is known."""
    days = campaign.runs.number(DAY)
    if len(run_id) < len(days):
        days = days[np.isin(campaign.runs.run_id, run_id)]
    return np.where(np.isfinite(days), days, 0.0 if part.day is None else part.day)


def sums_given_up(part: Part, why: str) -> Kept:
    """Return the record of a file that took its worker down; it is tried again by the next run."""
    return Kept.of(PartSums(part.name, "", 0.0, 0.0, None, None, why))


#: a vehicle's id, and what is kept of its files
Vehicle = tuple[str, Sequence[Kept]]


def records_of(vehicles: Sequence[Vehicle]) -> list[VehicleRecord]:
    """Return the records of vehicles from the sums of their files."""
    return [record_of(name, [PartSums.from_dict(kept.values()) for kept in parts]) for name, parts in vehicles]


def record_given_up(vehicle: Vehicle, why: str) -> VehicleRecord:
    """Return the record of a vehicle that took its worker down."""
    return VehicleRecord(vehicle[0], 0, 0.0, None, None, why)
