"""Poses of all runs at once from the body's motion, with their derivatives by every parameter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.geometry.drives import Motion

#: turn of half a step below which the derivative of sin(h)/h is its series
SMALL_RAD: Final = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Poses at the samples; runs continue one another, since only displacements within a run are used."""

    #: x and y in m, heading in rad, shape (3, n_samples)
    pose: FloatArray
    #: derivatives of `pose`, shape (n_parameters, 3, n_samples)
    by_parameter: FloatArray


def integrate_motion(motion: Motion) -> Path:
    """Integrate steps of constant twist: each is the chord of its arc, at the heading in its middle.

    `motion`: motion of the body in each step.
    """
    forward, left, turn = motion.body
    d_forward, d_left, d_turn = (motion.by_parameter[:, axis] for axis in range(3))
    half = 0.5 * turn
    ratio = np.sinc(half / np.pi)
    near = np.abs(half) < SMALL_RAD
    slope = np.where(near, -half / 3.0, (np.cos(half) - ratio) / np.where(near, 1.0, half))
    theta = np.cumsum(turn)
    cosine, sine = np.cos(theta - half), np.sin(theta - half)
    along_x, along_y = forward * cosine - left * sine, forward * sine + left * cosine
    pose = np.stack([np.cumsum(ratio * along_x), np.cumsum(ratio * along_y), theta])
    d_theta = np.cumsum(d_turn, axis=1)
    d_middle = d_theta - 0.5 * d_turn
    d_ratio = slope * 0.5 * d_turn
    d_x = d_ratio * along_x + ratio * (d_forward * cosine - d_left * sine - along_y * d_middle)
    d_y = d_ratio * along_y + ratio * (d_forward * sine + d_left * cosine + along_x * d_middle)
    return Path(pose, np.stack([np.cumsum(d_x, axis=1), np.cumsum(d_y, axis=1), d_theta], axis=1))


def moved_between(pose: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return displacements from poses `first` to poses `last` in the frames of the former, shape (n, 3)."""
    delta = pose[:, last] - pose[:, first]
    cosine, sine = np.cos(pose[2, first]), np.sin(pose[2, first])
    return np.stack([cosine * delta[0] + sine * delta[1], cosine * delta[1] - sine * delta[0], delta[2]], axis=1)


def displacement(
    pose: FloatArray, by_parameter: FloatArray, first: IntArray, last: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the displacement from pose `first` to pose `last` in the frame of the former, and its derivatives.

    `pose` (shape (3, n)); `by_parameter` (shape (n_parameters, 3, n)): their derivatives; `first`, `last` (shape
    (n_segments,)): which poses. Returns `moved` (shape (n_segments, 3)): forward, left, turn; `derivative` (shape
    (n_segments, 3, n_parameters)): derivatives of `moved`.
    """
    delta = pose[:, last] - pose[:, first]
    cosine, sine = np.cos(pose[2, first]), np.sin(pose[2, first])
    forward, left = cosine * delta[0] + sine * delta[1], cosine * delta[1] - sine * delta[0]
    d_delta = by_parameter[:, :, last] - by_parameter[:, :, first]
    d_start = by_parameter[:, 2][:, first]
    d_forward = cosine * d_delta[:, 0] + sine * d_delta[:, 1] + left * d_start
    d_left = cosine * d_delta[:, 1] - sine * d_delta[:, 0] - forward * d_start
    moved = np.stack([forward, left, delta[2]], axis=1)
    return moved, np.stack([d_forward, d_left, d_delta[:, 2]], axis=0).transpose(2, 0, 1)
