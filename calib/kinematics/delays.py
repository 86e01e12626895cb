"""Delays of the reference by recording, where one common delay does not fit."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from calib.kinematics.drives import Parameters
from calib.kinematics.model import Model
from calib.kinematics.recording import Recording
from calib.kinematics.solve import DEGREES, Solution
from calib.kinematics.uncertainty import whitened
from calib.types import FloatArray, IntArray

#: chance with which recordings of one delay are taken for ones of several
CHANCE: Final = 0.001
#: how far from the common delay one is sought, and in how many steps
REACH_S: Final = 0.5
TRIED: Final = 51
#: blocks that a recording needs for a delay of its own
FEWEST_BLOCKS: Final = 4


@dataclass(frozen=True, slots=True)
class Delay:
    """Delay of the reference's stamps in one session, or in one run where there is one session."""

    label: str = field(metadata={"json": "recording"})
    value_s: float = field(metadata={"json": "value"})
    std_s: float = field(metadata={"json": "sd"})


def sought_delays(model: Model, solution: Solution, parameters: Parameters) -> FloatArray:
    """Return the difference of each run's delay from the common one, shape (n_runs,), by a grid search.

    The robust fit treats a recording with another delay as an outlier, so that the gradient does not find its delay.
    Zero where the common delay fits each recording best.

    `model`: with windows; `solution`: of the joint fit; `parameters`: the delay is the last of them.
    """
    group = _groups(model.recording)
    n_groups = int(group.max()) + 1
    nothing = model.recording.delay_added_s
    if not parameters.free[-1] or n_groups < 2:
        return nothing
    offsets = np.linspace(-REACH_S, REACH_S, TRIED)
    of = group[model.segments.run]
    losses = []
    for offset in offsets:
        values = solution.values.copy()
        values[-1] += offset
        residuals = np.einsum("nij,nj->ni", solution.whitener, model.predict(values).residuals)
        loss = np.log1p(np.square(residuals).sum(axis=1) / DEGREES)
        losses.append(np.bincount(of, loss, minlength=n_groups))
    best = offsets[np.argmin(losses, axis=0)]
    return nothing if np.ptp(best) < 1.5 * (offsets[1] - offsets[0]) else nothing + best[group]


def own_delays(model: Model, solution: Solution, parameters: Parameters) -> tuple[tuple[Delay, ...], FloatArray]:
    """Return the delay of each recording, and each run's difference from the common one; none where one fits all.

    `model`: with windows; its recording knows what the delay of each run was taken to add so far; `solution`: of the
    joint fit; `parameters`: the delay is the last of them. Returns `delays`: in the order driven; empty where the
    recordings do not ask for several; `added_s` (shape (n_runs,)): to be added to the common delay in each run.
    """
    recording, segments = model.recording, model.segments
    nothing: tuple[tuple[Delay, ...], FloatArray] = (), np.zeros(len(recording))
    group = _groups(recording)
    n_groups = int(group.max()) + 1
    if not parameters.free[-1] or n_groups < 2:
        return nothing
    jacobian, residuals = whitened(solution, parameters.free)
    by_delay = jacobian[:, :, -1]
    block = np.unique(segments.block, return_inverse=True)[1]
    of_block = group[segments.run[np.unique(block, return_index=True)[1]]]
    information = np.bincount(block, np.square(by_delay).sum(axis=1))
    pull = np.bincount(block, np.sum(by_delay * residuals, axis=1))
    size = np.bincount(of_block, information, minlength=n_groups)
    if np.bincount(of_block, minlength=n_groups).min() < FEWEST_BLOCKS or not (size > 0.0).all():
        return nothing
    shift = np.bincount(of_block, pull, minlength=n_groups) / size
    # about its own delay: what a common shift pulls in each block is no noise
    about = pull - shift[of_block] * information
    std = np.sqrt(np.bincount(of_block, np.square(about), minlength=n_groups)) / size
    added = recording.delay_added_s + shift[group]
    first = np.unique(group, return_index=True)[1]
    if not _disagree(added[first], std):
        return nothing
    labels = recording.session if len(np.unique(recording.session)) > 1 else recording.run_id
    common = float(solution.values[-1])
    delays = [Delay(str(labels[at]), common + float(added[at]), float(std[group[at]])) for at in sorted(first)]
    return tuple(delays), added


def _groups(recording: Recording) -> IntArray:
    labels = recording.session if len(np.unique(recording.session)) > 1 else recording.run_id
    return np.asarray(np.unique(labels, return_inverse=True)[1])


def _disagree(shift: FloatArray, std: FloatArray) -> bool:
    """Return whether the recordings ask for several delays beyond chance."""
    from scipy.special import chdtrc

    weight = 1.0 / np.square(std)
    mean = float(np.sum(weight * shift) / np.sum(weight))
    return bool(chdtrc(len(shift) - 1.0, float(np.sum(weight * np.square(shift - mean)))) < CHANCE)
