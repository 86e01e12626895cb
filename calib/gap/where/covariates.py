"""What the gap may depend on: the covariates of each unit."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import FloatArray, StrArray
from calib.gap.data.channels import Channel
from calib.gap.data.observations import Observations
from calib.gap.effects.covariate import covariate_columns
from calib.gap.effects.shapes import driven_speed_mps

#: with fewer known values nothing is asked of a covariate
FEWEST_UNITS: Final = 6
#: turns and lengths that differ by less are noise of the wheels themselves, which the gap shares
LEAST_TURN_RAD: Final = 0.3
LEAST_LENGTH: Final = 0.05


def covariate_values(observations: Observations) -> dict[str, FloatArray | StrArray]:
    """Return what the gap may depend on, by name, each shape (n_units,): numbers, or labels as text.

    Missing numbers are NaN, missing labels empty. Only what varies is listed.
    """
    load_left, load_right = observations.number("load_left_N"), observations.number("load_right_N")
    by_wheels = observations.total(observations.turn_rad)
    # by the reference where there is one: the wheels' own turn shares the gap's errors
    turn = np.where(observations.usable[:, Channel.HEADING], observations.measured[:, Channel.HEADING], by_wheels)
    speed = observations.number("speed_mps")
    values: dict[str, FloatArray | StrArray] = {
        "route": observations.labels["kind"],
        "session": observations.labels["session"],
        "direction": observations.labels["direction"],
        "payload_kg": observations.number("payload_kg"),
        "load_left_N": load_left,
        "load_right_N": load_right,
        "load_sum_N": load_left + load_right,
        "load_difference_N": load_right - load_left,
        "speed_mps": speed if np.isfinite(speed).any() else driven_speed_mps(observations),
        "temperature_C": observations.number("temperature_C"),
        "minutes_under_load": observations.number("minutes_under_load"),
        "travelled_km": observations.number("travelled_km"),
    }
    if np.ptp(turn) > LEAST_TURN_RAD:
        values["turn"] = turn
        values["turn_absolute"] = np.maximum(
            observations.total(np.abs(observations.turn_rad)) - np.abs(by_wheels - turn), 0.0
        )
    if np.ptp(observations.length_m) > LEAST_LENGTH * float(np.max(observations.length_m)):
        values["length_m"] = observations.length_m
    for name in ("amplitude_m", "wavelength_m", *covariate_columns(observations)):
        values[name] = observations.number(name)
    return {name: column for name, column in values.items() if _varied(column)}


def _varied(values: FloatArray | StrArray) -> bool:
    if values.dtype.kind == "f":
        known = values[np.isfinite(values)]
        return len(known) >= FEWEST_UNITS and float(np.ptp(known)) > 1e-9 * max(float(np.abs(known).max()), 1e-9)
    return len(np.unique(values[values != ""])) > 1
