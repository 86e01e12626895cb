"""The rangefinder's distances are all off by the same length."""

from __future__ import annotations

import numpy as np

from calib.gap.data.observations import Observations
from calib.gap.effects.effect import Effect, Form, Parameter
from calib.gap.effects.family import Family
from calib.gap.predict.push import Push


class RangefinderOffset(Effect):
    """The laser reads a constant too much, whatever the distance; end poses do not change."""

    id = "rangefinder_offset"
    title = "a constant offset of the rangefinder"
    implausible = "a start mark or target that moved"
    family = Family.INSTRUMENT
    needs = "distances by the instrument"
    separates = "several distances, read at rest"

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none without a laser distance."""
        if not observations.usable[:, 0].any():
            return []
        reading = np.zeros((len(observations), 6))
        reading[:, 0] = 1.0
        parameter = Parameter("offset", "m", typical=5e-3, largest=3e-2)
        return [Form(self.id, "", (parameter,), lambda _: [Push(reading=reading)])]
