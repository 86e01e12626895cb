"""The rangefinder's distances are all off by the same share."""

from __future__ import annotations

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter
from calib.gap.effects.shapes import laser_share


class RangefinderScale(Effect):
    """The laser reads (1 + k) times the distance; end poses do not change."""

    id = "rangefinder_scale"
    title = "a rangefinder of wrong scale"
    implausible = "both effective radii, or a target that moved"
    family = Family.INSTRUMENT
    needs = "distances by the instrument"
    separates = "a length measured by other means"

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none without a laser distance."""
        return laser_share(observations, self.id, Parameter("relative", "1", typical=1e-3, largest=1e-2))
