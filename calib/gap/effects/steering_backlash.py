"""Play between the steering angle sensor and the wheel."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from calib.campaign.model import FloatArray
from calib.gap.effects.effect import Effect, Form, Parameter
from calib.gap.effects.steering import error_form, has_front, steer_rad
from calib.gap.situation import Situation

__all__ = ["SteeringBacklash"]

#: a move smaller than this is noise of the sensor
_MOVE_RAD = 1e-3


class SteeringBacklash(Effect):
    """The logged angle is ahead of the wheel by half the play, on the side of the last move or of the turn."""

    id: ClassVar[str] = "steering_backlash"
    title: ClassVar[str] = "backlash in the steering"
    implausible: ClassVar[str] = "a steering angle whose zero is off"

    def forms(self, s: Situation) -> list[Form]:
        """Return a form by the last move of the steering and one by the side of the turn; none without moves."""
        angle = steer_rad(s)
        if not has_front(s).any() or not (np.abs(angle) > 0.02).any():
            return []
        parameter = Parameter("play", "rad", typical=8e-3, largest=4e-2, sign=1)
        by_side = np.where(np.abs(angle) > _MOVE_RAD, np.sign(angle), 0.0)
        return [
            error_form(s, self.id, "by the last move", parameter, 0.5 * _last_move(s, angle), tries=2),
            error_form(s, self.id, "by the side of the turn", parameter, 0.5 * by_side, tries=2),
        ]


def _last_move(s: Situation, angle: FloatArray) -> FloatArray:
    """Return the sign of the last move of the steering at each step, 0 before the first, shape (n_steps,)."""
    move = np.concatenate(([0.0], np.diff(angle)))
    move[s.starts[:-1]] = 0.0
    index = np.arange(len(angle))
    latest = np.maximum.accumulate(np.where(np.abs(move) > _MOVE_RAD, index, -1))
    known = latest >= s.starts[s.unit]
    return np.where(known, np.sign(move[np.maximum(latest, 0)]), 0.0)
