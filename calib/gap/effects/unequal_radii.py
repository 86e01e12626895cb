"""One rear wheel is larger than the other."""

from __future__ import annotations

import numpy as np

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Push


class UnequalRadii(Effect):
    """e_theta = eps S / b and e_n = eps S^2 / 2b, with eps = (r_R - r_L) / r (Borenstein and Feng's E_d, Eq. 15)."""

    id = "unequal_radii"
    title = "rear wheels of unequal radius"
    implausible = "swapped or different encoders"
    family = Family.CALIBRATION
    of_rear_wheels = True
    needs = "headings or lateral positions at the end of straight runs"
    separates = "unladen runs, and squares both ways round"
    hides_in = "the ratio of the wheel radii"
    calibration_direction = (-0.5, 0.5, 0.0, 0.0)
    typical = 2e-3

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; it applies to any campaign."""
        half = np.full(len(observations), 0.5)
        parameter = Parameter("relative", "1", typical=self.typical, largest=2e-2)
        return [Form(self.id, "", (parameter,), lambda _: [Push(left=-half, right=half)])]
