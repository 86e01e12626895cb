"""The effective radius of each wheel follows its load by a curved law."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Centre, Effect, Family, Form, Observations, Push, varies
from calib.gap.effects.load_slopes import slope_parameters

EXPONENTS: Final = (0.5, 0.7, 0.85, 2.0)


class LoadRadiusNonlinear(Effect):
    """dr_i = c_i F_0 [(F_i / F_0)^p - 1] / p: no change at the reference load F_0, slope c_i there, for any p."""

    id = "load_radius_nonlinear"
    title = "wheel radii that follow the load by a curved law"
    implausible = "misreported payloads, or a wheel that has come loose from its rim"
    family = Family.LOAD
    of_rear_wheels = True
    needs = "three payloads, with distances or end poses"
    separates = "three loads and more, far apart"
    is_load_law = True
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """Return one form an exponent, one slope a wheel; none where the loads do not vary."""
        left, right = observations.number("load_left_N"), observations.number("load_right_N")
        if not (varies(left, 5.0) or varies(right, 5.0)):
            return []
        reference = observations.model.reference_load_N
        if reference <= 1.0:
            reference = max(1.0, float(np.mean(0.5 * (left + right))))
        slopes = slope_parameters(observations)

        def form(exponent: float, centre: Centre) -> Form:
            reference = centre.mean

            def shape(load: FloatArray) -> FloatArray:
                ratio = np.maximum(load, 0.0) / reference
                return np.asarray(reference * (ratio**exponent - 1.0) / exponent)

            per_left, per_right = shape(left) / observations.radius_left_m, shape(right) / observations.radius_right_m
            label = "quadratic" if exponent == 2.0 else f"exponent {exponent:g}"
            return Form(
                self.id,
                label,
                slopes,
                lambda _: [Push(left=per_left), Push(right=per_right)],
                settings={"exponent": exponent},
                tries=len(EXPONENTS),
                centre=centre,
                about=lambda elsewhere: form(exponent, elsewhere),
            )

        return [form(exponent, Centre(reference)) for exponent in EXPONENTS]
