"""How noise grows: the reference's own, and random walks of heading and distance along the way."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.geometry.path import Path
from calib.geometry.segments import Segments

#: variances that make up the covariance of a displacement: of position and heading by the reference (m^2, rad^2),
#: of the random walks of heading and of distance (rad^2/m, m^2/m)
COMPONENTS: Final = ("reference_xy", "reference_theta", "heading_walk", "along_walk")
#: how far below its stated size a component may fall
LEAST: Final = 1e-4
#: 0.5 would never lower the likelihood but creeps
POWER: Final = 0.9


def kernels(path: Path, body: FloatArray, segments: Segments, yaw_rad: float) -> FloatArray:
    """Return the covariance of each displacement for each component of unit size.

    `path`: poses at the samples; `body` (shape (3, n_samples)): motion of the body in each step; `yaw_rad`: yaw of the
    sensor on the vehicle. Shape (4, n, 3, 3): in the order of `COMPONENTS`, in the sensor's frame at the start of the
    stretch.
    """
    n = len(segments)
    kernel = np.zeros((len(COMPONENTS), n, 3, 3))
    forward, left = segments.measured[:, 0], segments.measured[:, 1]
    kernel[0, :, 0, 0] = kernel[0, :, 1, 1] = 2.0
    start = np.stack([left, -forward, -np.ones(n)], axis=1)
    kernel[1] = start[:, :, None] * start[:, None, :]
    kernel[1, :, 2, 2] += 1.0
    walk, along = _walks(path, body, segments)
    turn = path.pose[2, segments.first] + yaw_rad
    rotate = np.zeros((n, 3, 3))
    rotate[:, 0, 0] = rotate[:, 1, 1] = np.cos(turn)
    rotate[:, 0, 1], rotate[:, 1, 0] = np.sin(turn), -np.sin(turn)
    rotate[:, 2, 2] = 1.0
    for at, covariance in ((2, walk), (3, along)):
        kernel[at] = rotate @ covariance @ rotate.transpose(0, 2, 1)
    unseen = ~segments.seen
    for component in kernel:
        component[unseen] = 0.0
        component.transpose(0, 2, 1)[unseen] = 0.0
    return kernel


def _walks(path: Path, body: FloatArray, segments: Segments) -> tuple[FloatArray, FloatArray]:
    """Return covariances of the end pose, in the path's own frame, of unit walks of heading and distance."""
    x, y, theta = path.pose
    # a turn on the spot makes noise too: a radian counts as a metre of a hand's width
    weight = np.hypot(body[0], body[1]) + 0.1 * np.abs(body[2])
    first, last = segments.first, segments.last

    def between(values: FloatArray) -> FloatArray:
        total = np.cumsum(values)
        return np.asarray(total[last] - total[first])

    zero = between(weight)
    dx, dy = x[last] - x[first], y[last] - y[first]
    # moments about the start of each stretch, in two steps so that nothing large cancels
    mx, my = between(weight * x), between(weight * y)
    one_x, one_y = mx - zero * x[first], my - zero * y[first]
    two_xx = between(weight * x * x) - 2 * x[first] * mx + zero * x[first] ** 2
    two_yy = between(weight * y * y) - 2 * y[first] * my + zero * y[first] ** 2
    two_xy = between(weight * x * y) - x[first] * my - y[first] * mx + zero * x[first] * y[first]
    # a kick of heading at (x, y) moves the end by (-(y_end - y), x_end - x)
    a, b = -(dy * zero - one_y), dx * zero - one_x
    aa = dy * dy * zero - 2 * dy * one_y + two_yy
    bb = dx * dx * zero - 2 * dx * one_x + two_xx
    ab = -(dx * dy * zero - dy * one_x - dx * one_y + two_xy)
    walk = np.empty((len(segments), 3, 3))
    walk[:, 0, 0], walk[:, 1, 1], walk[:, 2, 2] = np.maximum(aa, 0.0), np.maximum(bb, 0.0), zero
    walk[:, 0, 1] = walk[:, 1, 0] = ab
    walk[:, 0, 2] = walk[:, 2, 0] = a
    walk[:, 1, 2] = walk[:, 2, 1] = b
    along = np.zeros((len(segments), 3, 3))
    cosine, sine = np.cos(theta), np.sin(theta)
    along[:, 0, 0], along[:, 1, 1] = between(weight * cosine**2), between(weight * sine**2)
    along[:, 0, 1] = along[:, 1, 0] = between(weight * cosine * sine)
    return walk, along


def covariances(kernel: FloatArray, scales: FloatArray, seen: BoolArray) -> FloatArray:
    """Return the covariance of each displacement, shape (n, 3, 3); 1 on the diagonal where nothing was measured."""
    total = np.asarray(np.einsum("c,cnij->nij", scales, kernel), dtype=np.float64)
    diagonal = np.arange(3)
    total[:, diagonal, diagonal] += np.where(seen, 1e-18, 1.0)
    return total


def update_scales(kernel: FloatArray, scales: FloatArray, inverse: FloatArray, whitened: FloatArray) -> FloatArray:
    """Return better variances of the components: one step that never lowers the likelihood (Zhou et al. 2019).

    `kernel` (shape (4, n, 3, 3)); `scales` (shape (4,)): variances now; `inverse` (shape (n, 3, 3)): inverse
    covariances at `scales`; `whitened` (shape (n, 3)): inverse covariances times residuals, times the square root of
    the robust weights.
    """
    outer = (whitened[:, :, None] * whitened[:, None, :]).ravel()
    flat = kernel.reshape(len(kernel), -1)
    size, trace = flat @ outer, flat @ inverse.ravel()
    return np.asarray(scales * np.clip(size / np.where(trace > 0.0, trace, 1.0), 0.05, 20.0) ** POWER)
