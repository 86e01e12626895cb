"""The reference's axes are turned against the vehicle's start heading."""

from __future__ import annotations

import numpy as np

from calib.gap.data.observations import Observations
from calib.gap.effects.effect import Effect, Form, Parameter
from calib.gap.effects.family import Family
from calib.gap.predict.path import Path
from calib.gap.predict.push import Push


class ReferenceYaw(Effect):
    """e_n = alpha_0 S on straight runs: the end pose is read in axes turned by alpha_0."""

    id = "reference_yaw"
    title = "reference axes turned against the start heading"
    implausible = "unequal radii, or a badly placed start"
    family = Family.REFERENCE
    needs = "end positions"
    separates = "straight runs of several lengths"

    def forms(self, observations: Observations) -> list[Form]:
        """Return two forms: the position alone is turned, or position and heading; none without end poses."""
        if not observations.usable[:, 2].any():
            return []
        parameter = Parameter("yaw", "rad", typical=5e-3, largest=5e-2)

        def form(with_heading: float) -> Form:
            def pushes(path: Path) -> list[Push]:
                reading = np.zeros((len(observations), 6))
                c, sn = np.cos(path.frame), np.sin(path.frame)
                x, y = path.end[:, 0], path.end[:, 1]
                # turning (x, y) by alpha moves it by alpha (-y, x); read in the end frame
                reading[:, 1], reading[:, 2] = -c * y + sn * x, sn * y + c * x
                reading[:, 3] = with_heading
                return [Push(reading=reading)]

            label = "position and heading" if with_heading else "position alone"
            return Form(self.id, label, (parameter,), pushes, tries=2)

        return [form(0.0), form(1.0)]
