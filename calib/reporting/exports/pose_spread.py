"""What spread of end poses a motion model predicts, and the sizes of its noise that the residuals of runs show.

AMCL's differential motion model (S. Thrun, W. Burgard, D. Fox, Probabilistic Robotics, 2005, section 5.4, as nav2_amcl
has it) splits the motion between two updates into a turn, a way and a turn, each with a variance of its own::

    turn: alpha1 turn^2 + alpha2 way^2      way: alpha3 way^2 + alpha4 (turn_1^2 + turn_2^2)

so the covariance of an end pose is linear in the four alphas. The same holds of a random walk of distance and heading,
whose variances grow with the way, and of errors that stay the same during a run. All are estimated from end poses of
runs that the correction has not seen, the uncertainty of the reference beside them.

Errors that stay the same during a run (a radius that differs from run to run) cannot be drawn step by step. Round a
square they add up in heading and partly cancel in position, so no alphas spread as these runs do: `form_ratios`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.gap.observations.arrays import Channel
from calib.gap.predict import Path
from calib.types import BoolArray, FloatArray, StrArray

#: motion between two updates of the filter: the defaults of nav2_amcl
UPDATE_MIN_D_M: Final = 0.25
UPDATE_MIN_A_RAD: Final = 0.2
#: a shorter way has no direction: the filter takes the first turn as zero
SHORTEST_WAY_M: Final = 0.01
#: end pose: along and left of the final heading, and heading
POSE: Final = (Channel.ALONG, Channel.LATERAL, Channel.HEADING)
ALPHAS: Final = ("alpha1", "alpha2", "alpha3", "alpha4")
WALKS: Final = ("along", "heading")
CONSTANT: Final = ("scale", "curvature", "turn scale")
#: the value that nav2_amcl has where nothing is stated
DEFAULT_ALPHA: Final = 0.2
#: a component that at its usual size adds less than this share to every variance shows nothing
LEAST_SHARE: Final = 0.1
#: runs are held out in so many parts: each is predicted by nine tenths of the others of its kind
FOLDS: Final = 10
#: coverage of the interval of a ratio
COVERAGE: Final = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """Components of the covariance of end poses, (n_components, n_obs, 3, 3), and the reference's (n_obs, 3, 3)."""

    names: tuple[str, ...]
    components: FloatArray
    reference: FloatArray

    def of(self, units: BoolArray) -> Spread:
        """Return the same of some observations (n_obs,)."""
        return Spread(self.names, self.components[:, units], self.reference[units])

    def covariance(self, sizes: FloatArray) -> FloatArray:
        """Return the covariance of each end pose (n_obs, 3, 3) for sizes (n_components,)."""
        return np.asarray(self.reference + np.einsum("c,cuij->uij", sizes, self.components))


def _levers(way: FloatArray, end: FloatArray) -> FloatArray:
    """Return what a turn at poses (n, 3) does to the end pose, in the frame of the end heading, shape (n, 3)."""
    dx, dy = end[0] - way[:, 0], end[1] - way[:, 1]
    c, s = math.cos(end[2]), math.sin(end[2])
    return np.column_stack((-c * dy + s * dx, s * dy + c * dx, np.ones(len(way))))


def _directions(heading: FloatArray, end: FloatArray) -> FloatArray:
    """Return what a metre of way in headings (n,) does to the end pose, in the frame of the end heading."""
    return np.column_stack((np.cos(heading - end[2]), np.sin(heading - end[2]), np.zeros(len(heading))))


def _outer(vectors: FloatArray, weights: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("n,ni,nj->ij", weights, vectors, vectors))


def amcl_components(poses: FloatArray) -> FloatArray:
    """Return the covariance of the end of a path (n, 3) that each alpha of 1 makes, shape (4, 3, 3)."""
    knots = poses[_updates(poses)]
    end = knots[-1]
    step = np.diff(knots, axis=0)
    way = np.hypot(step[:, 0], step[:, 1])
    course = np.arctan2(step[:, 1], step[:, 0])
    first = np.where(way < SHORTEST_WAY_M, 0.0, _wrapped(course - knots[:-1, 2]))
    second = _wrapped(step[:, 2] - first)
    # a vehicle that drives backward has not turned by half a turn
    turns = [np.minimum(np.abs(turn), np.abs(_wrapped(turn - np.pi))) ** 2 for turn in (first, second)]
    before, after = _levers(knots[:-1], end), _levers(knots[1:], end)
    along = _directions(np.where(way < SHORTEST_WAY_M, knots[:-1, 2], course), end)
    by_turns = _outer(before, turns[0]) + _outer(after, turns[1])
    by_way = _outer(before, way**2) + _outer(after, way**2)
    return np.stack((by_turns, by_way, _outer(along, way**2), _outer(along, turns[0] + turns[1])))


def walk_components(poses: FloatArray) -> FloatArray:
    """Return the covariance of the end of a path (n, 3) that random walks of 1 a metre make, shape (2, 3, 3)."""
    step = np.diff(poses, axis=0)
    way = np.hypot(step[:, 0], step[:, 1])
    middle, end = 0.5 * (poses[:-1] + poses[1:]), poses[-1]
    return np.stack((_outer(_directions(middle[:, 2], end), way), _outer(_levers(middle, end), way)))


def constant_components(poses: FloatArray) -> FloatArray:
    """Return the covariance of the end of a path (n, 3) that errors of 1 which stay during the run make, (3, 3, 3).

    A relative error of the way, an error of the curvature (1/m), and a relative error of the turns.
    """
    step = np.diff(poses, axis=0)
    way = np.hypot(step[:, 0], step[:, 1])
    middle, end = 0.5 * (poses[:-1] + poses[1:]), poses[-1]
    levers = _levers(middle, end)
    moved = np.stack((way @ _directions(middle[:, 2], end), way @ levers, step[:, 2] @ levers))
    return np.asarray(np.einsum("ci,cj->cij", moved, moved))


def _updates(poses: FloatArray) -> list[int]:
    """Return where the filter updates: after a way or a turn since the update before; both ends of the path."""
    kept = [0]
    for at in range(1, len(poses)):
        dx, dy, turn = poses[at] - poses[kept[-1]]
        if math.hypot(dx, dy) >= UPDATE_MIN_D_M or abs(turn) >= UPDATE_MIN_A_RAD:
            kept.append(at)
    if kept[-1] != len(poses) - 1:
        kept.append(len(poses) - 1)
    return kept


def _wrapped(angle: FloatArray) -> FloatArray:
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


#: model of the noise -> names and covariances of its components
MODELS: Final[dict[str, tuple[tuple[str, ...], Callable[[FloatArray], FloatArray]]]] = {
    "amcl": (ALPHAS, amcl_components),
    "walk": (WALKS, walk_components),
    "constant": (CONSTANT, constant_components),
}


def spread_of(path: Path, units: BoolArray, model: str) -> Spread:
    """Return the components of a model of `MODELS` on the paths of some observations (n_obs,)."""
    s = path.s
    names, component = MODELS[model]
    found = [component(poses) for poses, on in zip(path.traces(), units, strict=True) if on]
    reference = np.zeros((len(found), 3, 3))
    reference[:, 0, 0] = reference[:, 1, 1] = s.sigma_xy_m[units] ** 2
    reference[:, 2, 2] = s.sigma_theta_rad[units] ** 2
    return Spread(names, np.stack(found, axis=1), reference)


def sizes_of(spread: Spread, residuals: FloatArray, begin: FloatArray | None = None) -> FloatArray:
    """Return the sizes of the components (n_components,), none below zero, that fit the residuals (n_obs, 3) best.

    Likeliest with each of along, lateral and heading by itself: what a filter's particles spread over shall be right in
    each. `begin`: sizes near the solution, for a shorter search.
    """
    from scipy.optimize import minimize

    components = np.einsum("cuii->cui", spread.components).reshape(len(spread.names), -1)
    reference = np.einsum("uii->ui", spread.reference).ravel()
    square = residuals.ravel() ** 2
    # in the unit that makes each component as large as the residuals: one step of the search fits all
    relative = components.reshape(len(components), -1, 3) / np.mean(residuals**2, axis=0)
    unit = 1.0 / np.maximum(np.mean(relative, axis=(1, 2)), 1e-30)
    scaled = unit[:, None] * components

    def misfit(sizes: FloatArray) -> tuple[float, FloatArray]:
        variance = reference + sizes @ scaled
        value = 0.5 * float(np.sum(np.log(variance) + square / variance))
        return value, 0.5 * scaled @ ((1.0 - square / variance) / variance)

    start = np.full(len(unit), 1.0 / len(unit)) if begin is None else begin / unit
    found = minimize(misfit, start, jac=True, method="L-BFGS-B", bounds=[(0.0, None)] * len(unit))
    return np.asarray(found.x * unit)


def undetermined(spread: Spread, sizes: FloatArray) -> tuple[str, ...]:
    """Return the components that these runs say nothing of: at their usual size they would hardly show."""
    total = spread.covariance(sizes)
    names = []
    for name, component in zip(spread.names, spread.components, strict=True):
        share = np.einsum("uii->ui", DEFAULT_ALPHA * component) / np.einsum("uii->ui", total)
        if float(share.max(initial=0.0)) < LEAST_SHARE:
            names.append(name)
    return tuple(names)


def ratios(variance: FloatArray, residuals: FloatArray) -> FloatArray:
    """Return observed over predicted standard deviation along, lateral, in heading (3,); variance as residuals."""
    return np.asarray(np.sqrt(np.mean(residuals**2, axis=0) / np.mean(variance, axis=0)))


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """Sizes of the components, and observed over predicted standard deviation of runs that they were not fitted on."""

    sizes: FloatArray
    #: along, lateral, heading, shape (3,)
    ratios: FloatArray
    #: interval of each, shape (3, 2): what the true ratio may be, by the chance of these runs
    interval: FloatArray


def fitted(spread: Spread, residuals: FloatArray, kinds: StrArray) -> Fitted:
    """Fit the sizes, and hold each tenth of the runs of every kind (n_obs,) against the sizes that the others give.

    Sizes at their bound of zero take from the others, and few runs more often show too little scatter than too much:
    the sizes are raised until runs held out scatter as predicted in the mean of the three.
    """
    from scipy.stats import chi2

    full = sizes_of(spread, residuals)
    fold = np.empty(len(residuals), dtype=np.int64)
    fold[np.argsort(kinds, kind="stable")] = np.arange(len(residuals)) % FOLDS
    reference = np.einsum("uii->ui", spread.reference)
    added = np.empty_like(residuals)
    for number in range(FOLDS):
        held = fold == number
        sizes = sizes_of(spread.of(~held), residuals[~held], begin=full)
        added[held] = np.einsum("c,cuii->ui", sizes, spread.components[:, held])
    raised = max(1.0, float(np.exp(2.0 * np.mean(np.log(ratios(reference + added, residuals))))))
    variance = reference + raised * added
    found = ratios(variance, residuals)
    # the mean square has so many degrees of freedom as its own scatter says (Satterthwaite): few with heavy tails, but
    # never more than with normal ones, which the scatter of few squares hides
    normal = found**2 * variance
    scatter = np.sum((residuals**2 - normal) ** 2, axis=0)
    freedom = 2.0 * np.sum(residuals**2, axis=0) ** 2 / np.maximum(scatter, 2.0 * np.sum(normal**2, axis=0))
    tails = np.array([0.5 + 0.5 * COVERAGE, 0.5 - 0.5 * COVERAGE])
    interval = found[:, None] * np.sqrt(freedom[:, None] / chi2.ppf(tails, freedom[:, None]))
    return Fitted(raised * full, found, interval)


def form_ratios(amcl: Spread, others: Sequence[Spread], residuals: FloatArray) -> FloatArray:
    """Return the ratios (3,) that AMCL's model would have with infinitely many such runs: the bias by its form.

    `others`: random walks and errors constant during a run, which together describe the scatter.
    """
    components = np.concatenate([other.components for other in others])
    whole = Spread(tuple(name for other in others for name in other.names), components, amcl.reference)
    expected = np.sqrt(np.einsum("uii->ui", whole.covariance(sizes_of(whole, residuals))))
    return ratios(np.einsum("uii->ui", amcl.covariance(sizes_of(amcl, expected))), expected)
