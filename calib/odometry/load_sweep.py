"""Static wheel loads over a sweep of a payload, and the vehicle that carries it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.errors import BadInputError
from calib.limits import SWEEP_VALUES
from calib.types import FloatArray
from calib.vehicle import Vehicle, check_wheel_loads, wheel_loads_N


def vehicle_of(source: Path | None, **changes: float | None) -> Vehicle:
    """Return the vehicle of a campaign folder or coefficient file (None: the nominal one), with the changes given."""
    vehicle = Vehicle()
    if source is not None:
        if source.is_dir():
            from calib.campaign.read import read_campaign

            vehicle = read_campaign(source, logs=False).vehicle
        else:
            from calib.coefficients.file import load_coefficients

            vehicle = load_coefficients(source).geometry
    given: dict[str, Any] = {name: value for name, value in changes.items() if value is not None}
    for name, value in given.items():
        if not math.isfinite(value) or (not name.startswith("cog") and value <= 0.0):
            raise BadInputError(f"{name}: found {value!r}; expected a finite number above 0; correct it")
    return replace(vehicle, **given)


#: what can be swept -> unit
SWEPT: Final = {"payload_kg": "kg", "payload_x_m": "m", "payload_y_m": "m"}


@dataclass(frozen=True, slots=True, eq=False)
class LoadSweep:
    """Wheel loads over a sweep."""

    swept: str  #: what varies, of `SWEPT`; empty for a single payload
    #: payload_kg, payload_x_m, payload_y_m: shape (n,): payloads
    payload_kg: FloatArray
    payload_x_m: FloatArray
    payload_y_m: FloatArray
    #: front_N, left_N, right_N: shape (n,): wheel loads
    front_N: FloatArray
    left_N: FloatArray
    right_N: FloatArray

    def rows(self) -> list[dict[str, float]]:
        """Return one row a payload, with the sum of the loads."""
        names = ("payload_kg", "payload_x_m", "payload_y_m", "front_N", "left_N", "right_N")
        columns = np.stack([getattr(self, name) for name in names], axis=1).tolist()
        return [dict(zip(names, row, strict=True)) | {"total_N": sum(row[3:])} for row in columns]


def sweep_loads(
    vehicle: Vehicle,
    payload_kg: float,
    payload_x_m: float,
    payload_y_m: float,
    *,
    swept: str = "",
    span: tuple[float, float] = (0.0, 0.0),
    steps: int = 21,
) -> LoadSweep:
    """Return the wheel loads of one payload, or of a sweep of its mass or place.

    Parameters
    ----------
    vehicle : Vehicle
        Geometry and mass.
    payload_kg, payload_x_m, payload_y_m : float
        Payload; the swept one is not used.
    swept : str
        What varies, of `SWEPT`; empty for a single payload.
    span : (float, float)
        First and last value.
    steps : int
        Values, both ends included.

    Raises
    ------
    RefusedError
        Where the vehicle would tip or a wheel carry too much; names the payload at which.
    """
    values = {"payload_kg": payload_kg, "payload_x_m": payload_x_m, "payload_y_m": payload_y_m}
    if swept and (swept not in SWEPT or not 2 <= steps <= SWEEP_VALUES):
        raise BadInputError(
            f"sweep: found {swept!r} in {steps} steps; expected {', '.join(SWEPT)} in 2 to {SWEEP_VALUES} steps"
        )
    count = steps if swept else 1
    columns = {name: np.full(count, value) for name, value in values.items()}
    if swept:
        columns[swept] = np.linspace(span[0], span[1], steps)
    if not all(np.isfinite(column).all() for column in columns.values()) or (columns["payload_kg"] < 0.0).any():
        raise BadInputError("payload: found a negative or infinite value; expected a mass from 0 kg and a place in m")
    front, left, right = wheel_loads_N(vehicle, columns["payload_kg"], columns["payload_x_m"], columns["payload_y_m"])
    # name the first payload that cannot be carried, not the extremes of all of them
    bad = (np.minimum(np.minimum(front, left), right) <= 0.0) | (
        np.maximum(np.maximum(front, left), right) > vehicle.max_wheel_load_N
    )
    if bad.any():
        k = int(np.argmax(bad))
        mass, x, y = (float(column[k]) for column in columns.values())
        where = f"payload {mass:g} kg at x {x:g} m, y {y:g} m"
        check_wheel_loads(vehicle, front[k], left[k], right[k], what=where)
    return LoadSweep(swept, columns["payload_kg"], columns["payload_x_m"], columns["payload_y_m"], front, left, right)
