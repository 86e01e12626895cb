"""The rear axle slips outward in fast turns."""

from __future__ import annotations

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Path, Push
from calib.gap.effects.shapes import curvature_per_m, shows_curves


class SideSlip(Effect):
    """A slip angle -K v^2 kappa: a step of ds moves -K v^2 kappa ds to the left, e_n ~ v^2 theta."""

    id = "side_slip"
    title = "side slip of the rear axle in fast turns"
    implausible = "load transfer, or a reference point off the rear axle"
    family = Family.TURNING
    needs = "turns at known speeds, with end positions"
    separates = "turns at two speeds, the lateral position measured"

    def forms(self, observations: Observations) -> list[Form]:
        """Return the single form; none where nothing turns, no speed is known or no position was measured."""
        if not shows_curves(observations) or not observations.usable[:, 1:3].any():
            return []
        if not (observations.speed_mps != 0.0).any():
            return []

        def pushes(path: Path) -> list[Push]:
            observations = path.s
            # v^2 kappa ds is v |v| times the turn: it changes sides when the vehicle rolls backward
            return [Push(lateral_m=-(observations.speed_mps**2) * curvature_per_m(observations) * observations.path_m)]

        parameter = Parameter("slip_per_acceleration", "s2/m", typical=2e-3, largest=5e-2, sign=1)
        return [Form(self.id, "", (parameter,), pushes, by_parts=True)]
