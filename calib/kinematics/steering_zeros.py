"""Steering zeros that differ between recordings: a zero of each, drawn about a common one with a spread that is fitted.

A servo, or a linkage with play, comes to rest at another angle each time. One zero for all recordings then bends what
the other parameters say; a free zero for each says nothing of a further recording. Here the deviations are random
effects: the common zero and the other parameters are estimated by generalised least squares, each deviation is the
mean of its distribution given the data, and the spread is part of the uncertainty.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from calib.kinematics.delays import recording_groups, steering_zero_spread_rad
from calib.kinematics.drives import STEERING_SCALE
from calib.kinematics.joint_fit import Fitted, OwnZeros
from calib.kinematics.recording import Recording
from calib.kinematics.solve import Shared, Solution, solve
from calib.kinematics.uncertainty import clustered, whitened
from calib.types import FloatArray, IntArray

STEERING_ZERO: Final = "steering_zero_rad"
#: rounds of parameters, deviations and their spread; the spread of eight recordings is settled to 0.1 % after five
ROUNDS: Final = 8
#: of these, those in which the noise is estimated again
NOISE_ROUNDS: Final = 4
#: a last change of the spread below this share of it ends the search
SETTLED: Final = 0.01


def with_own_zeros(fitted: Fitted) -> Fitted:
    """Return the fit with a steering zero for each recording; the fit itself where one zero suits all.

    The angles of the recordings are then those by their own zeros; see `OwnZeros`.
    """
    spread = steering_zero_spread_rad(fitted.model, fitted.solution, fitted.parameters)
    if not spread:
        return fitted
    parameters, model, logged = fitted.parameters, fitted.model, fitted.model.recording
    group = recording_groups(logged)
    deviation = np.zeros(int(group.max()) + 1)
    solution = replace(fitted.solution, shared=_shared(fitted, fitted.solution, group, spread, deviation))
    for number in range(ROUNDS):
        before = spread
        values, deviation, spread = _round(fitted, solution, before)
        model = replace(model, recording=_turned(logged, deviation[group]))
        if number < NOISE_ROUNDS:
            solution = solve(model, parameters, values, solution.scales, rounds=1)
        else:
            solution = replace(solution, values=values, prediction=model.predict(values))
        solution = replace(solution, shared=_shared(fitted, solution, group, spread, deviation))
    clustering = clustered(solution, parameters, model.recording, model.segments)
    solution = replace(solution, converged=fitted.solution.converged and abs(spread - before) < SETTLED * spread)
    own = OwnZeros(logged, spread)
    return replace(fitted, model=model, solution=solution, clustering=clustering, own_zeros=own)


def _turned(recording: Recording, added_rad: FloatArray) -> Recording:
    """Return the recording with an angle added to the steering of each run, shape (n_runs,)."""
    steer = np.asarray(recording.steps.steer_rad) + added_rad[recording.run]
    return replace(recording, steps=replace(recording.steps, steer_rad=steer))


def _shared(fitted: Fitted, solution: Solution, group: IntArray, spread: float, deviation: FloatArray) -> Shared:
    """Return the random effect of the recordings' zeros.

    Parameters
    ----------
    fitted : Fitted
        The fit with one zero.
    solution : Solution
        At the deviations.
    group : array of int, shape (n_runs,)
        Recording of each run.
    spread : float
        Standard deviation of the deviations, rad.
    deviation : array, shape (n_groups,)
        Of the recordings' zeros from the common one, rad.
    """
    names = fitted.parameters.names
    # a deviation is added to the angle before its scale
    scale = solution.values[names.index(STEERING_SCALE)]
    by_zero = solution.prediction.jacobian[:, :, names.index(STEERING_ZERO)]
    change = np.einsum("nij,nj->ni", solution.whitener, by_zero * scale * spread)
    weighted = change * np.sqrt(solution.weights)[:, None]
    return Shared(group[fitted.model.segments.run], weighted, deviation / spread)


def _round(fitted: Fitted, solution: Solution, spread: float) -> tuple[FloatArray, FloatArray, float]:
    """Return values of the parameters, deviations of the recordings and their spread after one linear step.

    `solution`: with its random effect; `spread`: standard deviation of the deviations now, rad.
    """
    free, shared = fitted.parameters.free, solution.shared
    assert shared is not None
    jacobian, residuals = whitened(solution, free)
    step = np.linalg.lstsq(jacobian.reshape(-1, jacobian.shape[2]), residuals.ravel(), rcond=None)[0]
    plain, left = whitened(replace(solution, shared=None), free)
    left = left - plain @ step
    n_groups = len(shared.amount)
    size = np.bincount(shared.group, np.square(shared.change).sum(axis=1), minlength=n_groups)
    pull = np.bincount(shared.group, np.sum(shared.change * left, axis=1), minlength=n_groups)
    deviation = spread * (pull + size * shared.amount) / (1.0 + size)
    values = solution.values.copy()
    values[free] += step
    # common zero and scale of the angle are told by the differences of recordings: each takes a degree of freedom
    n_common = len({STEERING_ZERO, STEERING_SCALE} & set(fitted.parameters.free_names))
    known = float(np.sum(np.square(deviation)) / max(n_groups - n_common, 1))
    return values, deviation, float(np.sqrt(known + spread**2 * np.mean(1.0 / (1.0 + size))))
