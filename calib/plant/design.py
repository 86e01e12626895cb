"""What is driven: the runs of a campaign, before anything has moved."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from calib.plant.routes import SHORT
from calib.types import BoolArray, FloatArray, IntArray, StrArray
from calib.vehicle import Vehicle


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """The runs to drive, in the order driven, and what is measured on them."""

    #: kind, direction, session: shape (n_runs,): route, ``out`` or ``back`` (corridor only, else empty), label of the
    #: session
    kind: StrArray
    direction: StrArray
    session: StrArray
    #: payload_kg, payload_x_m, payload_y_m: shape (n_runs,): payload as reported
    payload_kg: FloatArray
    payload_x_m: FloatArray
    payload_y_m: FloatArray
    #: speed_mps, temperature_C, minutes_under_load: shape (n_runs,): set speed, hall temperature, minutes since the
    #: payload was put on
    speed_mps: FloatArray
    temperature_C: FloatArray
    minutes_under_load: FloatArray
    flying: BoolArray  #: shape (n_runs,): the run is read while still rolling, without a stop at its end
    stops: IntArray  #: shape (n_runs,): stops on the way, spread evenly over the route
    #: shape (n_runs,): further numeric columns of the run table
    columns: Mapping[str, FloatArray] = field(default_factory=dict)
    #: length_m, side_m, radius_m: corridor, side and corner radius of the squares
    length_m: float = 20.0
    side_m: float = 2.5
    radius_m: float = 1.2
    vehicle: Vehicle = field(default_factory=Vehicle)  #: its nominal geometry
    counts_per_rev: float = 4096.0  #: encoder counts per wheel revolution
    slope_per_N: float = 0.0  #: relative load slope that truth and model share; 0 is a rigid wheel
    log_period_s: float = 0.2  #: time between rows of the logs; 0 means that there are no logs
    front: bool = False  #: the logs have the front wheel and the steering angle
    trace: bool = False  #: the logs have a continuous pose reference
    #: which runs have a reference end pose: ``all``, ``turning`` (all but corridor runs) or ``none``
    poses: str = "all"
    laser: bool = True  #: corridor runs have a distance by laser
    weighed: bool = False  #: the run table has weighed wheel loads
    outside: bool = False  #: the run table has an outside simulator's end poses

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def corridor(self) -> BoolArray:
        """Whether a run goes along the corridor, shape (n_runs,)."""
        straight: BoolArray = np.char.startswith(self.kind, "corridor")
        return straight

    @property
    def heading_sign(self) -> FloatArray:
        """+1 where the run starts along the map's x axis, -1 against it (``back``), shape (n_runs,)."""
        return np.where(self.direction == "back", -1.0, 1.0)

    @property
    def start_x_m(self) -> FloatArray:
        """Where the runs start on the map's x axis: ``back`` at the far end of its stretch, shape (n_runs,)."""
        stretch = self.length_m * np.where(self.kind == "corridor_short", SHORT, 1.0)
        return np.where(self.direction == "back", stretch, 0.0)

    def select(self, keep: npt.ArrayLike) -> Design:
        """Return the runs that `keep` (mask or indices, repeats allowed) picks."""
        index = np.asarray(keep)
        of_runs = [field.name for field in fields(self) if isinstance(getattr(self, field.name), np.ndarray)]
        changed: dict[str, Any] = {name: getattr(self, name)[index] for name in of_runs}
        return replace(self, **changed, columns={name: column[index] for name, column in self.columns.items()})


def conditions(design: Design) -> IntArray:
    """Return a number for each run, the same for runs driven under the same conditions, shape (n_runs,)."""
    names = ("kind", "direction", "payload_kg", "payload_x_m", "payload_y_m", "speed_mps", "stops", "flying")
    rows = ["|".join(map(str, row)) for row in zip(*(getattr(design, name) for name in names), strict=True)]
    return np.unique(np.array(rows), return_inverse=True)[1].astype(np.int64)


def lacks(design: Design, needs: Iterable[str]) -> list[str]:
    """Return what a design lacks of an effect's needs; see `calib.plant.effects.form.Form`."""
    turning = bool((~design.corridor).any())
    has = {
        "loads": len(np.unique(design.payload_kg)) > 1,
        "offsets": len(np.unique(design.payload_kg)) > 2 and len(np.unique(design.payload_y_m)) > 1,
        "turns": turning,
        "bends": len(set(design.kind[~design.corridor])) > 2,
        "speeds": len(np.unique(design.speed_mps)) > 1,
        "three_speeds": len(np.unique(design.speed_mps)) > 2,
        "temperatures": float(np.ptp(design.temperature_C)) > 5.0,
        "dwell": len(np.unique(design.minutes_under_load)) > 2,
        "sessions": len(set(design.session)) > 1,
        "directions": len(set(design.direction) & {"out", "back"}) > 1,
        "corridor": bool(design.corridor.any()),
        "laser": design.laser and bool(design.corridor.any()),
        "poses": design.poses == "all" or (design.poses == "turning" and turning),
        "front": design.front,
        "flying": bool(design.flying.any()),
        "stops": bool(design.stops.any()),
        "slope": design.slope_per_N != 0.0,
        "trace": design.trace,
        "lengths": bool((design.kind == "corridor_short").any()),
        "lanes": bool(np.char.endswith(design.kind, "_b").any()),
        "outside": design.outside,
        "no_logs": design.log_period_s == 0.0,
    }
    return sorted(
        need
        for need in needs
        if not (need.partition(":")[2] in design.columns if need.startswith("column:") else has[need])
    )
