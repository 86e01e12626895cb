"""Covariance by clusters of runs or blocks (sandwich) or along a path of blocks, and whether sessions differ."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.special import digamma, fdtrc, polygamma, stdtrit

from calib.kinematics import Recording
from calib.kinematics.drives import Parameters
from calib.kinematics.model import Segments
from calib.kinematics.solve import DEGREES, Shared, Solution
from calib.types import BoolArray, FloatArray, IntArray, StrArray, floats

#: a length that turns determine relative to a radius -> these radii, of which the mean counts
_BESIDE: Final[Mapping[str, tuple[str, ...]]] = {
    "track_m": ("radius_left_m", "radius_right_m"),
    "wheelbase_m": ("front_radius_m",),
    "half_length_plus_half_width_m": ("wheel_radius_m",),
}
_WHEELS: Final = ("radius_left_m", "radius_right_m")


@dataclass(frozen=True, slots=True, eq=False)
class Freedom:
    """Degrees of freedom of the standard deviations."""

    #: rows: sums of parameters whose errors are nearly independent, shape (n_parameters, n_parameters)
    directions: FloatArray
    std: FloatArray  #: of each, shape (n_parameters,)
    dof: FloatArray  #: of `std`, shape (n_parameters,)

    def of(self, contrast: FloatArray) -> float:
        """Return the degrees of freedom of the variance of a sum of parameters (Welch and Satterthwaite)."""
        parts = np.square(np.linalg.solve(self.directions.T, contrast) * self.std)
        return float(parts.sum() ** 2 / max(float(np.sum(np.square(parts) / self.dof)), 1e-300))

    def select(self, kept: IntArray) -> "Freedom":
        """Return that of sums of some parameters alone."""
        return Freedom(self.directions[np.ix_(kept, kept)], self.std[kept], self.dof[kept])


def own_directions(names: Sequence[str], values: FloatArray) -> FloatArray:
    """Return sums of parameters with separate errors, rows (n, n): mean radius, by distances; ratios, by headings.

    `values` (shape (n,)).
    """
    at, out = {name: number for number, name in enumerate(names)}, np.eye(len(names))
    for name, radii in _BESIDE.items():
        if name in at and all(radius in at for radius in radii):
            places = [at[radius] for radius in radii]
            out[at[name], places] = -values[at[name]] / values[places].sum()
    if all(name in at for name in _WHEELS):
        left, right = (at[name] for name in _WHEELS)
        out[left, [left, right]] = 0.5
        out[right, [left, right]] = -1.0 / values[left], 1.0 / values[right]
    return out


#: cosines for n blocks: this times n^(2/3): of many the slower part counts
COSINES: Final = 3.3
#: how much steeper than level a spectrum may be, over the square of the frequency
STEEPNESS: Final = np.concatenate([-np.logspace(2.0, -1.0, 13), [0.0], np.logspace(-1.0, 2.0, 13)])


def _cosines(n: int) -> tuple[FloatArray, FloatArray]:
    number = np.arange(1.0, min(round(COSINES * n ** (2.0 / 3.0)), n - 1) + 1.0)
    waves = np.sqrt(2.0 / n) * np.cos(np.pi * np.outer(number, (np.arange(n) + 0.5) / n))
    return waves, 4.0 * np.square(np.sin(0.5 * np.pi * number / n))


def _level_at_zero(powers: FloatArray, squares: FloatArray, dof: float) -> tuple[float, float, FloatArray]:
    # the mixture over steepness by an inverse chi squared of the same mean and variance of the logarithm
    raised = 1.0 + np.abs(STEEPNESS)[:, None] * squares
    shapes = np.where(STEEPNESS[:, None] >= 0.0, raised, 1.0 / raised)
    levels = np.maximum((powers / shapes).mean(axis=1), 1e-300)
    likelihood = -0.5 * np.log(shapes).sum(axis=1) - 0.5 * len(powers) * np.log(levels)
    weights = np.exp(likelihood - likelihood.max())
    weights /= weights.sum()
    logs = np.log(levels) + np.log(0.5 * dof) - digamma(0.5 * dof)
    mean = float(weights @ logs)
    variance = float(weights @ np.square(logs - mean) + polygamma(1, 0.5 * dof))
    grid = np.geomspace(0.2, 2e4, 2000)
    matched = float(np.interp(-variance, -polygamma(1, 0.5 * grid), grid))
    level = float(np.exp(mean + digamma(0.5 * matched) - np.log(0.5 * matched)))
    return level, matched, np.asarray(np.exp(weights @ np.log(shapes)))


def covariance_along(pulls: FloatArray, information: FloatArray, directions: FloatArray) -> tuple[FloatArray, Freedom]:
    """Return the covariance of `directions` (see `own_directions`), and its degrees of freedom.

    `pulls` (shape (n_blocks, n_parameters)), `information` (shape (n_blocks, n_parameters, n_parameters)): of each
    block as driven. All are in columns in which all blocks together have unit information.
    """
    waves, squares = _cosines(len(pulls))
    number, amplitudes = len(squares), waves @ pulls @ directions.T
    std, dof, flat = np.empty(len(directions)), np.empty(len(directions)), np.empty_like(amplitudes)
    for at, direction in enumerate(directions):
        seen = information @ direction
        # what independent blocks would leave in each cosine after the fit
        taken = waves @ seen
        left = (waves * (seen @ direction)) @ waves.T - taken @ taken.T
        share = np.maximum(len(pulls) * np.diag(left) / max(float(direction @ seen.sum(axis=0)), 1e-300), 1e-6)
        own = max(float(np.trace(left) ** 2 / max(float(np.square(left).sum()), 1e-300)), 1.0)
        level, dof[at], shape = _level_at_zero(np.square(amplitudes[:, at]) / share, squares, own)
        std[at] = np.sqrt(len(pulls) * level)
        flat[:, at] = amplitudes[:, at] / np.sqrt(shape * share)
    products = flat.T @ flat
    size = np.sqrt(np.maximum(np.diag(products), 1e-300))
    # fewer cosines would leave some sum without any spread
    correlation = (number * products / np.outer(size, size) + np.eye(len(size))) / (number + 1.0)
    return correlation * np.outer(std, std), Freedom(np.eye(len(std)), std, dof)


#: power that is unbiased for known weights (CR2); 1 is the jackknife (CR3)
UNBIASED: Final = 0.5
#: for single runs: the coverage lies between the two
OF_RUNS: Final = 0.75


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """Covariance of the free parameters and the degrees of freedom of each."""

    covariance: FloatArray  #: of the free parameters, shape (n_free, n_free)
    dof: FloatArray  #: of what data leave of each standard deviation, shape (n_free,)
    #: independent groups (``run``, ``block``, ``session`` or ``route``), and their number
    by: str
    clusters: int
    #: standard deviations with all groups independent: steadier, to compare estimates by, shape (n_free,)
    apart: FloatArray
    known: FloatArray  #: variances that nominal values leave, part of the covariance's, shape (n_free,)
    freedom: Freedom | None = None  #: of sums of parameters, where known

    @property
    def std(self) -> FloatArray:
        """Standard deviations, shape (n_free,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def free(self) -> FloatArray:
        """Degrees of freedom of `std`, (n_free,): the part that nominal values leave is known."""
        variance = np.diag(self.covariance)
        return self.dof * np.square(variance / np.maximum(variance - self.known, 1e-9 * variance))


def whitened(solution: Solution, free: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return Jacobian, shape (n, 3, n_free), and residuals, shape (n, 3), whitened and weighted.

    A random effect is part of the covariance, not of the prediction.
    """
    root = np.sqrt(solution.weights)[:, None]
    jacobian = np.asarray((solution.whitener @ solution.prediction.jacobian[:, :, free]) * root[:, :, None])
    residuals = np.einsum("nij,nj->ni", solution.whitener, solution.prediction.residuals) * root
    shared = solution.shared
    if shared is None:
        return jacobian, residuals
    residuals = residuals + shared.change * shared.amount[shared.group][:, None]
    return _decorrelated(jacobian, shared), _decorrelated(residuals[:, :, None], shared)[:, :, 0]


def flattened(jacobian: FloatArray) -> FloatArray:
    """Return a Jacobian (n, 3, n_free) as rows, (3 n, n_free)."""
    return jacobian.reshape(-1, jacobian.shape[2])


def _decorrelated(columns: FloatArray, shared: Shared) -> FloatArray:
    factor = (1.0 / np.sqrt(1.0 + shared.size) - 1.0) / np.maximum(shared.size, 1e-300)
    sums = np.zeros((len(shared.amount), columns.shape[2]))
    np.add.at(sums, shared.group, np.einsum("ni,nik->nk", shared.change, columns))
    return columns + shared.change[:, :, None] * (factor[:, None] * sums)[shared.group][:, None, :]


def _unit_columns(solution: Solution, free: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    jacobian, residuals = whitened(solution, free)
    information = flattened(jacobian).T @ flattened(jacobian) + solution.pull
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    root = np.linalg.cholesky(np.linalg.inv(information * np.outer(scale, scale)))
    return flattened(jacobian * scale) @ root, residuals.ravel(), root, scale


def _by_nominal(solution: Solution, root: FloatArray, scale: FloatArray) -> FloatArray:
    return (bread := root @ root.T * np.outer(scale, scale)) @ solution.pull @ bread


def _rows_of(cluster: IntArray) -> Iterator[IntArray]:
    order = np.argsort(np.repeat(cluster, 3), kind="stable")
    for low, high in pairwise(np.concatenate(([0], np.cumsum(3 * np.bincount(cluster))))):
        yield order[low:high]


def sandwich_along(solution: Solution, free: BoolArray, block: IntArray, directions: FloatArray) -> Uncertainty:
    """Return the covariance from blocks (n,), numbered along the path, which share noise with neighbours.

    `free` (shape (n_parameters,)); `directions`: of `own_directions`.
    """
    flat, residuals, root, scale = _unit_columns(solution, free)
    parts = [(flat[rows], residuals[rows]) for rows in _rows_of(block)]
    pulls = _influence(solution) * np.stack([part.T @ residual for part, residual in parts])
    information = np.stack([part.T @ part for part, _ in parts])
    covariance, freedom = covariance_along(pulls, information, (directions * scale) @ root)
    back = np.linalg.inv(directions)
    freedom = replace(freedom, directions=directions)
    return replace(
        sandwich(solution, free, block, "block"),
        covariance=back @ covariance @ back.T + _by_nominal(solution, root, scale),
        dof=np.array([freedom.of(unit) for unit in np.eye(len(directions))]),
        freedom=freedom,
    )


def sandwich(
    solution: Solution,
    free: BoolArray,
    cluster: IntArray,
    by: str,
    power: float = UNBIASED,
    directions: FloatArray | None = None,
) -> Uncertainty:
    """Return the covariance of the free parameters by what stretches of one cluster leave together.

    Parameters
    ----------
    solution, free
        The robust fit, and which parameters were free, shape (n_parameters,).
    cluster, by
        Stretches of one cluster share their noise, shape (n,), and what clusters are.
    power
        Of what leverage takes from the residuals; they are enlarged by it.
    directions
        Sums of parameters, shape (n_free, n_free); see `sandwich_along`.
    """
    flat, residuals, root, scale = _unit_columns(solution, free)
    cluster = np.unique(cluster, return_inverse=True)[1]
    pulls, sizes, shares = [], [], []
    wanted = np.eye(len(root)) if directions is None else np.concatenate([np.eye(len(root)), directions])
    turned = root.T @ (wanted * scale).T
    for rows in _rows_of(cluster):
        part, residual = flat[rows], residuals[rows]
        left, singular, right = np.linalg.svd(part, full_matrices=False)
        grow = np.maximum(1.0 - singular**2, 1e-6) ** -power - 1.0
        lever = part + (left * (grow * singular)) @ right
        pulls.append(lever.T @ residual)
        seen = lever @ turned
        sizes.append(np.square(seen).sum(axis=0))
        shares.append(part.T @ seen)
    pull = np.stack(pulls) @ root.T
    factor = _influence(solution)
    by_nominal = _by_nominal(solution, root, scale)
    by_data = factor**2 * (pull.T @ pull) * np.outer(scale, scale)
    columns = zip(np.stack(sizes).T, np.moveaxis(np.stack(shares), 2, 0), strict=True)
    inner = [np.diag(size) - share @ share.T for size, share in columns]
    degrees = np.array([max(np.trace(one) ** 2 / max(np.square(one).sum(), 1e-300), 1.0) for one in inner])
    covariance = by_data + by_nominal
    uncertainty = Uncertainty(
        covariance, degrees[: len(root)], by, len(pull), np.sqrt(np.diag(covariance)), np.diag(by_nominal)
    )
    if directions is None:
        return uncertainty
    std = np.sqrt(np.diag(directions @ by_data @ directions.T))
    return replace(uncertainty, freedom=Freedom(directions, std, degrees[len(root) :]))


def _by_information(solution: Solution, free: BoolArray) -> FloatArray:
    jacobian = flattened(whitened(solution, free)[0])
    return np.asarray(np.linalg.inv(jacobian.T @ jacobian + solution.pull), dtype=np.float64)


def expected(solution: Solution, free: BoolArray, cluster: IntArray) -> Uncertainty:
    """Return the covariance by the runs' information, and the degrees of freedom of `sandwich`."""
    covariance = _by_information(solution, free)
    by_runs = sandwich(solution, free, cluster, "run", power=OF_RUNS)
    return replace(by_runs, covariance=covariance, apart=np.sqrt(np.diag(covariance)))


def _influence(solution: Solution) -> float:
    size = np.maximum(solution.prediction.jacobian.any(axis=2).sum(axis=1), 1)
    squares = (DEGREES + size) / solution.weights - DEGREES
    slope = solution.weights * (1.0 - 2.0 * squares / (size * (DEGREES + squares)))
    return float(np.mean(solution.weights) / max(np.mean(slope), 0.2 * np.mean(solution.weights)))


#: of taking like sessions for different ones: a campaign is judged once
SESSIONS_CHANCE: Final = 1e-4
#: columns that depend more on the others tell nothing of their own
DEPENDENT: Final = 1e-6


def left_within(solution: Solution, free: BoolArray, segments: Segments, labels: StrArray) -> tuple[float, float]:
    """Return root mean squares of position (m) and heading (rad) left by a fit of each session.

    A session has its own parameters, start heading and yaw of the reference's axes. Infinite where sessions do not
    differ beyond chance (F test), or too little is known. `labels` (shape (n_runs,)): session of each run.
    """
    turned = np.zeros((len(segments), 3, 2))
    turned[:, 0], turned[:, 1] = segments.measured[:, 1:2], -segments.measured[:, :1]
    turned[:, 2, 0] = -1.0
    turned[~segments.seen] = 0.0
    columns = np.concatenate([solution.prediction.jacobian[:, :, free], turned], axis=2)
    residuals = solution.prediction.residuals
    white, white_residuals = solution.whitener @ columns, np.einsum("nij,nj->ni", solution.whitener, residuals)
    session, longest = labels[segments.run], segments.level == 0
    enough, squares, dof, left, n_segments = np.zeros_like(longest), 0.0, 0, np.zeros(2), np.zeros(2)
    for label in np.unique(session[longest]):
        at = (session == label) & longest
        (step, square, rank), seen = _least_squares(white[at], white_residuals[at]), segments.seen[at]
        if (size := int(seen.sum())) < 2 * rank:
            continue
        own = residuals[at] - columns[at] @ step
        enough, squares, dof = enough | at, squares + square, dof + size - rank
        left += np.array([np.square(own[:, :2]).sum(), np.square(own[:, 2]).sum()]) * size / (size - rank)
        n_segments += seen[:, :2].any(axis=1).sum(), seen[:, 2].sum()
    if squares > 0.0:
        # axes turned alike in all sessions are no difference between them
        _, together, rank = _least_squares(white[enough], white_residuals[enough])
        freed = int(segments.seen[enough].sum()) - rank - dof
        if freed > 0 and fdtrc(freed, dof, (together - squares) / freed / (squares / dof)) <= SESSIONS_CHANCE:
            position, heading = np.sqrt(left / np.maximum(n_segments, 1.0))
            return float(position), float(heading)
    return np.inf, np.inf


def _least_squares(columns: FloatArray, values: FloatArray) -> tuple[FloatArray, float, int]:
    flat = columns.reshape(-1, columns.shape[2])
    scale = np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
    step, _, rank, _ = np.linalg.lstsq(flat / scale, values.ravel(), rcond=DEPENDENT)
    return step / scale, float(np.square(values.ravel() - flat @ (step / scale)).sum()), int(rank)


#: groups for a covariance
FEWEST_CLUSTERS: Final = 4
#: so many runs are the groups; of fewer, blocks within them
ENOUGH_RUNS: Final = 8
#: standard deviations of the correlation of scores within a group from which it counts as one
ALIKE: Final = 2.6


def clustered(solution: Solution, parameters: Parameters, recording: Recording, segments: Segments) -> Uncertainty:
    """Return the covariance, clustered by run or block, session or route: that of the widest intervals.

    Sessions, or routes, are groups where scores within them are correlated, or sessions differ. No interval is narrower
    than by the noise.
    """
    free = parameters.free
    _, first, block = np.unique(segments.block, return_index=True, return_inverse=True)
    run, (flat, residuals, *_) = segments.run[first], _unit_columns(solution, free)
    pulls = (flat * residuals[:, None]).reshape(len(block), 3, -1).sum(axis=1)
    scores = floats(np.stack([np.bincount(block, column) for column in pulls.T], axis=1))
    own = own_directions(parameters.free_names, solution.values[free])
    if len(np.unique(run)) >= min(ENOUGH_RUNS, len(run)):
        best = sandwich(solution, free, segments.run, "run", OF_RUNS, own)
    else:
        best = sandwich_along(solution, free, block, own)
    alone = best.by
    for name, labels in (("session", recording.session), ("route", recording.routes)):
        group = np.unique(labels, return_inverse=True)[1][run]
        apart = name == "session" and left_within(solution, free, segments, recording.session)[0] < np.inf
        if len(np.unique(group)) >= FEWEST_CLUSTERS and (apart or _alike(scores, group) > ALIKE):
            candidate = sandwich(solution, free, group[block], name, directions=own)
            if best.by == alone or _width(candidate) > _width(best):
                best = candidate
    if alone == "block":
        return best
    least = np.sqrt(np.diag(_by_information(solution, free)))
    wider = np.maximum(least / np.maximum(best.std, 1e-300), 1.0)
    return replace(best, covariance=best.covariance * np.outer(wider, wider))


def _width(uncertainty: Uncertainty) -> float:
    return float(np.mean(np.log(uncertainty.std * stdtrit(uncertainty.dof, 0.975))))


def _alike(scores: FloatArray, group: IntArray) -> float:
    pairs = (scores @ scores.T)[np.triu(group[:, None] == group, 1)]
    spread = float(np.linalg.norm(pairs))
    return float(pairs.sum()) / spread if spread > 0.0 else 0.0
