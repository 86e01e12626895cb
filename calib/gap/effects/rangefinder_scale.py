"""The rangefinder's distances are all off by the same share."""

from __future__ import annotations

from typing import ClassVar

from calib.gap.data.observations import Observations
from calib.gap.effects.effect import Effect, Form, Parameter
from calib.gap.effects.family import Family
from calib.gap.effects.shapes import laser_share

__all__ = ["RangefinderScale"]


class RangefinderScale(Effect):
    """The laser reads (1 + k) times the distance; end poses do not change."""

    id: ClassVar[str] = "rangefinder_scale"
    title: ClassVar[str] = "a rangefinder of wrong scale"
    implausible: ClassVar[str] = "both effective radii, or a target that moved"
    family: ClassVar[Family] = Family.INSTRUMENT
    needs: ClassVar[str] = "distances by the instrument"
    separates: ClassVar[str] = "a length measured by other means"

    def forms(self, s: Observations) -> list[Form]:
        """Return the single form; none without a laser distance."""
        return laser_share(s, self.id, Parameter("relative", "1", typical=1e-3, largest=1e-2))
