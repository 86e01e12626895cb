"""The integrated path: poses at the samples, their derivatives, displacements between them."""

from dataclasses import dataclass

import numpy as np

from calib.kinematics.drives import Motion
from calib.types import FloatArray, IntArray, in_frame

#: half turn of a step below which the derivative of sin(h)/h is its series; of all steps, where five terms are exact
SMALL_RAD, SHORT_RAD = 1e-4, 0.1


def _bend_of_chord(half: FloatArray) -> FloatArray:
    # derivative of sin(h)/h
    if np.abs(half).max(initial=0.0) >= SHORT_RAD:
        near = np.abs(half) < SMALL_RAD
        return np.where(near, -half / 3.0, (np.cos(half) - np.sinc(half / np.pi)) / np.where(near, 1.0, half))
    total, square = np.ones_like(half), half * half
    for divisor in (88.0, 54.0, 28.0, 10.0):
        total *= square
        total *= -1.0 / divisor
        total += 1.0
    return -half / 3.0 * total


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Poses at the samples; runs continue one another."""

    #: x and y in m, heading in rad, shape (3, n_samples)
    pose: FloatArray
    #: its steps
    motion: Motion
    #: cosine and sine of the heading in the middle of each step, shape (2, n_samples)
    middle: FloatArray

    def by_parameter(self, at: IntArray) -> FloatArray:
        """Return derivatives of the poses `at` samples, ascending, shape (n_parameters, 3, len(at))."""
        (x, y, _), (forward, left, turn) = self.pose, self.motion.body
        cosine, sine = self.middle
        along_x, along_y = forward * cosine - left * sine, forward * sine + left * cosine
        ratio, bend = np.sinc(0.5 * turn / np.pi), 0.5 * _bend_of_chord(0.5 * turn)
        # by parts, from the end: a turn takes all later chords along
        half_ratio = 0.5 * ratio
        by_turn_x, by_turn_y = bend * along_x - half_ratio * along_y + y, bend * along_y + half_ratio * along_x - x
        cosine, sine = ratio * cosine, ratio * sine
        first = np.append(0, at[:-1] + 1)

        def until(values: FloatArray) -> FloatArray:
            return np.cumsum(np.add.reduceat(values[: at[-1] + 1], first))

        by_motion = self.motion.by_parameter()
        by_parameter = np.empty((len(by_motion), 3, len(at)))
        for (d_forward, d_left, d_turn), (d_x, d_y, d_theta) in zip(by_motion, by_parameter, strict=True):
            step_x, step_y = by_turn_x * d_turn + cosine * d_forward, by_turn_y * d_turn + sine * d_forward
            if d_left.any():
                step_x, step_y = step_x - sine * d_left, step_y + cosine * d_left
            d_theta[:] = until(d_turn)
            d_x[:], d_y[:] = until(step_x) - y[at] * d_theta, until(step_y) + x[at] * d_theta
        return by_parameter


def integrate_motion(motion: Motion) -> Path:
    """Integrate steps of constant twist: each is the chord of its arc, at the heading in its middle."""
    forward, left, turn = motion.body
    half, theta = 0.5 * turn, np.cumsum(turn)
    middle = theta - half
    cosine, sine, ratio = np.cos(middle), np.sin(middle), np.sinc(half / np.pi)
    x, y = (forward * cosine - left * sine) * ratio, (forward * sine + left * cosine) * ratio
    return Path(np.stack([np.cumsum(x), np.cumsum(y), theta]), motion, np.stack([cosine, sine]))


def moved_between(pose: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return displacements from poses `first` to poses `last` in the frames of the former, shape (n, 3)."""
    return in_frame(pose[:, last] - pose[:, first], pose[2, first])


def displacement(
    pose: FloatArray, by_parameter: FloatArray, first: IntArray, last: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the displacement from pose `first` to pose `last` in the frame of the former, and its derivatives.

    `pose` (shape (3, n)); `by_parameter` (shape (n_parameters, 3, n)); `first`, `last` (shape (n_segments,)). Returns
    `moved` (shape (n_segments, 3)): forward, left, turn; `derivative` (shape (n_segments, 3, n_parameters)).
    """
    moved = moved_between(pose, first, last)
    cosine, sine = np.cos(pose[2, first]), np.sin(pose[2, first])
    d_delta = by_parameter[:, :, last] - by_parameter[:, :, first]
    d_start = by_parameter[:, 2][:, first]
    d_forward = cosine * d_delta[:, 0] + sine * d_delta[:, 1] + moved[:, 1] * d_start
    d_left = cosine * d_delta[:, 1] - sine * d_delta[:, 0] - moved[:, 0] * d_start
    return moved, np.stack([d_forward, d_left, d_delta[:, 2]], axis=0).transpose(2, 0, 1)
