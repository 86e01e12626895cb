"""The parameters of a vehicle's odometry: name, nominal value, and how well the nominal value is known beforehand."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import FloatArray

#: pose of the reference's sensor on the vehicle, and the time by which its stamps lag behind the encoders'
SENSOR: Final = ("sensor_x_m", "sensor_y_m", "sensor_yaw_rad", "delay_s")

#: how far a lever arm, an angle and a delay may be from what the settings say
SENSOR_STD: Final = {"sensor_x_m": 0.2, "sensor_y_m": 0.2, "sensor_yaw_rad": 0.5, "delay_s": 0.2}


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter: its name, which ends in its unit, its nominal value, and the spread of what is possible."""

    #: for example ``track_m``
    name: str
    #: value before the calibration
    nominal: float
    #: standard deviation of the true value about the nominal one, before any data; it scales the parameter, and data
    #: that do not do clearly better leave the parameter undetermined
    prior_std: float


@dataclass(frozen=True, slots=True, eq=False)
class Parameters:
    """Parameters in a fixed order, with those that are to be estimated."""

    #: all parameters of drive and sensor
    items: tuple[Parameter, ...]
    #: which are estimated; the others stay at their nominal value, shape (n_parameters,)
    free: np.ndarray[tuple[int], np.dtype[np.bool_]]

    @staticmethod
    def of(items: Sequence[Parameter], free: Iterable[str]) -> Parameters:
        """Return parameters of which those named in `free` are estimated."""
        names = set(free)
        return Parameters(tuple(items), np.array([item.name in names for item in items], dtype=np.bool_))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        return tuple(item.name for item in self.items)

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the parameters that are estimated."""
        return tuple(name for name, free in zip(self.names, self.free, strict=True) if free)

    @property
    def nominal(self) -> FloatArray:
        """Nominal values, shape (n_parameters,)."""
        return np.array([item.nominal for item in self.items])

    @property
    def prior_std(self) -> FloatArray:
        """Spread of what is possible, shape (n_parameters,)."""
        return np.array([item.prior_std for item in self.items])

    def without(self, names: Iterable[str]) -> Parameters:
        """Return the parameters with those in `names` held at their nominal value."""
        held = set(names)
        return Parameters.of(self.items, (name for name in self.free_names if name not in held))

    def mapping(self, values: FloatArray) -> Mapping[str, float]:
        """Return values by name."""
        return {name: float(value) for name, value in zip(self.names, values, strict=True)}


def sensor_parameters(x_m: float, y_m: float, yaw_rad: float) -> tuple[Parameter, ...]:
    """Return the parameters of the reference's sensor, centred on what the settings say of it."""
    nominal = dict(zip(SENSOR, (x_m, y_m, yaw_rad, 0.0), strict=True))
    return tuple(Parameter(name, nominal[name], SENSOR_STD[name]) for name in SENSOR)
