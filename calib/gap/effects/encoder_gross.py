"""A gross fault of the encoders: a factor, swapped sides, a sign."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from calib.campaign.model import BoolArray
from calib.gap.effects.effect import Effect, Form, Parameter
from calib.gap.path import Path, Push, predict
from calib.gap.situation import Situation

__all__ = ["EncoderGross"]


class EncoderGross(Effect):
    """Factors of 2, 4, pi on one wheel or both, swapped wheels, a sign; only where the gap itself is gross."""

    id: ClassVar[str] = "encoder_gross"
    title: ClassVar[str] = "a gross fault of the encoders"
    implausible: ClassVar[str] = "a reference that was read in other units or axes"

    def forms(self, s: Situation) -> list[Form]:
        """Return the forms, acting on the runs that contradict the model; none where no run does so grossly."""
        struck = _struck(s)
        if not struck.any():
            return []
        acts = struck.astype(np.float64)
        # the factor by which true travel exceeds the counted one, less 1: from -3/4 (counts x 4) to 3 (counts / 4)
        change = Parameter("travel_factor_less_1", "1", typical=1.0, largest=4.0)
        share = Parameter("share", "1", typical=1.0, largest=1.5, sign=1)
        steps = acts[s.unit]

        def swapped(path: Path) -> list[Push]:
            s_ = path.s
            with np.errstate(divide="ignore", invalid="ignore"):
                left = np.where(s_.travel_left_m != 0.0, s_.travel_right_m / s_.travel_left_m - 1.0, 0.0)
                right = np.where(s_.travel_right_m != 0.0, s_.travel_left_m / s_.travel_right_m - 1.0, 0.0)
            return [Push(left=left * steps, right=right * steps)]

        offered = [
            ("factor of the left wheel", change, lambda _: [Push(left=acts)]),
            ("factor of the right wheel", change, lambda _: [Push(right=acts)]),
            ("factor of both wheels", change, lambda _: [Push(left=acts, right=acts)]),
            ("swapped wheels", share, swapped),
            ("sign of the left wheel", share, lambda _: [Push(left=-2.0 * acts)]),
            ("sign of the right wheel", share, lambda _: [Push(right=-2.0 * acts)]),
            ("sign of both wheels", share, lambda _: [Push(left=-2.0 * acts, right=-2.0 * acts)]),
        ]
        return [Form(self.id, label, (parameter,), pushes, tries=len(offered)) for label, parameter, pushes in offered]


def _struck(s: Situation) -> BoolArray:
    """Say which units contradict the model by more than a fifth in distance or heading, shape (n_units,)."""
    path = predict(s)
    length = np.maximum(s.length_m, 1e-3)
    # along the bent line, so that a straying heading does not pass for a wrong distance
    line = np.abs(s.total(path.ds_m * path.weave_cos))
    with np.errstate(invalid="ignore"):
        by_distance = np.abs(s.measured[:, 0] - line) > 0.2 * np.maximum(line, 0.2 * length)
        turned = np.abs(s.measured[:, 3] - path.end[:, 2])
        # wheels that differ by 5 % are beyond any unequal radii; a radian beyond any straying on a straight run
        by_heading = (
            (turned > 0.2 * np.abs(path.end[:, 2])) & (turned > 0.5) & (turned * s.model.track_m > 0.05 * length)
        )
    measured, predicted = s.measured[:, 1:3], path.end[:, :2]
    far = np.minimum(np.hypot(measured[:, 0], measured[:, 1]), np.hypot(predicted[:, 0], predicted[:, 1]))
    with np.errstate(invalid="ignore"):
        # driven to the opposite side, and well away from the start
        opposite = (np.sum(measured * predicted, axis=1) < -0.5 * far**2) & (far > 0.3 * length)
    struck: BoolArray = (by_distance & s.usable[:, 0]) | (by_heading & s.usable[:, 3]) | (opposite & s.usable[:, 1])
    return struck
