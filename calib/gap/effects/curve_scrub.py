"""Wheels scrub in turns: the track that acts widens with curvature."""

from __future__ import annotations

import numpy as np

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Path, Push
from calib.gap.effects.scales import reach
from calib.gap.effects.shapes import curvature_per_m, shows_curves


class CurveScrub(Effect):
    """b (1 + k |kappa|), so e_theta = -k |kappa| theta."""

    id = "curve_scrub"
    title = "scrubbing in turns that widens the track"
    implausible = "a track other than believed, or load transfer in fast turns"
    family = Family.TURNING
    of_rear_wheels = True
    needs = "turns of several curvatures"
    separates = "turns of several radii at one speed"
    shifts = ("track_width",)

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none where nothing turns."""
        if not shows_curves(observations):
            return []

        def pushes(path: Path) -> list[Push]:
            return [Push(track=np.abs(curvature_per_m(path.s)))]

        # up to 3 % in a turn of the vehicle's own length; of either sign: tracks of real robots narrow in turns, too
        parameter = Parameter(
            "widening", "m", typical=1.5e-2 * reach(observations), largest=1.5e-1 * reach(observations)
        )
        return [Form(self.id, "", (parameter,), pushes, by_parts=True)]
