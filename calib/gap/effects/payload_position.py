"""The payload stands elsewhere than reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Path, Push
from calib.gap.effects.load_slopes import radius_slopes_m_per_N
from calib.gap.effects.scales import reach
from calib.units import GRAVITY_MPS2


class PayloadPosition(Effect):
    """All payloads stand dy further left or dx further ahead: the loads shift, and with them the radii.

    Left: dF = +-m g dy / b, e_theta ~ S 2 c W dy / b^2. Ahead: dF = -m g dx / 2L on each rear wheel and +m g dx / L on
    the front wheel, so e_s and e_F go opposite ways. The slope is the mean of both wheels' (see `load_slopes`).
    """

    id = "payload_position"
    title = "a misreported payload position"
    implausible = "rear wheels of unequal radius, or loads that were misread"
    family = Family.LOAD
    needs = "payloads, with headings or the front wheel"
    separates = "unladen runs beside laden ones"
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """Return a form sideways and one lengthways; none without payloads."""
        weight_N = GRAVITY_MPS2 * np.nan_to_num(observations.number("payload_kg"))
        if not (weight_N > 0.0).any():
            return []
        wheelbase, track = observations.vehicle.wheelbase_m, observations.model.track_m
        front_m = np.where(
            observations.usable[:, 4],
            np.nan_to_num(observations.total(np.nan_to_num(observations.front_roll_rad) * observations.steer_cos)),
            0.0,
        )
        by_steering = (
            observations.total(np.nan_to_num(observations.front_roll_rad) * observations.steer_sin) / wheelbase
        )
        by_steering = np.where(observations.usable[:, 5], by_steering, 0.0)

        def slope(path: Path) -> float:
            return 0.5 * sum(radius_slopes_m_per_N(path))

        def sideways(path: Path) -> list[Push]:
            change_m = slope(path) * weight_N / track
            return [Push(left=change_m / observations.radius_left_m, right=-change_m / observations.radius_right_m)]

        def ahead(path: Path) -> list[Push]:
            change_m = slope(path) * weight_N / wheelbase
            left, right = -0.5 * change_m / observations.radius_left_m, -0.5 * change_m / observations.radius_right_m
            # the front wheel travels more for its counts, which the front channels subtract
            front, steering = -front_m * change_m, -by_steering * change_m
            return [replace(Push.on_readings(observations, front=front, steering=steering), left=left, right=right)]

        def parameter(name: str) -> tuple[Parameter, ...]:
            return (Parameter(name, "m", typical=3e-2 * reach(observations), largest=2.5e-1 * reach(observations)),)

        return [
            Form(self.id, "sideways", parameter("further_left"), sideways, tries=2),
            Form(self.id, "lengthways", parameter("further_ahead"), ahead, tries=2),
        ]
