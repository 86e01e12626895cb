"""Whether sessions differ: what fits of each session by itself leave beside what the fit of all leaves."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.kinematics.model import Segments
from calib.kinematics.solve import Solution
from calib.types import BoolArray, StrArray

#: chance of taking sessions that are alike for ones that differ: a campaign is judged once
CHANCE: Final = 1e-4
#: columns that depend on the others by more than this part tell nothing of their own
DEPENDENT: Final = 1e-6


def left_within(solution: Solution, free: BoolArray, segments: Segments, labels: StrArray) -> tuple[float, float]:
    """Return root mean squares of position (m) and heading (rad) that a fit of each session leaves.

    Both are infinite where sessions do not differ beyond chance (F test), or too little is known of each. A session has
    its own parameters, start heading of the reference, and yaw of its axes.

    `solution`, `free`, `segments`: of the fit of all sessions; `labels` (shape (n_runs,)): session of each run.
    """
    from scipy.special import fdtrc

    jacobian = solution.prediction.jacobian[:, :, free]
    turned = np.zeros((len(segments), 3, 2))
    turned[:, 0], turned[:, 1] = segments.measured[:, 1:2], -segments.measured[:, :1]
    turned[:, 2, 0] = -1.0
    columns = np.concatenate([jacobian, np.where(segments.seen[:, :, None], turned, 0.0)], axis=2)
    rest = solution.prediction.residuals
    white, white_rest = solution.whitener @ columns, np.einsum("nij,nj->ni", solution.whitener, rest)
    session = labels[segments.run]
    squares, dof, left, n_segments = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
    for label in np.unique(session):
        at = (session == label) & (segments.level == 0)
        flat, seen = white[at].reshape(-1, columns.shape[2]), segments.seen[at]
        scale = np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
        step, _, rank, _ = np.linalg.lstsq(flat / scale, white_rest[at].ravel(), rcond=DEPENDENT)
        size = int(seen.sum())
        if size < 2 * rank:
            continue
        own = rest[at] - columns[at] @ (step / scale)
        after = white_rest[at].ravel() - flat @ (step / scale)
        squares += np.square(white_rest[at]).sum(), np.square(after).sum()
        dof += size, size - rank
        left += np.array([np.square(own[:, :2]).sum(), np.square(own[:, 2]).sum()]) * size / (size - rank)
        n_segments += seen[:, :2].any(axis=1).sum(), seen[:, 2].sum()
    more = dof[0] - dof[1] - free.sum()
    if more <= 0.0 or squares[1] <= 0.0:
        return np.inf, np.inf
    ratio = (squares[0] - squares[1]) / more / (squares[1] / dof[1])
    if fdtrc(more, dof[1], ratio) > CHANCE:
        return np.inf, np.inf
    position, heading = np.sqrt(left / np.maximum(n_segments, 1.0))
    return float(position), float(heading)
