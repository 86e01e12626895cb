"""Skidding at stops."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from calib.gap.effects import quantities
from calib.gap.effects.effect import Effect, Family, Form, Parameter, varies
from calib.gap.effects.steering import rate_per_s
from calib.gap.observations.arrays import Observations
from calib.gap.predict import Path
from calib.gap.steps import Perturbation
from calib.types import BoolArray, FloatArray

#: a stop lies in a curve where a way of one track turns by more, in radians
LEAST_BEND_PER_TRACK: Final = 0.1


class BrakingSkid(Effect):
    """A slide at each stop, the same at every stop or growing with the square of the highest speed since the last one.

    Wheels that creep let the vehicle turn on along its curve, locked ones do not, and a turn may end with the drive: in
    curves the turn is a parameter of its own, the way along the curve that would turn it as much.
    """

    id = "braking_skid"
    title = "skidding when it stops"
    implausible = "latency, or an offset of the reference"
    family = Family.SPEED
    needs = "stops"
    separates = "runs of one length with more and fewer stops"
    shifts = ("radius_scale",)
    zero_known = True

    def forms(self, observations: Observations) -> list[Form]:
        """Return a form with equal slides and, where speeds differ, one ~ v^2; none where no run stops."""
        bends = observations.of_parts(lambda part: np.abs(quantities.curvature_per_m(part)[stops(part)]))
        if not len(bends):
            return []
        per_stop = Parameter("per_stop", "m", typical=5e-4, largest=1e-2, sign=1)
        squared = Parameter("per_speed_squared", "s2/m", typical=2e-3, largest=4e-2, sign=1)
        laws = [("the same at each stop", per_stop, 0), ("~ v^2", squared, 2)]
        speed = quantities.driven_speed_mps(observations)
        speeds_differ = varies(speed, quantities.same_speed_mps(speed), observations)
        turns = observations.applied or bends.max() > LEAST_BEND_PER_TRACK / observations.model.track_m

        def slides(path: Path, power: int) -> list[Perturbation]:
            s, at = path.s, stops(path.s)
            along = np.where(at, np.where(s.path_m < 0.0, -1.0, 1.0) * _highest_mps(s, at) ** power, 0.0)
            turn = np.abs(along) * quantities.curvature_per_m(s)
            return [Perturbation(along_m=along), Perturbation(heading_rad=turn)][: 1 + turns]

        return self.offer(
            [
                (label, (one, replace(one, name=f"turning_{one.name}"))[: 1 + turns], partial(slides, power=power))
                for label, one, power in laws[: 1 + speeds_differ]
            ],
            by_parts=True,
        )


def _highest_mps(observations: Observations, at: BoolArray) -> FloatArray:
    """Return the highest speed since the stop before, over four steps as whole counts jump, shape (n_steps,)."""
    middle_m = observations.cumulative(observations.path_m) - 0.5 * observations.path_m
    rate = np.abs(rate_per_s(observations, middle_m, 2))
    edges = np.union1d(observations.starts, np.flatnonzero(at) + 1)
    highest = np.maximum.reduceat(np.where(rate > 0.0, rate, np.abs(observations.speed_mps)), edges[:-1])
    return np.repeat(highest, np.diff(edges))


def stops(observations: Observations) -> BoolArray:
    """Return the last moving step before each stop, shape (n_steps,).

    A log that ends at less than half the driven speed ends in a stop. A run without a log stops once, at its end. The
    axle of a vehicle that turns on the spot does not slide on.
    """
    speed = np.abs(observations.speed_mps)
    last = np.zeros(len(observations.unit), dtype=bool)
    last[observations.starts[1:] - 1] = True
    spot = quantities.on_the_spot(observations, observations.turn_rad, observations.path_m) > 0.0
    moving = (speed > quantities.standstill_mps(observations)[observations.unit]) & ~spot
    follows = np.concatenate((moving[1:], [False]))
    driven = np.nan_to_num(quantities.driven_speed_mps(observations))[observations.unit]
    within = moving & ~last & ~follows
    at_end = last & moving & (speed < 0.5 * driven)
    return np.where(observations.from_log[observations.unit], within | at_end, last)
