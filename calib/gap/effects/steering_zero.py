"""The steering angle's zero is off."""

from __future__ import annotations

import numpy as np

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter
from calib.gap.effects.steering import error_form, has_front


class SteeringZero(Effect):
    """The logged angle is too large by delta_0: e_delta = S delta_0 / L on a straight."""

    id = "steering_zero"
    title = "a steering angle whose zero is off"
    implausible = "backlash, or rear wheels of unequal radius"
    family = Family.STEERING
    needs = "the front wheel in the log"
    separates = "forward and back"

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none without a front wheel in the log."""
        if not has_front(observations).any():
            return []
        parameter = Parameter("zero", "rad", typical=8e-3, largest=3.5e-2)
        return [error_form(observations, self.id, "", parameter, np.ones(len(observations.unit)))]
