"""Play between the steering angle sensor and the wheel."""

from __future__ import annotations

from typing import ClassVar, Final

import numpy as np

from calib.campaign.model import FloatArray
from calib.gap.effects.effect import Effect, Form, Parameter
from calib.gap.effects.steering import error_form, has_front, steer_rad
from calib.gap.situation import Situation

__all__ = ["SteeringBacklash"]

#: logged angle from which on a step belongs to a turn
_TURN_RAD: Final = 0.02
#: plays that are tried; the least stands for the side of the last move
PLAYS_RAD: Final = (2e-3, 8e-3, 2e-2)


class SteeringBacklash(Effect):
    """The logged angle is ahead of the wheel by a share of half the play, on the side of the last moves or of the turn.

    Negative where the sensor sits beyond the play and lags the wheel.
    """

    id: ClassVar[str] = "steering_backlash"
    title: ClassVar[str] = "backlash in the steering"
    implausible: ClassVar[str] = "a steering angle whose zero is off"

    def forms(self, s: Situation) -> list[Form]:
        """Return forms that follow the moves through plays of several widths, and one by the side of the turn."""
        angle = steer_rad(s)
        if not has_front(s).any() or not (np.abs(angle) > 0.02).any():
            return []
        parameter = Parameter("play", "rad", typical=8e-3, largest=4e-2)
        # only a clear turn has a side: the sign of an angle near zero is the sign of its sensor's noise
        by_side = np.where(np.abs(angle) > _TURN_RAD, np.sign(angle), 0.0)
        tries = 1 + len(PLAYS_RAD)
        made = [
            error_form(
                s,
                self.id,
                f"by the moves, through {1e3 * play:g} mrad",
                parameter,
                _lost_in_play(s, angle, play) / play,
                tries=tries,
                settings={"play_rad": play},
            )
            for play in PLAYS_RAD
        ]
        return [*made, error_form(s, self.id, "by the side of the turn", parameter, 0.5 * by_side, tries=tries)]


def _lost_in_play(s: Situation, angle: FloatArray, play: float) -> FloatArray:
    """Return angle less what comes through the play, which starts in its middle, shape (n_steps,).

    The output keeps still until the input has crossed the play: a recursion, taken step by step over all units.
    """
    longest = int(s.lengths.max())
    index = np.minimum(s.starts[:-1] + np.arange(longest)[:, None], s.starts[1:] - 1)
    through = angle[index]
    now = through[0]
    for row in through:
        now = np.clip(now, row - 0.5 * play, row + 0.5 * play)
        row[:] = now
    step = np.arange(len(angle)) - s.starts[s.unit]
    return np.asarray(angle - through[step, s.unit])
