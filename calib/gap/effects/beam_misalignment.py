"""The laser beam is not parallel to the way."""

from __future__ import annotations

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter
from calib.gap.effects.shapes import laser_share


class BeamMisalignment(Effect):
    """The laser reads the distance over cos(alpha); the parameter is 1 / cos(alpha) - 1, never negative."""

    id = "beam_misalignment"
    title = "a laser beam at an angle to the way"
    implausible = "the rangefinder's scale (a beam 5 degrees off reads only 0.4 % too much)"
    family = Family.INSTRUMENT
    needs = "distances by the instrument"
    separates = "the beam aimed anew; a scale of the instrument looks exactly alike"

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none without a laser distance."""
        # 1.5e-4 at 1 degree, 1.4e-3 at 3 degrees, 3.8e-3 at 5 degrees
        return laser_share(observations, self.id, Parameter("excess", "1", typical=5e-4, largest=3.8e-3, sign=1))
