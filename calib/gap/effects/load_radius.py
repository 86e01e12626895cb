"""The effective radius of each wheel changes linearly with its load."""

from __future__ import annotations

from calib.gap.effects.effect import Effect, Family, Form, Observations, Push, varies
from calib.gap.effects.load_slopes import slope_parameters


class LoadRadius(Effect):
    """dr_i = c_i (F_i - F_0), each wheel its own c and either sign: e_s ~ S dF, e_theta ~ S (F_R - F_L) / b."""

    id = "load_radius"
    title = "wheel radii that follow the load"
    implausible = "misreported payloads, or a wheel that has come loose from its rim"
    family = Family.LOAD
    of_rear_wheels = True
    needs = "two payloads or places of it, with distances or end poses"
    separates = "two loads and more, some of them off the middle"
    is_load_law = True
    carries_law_slope = True
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """Return the linear law, one slope a wheel; none where the loads do not vary."""
        left, right = observations.number("load_left_N"), observations.number("load_right_N")
        if not (varies(left, 5.0) or varies(right, 5.0)):
            return []
        reference = observations.model.reference_load_N
        per_left, per_right = (
            (left - reference) / observations.radius_left_m,
            (right - reference) / observations.radius_right_m,
        )
        return [
            Form(self.id, "", slope_parameters(observations), lambda _: [Push(left=per_left), Push(right=per_right)])
        ]
