"""Both effective radii are off by the same share."""

from __future__ import annotations

import numpy as np

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Push


class RadiusScale(Effect):
    """e_s = -eps S, no heading error apart from the turn's own scale (calibration, absorbed by both radii)."""

    id = "radius_scale"
    title = "both effective radii off by the same share"
    implausible = "the encoder's counts per revolution, or a gear ratio"
    family = Family.CALIBRATION
    needs = "distances or end positions"
    separates = "a distance taped on the floor, against the counts and the instrument"
    hides_in = "the wheel radii"
    calibration_direction = (1.0, 1.0, 0.0, 0.0)
    typical = 3e-3

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; it applies to any campaign."""
        ones = np.ones(len(observations))
        parameter = Parameter("relative", "1", typical=self.typical, largest=3e-2)
        return [Form(self.id, "", (parameter,), lambda _: [Push(left=ones, right=ones)])]
