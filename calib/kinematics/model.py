"""What a vehicle of given parameters would have done to the sensor in each stretch, against what was measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.kinematics.drives import SENSOR, Drive, Path, displacement, integrate_motion
from calib.kinematics.recording import Recording
from calib.kinematics.segments import Segments
from calib.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Residuals, their derivatives, and the path behind them."""

    #: measured less predicted displacement; 0 where nothing was measured, shape (n, 3)
    residuals: FloatArray
    #: derivatives of the prediction by drive parameters, sensor pose and delay, shape (n, 3, n_parameters)
    jacobian: FloatArray
    #: poses at the samples
    path: Path


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A drive, a recording and stretches of it: predicts at any parameter values.

    Parameters are those of the drive, then those of `SENSOR`.
    """

    drive: Drive
    recording: Recording
    segments: Segments

    def predict(self, values: FloatArray) -> Prediction:
        """Return residuals and derivatives at `values`, shape (n_parameters,)."""
        n_drive = len(values) - len(SENSOR)
        path = integrate_motion(self.drive.motion(values[:n_drive], self.recording.steps))
        first, last = self.segments.first, self.segments.last
        delay = float(values[-1])
        pose, by_parameter, by_delay, first, last = _at_times(path, self.recording, first, last, delay)
        moved, derivative = displacement(pose, np.concatenate([by_parameter, by_delay[None]]), first, last)
        seen, by_sensor = _sensor(moved, values[-4:-1])
        rotate = _rotation(-values[-2], len(moved))
        by_gyro = np.zeros((len(moved), 3, 1))
        by_gyro[:, 2, 0] = np.where(self.segments.gyro, seen[:, 2], 0.0)
        jacobian = np.concatenate(
            [
                _through(derivative[:, :, :n_drive], rotate, moved, values[-4:-1]),
                by_gyro,
                by_sensor,
                _through(derivative[:, :, n_drive:], rotate, moved, values[-4:-1]),
            ],
            axis=2,
        )
        scale = np.where(self.segments.gyro, values[n_drive], 1.0)
        others = np.arange(len(values)) != n_drive
        jacobian[:, 2, others] *= scale[:, None]
        seen[:, 2] *= scale
        residuals = self.segments.measured - seen
        unseen = ~self.segments.seen
        residuals[unseen] = 0.0
        jacobian[unseen] = 0.0
        return Prediction(residuals, jacobian, path)


def _at_times(
    path: Path, recording: Recording, first: IntArray, last: IntArray, delay_s: float
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, IntArray]:
    """Return poses `delay_s` before the samples, their derivatives by parameters and by the delay, and new numbers.

    The reference's stamps lag: what it stamps t was true at t - delay. Only the samples in use are interpolated.
    """
    used, inverse = np.unique(np.concatenate([first, last]), return_inverse=True)
    run = recording.run[used]
    low, high = recording.offsets[run], recording.offsets[run + 1] - 1
    t_s = recording.t_s
    delay = delay_s + recording.delay_added_s[run]
    wanted = np.clip(t_s[used] - delay, t_s[low], t_s[high])
    # samples are few steps away, so a global search on time within runs is done with shifted clocks
    shift = np.concatenate(([0.0], np.cumsum(t_s[recording.offsets[1:] - 1] + 1.0)))[:-1]
    clock = t_s + shift[recording.run]
    at = np.clip(np.searchsorted(clock, wanted + shift[run], side="right") - 1, low, np.maximum(high - 1, low))
    following = np.minimum(at + 1, high)
    span = t_s[following] - t_s[at]
    share = np.where(span > 0.0, (wanted - t_s[at]) / np.where(span > 0.0, span, 1.0), 0.0)
    step = path.pose[:, following] - path.pose[:, at]
    pose = path.pose[:, at] + share * step
    d_step = path.by_parameter[:, :, following] - path.by_parameter[:, :, at]
    by_parameter = path.by_parameter[:, :, at] + share * d_step
    by_delay = -_velocity(path.pose, t_s, at, low, high)
    half = len(first)
    return pose, by_parameter, by_delay, inverse[:half], inverse[half:]


def _velocity(pose: FloatArray, t_s: FloatArray, at: IntArray, low: IntArray, high: IntArray) -> FloatArray:
    """Return the velocity about samples, over two samples either side: counters move in whole counts."""
    before, after = np.maximum(at - 2, low), np.minimum(at + 3, high)
    span = t_s[after] - t_s[before]
    return np.asarray((pose[:, after] - pose[:, before]) / np.where(span > 0.0, span, np.inf))


def _rotation(angle: float, n: int) -> FloatArray:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.broadcast_to(np.array([[cosine, -sine], [sine, cosine]]), (n, 2, 2))


def _sensor(moved: FloatArray, place: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the sensor's displacement for displacements of the vehicle, and its derivatives by the sensor's pose."""
    x, y, yaw = place
    turn = moved[:, 2]
    cosine, sine = np.cos(turn) - 1.0, np.sin(turn)
    forward = moved[:, 0] + cosine * x - sine * y
    left = moved[:, 1] + sine * x + cosine * y
    c, s = np.cos(yaw), np.sin(yaw)
    seen = np.stack([c * forward + s * left, c * left - s * forward, turn], axis=1)
    by = np.zeros((len(moved), 3, 3))
    by[:, 0, 0], by[:, 1, 0] = c * cosine + s * sine, c * sine - s * cosine
    by[:, 0, 1], by[:, 1, 1] = -c * sine + s * cosine, c * cosine + s * sine
    by[:, 0, 2], by[:, 1, 2] = seen[:, 1], -seen[:, 0]
    return seen, by


def _through(derivative: FloatArray, rotate: FloatArray, moved: FloatArray, place: FloatArray) -> FloatArray:
    """Return derivatives of the sensor's displacement from those of the vehicle's."""
    x, y, _ = place
    turn = moved[:, 2]
    d_forward = derivative[:, 0] + (-np.sin(turn) * x - np.cos(turn) * y)[:, None] * derivative[:, 2]
    d_left = derivative[:, 1] + (np.cos(turn) * x - np.sin(turn) * y)[:, None] * derivative[:, 2]
    moved_by = np.stack([d_forward, d_left], axis=1)
    return np.concatenate([rotate @ moved_by, derivative[:, 2:3]], axis=1)
