"""One rear wheel is larger than the other."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from calib.gap.data.observations import Observations
from calib.gap.effects.effect import Effect, Form, Parameter
from calib.gap.effects.family import Family
from calib.gap.predict.push import Push

__all__ = ["UnequalRadii"]


class UnequalRadii(Effect):
    """e_theta = eps S / b and e_n = eps S^2 / 2b, with eps = (r_R - r_L) / r (Borenstein and Feng's E_d, Eq. 15)."""

    id: ClassVar[str] = "unequal_radii"
    title: ClassVar[str] = "rear wheels of unequal radius"
    implausible: ClassVar[str] = "swapped or different encoders"
    family: ClassVar[Family] = Family.CALIBRATION
    of_rear_wheels: ClassVar[bool] = True
    needs: ClassVar[str] = "headings or lateral positions at the end of straight runs"
    separates: ClassVar[str] = "unladen runs, and squares both ways round"
    hides_in: ClassVar[str] = "the ratio of the wheel radii"
    calibration_direction: ClassVar[tuple[float, ...] | None] = (-0.5, 0.5, 0.0, 0.0)
    typical: ClassVar[float] = 2e-3

    def forms(self, s: Observations) -> list[Form]:
        """Return the single form; it applies to any campaign."""
        half = np.full(len(s), 0.5)
        parameter = Parameter("relative", "1", typical=self.typical, largest=2e-2)
        return [Form(self.id, "", (parameter,), lambda _: [Push(left=-half, right=half)])]
