"""Fast turns press on the outer wheel: the radii follow the transferred load."""

from __future__ import annotations

import numpy as np

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Path, Push
from calib.gap.effects.scales import softness
from calib.gap.effects.shapes import curvature_per_m, shows_curves
from calib.units import GRAVITY_MPS2


class CurveLoadTransfer(Effect):
    """dF = W v^2 kappa h / (g b) from the inner to the outer rear wheel, dr = c dF: e_theta ~ W v^2 theta.

    The front wheel stands on the centre line and takes no part of the roll moment.
    """

    id = "curve_load_transfer"
    title = "load that moves to the outer wheel in fast turns"
    implausible = "a track other than believed, or side slip"
    family = Family.TURNING
    of_rear_wheels = True
    needs = "turns at known speeds"
    separates = "the same turn at two speeds and two loads"

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none where nothing turns or no speed is known."""
        if not shows_curves(observations):
            return []
        if not (observations.speed_mps != 0.0).any():
            return []

        def pushes(path: Path) -> list[Push]:
            observations = path.s
            # the curvature counts turn per way without sign: rolling backward, the same turn pulls to the other side
            pull_mps2 = observations.speed_mps * np.abs(observations.speed_mps) * curvature_per_m(observations)
            moved_N = (
                observations.weight_N[observations.unit]
                * pull_mps2
                * observations.vehicle.cog_z_m
                / (GRAVITY_MPS2 * observations.model.track_m)
            )
            return [
                Push(
                    left=-moved_N / observations.radius_left_m[observations.unit],
                    right=moved_N / observations.radius_right_m[observations.unit],
                )
            ]

        radius = 0.5 * (observations.model.radius_left_m + observations.model.radius_right_m) * softness(observations)
        parameter = Parameter("slope", "m/N", typical=1e-5 * radius, largest=6e-5 * radius)
        return [Form(self.id, "", (parameter,), pushes, by_parts=True)]
