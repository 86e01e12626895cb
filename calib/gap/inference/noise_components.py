"""Noise components: their covariance in the channels of a run, and the trends that are no noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Final

import numpy as np

from calib.campaign.model import NUMERIC_COLUMNS
from calib.gap.predict import Path
from calib.types import BoolArray, FloatArray, IntArray

#: (name, prior median of the standard deviation's scale, prior spread of its natural logarithm)
COMPONENTS: Final[tuple[tuple[str, float, float], ...]] = (
    ("distance", 1.0, 0.4),  # times the rangefinder's stated sigma
    # times the reference's: of positions it may be off by a factor of two; turns would take that of headings for theirs
    ("position", 1.0, 0.7),
    ("heading", 1.0, 0.4),
    ("heading_walk", 2e-4, 1.0),  # rad per sqrt(m)
    ("along_walk", 2e-4, 1.0),  # m per sqrt(m)
    ("radius_scatter", 5e-5, 1.5),  # relative, both wheels, from run to run
    ("yaw_scatter", 5e-5, 1.5),  # relative, right against left, from run to run
    ("start_heading", 3e-4, 1.0),  # rad, from run to run
    ("front_walk", 5e-4, 1.0),  # m per sqrt(m)
    ("steering_walk", 1e-3, 1.0),  # rad per sqrt(m)
    ("front_scatter", 3e-4, 1.0),  # relative, front radius, from run to run
    ("steer_scatter", 1e-3, 1.0),  # rad, zero of the steering angle, from run to run
)
PRIOR_MEDIANS: Final = np.array([median for _, median, _ in COMPONENTS])
N_CHANNELS: Final = 6
#: relative change of a radius by a standardised trend
STEP: Final = 1e-2
Column = tuple[FloatArray, tuple[int, ...]]


def kernels(path: Path) -> FloatArray:
    """Return the covariance of each component at scale 1, shape (n_components, n_units, 6, 6)."""
    observations = path.s
    n = len(observations)
    shapes = np.zeros((len(COMPONENTS), n, N_CHANNELS, N_CHANNELS))
    for number, channel in ((0, 0), (1, 1), (1, 2), (2, 3)):
        shapes[number, :, channel, channel] = observations.sigma[:, channel] ** 2
    for units, part in path.parts():
        length = np.abs(part.steps.ds_m)
        for number, vector in zip((3, 4), _step_vectors(part), strict=True):
            shapes[number, units] = _summed_products(vector, length, part.s.starts)
    calibration = path.calibration
    both = calibration[:, :, 0] + calibration[:, :, 1]
    differ = 0.5 * (calibration[:, :, 1] - calibration[:, :, 0])
    zero = np.zeros((n, N_CHANNELS))
    zero[:, 4] = -observations.vehicle.wheelbase_m * path.end[:, 2]
    zero[:, 5] = path.way_m / observations.vehicle.wheelbase_m
    start = _start_turn(path)
    for number, rows in ((5, both), (6, differ), (7, start), (10, calibration[:, :, 3]), (11, zero)):
        shapes[number] = rows[:, :, None] * rows[:, None, :]
    shapes[8, :, 4, 4] = observations.length_m
    shapes[9, :, 5, 5] = observations.length_m
    return shapes


def _step_vectors(path: Path) -> tuple[dict[int, FloatArray], dict[int, FloatArray]]:
    observations, steps = path.s, path.steps
    unit = observations.unit
    c, s = np.cos(path.frame)[unit], np.sin(path.frame)[unit]
    axis = observations.axis[unit]
    by_x, by_line = np.abs(axis) == 1, axis == 0
    chord = np.maximum(np.hypot(path.end[:, 0], path.end[:, 1]), 1e-9)
    ux, uy = (path.end[:, 0] / chord)[unit], (path.end[:, 1] / chord)[unit]
    ones = np.ones(len(unit))
    turned = np.where(by_x, axis * steps.lever_x, ux * steps.lever_x + uy * steps.lever_y)
    kick = {
        0: np.where(by_line, 0.0, turned),
        1: c * steps.lever_x + s * steps.lever_y,
        2: c * steps.lever_y - s * steps.lever_x,
        3: ones,
        5: ones,
    }
    moved = np.where(by_x, axis * steps.cos, ux * steps.cos + uy * steps.sin)
    push = {
        0: np.where(by_line, 1.0, moved),
        1: c * steps.cos + s * steps.sin,
        2: c * steps.sin - s * steps.cos,
        4: ones,
    }
    return kick, push


def _summed_products(vector: Mapping[int, FloatArray], weight: FloatArray, starts: IntArray) -> FloatArray:
    summed = np.zeros((len(starts) - 1, N_CHANNELS, N_CHANNELS))
    weighted = {channel: values * weight for channel, values in vector.items()}
    for a, b in combinations_with_replacement(sorted(vector), 2):
        summed[:, a, b] = summed[:, b, a] = np.add.reduceat(weighted[a] * vector[b], starts[:-1])
    return summed


def _start_turn(path: Path) -> FloatArray:
    start, (c, s) = np.zeros((len(path.s), N_CHANNELS)), path.frame_turned
    start[:, 1] = s * path.end[:, 0] - c * path.end[:, 1]
    start[:, 2] = c * path.end[:, 0] + s * path.end[:, 1]
    start[:, 3] = 1.0
    return start


def quantisation(path: Path) -> FloatArray:
    """Return the covariance of whole counts, shape (n_units, 6, 6)."""
    observations = path.s
    covariance = np.zeros((len(observations), N_CHANNELS, N_CHANNELS))
    radius = observations.vehicle.wheel_radius_m
    for wheel, sign in ((0, -1.0), (1, 1.0)):
        # both ends are off by a uniform share of a count
        sigma = observations.count_rad[wheel] * radius / np.sqrt(6.0)
        rows = np.zeros(N_CHANNELS)
        rows[[0, 1, 4]] = 0.5 * sigma
        rows[[3, 5]] = sign * sigma / observations.model.track_m
        covariance += np.outer(rows, rows)
    return covariance


def masked(covariance: FloatArray, usable: BoolArray) -> FloatArray:
    """Give missing channels unit variance and no correlation."""
    kept = np.where(usable[:, :, None] & usable[:, None, :], covariance, 0.0)
    index = np.arange(N_CHANNELS)
    kept[:, index, index] = np.where(usable, np.maximum(kept[:, index, index], 1e-18), 1.0)
    kept[:, index, index] *= 1.0 + 1e-9
    return kept


def whitener_of(covariance: FloatArray) -> FloatArray:
    """Return the inverse Cholesky factor of each unit's covariance, shape (n_units, 6, 6)."""
    return np.linalg.inv(np.linalg.cholesky(covariance))


@dataclass(frozen=True, slots=True, eq=False)
class NoiseComponents:
    """What the noise of some units is made of."""

    kernels: FloatArray  #: shape (n_components, n_units, 6, 6): covariance of each component at scale 1
    fixed: FloatArray  #: shape (n_units, 6, 6): covariance without a scale
    usable: BoolArray  #: shape (n_units, 6): channels that a unit has
    active: BoolArray  #: shape (n_components,): components that show in any channel used

    @staticmethod
    def about(path: Path) -> "NoiseComponents":
        """Return those of all units of a path."""
        usable, shapes = path.s.usable, kernels(path)
        both = (usable[:, :, None] & usable[:, None, :]).astype(np.float64)
        active = np.array([bool((np.abs(shape) * both).sum() > 0) for shape in shapes])
        start = _start_turn(path) * path.s.sigma_start_rad[:, None]
        return NoiseComponents(shapes, quantisation(path) + start[:, :, None] * start[:, None, :], usable, active)

    def covariance(self, log_scale: FloatArray, weight: FloatArray) -> FloatArray:
        """Return the covariance of each unit, shape (n_units, 6, 6)."""
        variance = np.exp(2 * np.where(self.active, log_scale, np.log(PRIOR_MEDIANS))) * self.active
        whole = np.tensordot(variance, self.kernels, axes=1) + self.fixed
        return masked(whole / weight[:, None, None], self.usable)

    def dof(self, log_scale: FloatArray, uncertainty: FloatArray) -> FloatArray:
        """Return the degrees of freedom of each unit's level in each channel, shape (n_units, 6).

        2 over the variance of its square's logarithm (Satterthwaite, Biometrics Bulletin 2 (1946) 110), by the
        `uncertainty` of the scales' logs.
        """
        variance, diagonal = np.exp(2 * log_scale) * self.active, np.diagonal(self.kernels, axis1=2, axis2=3)
        level = np.tensordot(variance, diagonal, axes=1) + np.diagonal(self.fixed, axis1=1, axis2=2)
        share = variance[:, None, None] * diagonal / np.where(self.usable, level, np.inf)
        spread = np.einsum("inc,ij,jnc->nc", share, uncertainty, share)
        return np.asarray(0.5 / np.maximum(spread, 1e-9))

    def select(self, units: IntArray) -> "NoiseComponents":
        """Return those of some units."""
        kernels = np.ascontiguousarray(self.kernels[:, units])
        return NoiseComponents(kernels, self.fixed[units], self.usable[units], self.active)


def ambient_trends(path: Path) -> FloatArray:
    """Return what both radii may do with the surroundings and by session, (n_units, 6, k), to unit prior variance."""
    observations = path.s
    waited = observations.number("minutes_under_load")
    load = observations.number("load_left_N") + observations.number("load_right_N")
    crept = np.log1p(np.maximum(np.nan_to_num(waited), 0.0) / 5.0) * load
    values = [observations.number("temperature_C"), waited, crept]
    values += [column for name, column in observations.numbers.items() if name not in NUMERIC_COLUMNS]
    columns = [(column, (0, 1)) for value in values for column in _standardised(value)]
    on_reference = _on_reference(path, _standardised(values[0]))
    return np.concatenate([_on_radii(path, columns), on_reference, session_steps(path)], axis=2)


def _on_reference(path: Path, columns: Sequence[FloatArray]) -> FloatArray:
    usable = path.s.usable
    moved = np.zeros(usable.shape)
    if usable[:, 0].any():
        end = (path.end[:, 0] + 1j * path.end[:, 1]) * np.exp(-1j * path.frame)
        moved[:, 1], moved[:, 2] = end.real, end.imag
    scaled = [moved * column[:, None] * STEP for column in columns if moved.any()]
    stacked = np.stack(scaled, axis=2) if scaled else np.zeros((*usable.shape, 0))
    return np.where(usable[:, :, None], stacked, 0.0)


def session_steps(path: Path) -> FloatArray:
    """Return what each radius may step by from session to session, (n_units, 6, k)."""
    labels, session = np.unique(path.s.labels["session"], return_inverse=True)
    inside = [_standardised((session == later).astype(np.float64))[0] for later in range(1, len(labels))]
    return _on_radii(path, [(mine, (0, 1)) for mine in inside])


def ambient_interactions(path: Path) -> list[FloatArray]:
    """Return what temperature and dwell may do differently at another total or own load, speed or turning.

    (n_units, 6, 2) for each pair that varies.
    """
    observations = path.s
    left, right = observations.number("load_left_N"), observations.number("load_right_N")
    speed, turned = observations.number("speed_mps"), observations.total(np.abs(observations.turn_rad))
    total = left + right
    others = ((total, total), (left, right), (speed, speed), (turned, turned))
    values = (observations.number("temperature_C"), observations.number("minutes_under_load"))
    each = [
        [(first * second, (k,)) for k in (0, 1) for second in _standardised(pair[k])]
        for value in values
        for first in _standardised(value)
        for pair in others
    ]
    return [_on_radii(path, columns) for columns in each if columns]


def load_speed_trends(path: Path) -> FloatArray:
    """Return what radii may do with load (straight and curved) and speed, (n_units, 6, k)."""
    observations = path.s
    columns: list[Column] = []
    for wheel, side in enumerate(("left", "right")):
        for load in _standardised(observations.number(f"load_{side}_N")):
            columns += [(load, (wheel,)), *((curved, (wheel,)) for curved in _standardised(load**2))]
    columns += [(speed, (0, 1)) for speed in _standardised(observations.number("speed_mps"))]
    return _on_radii(path, columns)


def route_trends(path: Path) -> FloatArray:
    """Return what each channel may do with loads and speed on each route, (n_units, 6, k), to a metre or radian."""
    observations, columns = path.s, []
    left, right = observations.number("load_left_N"), observations.number("load_right_N")
    for on in (observations.kind == kind for kind in np.unique(observations.kind)):
        for values in (left + right, right - left, observations.number("speed_mps")):
            for column in _standardised(np.where(on, values, np.nan)):
                columns += [column[:, None] * (observations.usable & (np.arange(N_CHANNELS) == k)) for k in range(4)]
    columns = [column for column in columns if column.any()]
    return np.stack(columns, axis=2) if columns else np.zeros((*observations.usable.shape, 0))


def _on_radii(path: Path, columns: Sequence[Column]) -> FloatArray:
    pushed = [path.calibration[:, :, k] * column[:, None] * STEP for column, wheels in columns for k in wheels]
    stacked = np.stack(pushed, axis=2) if pushed else np.zeros((len(path.s), 6, 0))
    return np.where(path.s.usable[:, :, None], stacked, 0.0)


def _standardised(values: FloatArray) -> list[FloatArray]:
    if not np.isfinite(values).any():
        return []
    filled = np.nan_to_num(values - np.nanmean(values))
    spread = float(filled.std())
    return [filled / spread] if spread > 1e-9 else []
