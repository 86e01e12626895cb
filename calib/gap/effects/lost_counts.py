"""One wheel's counter loses counts."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Push, varies
from calib.gap.effects.shapes import driven_speed_mps


class LostCounts(Effect):
    """One wheel travels a share p more than its counts say: p constant, or growing with the speed above v_0.

    A constant share is an exact alias of that wheel's radius.
    """

    id = "lost_counts"
    title = "counts lost by one encoder"
    implausible = "the radius of that wheel, or a wrong count per revolution"
    family = Family.COUNTS
    of_rear_wheels = True
    needs = "headings or distances; two speeds for a share that grows"
    separates = "the front wheel as a second counter, at several speeds"
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """Return, for each wheel, a constant share and, where speeds differ, two shares that grow with speed."""
        ones = np.ones(len(observations))
        constant = Parameter("share", "1", typical=2e-3, largest=2e-2, sign=1)
        shapes: list[tuple[str, FloatArray, Parameter, dict[str, float]]] = [("constant share", ones, constant, {})]
        speed = driven_speed_mps(observations)
        if varies(speed, 0.02):
            growing = Parameter("share_per_mps", "s/m", typical=5e-3, largest=5e-2, sign=1)
            for v_0 in (float(speed.min()), float(np.median(speed))):
                over = np.maximum(speed - v_0, 0.0)
                if varies(over, 0.02):
                    label = f"share growing above {v_0:.2f} m/s"
                    shapes.append((label, over, growing, {"speed_mps": v_0}))

        def form(side: str, label: str, part: FloatArray, parameter: Parameter, settings: dict[str, float]) -> Form:
            push = Push(left=part) if side == "left" else Push(right=part)
            return Form(
                self.id,
                f"{side} wheel, {label}",
                (parameter,),
                lambda _: [push],
                settings=settings,
                tries=2 * len(shapes),
            )

        return [form(side, *shape) for shape in shapes for side in ("left", "right")]
