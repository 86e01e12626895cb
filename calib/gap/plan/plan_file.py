"""Read ``PLAN.toml``: a vehicle as in ``campaign.toml``, what is measured, and the runs that are planned."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.campaign.model import Campaign, Logs, RunTable
from calib.campaign.settings_file import load_toml, parse_settings
from calib.errors import BadFileError, BadInputError
from calib.gap.plan.planned_runs import DEFAULT_CORRIDOR_M, Measured, PlannedRun, drive, route_of
from calib.limits import PLANNED_RUNS, refuse_beyond

FORMAT: Final = "calib-plan/1"
_TEXTS: Final = ("kind", "direction", "session")
_NUMBERS: Final = (
    "payload_kg",
    "payload_x_m",
    "payload_y_m",
    "speed_mps",
    "temperature_C",
    "minutes_under_load",
)
#: sensors that drive the odometry without rear encoders -> what only a log holds of them
_ALONG_THE_WAY: Final = {
    "front": "a front wheel is counted, and its angle read,",
    "wheels": "four wheels are counted",
}
_MEASURED: Final = tuple(field.name for field in fields(Measured))


def read_plan(path: Path) -> Campaign:
    """Return the campaign that a plan would make if the vehicle were as its model says.

    Parameters
    ----------
    path : Path
        The plan: ``format = "calib-plan/1"``, the sections of ``campaign.toml``, ``[measured]`` with ``distance``,
        ``poses``, ``front``, ``log`` (true or false) and ``corridor_m``, and ``[[runs]]``, each with ``kind``, where
        wanted ``count`` and the columns of the run table, ``stops``, ``read_rolling``.

    Raises
    ------
    BadFileError
        Where the file cannot be used.
    """
    document = load_toml(path, str(path))
    _format(document, path)
    runs = _runs(document.pop("runs", None), path)
    measured, corridor_m = _measured(document.pop("measured", {}), path)
    settings = parse_settings(document, str(path), path.stem)
    if settings.odometry.source in _ALONG_THE_WAY and not measured.log:
        counted = _ALONG_THE_WAY[settings.odometry.source]
        raise _wrong(path, "measured.log", False, f"true: {counted} along the way only, so nothing goes without a log")
    nothing = RunTable({"run_id": np.zeros(0, dtype=np.str_)}, {}, np.zeros(0, dtype=bool), np.zeros(0, dtype=np.int64))
    bare = settings.campaign(nothing, Logs.empty(0), simulated=True, notes=settings.notes)
    return drive(bare, runs, measured, corridor_m)


def read_candidates(path: Path) -> list[PlannedRun]:
    """Return the runs of a list to choose from: a file with ``[[runs]]`` as in a plan; ``count`` is passed over."""
    document = load_toml(path, str(path))
    _format(document, path)
    runs = _runs(document.get("runs"), path)
    return list({repr(run): run for run in runs}.values())


def _format(document: dict[str, Any], path: Path) -> None:
    found = document.pop("format", FORMAT)
    if found != FORMAT:
        raise BadFileError(
            path, column="format", found=repr(found)[:60], expected=repr(FORMAT), remedy="give a plan of runs"
        )


def _wrong(path: Path, column: str, found: object, expected: str) -> BadFileError:
    shown = str(found).lower() if isinstance(found, bool) else repr(found)
    return BadFileError(path, column=column, found=shown[:60], expected=expected, remedy="correct the plan")


def _measured(section: object, path: Path) -> tuple[Measured, float]:
    if not isinstance(section, Mapping):
        raise _wrong(path, "measured", section, "a section [measured]")
    flags: dict[str, bool] = {}
    corridor_m = DEFAULT_CORRIDOR_M
    for key, value in section.items():
        if key in _MEASURED and isinstance(value, bool):
            flags[key] = value
        elif key == "corridor_m":
            corridor_m = _number(path, "measured.corridor_m", value, low=1.0, high=1000.0)
        else:
            raise _wrong(path, f"measured.{key}", value, f"{', '.join(_MEASURED)} (true or false), or corridor_m")
    measured = Measured(**flags)
    if not (measured.distance or measured.poses):
        raise _wrong(path, "measured", dict(section), "distance or poses to be true, else nothing is measured")
    return measured, corridor_m


def _runs(section: object, path: Path) -> list[PlannedRun]:
    if not isinstance(section, list) or not section:
        raise _wrong(path, "runs", section, "one [[runs]] or more")
    runs: list[PlannedRun] = []
    for number, entry in enumerate(section, start=1):
        where = f"runs[{number}]"
        if not isinstance(entry, Mapping):
            raise _wrong(path, where, entry, "a table [[runs]]")
        count = entry.get("count", 1)
        if isinstance(count, bool) or not isinstance(count, int) or count < 1:
            raise _wrong(path, f"{where}.count", count, "a whole number from 1")
        # before they are made
        remedy = "plan fewer, or judge the plan in parts"
        refuse_beyond(len(runs) + count, PLANNED_RUNS, shown=str(path), what="runs", remedy=remedy, column=where)
        runs += [_run(path, where, entry)] * count
    return runs


def _run(path: Path, where: str, entry: Mapping[str, Any]) -> PlannedRun:
    given: dict[str, Any] = {}
    columns: dict[str, float] = {}
    for key, value in entry.items():
        column = f"{where}.{key}"
        if key == "count":
            continue
        if key in _TEXTS:
            if not isinstance(value, str):
                raise _wrong(path, column, value, "a text")
            given[key] = value
        elif key == "read_rolling":
            if not isinstance(value, bool):
                raise _wrong(path, column, value, "true or false")
            given[key] = value
        elif key == "stops":
            if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= 100:
                raise _wrong(path, column, value, "a whole number from 0 to 100")
            given[key] = value
        elif key in _NUMBERS:
            low = {"payload_kg": 0.0, "speed_mps": 1e-3, "minutes_under_load": 0.0}.get(key, -1e6)
            given[key] = _number(path, column, value, low=low, high=1e6)
        else:
            columns[key] = _number(path, column, value, low=-1e12, high=1e12)
    if "kind" not in given:
        raise _wrong(path, f"{where}.kind", None, "the name of a route")
    if given.get("direction", "") not in {"", "out", "back"}:
        raise _wrong(path, f"{where}.direction", given["direction"], "out or back")
    try:
        route_of(given["kind"])
    except BadInputError as error:
        expected = str(error).partition("expected ")[2].partition(";")[0]
        raise _wrong(path, f"{where}.kind", given["kind"], expected) from error
    return PlannedRun(**given, columns=columns)


def _number(path: Path, column: str, value: object, *, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise _wrong(path, column, value, "a finite number")
    if not low <= value <= high:
        raise _wrong(path, column, value, f"a number from {low:g} to {high:g}")
    return float(value)
