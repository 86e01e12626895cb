"""The vehicle: its geometry, mass and static wheel loads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calib.units import GRAVITY_MPS2

__all__ = ["Vehicle", "wheel_loads_N"]

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Geometry and mass of a vehicle with a driven, steered front wheel and two free rear wheels.

    The origin is the middle of the rear axle, x forward, y left, yaw counter-clockwise (REP-103).

    Parameters
    ----------
    track_m : float
        Distance between the contact points of the rear wheels.
    wheelbase_m : float
        Rear axle to front wheel.
    wheel_radius_m : float
        Nominal free radius of the rear wheels.
    mass_kg : float
        Mass without payload.
    cog_x_m, cog_y_m : float
        Centre of mass without payload, ahead of the rear axle and left of the centre line.
    cog_z_m : float
        Height of the centre of mass above the floor.
    max_wheel_load_N : float
        Permissible wheel load.
    """

    track_m: float = 0.700
    wheelbase_m: float = 1.000
    wheel_radius_m: float = 0.100
    mass_kg: float = 100.0
    cog_x_m: float = 0.388
    cog_y_m: float = 0.0
    cog_z_m: float = 0.4
    max_wheel_load_N: float = 5000.0

    @property
    def unladen_load_N(self) -> float:
        """Mean load of a rear wheel without payload (Eqs 1 and 2 plus the force balance)."""
        return 0.5 * self.mass_kg * GRAVITY_MPS2 * (1.0 - self.cog_x_m / self.wheelbase_m)


def wheel_loads_N(
    vehicle: Vehicle, payload_kg: npt.ArrayLike, payload_x_m: npt.ArrayLike, payload_y_m: npt.ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the static loads of the front, left and right wheel (Eqs 1 and 2 plus the force balance).

    Moments about the rear axle and about its centre line; the vehicle's own centre of mass may stand off the centre
    line. With ``cog_y_m = 0`` and ``y_paper = y + track / 2`` these are the paper's equations.

    Parameters
    ----------
    vehicle : Vehicle
        Geometry and mass.
    payload_kg, payload_x_m, payload_y_m : array_like of float
        Payload, its distance ahead of the rear axle, and left of the centre line; any shapes that broadcast. A negative
        result means that a wheel would lift off.

    Returns
    -------
    front_N, left_N, right_N : array of float
        Wheel loads, of the broadcast shape.
    """
    mass, x, y = np.broadcast_arrays(
        np.asarray(payload_kg, dtype=np.float64),
        np.asarray(payload_x_m, dtype=np.float64),
        np.asarray(payload_y_m, dtype=np.float64),
    )
    weight = (vehicle.mass_kg + mass) * GRAVITY_MPS2
    front = (vehicle.mass_kg * vehicle.cog_x_m + mass * x) * GRAVITY_MPS2 / vehicle.wheelbase_m
    roll = (vehicle.mass_kg * vehicle.cog_y_m + mass * y) * GRAVITY_MPS2 / vehicle.track_m
    rear = weight - front
    return front, 0.5 * rear + roll, 0.5 * rear - roll
