"""A rear wheel drags when it rolls one way."""

from __future__ import annotations

import numpy as np

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Path, Push, varies


class RearDrag(Effect):
    """One wheel travels a share more for its counts, in one rolling sense only.

    The sense is forward where any run rolls backward; else the ``direction`` label stands for it, out against back.
    """

    id = "rear_drag"
    title = "a rear wheel that drags one way"
    implausible = "unequal radii, or a brake that does not release"
    family = Family.DIRECTION
    of_rear_wheels = True
    needs = "runs forward and backward"
    separates = "the same way forward and backward"
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """Return a form for the left and one for the right wheel; none where everything rolls and goes one way."""
        backward = observations.total(np.where(observations.path_m < 0.0, -observations.path_m, 0.0))
        if (backward > 0.5).any():
            # a unit that rolls one way throughout needs no steps
            one_way = bool(((backward < 1e-3) | (backward > observations.length_m - 1e-3)).all())
            forward, label = (observations.total(observations.path_m) > 0.0) if one_way else None, "rolling forward"
        elif varies(observations.heading_sign):
            forward, label = observations.heading_sign > 0.0, "going out"
        else:
            return []
        parameter = Parameter("relative", "1", typical=5e-4, largest=5e-3)

        def form(side: str) -> Form:
            def pushes(path: Path) -> list[Push]:
                observations = path.s
                part = np.asarray(
                    observations.path_m >= 0.0 if forward is None else observations.here(forward), dtype=np.float64
                )
                return [Push(left=part) if side == "left" else Push(right=part)]

            return Form(self.id, f"{side} wheel, {label}", (parameter,), pushes, tries=2, by_parts=True)

        return [form("left"), form("right")]
