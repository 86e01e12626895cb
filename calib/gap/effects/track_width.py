"""The track is wider or narrower than believed."""

from __future__ import annotations

import numpy as np

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Push


class TrackWidth(Effect):
    """e_theta = -(db / b) theta (Eq. 16, E_b)."""

    id = "track_width"
    title = "a track other than believed"
    implausible = "the reference's scale, or scrubbing in tight turns"
    family = Family.CALIBRATION
    of_rear_wheels = True
    needs = "headings after turns"
    separates = "turns of several curvatures at several speeds"
    hides_in = "the track width"
    calibration_direction = (0.0, 0.0, 1.0, 0.0)
    typical = 1e-2

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; it applies to any campaign."""
        ones = np.ones(len(observations))
        parameter = Parameter("relative", "1", typical=self.typical, largest=1e-1)
        return [Form(self.id, "", (parameter,), lambda _: [Push(track=ones)])]
