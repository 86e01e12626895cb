"""How the radii follow the load under a hypothesis: what a misreported load acts through."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.gap.effects.effect import Observations, Parameter, Path
from calib.gap.effects.scales import softness
from calib.vehicle import wheel_loads_N

#: relative slope where neither the model nor the hypothesis has any
NOMINAL_PER_N: Final = 1e-5


def slope_parameters(observations: Observations) -> tuple[Parameter, ...]:
    """Return the slopes of the left and right radius against load in m/N, as an effect's parameters.

    0.1 to 1.5 % per kN on a wheel of 0.1 m is 1e-7 to 1.5e-6 m/N; more on lighter vehicles.
    """
    radius = 0.5 * (observations.model.radius_left_m + observations.model.radius_right_m) * softness(observations)
    names = ("slope_left", "slope_right")
    return tuple(Parameter(name, "m/N", typical=1e-5 * radius, largest=6e-5 * radius) for name in names)


def radius_slopes_m_per_N(path: Path, use: BoolArray | None = None) -> tuple[float, float]:
    """Return the slopes of the left and right radius against load.

    Those of the model; where it has none, those that the hypothesis gives the radii of the units `use`, shape
    (n_units,); where there are none either, `NOMINAL_PER_N` times the radius (more on
    lighter vehicles). With a nominal slope only the product
    of slope and misreported load means anything.
    """
    observations = path.s
    model, nominal_per_N = observations.model, NOMINAL_PER_N * softness(observations)
    if model.slope_left_m_per_N != 0.0 or model.slope_right_m_per_N != 0.0:
        return model.slope_left_m_per_N, model.slope_right_m_per_N
    keep = np.ones(len(observations), dtype=bool) if use is None else use
    slopes = []
    for rolled, load, radius in zip(
        path.rolling_radii_m.T,
        (observations.number("load_left_N"), observations.number("load_right_N")),
        (model.radius_left_m, model.radius_right_m),
        strict=True,
    ):
        good = keep & np.isfinite(rolled) & np.isfinite(load)
        slope = 0.0
        if good.sum() > 1 and np.ptp(load[good]) > 20.0:
            over = load[good] - load[good].mean()
            slope = float(over @ rolled[good] / (over @ over))
        slopes.append(slope if abs(slope) > 0.1 * nominal_per_N * radius else nominal_per_N * radius)
    return slopes[0], slopes[1]


def payload_load_N(observations: Observations) -> tuple[FloatArray, FloatArray]:
    """Return what the reported payload adds to the left and right wheel, each shape (n_units,) (Eqs 1 and 2)."""
    payload = np.nan_to_num(observations.number("payload_kg"))
    x, y = observations.number("payload_x_m"), observations.number("payload_y_m")
    x, y = np.where(np.isnan(x), observations.vehicle.cog_x_m, x), np.nan_to_num(y)
    _, left, right = wheel_loads_N(observations.vehicle, payload, x, y)
    _, none_left, none_right = wheel_loads_N(observations.vehicle, 0.0, 0.0, 0.0)
    return left - none_left, right - none_right
