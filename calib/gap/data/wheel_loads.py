"""The wheel loads of all runs: weighed, else by the payload."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import Campaign
from calib.vehicle import wheel_loads_N


def filled_loads(campaign: Campaign) -> tuple[FloatArray, FloatArray, bool]:
    """Return the wheel loads of all runs, each shape (n_runs,), and whether any of them is known."""
    runs, vehicle = campaign.runs, campaign.vehicle
    left, right = runs.number("load_left_N"), runs.number("load_right_N")
    payload = runs.number("payload_kg")
    known = bool(np.isfinite(left).any() and np.isfinite(right).any()) or bool(np.isfinite(payload).any())
    x, y = runs.number("payload_x_m"), runs.number("payload_y_m")
    _, by_left, by_right = wheel_loads_N(
        vehicle,
        np.nan_to_num(payload),
        np.where(np.isnan(x), vehicle.cog_x_m, x),
        np.nan_to_num(y),
    )
    return np.where(np.isnan(left), by_left, left), np.where(np.isnan(right), by_right, right), known
