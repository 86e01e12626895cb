"""The track that acts changes with the load on the rear axle."""

from __future__ import annotations

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Push, varies
from calib.gap.effects.scales import softness
from calib.gap.effects.shapes import shows_curves


class LoadDependentTrack(Effect):
    """b (1 + k (F - F_0)), F the load of both rear wheels, F_0 twice the reference load of a wheel."""

    id = "load_dependent_track"
    title = "a track that follows the load"
    implausible = "load transfer in turns, or misreported payloads"
    family = Family.TURNING
    of_rear_wheels = True
    needs = "turns under two loads"
    separates = "the same slow turn under two loads"
    shifts = ("track_width",)

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none where the loads do not vary or nothing turns."""
        axle = observations.number("load_left_N") + observations.number("load_right_N")
        if not varies(axle, 10.0) or not shows_curves(observations):
            return []
        over = axle - 2.0 * observations.model.reference_load_N
        # up to 1 % for 1000 N
        parameter = Parameter(
            "per_N", "1/N", typical=5e-6 * softness(observations), largest=5e-5 * softness(observations)
        )
        return [Form(self.id, "", (parameter,), lambda _: [Push(track=over)])]
