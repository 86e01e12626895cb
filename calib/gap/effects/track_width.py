"""The track is wider or narrower than believed."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from calib.gap.data.observations import Observations
from calib.gap.effects.effect import Effect, Form, Parameter
from calib.gap.predict.path import Push

__all__ = ["TrackWidth"]


class TrackWidth(Effect):
    """e_theta = -(db / b) theta (Eq. 16, E_b)."""

    id: ClassVar[str] = "track_width"
    title: ClassVar[str] = "a track other than believed"
    implausible: ClassVar[str] = "the reference's scale, or scrubbing in tight turns"
    calibration: ClassVar[bool] = True

    def forms(self, s: Observations) -> list[Form]:
        """Return the single form; it applies to any campaign."""
        ones = np.ones(len(s))
        parameter = Parameter("relative", "1", typical=1e-2, largest=1e-1)
        return [Form(self.id, "", (parameter,), lambda _: [Push(track=ones)])]
