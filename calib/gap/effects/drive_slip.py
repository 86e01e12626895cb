"""The driven front wheel slips."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from calib.campaign.model import FloatArray
from calib.gap.effects.effect import Effect, Form, Parameter
from calib.gap.effects.steering import front_travel_m, has_front, steer_rad
from calib.gap.path import Push
from calib.gap.situation import Situation

__all__ = ["DriveSlip"]


class DriveSlip(Effect):
    """The front wheel counts a share s = F_x / C more than it travels; only the front channels see it.

    The driving force is mass times acceleration (when it speeds up, or also, reversed, when the front wheel brakes),
    or rolling resistance, which goes with the weight.
    """

    id: ClassVar[str] = "drive_slip"
    title: ClassVar[str] = "slip of the driven front wheel"
    implausible: ClassVar[str] = "the front wheel's radius"

    def forms(self, s: Situation) -> list[Form]:
        """Return forms by the force that slips; none without a front wheel in the log."""
        if not has_front(s).any():
            return []
        force = s.weight_N / float(np.mean(s.weight_N))
        acceleration = _acceleration_mps2(s) * force[s.unit]
        speeding = np.maximum(acceleration, 0.0)
        # a run from rest to rest gains and loses the same by acceleration and braking
        found: list[tuple[str, FloatArray, Parameter]] = []
        per_acceleration = Parameter("slip_per_mps2", "s2/m", typical=1e-2, largest=1e-1)
        front = front_travel_m(s)
        if (np.abs(s.total(front * speeding)) > 1e-4).any():
            found.append(("speeding up", speeding, per_acceleration))
        if (np.abs(s.total(front * acceleration)) > 1e-2).any():
            found.append(("speeding up and braking", acceleration, per_acceleration))
        found.append(("rolling resistance", force[s.unit], Parameter("slip", "1", typical=1e-2, largest=5e-2)))

        def made(label: str, slip: FloatArray, parameter: Parameter) -> Form:
            reading = np.zeros((len(s), 6))
            reading[:, 4] = s.total(front * slip)
            reading[:, 5] = s.total(front * slip * np.sin(steer_rad(s))) / s.vehicle.wheelbase_m
            return Form(self.id, label, (parameter,), lambda _: [Push(reading=reading)], tries=len(found))

        return [made(*one) for one in found]


def _acceleration_mps2(s: Situation) -> FloatArray:
    """Return the acceleration in the sense of rolling in each step, over two steps each way, shape (n_steps,)."""
    speed = np.abs(s.speed_mps)
    index = np.arange(len(speed))
    before = np.maximum(index - 2, s.starts[s.unit])
    after = np.minimum(index + 2, s.starts[s.unit + 1] - 1)
    middle = s.time_s - 0.5 * s.duration_s
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = (speed[after] - speed[before]) / (middle[after] - middle[before])
    return np.where(np.isfinite(rate), rate, 0.0)
