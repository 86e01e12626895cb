"""Both radii grow with temperature."""

from __future__ import annotations

from calib.gap.effects.effect import Centre, Effect, Family, Form, Observations, Parameter, Push, varies


class TemperatureRadius(Effect):
    """dr / r = alpha (T - T_0) for both wheels, T_0 the campaign's mean temperature."""

    id = "temperature_radius"
    title = "wheel radii that follow the temperature"
    implausible = "wear, or something else that changed with the session"
    family = Family.DRIFT
    needs = "temperature_C that varies"
    separates = "cold and warm runs within one session"
    shifts = ("radius_scale",)

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none where the temperature is not known or does not vary."""
        temperature = observations.number("temperature_C")
        if not varies(temperature, 0.5):
            return []
        # 0.05 to 0.2 % per 20 K
        parameter = Parameter("alpha", "1/K", typical=5e-5, largest=3e-4)

        def form(centre: Centre) -> Form:
            over = centre.deviations(temperature)
            return Form(self.id, "", (parameter,), lambda _: [Push(left=over, right=over)], centre=centre, about=form)

        return [form(Centre.of(temperature))]
