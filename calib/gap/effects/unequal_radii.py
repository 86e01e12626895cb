"""One rear wheel is larger than the other."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from calib.gap.data.observations import Observations
from calib.gap.effects.effect import Effect, Form, Parameter
from calib.gap.predict.path import Push

__all__ = ["UnequalRadii"]


class UnequalRadii(Effect):
    """e_theta = eps S / b and e_n = eps S^2 / 2b, with eps = (r_R - r_L) / r (Borenstein and Feng's E_d, Eq. 15)."""

    id: ClassVar[str] = "unequal_radii"
    title: ClassVar[str] = "rear wheels of unequal radius"
    implausible: ClassVar[str] = "swapped or different encoders"
    calibration: ClassVar[bool] = True

    def forms(self, s: Observations) -> list[Form]:
        """Return the single form; it applies to any campaign."""
        half = np.full(len(s), 0.5)
        parameter = Parameter("relative", "1", typical=2e-3, largest=2e-2)
        return [Form(self.id, "", (parameter,), lambda _: [Push(left=-half, right=half)])]
