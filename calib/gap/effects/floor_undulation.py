"""An uneven floor: the wheels roll up and down, the vehicle gets less far."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import BoolArray
from calib.gap.data.observations import STRAIGHT_RAD
from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Push, varies
from calib.gap.effects.floor import common_frame

_MOST: Final = 8
#: a run that turns by more than this in all, to and fro, is no lane
_BENT_RAD: Final = 2.5


class FloorUndulation(Effect):
    """On one lane the way is shorter than what the wheels roll by <z'^2> / 2, never longer."""

    id = "floor_undulation"
    title = "an uneven floor on one lane"
    implausible = "both effective radii on that lane, or a path that weaves"
    family = Family.FLOOR
    needs = "two lanes"
    separates = "the same runs on another lane"
    shifts = ("radius_scale",)

    def forms(self, observations: Observations) -> list[Form]:
        """Return a form for each lane: the values of a column ``lane`` where there is one, else the kinds of route."""
        lane = observations.number("lane")
        groups: list[tuple[str, BoolArray]]
        if varies(lane):
            values = np.unique(lane)
            groups = [(f"lane {value:g}", lane == value) for value in values]
        elif common_frame(observations):
            # only routes that run straight along the hall are lanes
            kind = observations.labels["kind"]
            bent = (observations.total(np.abs(observations.turn_rad)) > _BENT_RAD) | (
                np.abs(observations.total(observations.turn_rad)) > STRAIGHT_RAD
            )
            names = [name for name in np.unique(kind) if not bent[kind == name].any()]
            groups = [(f"route {name}", kind == name) for name in names]
        else:
            groups = []
        if not 1 < len(groups) <= _MOST:
            return []
        parameter = Parameter("excess", "1", typical=2.5e-4, largest=2e-3, sign=1)

        def form(label: str, mine: BoolArray) -> Form:
            shorter = np.where(mine, -1.0, 0.0)
            push = Push(left=shorter, right=shorter)
            return Form(self.id, label, (parameter,), lambda _: [push], tries=len(groups))

        return [form(*group) for group in groups]
