"""Play between the steering angle sensor and the wheel."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter
from calib.gap.effects.steering import error_form, has_front, steer_rad

#: logged angle from which on a step belongs to a turn
_TURN_RAD: Final = 0.02
#: logged angle below which nothing moves, however fine the sensor
_STILL_RAD: Final = 2e-3
#: plays that are tried; the least stands for the side of the last move
PLAYS_RAD: Final = (2e-3, 8e-3, 2e-2)
#: way to either side over which the rear wheels' turn is taken: over less the counters are too coarse to tell it
_SMOOTH_M: Final = 0.2


class SteeringBacklash(Effect):
    """Play lies between the wheel and the sensor of its angle.

    Where the sensor sits at the motor, the logged angle is ahead of the wheel by half the play on the side of the last
    moves. Where it sits beyond the play, it follows what the wheel does, which the rear wheels tell, and lags.
    """

    id = "steering_backlash"
    title = "backlash in the steering"
    implausible = "a steering angle whose zero is off"
    family = Family.STEERING
    needs = "the front wheel in the log, turned both ways"
    separates = "one angle approached from the left and from the right"

    def forms(self, observations: Observations) -> list[Form]:
        """Return forms that follow the moves through plays of several widths, and one by the side of the turn."""
        angle = steer_rad(observations)
        if not has_front(observations).any() or not (np.abs(angle) > _TURN_RAD).any():
            return []
        parameter = Parameter("play", "rad", typical=8e-3, largest=4e-2, sign=1)
        # only a clear turn has a side: the sign of an angle near zero is the sign of its sensor's noise
        by_side = np.where(np.abs(angle) > _TURN_RAD, np.sign(angle), 0.0)
        noise = _noise_rad(observations, angle)
        # a coarse sensor does not tell noise, zero and small corrections apart: there a turn alone is a move
        band = _STILL_RAD if 6.0 * noise < _STILL_RAD else max(_TURN_RAD, 6.0 * noise)
        moved = np.where(np.abs(angle) > band, angle, 0.0)
        wheel = _wheel_rad(observations, angle)
        rough = _noise_rad(observations, wheel)
        tries = 1 + 2 * len(PLAYS_RAD)
        forms = []
        for play in PLAYS_RAD:
            settings = {"play_rad": play}
            ahead = _lost_in_play(observations, moved, play, 6.0 * noise) / play
            forms.append((f"by the moves of the motor, through {1e3 * play:g} mrad", ahead, settings))
            behind = -_lost_in_play(observations, wheel, play, 3.0 * rough) / play
            forms.append((f"by the moves of the wheel, through {1e3 * play:g} mrad", behind, settings))
        forms.append(("by the side of the turn", 0.5 * by_side, {}))
        return [
            error_form(observations, self.id, label, parameter, error, tries=tries, settings=settings)
            for label, error, settings in forms
        ]


def _noise_rad(observations: Observations, angle: FloatArray) -> float:
    """Return the standard deviation of one reading of an angle, from its second differences within runs."""
    inside = np.flatnonzero(observations.unit[2:] == observations.unit[:-2])
    bent = np.abs(angle[inside + 2] - 2.0 * angle[inside + 1] + angle[inside])
    bent = bent[np.isfinite(bent)]
    return float(1.4826 * np.median(bent) / np.sqrt(6.0)) if len(bent) else 0.0


def _wheel_rad(observations: Observations, angle: FloatArray) -> FloatArray:
    """Return the steering angle that the rear wheels' turn tells, shape (n_steps,); NaN where the vehicle hardly moves.

    The bend is the slope of a straight line through the headings over some way to either side: coarse counts then add
    little noise. Its middle value on the straight is taken off: unequal radii are no steering.
    """
    turn, path, way = (
        np.cumsum(observations.turn_rad),
        np.cumsum(observations.path_m),
        np.cumsum(np.abs(observations.path_m)),
    )
    index = np.arange(len(angle))
    first = np.minimum(np.searchsorted(way, way - _SMOOTH_M), index - 1)
    last = np.maximum(np.searchsorted(way, way + _SMOOTH_M, side="right") - 1, index + 1)
    first = np.maximum(first, observations.starts[observations.unit])
    last = np.minimum(last, observations.starts[observations.unit + 1] - 1)
    long_enough = np.abs(path[last] - path[first]) > 0.5 * _SMOOTH_M

    def summed(values: FloatArray) -> FloatArray:
        running = np.concatenate(([0.0], np.cumsum(values)))
        return np.asarray(running[last + 1] - running[first])

    count = last - first + 1.0
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = summed(path**2) - summed(path) ** 2 / count
        slope = (summed(path * turn) - summed(path) * summed(turn) / count) / variance
    steered = np.arctan(observations.vehicle.wheelbase_m * np.where(long_enough & np.isfinite(slope), slope, np.nan))
    straight = (np.abs(angle) < _TURN_RAD) & np.isfinite(steered)
    return np.asarray(steered - (np.median(steered[straight]) if straight.any() else 0.0))


def _lost_in_play(observations: Observations, angle: FloatArray, play: float, least: float) -> FloatArray:
    """Return angle less what comes through the play, which starts in its middle, shape (n_steps,).

    The output keeps still until the input has crossed the play: a recursion, taken step by step over all units. A play
    below `least` is taken up by the last move that stands out of the noise.
    """
    wide = max(play, least)
    longest = int(observations.lengths.max())
    index = np.minimum(observations.starts[:-1] + np.arange(longest)[:, None], observations.starts[1:] - 1)
    through = angle[index]
    now = np.zeros(through.shape[1])
    for row in through:
        # a NaN moves nothing
        now = np.fmin(np.fmax(now, row - 0.5 * wide), row + 0.5 * wide)
        row[:] = now
    step = np.arange(len(angle)) - observations.starts[observations.unit]
    return np.asarray(np.nan_to_num((angle - through[step, observations.unit]) * (play / wide)))
