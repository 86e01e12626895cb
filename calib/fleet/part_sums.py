"""One task: read a file of journeys and return the sums of both wheels, or the one line that says why not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.faults import Border
from calib.campaign.model import Campaign, Logs
from calib.campaign.read import loads_from_payload, read_campaign
from calib.campaign.readers import read_table
from calib.campaign.runs_file import run_table
from calib.campaign.settings_file import Settings, read_settings
from calib.errors import CalibError
from calib.fleet.members import Part
from calib.radius.effective import effective_radii
from calib.radius.session_sums import SessionSums

#: column of the run table that says the day of a run; any origin
DAY: Final = "day"


@dataclass(frozen=True, slots=True, eq=False)
class PartSums:
    """What one file of journeys comes to.

    Parameters
    ----------
    name : str
        Of the file.
    key : str
        By which the file is known again.
    reference_load_N, radius_m : float
        From which loads and radii are counted; the model's reference load, the nominal radius.
    left, right : SessionSums or None
        None where `why` says what is wrong.
    why : str
        One line; empty where the file could be used.
    """

    name: str
    key: str
    reference_load_N: float
    radius_m: float
    left: SessionSums | None
    right: SessionSums | None
    why: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        wheels = {"left": self.left, "right": self.right}
        return {
            "name": self.name,
            "key": self.key,
            "reference_load_N": self.reference_load_N,
            "radius_m": self.radius_m,
            "why": self.why,
            "wheels": {name: None if sums is None else _plain(sums) for name, sums in wheels.items()},
        }

    @staticmethod
    def from_dict(value: Mapping[str, Any]) -> PartSums:
        """Return what `to_dict` wrote."""
        left, right = (_sums(value["wheels"][name]) for name in ("left", "right"))
        return PartSums(
            str(value["name"]),
            str(value["key"]),
            float(value["reference_load_N"]),
            float(value["radius_m"]),
            left,
            right,
            str(value["why"]),
        )


def _plain(sums: SessionSums) -> dict[str, Any]:
    return {
        "session": sums.session.tolist(),
        "table": sums.table.tolist(),
        "load_min_N": sums.load_min_N,
        "load_max_N": sums.load_max_N,
    }


def _sums(value: Mapping[str, Any] | None) -> SessionSums | None:
    if value is None:
        return None
    return SessionSums(
        np.array(value["session"], dtype=np.str_),
        np.array(value["table"], dtype=np.float64).reshape(-1, 8),
        float(value["load_min_N"]),
        float(value["load_max_N"]),
    )


def sums_of_parts(parts: Sequence[Part]) -> list[PartSums]:
    """Read files of journeys and add the runs of each up by session.

    Never raises for bad input: what is wrong stands in `why`, so that one vehicle's data never stop the fleet.

    Parameters
    ----------
    parts : sequence of Part
        The files. Settings that several of them share are read once.

    Returns
    -------
    list of PartSums
        One a file.
    """
    settings: dict[Path, Settings] = {}
    return [_sums_of_part(part, settings) for part in parts]


def _sums_of_part(part: Part, settings: dict[Path, Settings]) -> PartSums:
    key = ""
    try:
        key = part.key
        campaign = campaign_of(part, settings)
        radii = effective_radii(campaign)
    except (CalibError, OSError) as error:
        return PartSums(part.name, key, 0.0, 0.0, None, None, " ".join(str(error).split()))
    day = _days(campaign, radii.run_id, part)
    reference, nominal = campaign.model.reference_load_N, campaign.vehicle.wheel_radius_m
    session = np.where(radii.session == "", part.name, radii.session)
    left, right = (
        SessionSums.from_runs(session, load - reference, radius - nominal, day)
        for load, radius in (
            (radii.load_left_N, radii.radius_left_m),
            (radii.load_right_N, radii.radius_right_m),
        )
    )
    return PartSums(part.name, key, reference, nominal, left, right)


def campaign_of(part: Part, settings: dict[Path, Settings] | None = None) -> Campaign:
    """Return the campaign of a file of journeys; tables of a dataset take the fleet's settings and have no logs.

    Parameters
    ----------
    part : Part
        The file.
    settings : dict of Path to Settings, optional
        Settings read before, by folder; those read now are added.

    Raises
    ------
    CalibError
        Where something cannot be used.
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
    return shared.campaign(runs, Logs.empty(len(runs)), root=part.settings, notes=tuple(border.notes))


def _days(campaign: Campaign, run_id: Any, part: Part) -> FloatArray:
    """Return the day of each run used, shape (n_runs,); 0 where none is known."""
    days = campaign.runs.number(DAY)
    if len(run_id) < len(days):
        days = days[np.isin(campaign.runs.run_id, run_id)]
    return np.where(np.isfinite(days), days, 0.0 if part.day is None else part.day)
