"""The angle that a steered wheel truly had where its sensor is late, has play, or reads another zero or scale."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.plant.world import World

#: the sensor has turned round once it came back by this, or by so many standard deviations of its noise
TURNED_RAD: Final = 2e-3
TURNED_STD: Final = 6.0


def true_angles(read: FloatArray, time_s: FloatArray, last: IntArray, world: World) -> FloatArray:
    """Return the wheel's true angles, shape (n_steps_most, n_units): what the world's sensor would read as logged.

    Zero, scale, play and delay of the sensor are the world's. Beyond the end of a log (the unit's last step), where a
    late sensor's last angles would be, the last one holds.
    """
    true = (read - world.steer_zero_rad) / world.steer_scale
    if world.steer_backlash_rad.any():
        true = true + 0.5 * world.steer_backlash_rad * _side(true, last)
    if world.steer_delay_s.any():
        late = np.broadcast_to(world.steer_delay_s, last.shape)
        true = true.copy()
        for unit, end in enumerate(last + 1):
            at = time_s[:end, unit]
            true[:end, unit] = np.interp(at + late[unit], at, true[:end, unit])
    return np.asarray(true)


def _side(angle: FloatArray, last: IntArray) -> FloatArray:
    """Return to which side each angle last moved: beyond the play the wheel is ahead of its sensor there."""
    side = np.zeros_like(angle)
    bent = [np.abs(np.diff(angle[: end + 1, unit], 2)) for unit, end in enumerate(last)]
    noise = 1.4826 * float(np.median(np.concatenate(bent))) / np.sqrt(6.0) if any(map(len, bent)) else 0.0
    least = max(TURNED_RAD, TURNED_STD * noise)
    low, high = angle[0].copy(), angle[0].copy()
    now = np.zeros(angle.shape[1])
    for step, here in enumerate(angle):
        high = np.where(now >= 0, np.maximum(high, here), high)
        low = np.where(now <= 0, np.minimum(low, here), low)
        up = (now < 1) & (here - low > least)
        down = (now > -1) & (high - here > least) & ~up
        now = np.where(up, 1.0, np.where(down, -1.0, now))
        high, low = np.where(up, here, high), np.where(down, here, low)
        side[step] = now
    return side
