"""What neighbouring stretches share: the error of the pose between them lengthens one and shortens the other."""

from __future__ import annotations

import numpy as np

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.geometry.recording import Recording
from calib.geometry.segments import Segments
from calib.geometry.solve import Solution

__all__ = ["shared_end_scores"]


def shared_end_scores(
    solution: Solution, free: BoolArray, recording: Recording, segments: Segments, cluster: IntArray
) -> FloatArray:
    """Return the expected products of the scores of neighbouring groups, by the poses that they share.

    Groups taken for independent would count the error of the pose between two of them as if it were two errors, where
    the sum over both does not have it at all.

    Parameters
    ----------
    solution : Solution
        Its noise says how large the reference's errors are.
    free : array of bool, shape (n_parameters,)
        Which parameters were free.
    recording : Recording
        Poses by the reference.
    segments : Segments
        The stretches.
    cluster : array of int, shape (n,)
        Group of each stretch.

    Returns
    -------
    array of float, shape (n_free, n_free)
        Sum over pairs of neighbours, the earlier one first; to be added together with its transpose.
    """
    weight = np.sqrt(solution.weights)[:, None, None]
    jacobian = (solution.whitener @ solution.prediction.jacobian[:, :, free]) * weight
    ending, starting = _ends(recording, segments)
    # scores, (n, n_free, 3), of a unit error of the pose where each stretch ends, and where it starts
    by_last = jacobian.transpose(0, 2, 1) @ (solution.whitener @ ending) * weight
    by_first = jacobian.transpose(0, 2, 1) @ (solution.whitener @ starting) * weight
    last = _summed(by_last, segments.last, cluster)
    first = _summed(by_first, segments.first, cluster)
    variance = np.diag(solution.scales[[0, 0, 1]])
    total = np.zeros((int(free.sum()), int(free.sum())))
    for sample, (group, score) in last.items():
        other = first.get(sample)
        if other is not None and other[0] != group:
            total += score @ variance @ other[1].T
    return total


def _ends(recording: Recording, segments: Segments) -> tuple[FloatArray, FloatArray]:
    """Return derivatives (n, 3, 3) of each measured displacement by the pose at its end, and by that at its start."""
    n = len(segments)
    heading = recording.reference[2, segments.first]
    cosine, sine = np.cos(heading), np.sin(heading)
    ending = np.zeros((n, 3, 3))
    ending[:, 0, 0] = ending[:, 1, 1] = cosine
    ending[:, 0, 1], ending[:, 1, 0] = sine, -sine
    ending[:, 2, 2] = 1.0
    starting = -ending
    starting[:, 0, 2], starting[:, 1, 2] = segments.measured[:, 1], -segments.measured[:, 0]
    return ending, starting


def _summed(scores: FloatArray, samples: IntArray, cluster: IntArray) -> dict[int, tuple[int, FloatArray]]:
    """Return the sum of the scores at each sample, with the group of the stretches that begin or end there."""
    order = np.argsort(samples, kind="stable")
    places, firsts = np.unique(samples[order], return_index=True)
    sums = np.add.reduceat(scores[order], firsts, axis=0)
    groups = cluster[order][firsts]
    return {int(place): (int(group), total) for place, group, total in zip(places, groups, sums, strict=True)}
