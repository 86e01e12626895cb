"""The shapes that noise may have in a unit: what each source does to the channels at the end, at scale 1."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.gap.predict.path import Path

#: components: (name, prior median of the standard deviation's scale, prior spread of its natural logarithm)
COMPONENTS: Final[tuple[tuple[str, float, float], ...]] = (
    ("distance", 1.0, 0.4),  # times the rangefinder's stated sigma
    ("position", 1.0, 0.4),  # times the reference's stated sigma
    ("heading", 1.0, 0.4),  # times the reference's stated sigma
    ("heading_walk", 2e-4, 1.0),  # rad per sqrt(m)
    ("along_walk", 2e-4, 1.0),  # m per sqrt(m)
    ("radius_scatter", 2e-5, 1.0),  # relative, both wheels, from run to run
    ("yaw_scatter", 2e-5, 1.0),  # relative, right against left, from run to run
    ("start_heading", 3e-4, 1.0),  # rad, from run to run
    ("front_walk", 5e-4, 1.0),  # m per sqrt(m)
    ("steering_walk", 1e-3, 1.0),  # rad per sqrt(m)
    ("front_scatter", 3e-4, 1.0),  # relative, front radius, from run to run
    ("steer_scatter", 1e-3, 1.0),  # rad, zero of the steering angle, from run to run
)
#: prior medians, shape (n_components,)
MEDIANS: Final = np.array([median for _, median, _ in COMPONENTS])

_N_CHANNELS: Final = 6


def kernels(path: Path) -> FloatArray:
    """Return the covariance of each component at scale 1, shape (n_components, n_units, 6, 6)."""
    observations = path.s
    n = len(observations)
    shapes = np.zeros((len(COMPONENTS), n, _N_CHANNELS, _N_CHANNELS))
    shapes[0, :, 0, 0] = observations.sigma_distance_m**2
    shapes[1, :, 1, 1] = shapes[1, :, 2, 2] = observations.sigma_xy_m**2
    shapes[2, :, 3, 3] = observations.sigma_theta_rad**2
    for units, part in path.parts():
        length = np.abs(part.ds_m)
        for number, vector in zip((3, 4), _step_vectors(part), strict=True):
            shapes[number, units] = _summed_products(vector, length, part.s.starts)
    calibration = path.calibration
    both = calibration[:, :, 0] + calibration[:, :, 1]
    differ = 0.5 * (calibration[:, :, 1] - calibration[:, :, 0])
    zero = np.zeros((n, _N_CHANNELS))
    zero[:, 4] = -observations.vehicle.wheelbase_m * path.end[:, 2]
    zero[:, 5] = path.way_m / observations.vehicle.wheelbase_m
    start = _start_turn(path)
    for number, rows in ((5, both), (6, differ), (7, start), (10, calibration[:, :, 3]), (11, zero)):
        shapes[number] = rows[:, :, None] * rows[:, None, :]
    shapes[8, :, 4, 4] = observations.length_m
    shapes[9, :, 5, 5] = observations.length_m
    return shapes


def _step_vectors(path: Path) -> tuple[dict[int, FloatArray], dict[int, FloatArray]]:
    """Return what a turn and a way of 1 at each step do to each channel at the end, each (n_steps,)."""
    observations, steps = path.s, path.steps
    unit = observations.unit
    c, s = np.cos(path.frame)[unit], np.sin(path.frame)[unit]
    by_x, by_line = (observations.axis == 1)[unit], (observations.axis == 0)[unit]
    chord = np.maximum(np.hypot(path.end[:, 0], path.end[:, 1]), 1e-9)
    ux, uy = (path.end[:, 0] / chord)[unit], (path.end[:, 1] / chord)[unit]
    ones = np.ones(len(unit))
    turned = np.where(by_x, steps.lever_x, ux * steps.lever_x + uy * steps.lever_y)
    kick = {
        0: np.where(by_line, 0.0, turned),
        1: c * steps.lever_x + s * steps.lever_y,
        2: c * steps.lever_y - s * steps.lever_x,
        3: ones,
        5: ones,
    }
    moved = np.where(by_x, steps.cos, ux * steps.cos + uy * steps.sin)
    push = {
        0: np.where(by_line, 1.0, moved),
        1: c * steps.cos + s * steps.sin,
        2: c * steps.sin - s * steps.cos,
        4: ones,
    }
    return kick, push


def _summed_products(vector: Mapping[int, FloatArray], weight: FloatArray, starts: IntArray) -> FloatArray:
    """Sum the weighted outer products of a step vector over each unit, shape (n_units, 6, 6)."""
    summed = np.zeros((len(starts) - 1, _N_CHANNELS, _N_CHANNELS))
    channels = sorted(vector)
    for a in channels:
        weighted = vector[a] * weight
        for b in channels:
            if b >= a:
                summed[:, a, b] = summed[:, b, a] = np.add.reduceat(weighted * vector[b], starts[:-1])
    return summed


def _start_turn(path: Path) -> FloatArray:
    """Return what a turn of the start frame by 1 does to the readings, shape (n_units, 6)."""
    start = np.zeros((len(path.s), _N_CHANNELS))
    start[:, 1] = np.sin(path.frame) * path.end[:, 0] - np.cos(path.frame) * path.end[:, 1]
    start[:, 2] = np.cos(path.frame) * path.end[:, 0] + np.sin(path.frame) * path.end[:, 1]
    start[:, 3] = 1.0
    return start


def quantisation(path: Path) -> FloatArray:
    """Return the covariance that counting in whole counts gives, shape (n_units, 6, 6)."""
    observations = path.s
    covariance = np.zeros((len(observations), _N_CHANNELS, _N_CHANNELS))
    radius = observations.vehicle.wheel_radius_m
    for wheel, sign in ((0, -1.0), (1, 1.0)):
        # the first and the last count are each off by a uniform share of a count
        sigma = observations.count_rad[wheel] * radius / np.sqrt(6.0)
        rows = np.zeros(_N_CHANNELS)
        rows[[0, 1, 4]] = 0.5 * sigma
        rows[[3, 5]] = sign * sigma / observations.model.track_m
        covariance += np.outer(rows, rows)
    return covariance


def fixed_noise(path: Path) -> FloatArray:
    """Return the covariance that has no scale of its own, shape (n_units, 6, 6): counting, and a start frame read."""
    start = _start_turn(path) * path.s.sigma_start_rad[:, None]
    return quantisation(path) + start[:, :, None] * start[:, None, :]


def masked(covariance: FloatArray, usable: BoolArray) -> FloatArray:
    """Give missing channels unit variance and no correlation."""
    both = usable[:, :, None] & usable[:, None, :]
    kept = np.where(both, covariance, 0.0)
    index = np.arange(_N_CHANNELS)
    kept[:, index, index] = np.where(usable, np.maximum(kept[:, index, index], 1e-18), 1.0)
    # a touch of independent variance, so that exactly aliased channels can be factored
    kept[:, index, index] *= 1.0 + 1e-9
    return kept


def whiten(covariance: FloatArray, columns: FloatArray) -> FloatArray:
    """Multiply by the inverse Cholesky factor of each unit's covariance.

    Parameters
    ----------
    covariance : array of float, shape (n_units, 6, 6)
    columns : array of float, shape (n_units, 6, k)
        Zero where a channel is missing.

    Returns
    -------
    array of float, shape (n_units, 6, k)
    """
    whitened: FloatArray = np.linalg.solve(np.linalg.cholesky(covariance), columns)
    return whitened
