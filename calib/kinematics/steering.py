"""A steering angle against the turns of its vehicle: one that never moves, and what is read straight ahead."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from calib.types import FloatArray, IntArray

#: turns of the wheels by less, rms over the stretches, say nothing of the heading's unit
TURNS_RAD: Final = 0.1
#: a steering angle that reads more straight ahead was never zeroed: assembly leaves hundredths
FARTHEST_ZERO_RAD: Final = 0.1
#: no wheel is steered further
LARGEST_STEERING_RAD: Final = 2.0
LEAST_COSINE: Final = 0.2
#: estimates of the angle read straight ahead, each with the way of a front wheel that the one before gives
STRAIGHT_ROUNDS: Final = 5
#: an angle that moves less over a campaign is not that of a wheel that steers
STILL_RAD: Final = 1e-3
Between = Callable[[FloatArray], FloatArray]


def still_steering(steer_rad: FloatArray, rolled: FloatArray, turned_rad: FloatArray, run: IntArray) -> str:
    """Return what is wrong where the angle never moves but the curvature does; empty if right.

    `steer_rad` (shape (n_steps,)): angle read; `rolled`, `turned_rad`, `run` (shape (n,)): what the wheel rolled over
    each stretch, its measured turn and its run; stretches of one run follow each other.
    """
    if not len(run) or not float(np.ptp(steer_rad)) <= STILL_RAD:
        return ""
    left_rad = turned_rad - rolled * float(rolled @ turned_rad) / max(float(rolled @ rolled), 1e-12)
    first = np.flatnonzero(np.diff(run, prepend=-1))
    departed_rad = max(float(np.ptp(np.append(0.0, np.cumsum(part)))) for part in np.split(left_rad, first[1:]))
    if departed_rad < TURNS_RAD:
        return ""
    return (
        f"it reads {np.mean(steer_rad):.3g} rad throughout, while the vehicle turned by {departed_rad:.2g} rad more "
        "than one steering angle turns it; check the sensor of the steering and its column"
    )


def of_front(rolled: FloatArray, steer_rad: FloatArray) -> FloatArray:
    """Return the front wheel's way by a counted shaft at the rear; none is steered across."""
    return rolled / np.maximum(np.cos(steer_rad), LEAST_COSINE)


def straight_reading_rad(
    rolled: FloatArray, steer_rad: FloatArray, turned_rad: FloatArray, between: Between, *, by_shaft: bool = False
) -> float:
    """Return the steering angle read straight ahead; 0 where unknown or near 0.

    A reading delta counted from c turns the vehicle by ``k phi sin(delta - c)``: linear in the sine and cosine of c. Of
    c and its opposite, which counters of the other sign make alike, that nearer to most readings is taken.

    Parameters
    ----------
    rolled, steer_rad
        Way of the front wheel in each step, and the angle read, shape (n_steps,).
    turned_rad, between
        Measured turns of stretches, shape (n,), and sums of steps over these.
    by_shaft
        The way is that of a counted rear axle: turns go by the tangent.
    """
    if len(turned_rad) < 4 or float(np.ptp(steer_rad)) > 2.0 * LARGEST_STEERING_RAD:
        return 0.0
    most = np.sum(np.abs(rolled) * np.exp(1j * steer_rad))
    total, found_rad = turned_rad @ turned_rad, float(np.angle(most))
    for _ in range(STRAIGHT_ROUNDS if by_shaft else 1):
        front = of_front(rolled, steer_rad - found_rad) if by_shaft else rolled
        ways = np.stack([between(front * np.sin(steer_rad)), between(front * np.cos(steer_rad))])
        (by_sine, by_cosine), *_ = np.linalg.lstsq(ways.T, turned_rad)
        straight = complex(by_sine, -by_cosine)
        straight *= np.sign((straight * most.conjugate()).real)
        found_rad = float(np.angle(straight))
    left = np.sum((turned_rad - by_sine * ways[0] - by_cosine * ways[1]) ** 2)
    # from the largest zero that a fit finds: where that leaves as little, these turns do not tell
    near_rad = float(np.copysign(FARTHEST_ZERO_RAD, found_rad))
    by_near = np.cos(near_rad) * ways[0] - np.sin(near_rad) * ways[1]
    alone = total - (by_near @ turned_rad) ** 2 / max(by_near @ by_near, 1e-12)
    if left > POOR * total or (straight.real > 0.0 and left > CLEARLY_LESS * alone):
        return 0.0
    return found_rad if abs(found_rad) > FARTHEST_ZERO_RAD else 0.0


#: columns as they stand count as wrong where others leave less than this part of what they leave
CLEARLY_LESS: Final = 0.25
#: and where they leave more than this part of the way and of the turns
POOR: Final = 0.1
