"""Robust Gauss-Newton with noise that grows along the path."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from scipy.special import chdtri

from calib.kinematics.drives import Parameters, Path
from calib.kinematics.model import Model, Prediction, Segments
from calib.types import WAY_PER_RAD_M, BoolArray, FloatArray, IntArray

#: variances of a displacement's covariance: of the reference's position and heading (m^2, rad^2), of the random walks
#: of heading and distance (rad^2/m, m^2/m)
COMPONENTS: Final = ("reference_xy", "reference_theta", "heading_walk", "along_walk")
#: how far below its stated size
LEAST: Final = 1e-4
#: readings at the stated size beside the data: of few runs a walk may fit all by chance
STATED_READINGS: Final = np.array([1.0, 1.0, 0.0, 0.0])
#: exponent of the step: 0.5 never lowers the likelihood, slowly
POWER: Final = 0.9


def kernels(path: Path, body: FloatArray, segments: Segments, yaw_rad: float) -> FloatArray:
    """Return each displacement's covariance for unit `COMPONENTS`, (4, n, 3, 3), in the sensor's frame at its start.

    `body` (shape (3, n_samples)): motion in each step; `yaw_rad`: of the sensor on the vehicle.
    """
    n = len(segments)
    kernel = np.zeros((len(COMPONENTS), n, 3, 3))
    kernel[0, :, 0, 0] = kernel[0, :, 1, 1] = 2.0
    start = np.stack([segments.measured[:, 1], -segments.measured[:, 0], -np.ones(n)], axis=1)
    kernel[1] = start[:, :, None] * start[:, None, :]
    kernel[1, :, 2, 2] += 1.0
    turn = path.pose[2, segments.first] + yaw_rad
    if segments.around is not None:
        x, y = np.diff(path.pose[:2, segments.around], axis=2)[..., 0]
        turn = np.where((x == 0.0) & (y == 0.0), turn, np.arctan2(y, x))
    rotate = np.zeros((n, 3, 3))
    rotate[:, 0, 0] = rotate[:, 1, 1] = np.cos(turn)
    rotate[:, 0, 1], rotate[:, 1, 0] = np.sin(turn), -np.sin(turn)
    rotate[:, 2, 2] = 1.0
    kernel[2:] = rotate @ _walks(path, body, segments) @ rotate.transpose(0, 2, 1)
    return kernel * (segments.seen[:, :, None] & segments.seen[:, None, :])


def _walks(path: Path, body: FloatArray, segments: Segments) -> FloatArray:
    x, y, theta = path.pose
    weight = np.hypot(body[0], body[1]) + WAY_PER_RAD_M * np.abs(body[2])
    first, last, between = segments.first, segments.last, segments.between
    zero = between(weight)
    dx, dy = x[last] - x[first], y[last] - y[first]
    # moments about the start of each stretch, in two steps: nothing large cancels
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
    walk, along = np.zeros((2, len(segments), 3, 3))
    walk[:, 0, 0], walk[:, 1, 1], walk[:, 2, 2] = np.maximum(aa, 0.0), np.maximum(bb, 0.0), zero
    walk[:, 0, 1] = walk[:, 1, 0] = ab
    walk[:, 0, 2] = walk[:, 2, 0] = a
    walk[:, 1, 2] = walk[:, 2, 1] = b
    cosine, sine = np.cos(theta), np.sin(theta)
    along[:, 0, 0], along[:, 1, 1] = between(weight * cosine**2), between(weight * sine**2)
    along[:, 0, 1] = along[:, 1, 0] = between(weight * cosine * sine)
    return np.stack([walk, along])


#: rows of a lower triangle: symmetric matrices are kept as shape (6, n)
_ROWS: Final = np.array([0, 1, 1, 2, 2, 2])
_COLUMNS: Final = np.array([0, 0, 1, 0, 1, 2])
#: how often an entry stands in the whole matrix
_TIMES: Final = np.where(_ROWS == _COLUMNS, 1.0, 2.0)[:, None]


#: degrees of freedom of the Student t
DEGREES: Final = 5.0
#: linearisations; those in which the noise is estimated too; steps within one
ROUNDS: Final = 15
NOISE_ROUNDS: Final = 4
INNER: Final = 40
#: stretches from which the noise is estimated
NOISE_STRETCHES: Final = 500
#: a step below this part of a standard deviation ends the search; one below it squared ends the steps within
CLOSE: Final = 1e-3
#: a change within a step below this part of it ends the steps within
INEXACT: Final = 1e-2
#: a step of the noise's variances that gains less log likelihood is the last
STEADY: Final = 1e-3
#: pull to the nominal values, in parts of the information: only for solvability
RIDGE: Final = 1e-10
#: step, in prior spreads
LONGEST: Final = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Shared:
    """A random effect of unit variance that segments of one group share."""

    #: of each segment, shape (n,)
    group: IntArray
    #: what a unit of it adds to whitened, weighted residuals, shape (n, 3)
    change: FloatArray
    #: what it is taken to be in each group, shape (n_groups,)
    amount: FloatArray

    @property
    def size(self) -> FloatArray:
        """Information on it in each group, shape (n_groups,)."""
        size = np.bincount(self.group, np.square(self.change).sum(axis=1), minlength=len(self.amount))
        return np.asarray(size, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Result of the search."""

    #: all parameters; those not free at their nominal value, shape (n_parameters,)
    values: FloatArray
    prediction: Prediction
    #: variances of the noise's components, shape (4,)
    scales: FloatArray
    #: turns residuals into ones of unit covariance, shape (n, 3, 3)
    whitener: FloatArray
    #: robust, shape (n,)
    weights: FloatArray
    #: squared whitened residuals, their middle where normal noise has it, shape (n,)
    squares: FloatArray
    converged: bool
    #: information that nominal values add, shape (n_free, n_free)
    pull: FloatArray
    #: a random effect beside the noise; the prediction contains it
    shared: Shared | None = None


def solve(
    model: Model,
    parameters: Parameters,
    start: FloatArray,
    scales: FloatArray,
    rounds: int = ROUNDS,
    noise_rounds: int = NOISE_ROUNDS,
    steady: float = STEADY,
) -> Solution:
    """Return the parameters that the data make most likely.

    Parameters
    ----------
    model, parameters
        What predicts displacements, and what is estimated, with the spread of what is possible.
    start, scales : array, shapes (n_parameters,) and (4,)
        Where to begin, also with the variances of the noise's components.
    rounds, noise_rounds
        Linearisations at most, and those in which the noise is estimated too.
    steady
        A step of the noise's variances that gains less log likelihood ends their estimation.
    """
    values, stated = start.copy(), scales
    free, prior = parameters.free, parameters.prior_std
    seen = model.segments.seen
    size = seen.sum(axis=1)
    prediction, converged = model.predict(values), False
    for number in range(rounds):
        by_spread = prediction.jacobian[:, :, free].transpose(1, 0, 2) * prior[free]
        if number < noise_rounds:
            kernel = _kernel(model, prediction, values)
            whitener = _whiteners(kernel, scales, seen)
        share = float(_weights(_whitened(whitener, prediction.residuals.T), size)[0].mean())
        # normal at first: another minimum may lie in a robust one's tail
        nominal = partial(_nominal, parameters, share=share, dof=DEGREES if number >= noise_rounds else 1e9)
        off, pulls, _ = nominal(values)
        pull = np.sqrt(pulls)[:, None] * parameters.pull, np.sqrt(pulls) * off
        problem = _Linear(np.ascontiguousarray(prediction.residuals.T), by_spread, seen, size, *pull)
        if number < noise_rounds:
            thinned = slice(None, None, max(1, len(size) // NOISE_STRETCHES))
            scales = _noise(problem.part(thinned), np.ascontiguousarray(kernel[:, :, thinned]), scales, stated, steady)
            whitener = _whiteners(kernel, scales, seen)
        spreads, sigmas = _settle(problem, whitener)
        step = np.zeros(len(values))
        step[free] = spreads * prior[free]
        if number >= noise_rounds - 1 and sigmas < CLOSE:
            converged = True
            break
        part = LONGEST / max(float(np.max(np.abs(spreads), initial=0.0)), LONGEST)
        # a delay's derivative is the speed over some samples: shorter steps find nothing
        least_part = INEXACT / max(sigmas, INEXACT) / part
        advanced = _advance(model, (values, prediction), part * step, least_part, whitener, nominal)
        if advanced is None and number >= noise_rounds - 1:
            break
        values, prediction = advanced or (values, prediction)
    weights, squares = _weights(_whitened(whitener, prediction.residuals.T), size)
    ratio = float(np.median(squares / chdtri(np.maximum(size, 1), 0.5)))
    squares, known = squares / ratio if ratio > 0.0 else squares, _known(parameters, values)
    return Solution(values, prediction, scales, _whole(whitener), weights, squares, converged, known)


def planned(model: Model, parameters: Parameters, values: FloatArray, scales: FloatArray) -> Solution:
    """Return the solution of runs not driven yet, at known variances of the noise, shape (4,)."""
    prediction, seen = model.predict(values), model.segments.seen
    whitener = _whiteners(_kernel(model, prediction, values), scales, seen)
    n, known = len(seen), _known(parameters, values)
    return Solution(values, prediction, scales, _whole(whitener), np.ones(n), np.zeros(n), True, known)


def _nominal(
    parameters: Parameters, values: FloatArray, share: float = 1.0, dof: float = DEGREES
) -> tuple[FloatArray, FloatArray, float]:
    # spreads off in the rows that pull, weights and loss. The mean radius, the last row, may be far off: robust with
    # `dof`, at first no heavier than residuals: `share`
    off = parameters.pull @ ((parameters.nominal - values) / parameters.prior_std)[parameters.free]
    weights, losses = np.ones(len(off)), 0.5 * np.square(off)
    weights[-1:] = share * (dof + 1.0) / (dof + 2.0 * losses[-1:])
    losses[-1:] = 0.5 * share * (dof + 1.0) * np.log1p(2.0 * losses[-1:] / dof)
    return off, weights, float(losses.sum())


def _known(parameters: Parameters, values: FloatArray) -> FloatArray:
    rows = parameters.pull / parameters.prior_std[parameters.free]
    return (rows.T * np.minimum(_nominal(parameters, values)[1], 1.0)) @ rows


@dataclass(frozen=True, slots=True, eq=False)
class _Linear:
    residuals: FloatArray  #: shape (3, n)
    jacobian: FloatArray  #: shape (3, n, n_free)
    seen: BoolArray  #: shape (n, 3)
    size: IntArray  #: shape (n,)
    pull: FloatArray  #: towards nominal values, shape (n_rows, n_free)
    off: FloatArray  #: shape (n_rows,)

    def part(self, chosen: slice) -> "_Linear":
        residuals, jacobian = (np.ascontiguousarray(part[:, chosen]) for part in (self.residuals, self.jacobian))
        return replace(self, residuals=residuals, jacobian=jacobian, seen=self.seen[chosen], size=self.size[chosen])

    def whitened(self, whitener: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return Jacobian, shape (3 n, n_free), and residuals, shape (3 n,), whitened."""
        jacobian = _whitened(whitener, self.jacobian).reshape(-1, self.jacobian.shape[2])
        return jacobian, _whitened(whitener, self.residuals).ravel()


def _settle(problem: _Linear, whitener: FloatArray) -> tuple[FloatArray, float]:
    jacobian, residuals = problem.whitened(whitener)
    step, moved = np.zeros(jacobian.shape[1]), np.zeros(len(residuals))
    for _ in range(INNER):
        step = _weighted(problem, jacobian, residuals, moved)
        before, moved = moved, jacobian @ step
        if float(np.linalg.norm(moved - before)) < max(CLOSE**2, INEXACT * float(np.linalg.norm(moved))):
            break
    return step, float(np.linalg.norm(moved))


def _weighted(problem: _Linear, jacobian: FloatArray, residuals: FloatArray, moved: FloatArray) -> FloatArray:
    weights = _weights((residuals - moved).reshape(3, -1), problem.size)[0]
    scaled = (jacobian.reshape(3, -1, jacobian.shape[1]) * weights[:, None]).reshape(jacobian.shape)
    normal = scaled.T @ jacobian + problem.pull.T @ problem.pull
    normal.flat[:: len(normal) + 1] += RIDGE * max(float(np.trace(normal)) / max(len(normal), 1), 1.0)
    return np.asarray(np.linalg.solve(normal, residuals @ scaled + problem.off @ problem.pull))


def _noise(problem: _Linear, kernel: FloatArray, scales: FloatArray, stated: FloatArray, steady: float) -> FloatArray:
    # by steps that do not lower the likelihood (Zhou et al. 2019); kernel: lower triangles, (4, 6, n)
    flat = kernel.reshape(len(kernel), -1)
    step = np.zeros(problem.jacobian.shape[2])
    for _ in range(INNER):
        whitener = _whiteners(kernel, scales, problem.seen)
        jacobian, residuals = problem.whitened(whitener)
        step = _weighted(problem, jacobian, residuals, jacobian @ step)
        left = (residuals - jacobian @ step).reshape(3, -1)
        a, b, c, d, e, f = whitener
        x, y, turn = left * np.sqrt(_weights(left, problem.size)[0])
        pulled = np.stack([a * x + b * y + d * turn, c * y + e * turn, f * turn])
        inverse = np.stack([a * a + b * b + d * d, b * c + d * e, c * c + e * e, d * f, e * f, f * f]) * _TIMES
        size, trace = flat @ (_TIMES * pulled[_ROWS] * pulled[_COLUMNS]).ravel(), flat @ inverse.ravel()
        now = scales
        size, trace = size + STATED_READINGS * stated / now**2, trace + STATED_READINGS / now
        quotient = size / np.where(trace > 0.0, trace, 1.0)
        moved = np.maximum(now * np.clip(quotient, 0.05, 20.0) ** POWER, LEAST * stated)
        gains = 0.5 * np.abs(now * (size - trace) * np.log(moved / now)) >= steady
        scales = np.where(gains, moved, now)
        if not gains.any():
            break
    return scales


def _kernel(model: Model, prediction: Prediction, values: FloatArray) -> FloatArray:
    whole = kernels(prediction.path, model.motion(values).body, model.segments, float(values[-2]))
    return np.ascontiguousarray(whole[:, :, _ROWS, _COLUMNS].transpose(0, 2, 1))


def _whiteners(kernel: FloatArray, scales: FloatArray, seen: BoolArray) -> FloatArray:
    total = (scales @ kernel.reshape(len(kernel), -1)).reshape(6, -1)
    total[_ROWS == _COLUMNS] += np.where(seen.T, 1e-18, 1.0)
    xx, yx, yy, tx, ty, tt = total
    with np.errstate(invalid="ignore", divide="ignore"):
        a = np.sqrt(xx)
        b, c = yx / a, tx / a
        d = np.sqrt(yy - b * b)
        e = (ty - c * b) / d
        f = np.sqrt(tt - c * c - e * e)
    if not (a * d * f > 0.0).all():
        raise np.linalg.LinAlgError("a covariance is not positive definite")
    return np.stack([1.0 / a, -b / (a * d), 1.0 / d, (b * e - c * d) / (a * d * f), -e / (d * f), 1.0 / f])


def _whitened(whitener: FloatArray, values: FloatArray) -> FloatArray:
    a, b, c, d, e, f = whitener if values.ndim == 2 else whitener[:, :, None]
    x, y, turn = values
    white = np.empty_like(values)
    white[0], white[1], white[2] = a * x, b * x + c * y, d * x + e * y + f * turn
    return white


def _whole(whitener: FloatArray) -> FloatArray:
    whole = np.zeros((whitener.shape[1], 3, 3))
    whole[:, _ROWS, _COLUMNS] = whitener.T
    return whole


def _weights(white: FloatArray, size: IntArray) -> tuple[FloatArray, FloatArray]:
    squares = np.square(white).sum(axis=0)
    return (DEGREES + size) / (DEGREES + squares), squares


def _advance(
    model: Model,
    start: tuple[FloatArray, Prediction],
    step: FloatArray,
    least_part: float,
    whitener: FloatArray,
    nominal: Callable[[FloatArray], tuple[FloatArray, FloatArray, float]],
) -> tuple[FloatArray, Prediction] | None:
    size = model.segments.seen.sum(axis=1)

    def loss(values: FloatArray, residuals: FloatArray) -> float:
        squares = _weights(_whitened(whitener, residuals.T), size)[1]
        return float(np.sum(0.5 * (DEGREES + size) * np.log1p(squares / DEGREES))) + nominal(values)[2]

    part, most = 1.0, loss(start[0], start[1].residuals) * (1.0 + 1e-12)
    while part == 1.0 or part >= least_part:
        trial = start[0] + part * step
        prediction = model.predict(trial, by_drive=part == 1.0)
        if loss(trial, prediction.residuals) <= most:
            return trial, prediction if part == 1.0 else model.predict(trial, path=prediction.path)
        part *= 0.4
    return None
