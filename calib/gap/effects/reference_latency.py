"""The reference is late, or early: a vehicle that rolls is seen where it was, or will be."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Path, Push
from calib.gap.effects.shapes import end_motion, stands_mps, start_motion, start_to_end_frame


class ReferenceLatency(Effect):
    """The reading is tau old (or, below 0, ahead of the counts): e_s = -tau v_end and e_theta = -tau omega_end.

    A window of a recording begins in motion too, and its start, from which all is counted, is as late as its end.
    """

    id = "reference_latency"
    title = "a reference that reads late"
    implausible = "an offset, or radii that follow the speed"
    family = Family.REFERENCE
    needs = "readings taken while it rolls"
    separates = "readings after the stop beside readings on the move"

    def forms(self, observations: Observations) -> list[Form]:
        """Return forms by instrument (end pose, laser, both); none where every run stands still when it is read."""
        speed, rate = end_motion(observations)
        nothing = np.zeros(len(observations))
        first_speed, first_rate = start_motion(observations) if observations.windowed else (nothing, nothing)
        least = np.minimum(0.01, 0.2 * stands_mps(observations))
        rolls = (np.abs(speed) > least) | (np.abs(first_speed) > least)
        has_pose = bool((observations.usable[:, 1:4].any(axis=1) & rolls).any())
        has_laser = bool((observations.usable[:, 0] & rolls).any())
        wanted = [("end pose", has_pose, True, False), ("laser", has_laser, False, True)]
        wanted.append(("end pose and laser", has_pose and has_laser, True, True))
        parameter = Parameter("latency", "s", typical=5e-2, largest=5e-1)
        tries = sum(pair[1] for pair in wanted)

        def form(label: str, pose: bool, laser: bool) -> Form:
            def pushes(path: Path) -> list[Push]:
                read: dict[str, FloatArray] = {}
                if pose:
                    # the start lay back by v_0 tau and was turned by omega_0 tau: all is seen from there
                    x, y = first_speed - first_rate * path.end[:, 1], first_rate * path.end[:, 0]
                    along, lateral = start_to_end_frame(path, x, y)
                    read |= {"along": along - speed, "lateral": lateral, "heading": first_rate - rate}
                if laser:
                    # the laser reads a length, which grows whichever way the vehicle rolls
                    read["distance"] = np.abs(first_speed) - np.abs(speed)
                return [Push.on_readings(observations, **read)]

            return Form(self.id, label, (parameter,), pushes, tries=tries)

        return [form(label, pose, laser) for label, offered, pose, laser in wanted if offered]
