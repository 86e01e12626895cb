"""Both radii change with speed."""

from __future__ import annotations

from calib.gap.effects.effect import Centre, Effect, Family, Form, Observations, Parameter, Push, varies
from calib.gap.effects.shapes import driven_speed_mps


class SpeedRadius(Effect):
    """dr / r = k (v - v_0) for both wheels, v_0 the campaign's mean speed; the speed of a run is its driven mean."""

    id = "speed_radius"
    title = "wheel radii that follow the speed"
    shifts = ("radius_scale",)
    implausible = "latency or lost counts (the centrifugal growth of a solid wheel is only about 6e-5 at 1 m/s)"
    family = Family.SPEED
    needs = "two speeds"
    separates = "one route at several speeds, read after the stop"

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none where all runs were driven alike."""
        speed = driven_speed_mps(observations)
        if not varies(speed, 0.02):
            return []
        parameter = Parameter("per_mps", "s/m", typical=3e-4, largest=3e-4)

        def form(centre: Centre) -> Form:
            over = centre.deviations(speed)
            return Form(self.id, "", (parameter,), lambda _: [Push(left=over, right=over)], centre=centre, about=form)

        return [form(Centre.of(speed))]
