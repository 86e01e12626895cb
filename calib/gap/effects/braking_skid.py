"""The vehicle slides on when it stops, its rear wheels turning too little."""

from __future__ import annotations

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Path, Push, varies
from calib.gap.effects.shapes import curvature_per_m, driven_speed_mps, stands_mps


class BrakingSkid(Effect):
    """A slide at each stop, the same at every stop or growing with the square of the speed before it.

    The vehicle slides on along its path, so in a turn it turns on too.
    """

    id = "braking_skid"
    title = "skidding when it stops"
    implausible = "latency, or an offset of the reference"
    family = Family.SPEED
    needs = "stops"
    separates = "runs of one length with more and fewer stops"
    shifts = ("radius_scale",)

    def forms(self, observations: Observations) -> list[Form]:
        """Return a form with equal slides and, where speeds differ, one ~ v^2; none where no run stops."""
        if not stops(observations).any():
            return []
        speed = driven_speed_mps(observations)
        per_stop = Parameter("per_stop", "m", typical=5e-4, largest=1e-2, sign=1)
        slips = [("the same at each stop", np.ones_like(speed), per_stop)]
        if varies(speed, 0.02):
            squared = Parameter("per_speed_squared", "s2/m", typical=2e-3, largest=4e-2, sign=1)
            slips.append(("~ v^2", speed**2, squared))

        def form(label: str, size: FloatArray, parameter: Parameter) -> Form:
            def pushes(path: Path) -> list[Push]:
                observations = path.s
                along = np.where(
                    stops(observations),
                    np.where(observations.path_m < 0.0, -1.0, 1.0) * observations.here(size)[observations.unit],
                    0.0,
                )
                return [Push(along_m=along, heading_rad=np.abs(along) * curvature_per_m(observations))]

            return Form(self.id, label, (parameter,), pushes, tries=len(slips), by_parts=True)

        return [form(*slip) for slip in slips]


def stops(observations: Observations) -> BoolArray:
    """Return the last moving step before each stop, shape (n_steps,).

    A log that ends at less than half the driven speed ends in a stop. A run without a log stops once, at its end.
    """
    speed = np.abs(observations.speed_mps)
    last = np.zeros(len(observations.unit), dtype=bool)
    last[observations.starts[1:] - 1] = True
    moving = speed > stands_mps(observations)[observations.unit]
    follows = np.concatenate((moving[1:], [False]))
    driven = np.nan_to_num(driven_speed_mps(observations))[observations.unit]
    within = moving & ~last & ~follows
    at_end = last & moving & (speed < 0.5 * driven)
    return np.where(observations.from_log[observations.unit], within | at_end, last)
