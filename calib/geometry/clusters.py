"""Which stretches share their noise: blocks, runs, recordings or routes, as the residuals themselves say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import FloatArray, IntArray, StrArray
from calib.geometry.freedom import own_directions
from calib.geometry.parameters import Parameters
from calib.geometry.recording import Recording
from calib.geometry.sandwich import OF_RUNS, Uncertainty, block_scores, sandwich, sandwich_along
from calib.geometry.segments import Segments
from calib.geometry.solve import Solution

#: groups that a covariance needs at least
FEWEST: Final = 4
#: so many runs are the groups to begin with; of fewer runs, blocks within them
ENOUGH_RUNS: Final = 8
#: standard deviations by which members of a group pull alike before the group counts as one
ALIKE: Final = 2.6


@dataclass(frozen=True, slots=True, eq=False)
class Clustering:
    """The groups taken for independent, and the covariance that follows."""

    #: ``run``, ``block``, ``session`` or ``route``
    name: str
    #: of the free parameters
    uncertainty: Uncertainty


def clustered(solution: Solution, parameters: Parameters, recording: Recording, segments: Segments) -> Clustering:
    """Return the covariance of the free parameters with groups as large as the residuals ask for.

    Runs of one session, or of one route, that pull the parameters alike beyond chance are one group each: what they
    share does not average out over repeats. Of several such groupings the one with the widest intervals holds.

    `solution`: of the robust fit.
    """
    free = parameters.free
    block = np.unique(segments.block, return_inverse=True)[1]
    first = np.unique(block, return_index=True)[1]
    run = segments.run[first]
    scores = block_scores(solution, free, block)
    if len(np.unique(run)) >= min(ENOUGH_RUNS, len(run)):
        best = Clustering("run", sandwich(solution, free, segments.run, power=OF_RUNS))
    else:
        directions = own_directions(parameters.free_names, solution.values[free])
        best = Clustering("block", sandwich_along(solution, free, block, directions))
    alone = best.name
    candidates = {"session": _codes(recording.session)[run], "route": _codes(_routes(recording))[run]}
    for name, group in candidates.items():
        if len(np.unique(group)) >= FEWEST and _alike(scores, group) > ALIKE:
            tried = sandwich(solution, free, group[block])
            if best.name == alone or _width(tried) > _width(best.uncertainty):
                best = Clustering(name, tried)
    return best


def _width(uncertainty: Uncertainty) -> float:
    """Return the mean logarithm of the intervals' half widths."""
    return float(np.mean(np.log(uncertainty.half_widths())))


def _codes(labels: StrArray) -> IntArray:
    return np.asarray(np.unique(labels, return_inverse=True)[1])


def _routes(recording: Recording) -> StrArray:
    """Return a label of each run's route: its kind, and the sense in which it turns."""
    turn = recording.end_pose[:, 2]
    sense = np.where(turn > 1.0, " ccw", np.where(turn < -1.0, " cw", ""))
    return np.char.add(recording.kind, sense)


def _alike(scores: FloatArray, group: IntArray) -> float:
    """Return by how many standard deviations members of a group pull alike."""
    products = scores @ scores.T
    same = (group[:, None] == group[None, :]) & ~np.eye(len(group), dtype=np.bool_)
    spread = float(np.sqrt(np.square(products[same]).sum() / 2.0))
    return float(products[same].sum() / 2.0 / spread) if spread > 0.0 else 0.0
