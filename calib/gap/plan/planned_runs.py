"""Planned runs: what is to be driven, candidates to choose from, and runs of two campaigns joined."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, Final

import numpy as np

from calib.campaign.model import LABEL_COLUMNS, Campaign, Logs, RunTable
from calib.documents import plain_fields
from calib.errors import BadInputError
from calib.types import FloatArray

#: numbers that say something at zero too; no stop and a place over the axle's middle need no word
SHOWN_AT_ZERO: Final = frozenset({"payload_kg", "speed_mps", "temperature_C", "minutes_under_load", "distance"})
#: routes that end where they begin, heading as they did
CORRIDORS: Final = (("corridor", "out"), ("corridor", "back"))
SQUARES: Final = (("square_cw", ""), ("square_ccw", ""))
BENDS: Final = (("route_left", ""), ("route_right", ""))
CLOSED_ROUTES: Final = ("square_cw", "square_ccw", "figure8")


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """A run to drive; fields as in the run table, NaN where any value will do."""

    kind: str  #: a route; see `route_of`
    direction: str = ""  #: ``out``, ``back`` or empty
    session: str = field(default="next", metadata={"json": False})
    payload_kg: float = 0.0
    payload_x_m: float = 0.0
    payload_y_m: float = 0.0
    speed_mps: float = 0.5
    temperature_C: float = float("nan")
    minutes_under_load: float = float("nan")
    read_rolling: bool = False  #: the end is measured while the vehicle still rolls
    stops: int = 0  #: stops between start and end
    loop: str = ""  #: ``closed``: it ends on the mark where it began
    tape: bool = False  #: a corridor whose length a tape measure gives
    count: int = 1  #: how often to drive it
    columns: Mapping[str, float] = field(default_factory=dict)  #: further numeric columns
    why: str = ""  #: what the run would tell, where it is recommended
    #: then: standard deviations between the nearest confounded effects; None where no effects are confounded
    distance: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the fields that are set as plain JSON values."""
        document = plain_fields(self)
        del document["columns"]
        if self.count == 1:
            del document["count"]
        kept = {key: value for key, value in document.items() if value or (value is not None and key in SHOWN_AT_ZERO)}
        return kept | dict(self.columns)


def usual_temperature_C(campaign: Campaign) -> float:
    """Return the median temperature of a campaign, NaN where none is recorded."""
    temperature = campaign.runs.number("temperature_C")
    return float(np.nanmedian(temperature)) if np.isfinite(temperature).any() else float("nan")


def default_candidates(campaign: Campaign, *, loops: bool = False, tape: bool = False) -> list[PlannedRun]:
    """Return candidate runs over routes, directions, payloads and their place, speeds, temperatures and dwell.

    For a lab without motion capture: with `loops`, routes that end where they begin close on a mark on the floor; with
    `tape`, corridors are measured by a tape. The largest payload is the campaign's own (twice the vehicle's mass where
    it carried none); temperatures vary by 10 K where the campaign records them.
    """
    carried_kg = float(np.nan_to_num(campaign.runs.number("payload_kg")).max(initial=0.0))
    most_kg = carried_kg if carried_kg > 0.0 else 2.0 * campaign.vehicle.mass_kg
    usual_C = usual_temperature_C(campaign)
    # a payload stands on the vehicle: within a fraction of the wheelbase
    ahead, aside = 0.3 * min(1.0, campaign.vehicle.wheelbase_m), 0.15 * min(1.0, campaign.vehicle.wheelbase_m)
    payloads = [(0.0, 0.0, 0.0), (0.5 * most_kg, ahead, 0.0), (most_kg, ahead, 0.0)]
    payloads += [(0.5 * most_kg, ahead, aside), (0.5 * most_kg, ahead, -aside)]
    routes = (*CORRIDORS, *SQUARES, ("figure8", ""), *BENDS)
    candidates = [
        PlannedRun(
            kind,
            direction,
            temperature_C=usual_C,
            speed_mps=speed,
            payload_kg=payload,
            payload_x_m=x,
            payload_y_m=y,
            minutes_under_load=10.0 if payload else 0.0,
            loop="closed" if loops and kind in CLOSED_ROUTES else "",
            tape=tape and kind == "corridor",
        )
        for (kind, direction), (payload, x, y), speed in product(routes, payloads, (0.3, 0.7))
    ]
    out = PlannedRun("corridor", "out", temperature_C=usual_C, tape=tape)
    loaded = replace(out, payload_kg=most_kg, payload_x_m=ahead)
    candidates += [replace(loaded, minutes_under_load=minutes) for minutes in (1.0, 60.0)]
    candidates += [replace(out, stops=4), replace(out, speed_mps=0.7, read_rolling=True)]
    candidates += [replace(out, kind=kind) for kind in ("corridor_short", "corridor_b")]
    if np.isfinite(usual_C):
        candidates += [replace(out, temperature_C=usual_C + step) for step in (-10.0, 10.0)]
    return candidates


def joined(first: Campaign, second: Campaign) -> Campaign:
    """Return the runs of two campaigns of one vehicle as one, the second's after the first's."""
    tables, logs = (first.runs, second.runs), (first.logs, second.logs)
    if any(len(log.offsets) != len(table) + 1 for log, table in zip(logs, tables, strict=True)):
        raise BadInputError("campaigns whose numbers of logs and runs differ cannot be joined")
    names = dict.fromkeys(name for table in tables for name in table.numbers)
    columns = dict.fromkeys(name for log in logs for name in log.columns)
    runs = RunTable(
        {name: np.concatenate([table.label(name) for table in tables]) for name in LABEL_COLUMNS},
        {name: np.concatenate([table.number(name) for table in tables]) for name in names},
        np.concatenate([table.excluded for table in tables]),
        np.concatenate([table.line for table in tables]),
    )

    def column(name: str) -> FloatArray:
        return np.concatenate([log.columns.get(name, np.full(int(log.offsets[-1]), np.nan)) for log in logs])

    offsets = np.concatenate([logs[0].offsets, logs[0].offsets[-1] + logs[1].offsets[1:]])
    return replace(first, runs=runs, logs=Logs(offsets, {name: column(name) for name in columns}))
