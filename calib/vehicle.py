"""The vehicle: its geometry, mass and static wheel loads."""

from __future__ import annotations

from dataclasses import dataclass

from calib.units import GRAVITY_MPS2

__all__ = ["Vehicle"]


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
