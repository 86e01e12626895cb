"""The steering angle is logged late."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter
from calib.gap.effects.steering import error_form, has_front, steer_rad


class SteeringDelay(Effect):
    """The logged angle is tau old, so short of the true one by tau d(delta)/dt.

    On a run at one speed e_delta = -v tau (delta_end - delta_start) / L.
    """

    id = "steering_delay"
    title = "a steering angle that is logged late"
    implausible = "a steering angle of wrong scale"
    family = Family.STEERING
    needs = "the front wheel in a log with times"
    separates = "runs that end in a turn"

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none where the steering does not move or the log has no times."""
        rate = _rate(observations, steer_rad(observations))
        if not has_front(observations).any() or not (np.abs(rate) > 1e-3).any():
            return []
        parameter = Parameter("delay", "s", typical=1e-1, largest=5e-1)
        return [error_form(observations, self.id, "", parameter, -rate)]


def _rate(observations: Observations, angle: FloatArray) -> FloatArray:
    """Return the rate of the steering angle in each step, one-sided at the ends of a unit, shape (n_steps,)."""
    index = np.arange(len(angle))
    before = np.maximum(index - 1, observations.starts[observations.unit])
    after = np.minimum(index + 1, observations.starts[observations.unit + 1] - 1)
    middle = observations.time_s - 0.5 * observations.duration_s
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = (angle[after] - angle[before]) / (middle[after] - middle[before])
    return np.where(np.isfinite(rate), rate, 0.0)
