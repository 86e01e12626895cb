"""The steering angle's scale is off, or the wheelbase."""

from __future__ import annotations

import numpy as np

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Path, Push
from calib.gap.effects.steering import error_form, excess, front_travel_m, has_front, steer_rad


class SteeringScale(Effect):
    """The logged angle is (1 + k) times the true one, or the wheelbase is (1 + k) times the believed one."""

    id = "steering_scale"
    title = "a steering angle of wrong scale, or a wrong wheelbase"
    implausible = "slip of the front wheel"
    family = Family.STEERING
    needs = "the front wheel in the log, turned"
    separates = "several steering angles"

    def forms(self, observations: Observations) -> list[Form]:
        """Return a form for the angle and one for the wheelbase; none where the front wheel is never turned."""
        angle = steer_rad(observations)
        if not has_front(observations).any() or not (np.abs(angle) > 0.02).any():
            return []
        parameter = Parameter("relative", "1", typical=1e-2, largest=1e-1)
        # the distance by the front wheel knows nothing of the wheelbase
        turn = front_travel_m(observations) * observations.steer_sin / observations.vehicle.wheelbase_m
        pushes = [excess(observations, np.zeros_like(turn), turn)]

        def longer(_: Path) -> list[Push]:
            return pushes

        return [
            error_form(observations, self.id, "scale of the angle", parameter, angle, tries=2),
            Form(self.id, "wheelbase", (parameter,), longer, tries=2),
        ]
