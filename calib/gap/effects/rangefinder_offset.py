"""The rangefinder's distances are all off by the same length."""

from __future__ import annotations

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Push


class RangefinderOffset(Effect):
    """The laser reads a constant too much, whatever the distance; end poses do not change."""

    id = "rangefinder_offset"
    title = "a constant offset of the rangefinder"
    implausible = "a start mark or target that moved"
    family = Family.INSTRUMENT
    needs = "distances by the instrument"
    separates = "several distances, read at rest"

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none without a laser distance."""
        if not observations.usable[:, 0].any():
            return []
        push = Push.on_readings(observations, distance=1.0)
        parameter = Parameter("offset", "m", typical=5e-3, largest=3e-2)
        return [Form(self.id, "", (parameter,), lambda _: [push])]
