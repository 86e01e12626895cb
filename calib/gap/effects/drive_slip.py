"""The driven front wheel slips."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from calib.arrays import FloatArray
from calib.gap.data.observations import Observations
from calib.gap.effects.effect import Effect, Form, Parameter
from calib.gap.effects.family import Family
from calib.gap.effects.steering import front_travel_m, has_front
from calib.gap.predict.push import Push

__all__ = ["DriveSlip"]


class DriveSlip(Effect):
    """The front wheel counts a share s = F_x / C more than it travels; only the front channels see it.

    A constant share looks the same as a front radius that is off, and is named so.

    The driving force is mass times acceleration (when it speeds up, or also, reversed, when the front wheel brakes) and
    rolling resistance, which goes with the weight; the stiffness C is constant or goes with the front wheel's load.
    """

    id: ClassVar[str] = "drive_slip"
    title: ClassVar[str] = "slip of the driven front wheel"
    implausible: ClassVar[str] = "the front wheel's radius"
    family: ClassVar[Family] = Family.STEERING
    needs: ClassVar[str] = "the front wheel in the log"
    separates: ClassVar[str] = "several accelerations"

    def forms(self, s: Observations) -> list[Form]:
        """Return forms by the force that slips; none without a front wheel in the log."""
        if not has_front(s).any():
            return []
        weight = s.weight_N / float(np.mean(s.weight_N))
        front_N = s.weight_N - s.number("load_left_N") - s.number("load_right_N")
        over_front = s.weight_N / np.maximum(front_N, 0.05 * s.weight_N)
        acceleration = _acceleration_mps2(s)
        speeding = np.maximum(acceleration, 0.0)
        front = front_travel_m(s)
        per_acceleration = Parameter("slip_per_mps2", "s2/m", typical=1e-2, largest=1e-1)
        rolling = Parameter("slip_rolling", "1", typical=3e-3, largest=5e-2)
        # a run from rest to rest gains and loses the same by acceleration and braking
        gains = bool((np.abs(s.total(front * speeding)) > 1e-4).any())
        unlike = bool(np.isfinite(over_front).all() and np.ptp(over_front / np.mean(over_front) / weight) > 0.02)
        constant = [np.ones(len(s.unit))]
        forces: list[tuple[str, FloatArray]] = [("by the force", weight)]
        if unlike:
            forces.append(("by the force over the front load", over_front / float(np.mean(over_front))))
        found: list[tuple[str, list[FloatArray], tuple[Parameter, ...]]] = []
        for name, force in forces:
            wide = force[s.unit]
            if gains:
                found.append((f"{name}, speeding up", [speeding * wide], (per_acceleration,)))
                both = [speeding * wide, wide]
                found.append((f"{name}, speeding up and rolling", both, (per_acceleration, rolling)))
            if (np.abs(s.total(front * acceleration * wide)) > 1e-2).any():
                both = [acceleration * wide, wide]
                found.append((f"{name}, speeding up, braking and rolling", both, (per_acceleration, rolling)))
            found.append((f"{name}, rolling", [wide], (rolling,)))

        if float(np.ptp(weight)) > 1e-9:
            found.append(("a constant share, or the front wheel's radius", constant, (rolling,)))

        def made(label: str, slips: list[FloatArray], parameters: tuple[Parameter, ...]) -> Form:
            pushes = []
            for slip in slips:
                reading = np.zeros((len(s), 6))
                reading[:, 4] = s.total(front * slip * s.steer_cos)
                reading[:, 5] = s.total(front * slip * s.steer_sin) / s.vehicle.wheelbase_m
                pushes.append(Push(reading=reading))
            return Form(self.id, label, parameters, lambda _: pushes, tries=len(found))

        return [made(*one) for one in found]


def _acceleration_mps2(s: Observations) -> FloatArray:
    """Return the acceleration in the sense of rolling in each step, over two steps each way, shape (n_steps,)."""
    speed = np.abs(s.speed_mps)
    index = np.arange(len(speed))
    before = np.maximum(index - 2, s.starts[s.unit])
    after = np.minimum(index + 2, s.starts[s.unit + 1] - 1)
    middle = s.time_s - 0.5 * s.duration_s
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = (speed[after] - speed[before]) / (middle[after] - middle[before])
    return np.where(np.isfinite(rate), rate, 0.0)
