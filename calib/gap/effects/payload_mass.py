"""A payload weighs other than reported."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import BoolArray
from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Path, Push
from calib.gap.effects.load_slopes import payload_load_N, radius_slopes_m_per_N

_MOST: Final = 6


class PayloadMass(Effect):
    """The payload of one label, or of all, is off by a share, and with it the loads: dr_i = c_i share dF_i.

    The slopes c_i are the model's, else those of the hypothesis as the other payloads show them, else a nominal 1 % per
    kN (then the share is only as good as that slope). All labels at once (a scale that reads too low) are asked of only
    where the model has slopes: in a model without them no payload does anything, and slopes that are off look alike.
    """

    id = "payload_mass"
    title = "a misreported payload mass"
    implausible = "radii that follow the load by a curved law"
    family = Family.LOAD
    needs = "payloads, with distances or end poses"
    separates = "a third payload, weighed"
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """Return a form for each of the (at most six) payloads driven most, and one for all; none without payloads."""
        payload = np.nan_to_num(observations.number("payload_kg"))
        values, counts = np.unique(np.round(payload, 3), return_counts=True)
        laden = values > 0.0
        values, counts = values[laden], counts[laden]
        values = np.sort(values[np.argsort(-counts, kind="stable")[:_MOST]])
        added_left, added_right = payload_load_N(observations)
        parameter = Parameter("share", "1", typical=0.15, largest=0.5)
        # one label may be mistyped; a scale that is off by more than a third is found out
        of_all = Parameter("share", "1", typical=0.1, largest=0.3)

        has_slopes = observations.model.slope_left_m_per_N != 0.0 or observations.model.slope_right_m_per_N != 0.0
        together = len(values) > 1 and has_slopes
        tries = len(values) + int(together)

        def form(label: str, mine: BoolArray, share: Parameter, settings: dict[str, float]) -> Form:

            def pushes(path: Path) -> list[Push]:
                left, right = radius_slopes_m_per_N(path, ~mine)
                return [
                    Push(
                        left=np.where(mine, left * added_left, 0.0) / observations.radius_left_m,
                        right=np.where(mine, right * added_right, 0.0) / observations.radius_right_m,
                    )
                ]

            return Form(self.id, label, (share,), pushes, settings, tries=tries)

        single = [
            form(f"payload of {value:g} kg", np.abs(payload - value) < 1e-3, parameter, {"payload_kg": float(value)})
            for value in values
        ]
        return [*single, form("all payloads", payload > 0.0, of_all, {})] if together else single
