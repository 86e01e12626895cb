"""Campaigns that are not driven: read from ``PLAN.toml``, or the demonstration that excites nearly every effect."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calib.campaign.model import Campaign, Logs, RunTable
from calib.campaign.settings import Encoder, OdometryModel, Rangefinder, Reference
from calib.campaign.settings_file import load_toml, parse_settings
from calib.errors import PLANNED_RUNS, BadFileError, BadInputError, refuse_beyond
from calib.gap.plan.planned_runs import (
    BENDS,
    CORRIDORS,
    DEFAULT_CORRIDOR_M,
    SQUARES,
    Measured,
    PlannedRun,
    drive,
    route_of,
)
from calib.vehicle import Vehicle

FORMAT: Final = "calib-plan/1"
#: sensors that drive the odometry without rear encoders -> what only a log holds of them
_IN_LOG_ONLY: Final = {
    "front": "the front wheel and its angle",
    "wheels": "the counts of the four wheels",
    "shaft": "the steering angle",
}
#: wider than any run: what is beyond is a typing error
_Size = Annotated[float, Field(ge=-1e6, le=1e6)]
_NotNegative = Annotated[float, Field(ge=0.0, le=1e6)]


class _Strict(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)


_Section = TypeVar("_Section", bound=_Strict)


class _MeasuredSection(_Strict):
    """``[measured]`` of a plan."""

    distance: bool = True
    poses: bool = True
    position: bool = False
    heading: bool = False
    front: bool = False
    log: bool = True
    gyro: bool = False
    corridor_m: float = Field(DEFAULT_CORRIDOR_M, ge=1.0, le=1000.0)


class _RunEntry(_Strict):
    """``[[runs]]`` of a plan; what has no field is a numeric column."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Annotated[float, Field(ge=-1e12, le=1e12)]]

    kind: str
    count: int = Field(1, ge=1)
    direction: Literal["", "out", "back"] = ""
    session: str = ""
    loop: Literal["", "closed"] = ""
    tape: bool = False
    payload_kg: _NotNegative = 0.0
    payload_x_m: _Size = 0.0
    payload_y_m: _Size = 0.0
    speed_mps: float = Field(0.5, ge=1e-3, le=1e6)
    temperature_C: _Size = 0.0
    minutes_under_load: _NotNegative = 0.0
    read_rolling: bool = False
    stops: int = Field(0, ge=0, le=100)

    def run(self) -> PlannedRun:
        """Return the run; what the entry leaves out is as in `PlannedRun`."""
        columns = self.__pydantic_extra__
        return PlannedRun(**self.model_dump(exclude_unset=True, exclude={"count", *columns}), columns=columns)


def read_plan(path: Path) -> Campaign:
    """Return the campaign that a plan would give if the vehicle were exactly as its model.

    `path`: the plan: ``format = "calib-plan/1"``, the sections of ``campaign.toml``, ``[measured]`` with ``distance``,
    ``poses`` (or ``position``, ``heading`` alone), ``front``, ``log``, ``gyro`` (true or false) and ``corridor_m``, and
    ``[[runs]]``, each with ``kind``, where wanted ``count`` and the columns of the run table, ``stops``,
    ``read_rolling``, ``tape``.

    Raises
    ------
    BadFileError
        Where the file cannot be used.
    """
    document = _load(path)
    runs = _runs(document.pop("runs", None), path)
    section = document.pop("measured", {})
    measured = _validated(_MeasuredSection, section, path, "measured")
    position, heading = measured.poses or measured.position, measured.poses or measured.heading
    closed_or_taped = any(run.loop or run.tape for run in runs)
    if not (measured.distance or position or heading or measured.gyro or closed_or_taped):
        raise _wrong(path, "measured", section, "distance, poses or gyro to be true, else nothing is measured")
    settings = parse_settings(document, str(path), path.stem)
    if settings.odometry.source in _IN_LOG_ONLY and not measured.log:
        only = _IN_LOG_ONLY[settings.odometry.source]
        raise _wrong(path, "measured.log", False, f"true: without a log there is no record of {only}")
    by = Measured(measured.distance, position, heading, measured.front, measured.log, measured.gyro)
    return drive(replace(settings, simulated=True), runs, by, measured.corridor_m)


def read_candidates(path: Path) -> list[PlannedRun]:
    """Return the runs to choose from: a file with ``[[runs]]`` as in a plan; ``count`` has no effect."""
    return list({repr(run): run for run in _runs(_load(path).get("runs"), path)}.values())


def _load(path: Path) -> dict[str, Any]:
    document = load_toml(path, str(path))
    stated = document.pop("format", FORMAT)
    if stated != FORMAT:
        raise BadFileError(
            path, column="format", found=repr(stated)[:60], expected=repr(FORMAT), remedy="give a plan of runs"
        )
    return document


def _runs(section: object, path: Path) -> list[PlannedRun]:
    if not isinstance(section, list) or not section:
        raise _wrong(path, "runs", section, "one [[runs]] or more")
    runs: list[PlannedRun] = []
    for number, table in enumerate(section, start=1):
        where = f"runs[{number}]"
        entry = _validated(_RunEntry, table, path, where)
        # before so many runs take memory
        remedy = "plan fewer, or judge the plan in parts"
        refuse_beyond(len(runs) + entry.count, PLANNED_RUNS, shown=str(path), what="runs", remedy=remedy, column=where)
        try:
            route_of(entry.kind)
        except BadInputError as error:
            expected = str(error).partition("expected ")[2].partition(";")[0]
            raise _wrong(path, f"{where}.kind", entry.kind, expected) from error
        runs += [entry.run()] * entry.count
    return runs


def _validated(kind: type[_Section], table: object, path: Path, where: str) -> _Section:
    if not isinstance(table, dict):
        raise _wrong(path, where, table, "a table")
    try:
        return kind.model_validate(table)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        column = ".".join([where, *(str(part) for part in first["loc"])])
        if first["type"] == "missing":
            raise _wrong(path, column, None, "a value") from error
        known = f"one of {', '.join(kind.model_fields)}" if first["type"] == "extra_forbidden" else ""
        raise _wrong(path, column, first["input"], known or first["msg"].removeprefix("Input should be ")) from error


def _wrong(path: Path, column: str, found: object, expected: str) -> BadFileError:
    shown = str(found).lower() if isinstance(found, bool) else repr(found)
    return BadFileError(path, column=column, found=shown[:60], expected=expected, remedy="correct the plan")


#: route and direction of six runs, driven in three sessions under changing conditions
ROUTES: Final = (*CORRIDORS, *SQUARES, *BENDS)
SESSIONS: Final = ("mon", "tue", "wed")
#: payload, its place ahead of the axle and left of the middle
PAYLOADS: Final = ((0.0, 0.0, 0.0), (100.0, 0.3, -0.1), (200.0, 0.2, 0.0), (100.0, 0.3, 0.1))
SPEEDS_MPS: Final = (0.3, 0.5, 0.6)
TEMPERATURES_C: Final = (14.0, 18.0, 23.0)
UNDER_LOAD_MIN: Final = (0.0, 3.0, 15.0, 40.0)


def demonstration() -> Campaign:
    """Return 36 noise-free runs of a nominal vehicle: a corridor both ways, squares and curved routes.

    Loads, speeds, temperatures, time under load and stops vary; laser, end poses and the front wheel are measured, and
    one end in five is read while the vehicle rolls.
    """
    radius_m, track_m = 0.100, 0.700
    nominal = Campaign(
        root=None,
        name="demonstration",
        simulated=True,
        vehicle=Vehicle(track_m=track_m, wheelbase_m=1.0, wheel_radius_m=radius_m, mass_kg=100.0, cog_x_m=0.388),
        encoder=Encoder(),
        model=OdometryModel(radius_m, radius_m, track_m, reference_load_N=300.0),
        rangefinder=Rangefinder(),
        reference=Reference(),
        runs=RunTable.empty(),
        logs=Logs.empty(0),
    )
    runs = [_demonstrated(number) for number in range(2 * len(SESSIONS) * len(ROUTES))]
    return drive(nominal, runs, Measured(front=True), DEFAULT_CORRIDOR_M)


def _demonstrated(number: int) -> PlannedRun:
    """Return a run of the demonstration: neighbours differ in every condition."""
    lap, (kind, direction) = number // len(ROUTES), ROUTES[number % len(ROUTES)]
    # a second, shorter lane on every other lap
    kind += "_short" if kind == "corridor" and lap % 2 else ""
    payload_kg, payload_x_m, payload_y_m = PAYLOADS[(number + lap) % len(PAYLOADS)]
    return PlannedRun(
        kind=kind,
        direction=direction,
        session=SESSIONS[lap // 2],
        payload_kg=payload_kg,
        payload_x_m=payload_x_m,
        payload_y_m=payload_y_m,
        speed_mps=SPEEDS_MPS[(number + number // 4) % len(SPEEDS_MPS)],
        temperature_C=TEMPERATURES_C[(lap + number // 3) % len(TEMPERATURES_C)],
        minutes_under_load=UNDER_LOAD_MIN[(2 * lap + number) % len(UNDER_LOAD_MIN)],
        read_rolling=number % 5 == 0,
        stops=number % 3,
    )
