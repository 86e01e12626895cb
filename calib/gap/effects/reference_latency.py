"""The reference is late: a vehicle that still rolls is seen where it was."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from calib.gap.data.observations import Observations
from calib.gap.effects.effect import Effect, Form, Parameter
from calib.gap.effects.family import Family
from calib.gap.effects.shapes import end_motion
from calib.gap.predict.push import Push

__all__ = ["ReferenceLatency"]


class ReferenceLatency(Effect):
    """The reading is tau old: e_s = -tau v_end and e_theta = -tau omega_end."""

    id: ClassVar[str] = "reference_latency"
    title: ClassVar[str] = "a reference that reads late"
    implausible: ClassVar[str] = "an offset, or radii that follow the speed"
    family: ClassVar[Family] = Family.REFERENCE
    needs: ClassVar[str] = "readings taken while it rolls"
    separates: ClassVar[str] = "readings after the stop beside readings on the move"

    def forms(self, s: Observations) -> list[Form]:
        """Return forms by instrument (end pose, laser, both); none where every run stands still when it is read."""
        speed, rate = end_motion(s)
        rolls = np.abs(speed) > 0.01
        has_pose = bool((s.usable[:, 1:4].any(axis=1) & rolls).any())
        has_laser = bool((s.usable[:, 0] & rolls).any())
        wanted = [("end pose", has_pose, True, False), ("laser", has_laser, False, True)]
        wanted.append(("end pose and laser", has_pose and has_laser, True, True))
        parameter = Parameter("latency", "s", typical=5e-2, largest=5e-1)
        tries = sum(one[1] for one in wanted)

        def made(label: str, pose: bool, laser: bool) -> Form:
            reading = np.zeros((len(s), 6))
            if pose:
                reading[:, 1], reading[:, 3] = -speed, -rate
            if laser:
                # the laser reads a length, which grows whichever way the vehicle rolls
                reading[:, 0] = -np.abs(speed)
            return Form(self.id, label, (parameter,), lambda _: [Push(reading=reading)], tries=tries)

        return [made(label, pose, laser) for label, offered, pose, laser in wanted if offered]
