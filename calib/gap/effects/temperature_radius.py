"""Both radii grow with temperature."""

from __future__ import annotations

from typing import ClassVar

from calib.gap.data.observations import Observations
from calib.gap.effects.effect import Effect, Form, Parameter, centred, varies
from calib.gap.predict.path import Push

__all__ = ["TemperatureRadius"]


class TemperatureRadius(Effect):
    """dr / r = alpha (T - T_0) for both wheels, T_0 the campaign's mean temperature."""

    id: ClassVar[str] = "temperature_radius"
    title: ClassVar[str] = "wheel radii that follow the temperature"
    implausible: ClassVar[str] = "wear, or something else that changed with the session"
    shifts: ClassVar[tuple[str, ...]] = ("radius_scale",)

    def forms(self, s: Observations) -> list[Form]:
        """Return the single form; none where the temperature is not known or does not vary."""
        temperature = s.number("temperature_C")
        if not varies(temperature, 0.5):
            return []
        over = centred(temperature)
        # 0.05 to 0.2 % per 20 K
        parameter = Parameter("alpha", "1/K", typical=5e-5, largest=3e-4)
        return [Form(self.id, "", (parameter,), lambda _: [Push(left=over, right=over)])]
