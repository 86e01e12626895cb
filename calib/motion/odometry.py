"""Odometry over whole logs as arrays: wheel travel in, poses out (Eqs 7 to 9).

Everything is done block by block, so that the intermediate arrays stay in the processor's cache, and in place. Sums run
within a block and are carried from block to block, which keeps their rounding below that of a sample-by-sample loop.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from calib.errors import BadInputError
from calib.motion.poses import FloatArray, Poses

__all__ = ["SCHEMES", "Poses", "end_poses", "integrate", "sinc"]

IntArray = npt.NDArray[np.int64]

#: how a step is drawn -> by which part of its turn the heading used lies behind the heading at its end
_BEHIND: Final = {"exact": 0.5, "mid_point": 0.5, "euler": 1.0, "end_point": 0.0}

#: ``end_point`` is Eq. 7 as printed: the heading at the end of the step
SCHEMES: Final = tuple(_BEHIND)

#: samples a block: the arrays in use stay in the second-level cache
BLOCK: Final = 8192

#: sin(u)/u as a series in u^2, and how many of its terms are good to the last digit up to which abs(u)
_SERIES: Final = (1.0, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800, 1 / 6227020800)
_TERMS: Final = ((2, 1e-4), (3, 4e-3), (4, 2e-2), (7, 0.5))


def integrate(
    travel_left_m: npt.ArrayLike,
    travel_right_m: npt.ArrayLike,
    track_m: npt.ArrayLike,
    *,
    offsets: npt.ArrayLike | None = None,
    start: npt.ArrayLike = (0.0, 0.0, 0.0),
    scheme: str = "exact",
) -> Poses:
    """Integrate the travel of the rear wheels into poses.

    Parameters
    ----------
    travel_left_m, travel_right_m : array_like of float, shape (n,) or (runs, n)
        Travel of each wheel in each step: one log, a stack of runs of equal length, or, with `offsets`, runs of any
        length laid end to end. For a log of counter readings give 0 at a run's first sample: the poses then stand at
        the samples.
    track_m : array_like of float
        Distance of the rear wheels' contact points: a number, or anything that broadcasts to the travel's shape.
    offsets : array_like of int, shape (runs + 1,), optional
        Steps of run i stand at ``offsets[i]:offsets[i + 1]``; runs may be empty.
    start : array_like of float, shape (3,) or (runs, 3)
        Start pose (x in m, y in m, theta in rad), one for all or one a run.
    scheme : {"exact", "mid_point", "euler", "end_point"}
        How a step is drawn: as the arc of constant curvature; as a straight line at the heading in its middle, at its
        beginning, or at its end (Eq. 7 as printed).

    Returns
    -------
    Poses
        Pose after each step, of the travel's shape.

    Raises
    ------
    BadInputError
        Where shapes do not fit or the scheme is not known.
    """
    job = _job(travel_left_m, travel_right_m, track_m, offsets, start, scheme)
    n = len(job.left)
    x, y, theta = np.empty(n), np.empty(n), np.empty(n)
    for block in _blocks(job):
        part = slice(block.first, block.last)
        for total, step, out in ((0, block.dx, x[part]), (1, block.dy, y[part])):
            np.cumsum(step, out=out)
            block.settle(job, out, total)
        theta[part] = block.heading
    return Poses(x.reshape(job.shape), y.reshape(job.shape), theta.reshape(job.shape))


def end_poses(
    travel_left_m: npt.ArrayLike,
    travel_right_m: npt.ArrayLike,
    track_m: npt.ArrayLike,
    *,
    offsets: npt.ArrayLike | None = None,
    start: npt.ArrayLike = (0.0, 0.0, 0.0),
    scheme: str = "exact",
) -> Poses:
    """Integrate the travel of the rear wheels and return the end pose of each run alone.

    Parameters and errors are those of `integrate`; an empty run ends where it starts.

    Returns
    -------
    Poses
        End poses, shape (runs,), or () for one log.
    """
    job = _job(travel_left_m, travel_right_m, track_m, offsets, start, scheme)
    end = job.pose.copy()
    for block in _blocks(job):
        runs = job.runs[block.runs]
        if len(block.local) == 1:
            end[0, runs] += block.dx.sum()
            end[1, runs] += block.dy.sum()
            end[2, runs] = block.heading[-1]
        else:
            end[0, runs] += np.add.reduceat(block.dx, block.local)
            end[1, runs] += np.add.reduceat(block.dy, block.local)
            end[2, runs] = block.heading[np.append(block.local[1:], len(block.heading)) - 1]
    if offsets is None and len(job.shape) == 1:
        return Poses(end[0, 0], end[1, 0], end[2, 0])
    return Poses(end[0], end[1], end[2])


def sinc(u: npt.ArrayLike) -> FloatArray:
    """Return sin(u) / u, 1 at 0; any shape, u in rad: the ratio of chord to arc for a turn of 2 u."""
    return np.asarray(np.sinc(np.asarray(u, dtype=np.float64) / np.pi))


@dataclass(slots=True, eq=False)
class _Job:
    """Input, laid flat; `pose` (3, runs) holds the start poses and stays as it is."""

    left: FloatArray
    right: FloatArray
    track: FloatArray | float
    starts: IntArray
    runs: IntArray
    pose: FloatArray
    behind: float
    curved: bool
    shape: tuple[int, ...]
    carried: FloatArray


@dataclass(slots=True, eq=False)
class _Block:
    """A stretch of the flat steps, with the pieces of runs that lie in it."""

    first: int
    last: int
    runs: slice
    local: IntArray
    continues: bool
    heading: FloatArray
    dx: FloatArray
    dy: FloatArray

    def settle(self, job: _Job, sums: FloatArray, which: int) -> None:
        """Turn running sums of the block into running sums of each run, from its start or from the block before."""
        base = job.pose[which, job.runs[self.runs]]
        if self.continues:
            base[0] = job.carried[which]
        if len(base) == 1:
            sums += base[0]
        else:
            base[1:] -= sums[self.local[1:] - 1]
            sums += np.repeat(base, np.diff(self.local, append=len(sums)))
        job.carried[which] = sums[-1]


def _blocks(job: _Job) -> Iterator[_Block]:
    """Go over the steps block by block; the arrays of a block are overwritten by the next one."""
    n = len(job.left)
    size = min(BLOCK, n)
    store = np.empty((5, size))
    for first in range(0, n, BLOCK):
        last = min(first + BLOCK, n)
        m = last - first
        heading, turn, chord, mid, work = (row[:m] for row in store)
        k0 = int(np.searchsorted(job.starts, first, side="right")) - 1
        k1 = int(np.searchsorted(job.starts, last, side="left"))
        local = job.starts[k0:k1] - first
        continues = bool(local[0] < 0)
        local[0] = 0
        left, right = job.left[first:last], job.right[first:last]
        np.subtract(right, left, out=turn)
        if isinstance(job.track, float):
            turn /= job.track
        else:
            turn /= job.track[first:last]
        np.add(right, left, out=chord)
        chord *= 0.5
        np.cumsum(turn, out=heading)
        block = _Block(first, last, slice(k0, k1), local, continues, heading, work, turn)
        block.settle(job, heading, 2)
        if job.behind == 0.0:
            mid[:] = heading
        else:
            turn *= job.behind
            np.subtract(heading, turn, out=mid)
        if job.curved:
            _shorten(chord, turn, work)
        np.cos(mid, out=work)
        work *= chord
        np.sin(mid, out=turn)
        turn *= chord
        yield block


def _shorten(chord: FloatArray, half: FloatArray, work: FloatArray) -> None:
    """Turn the length of arcs into that of their chords, in place; `half` is half their turn and is overwritten."""
    largest = max(float(half.max()), -float(half.min()))
    for terms, limit in _TERMS:
        if largest <= limit:
            np.multiply(half, half, out=half)
            np.multiply(half, _SERIES[terms - 1], out=work)
            for coefficient in _SERIES[terms - 2 : 0 : -1]:
                work += coefficient
                work *= half
            work += 1.0
            chord *= work
            return
    chord *= sinc(half)


def _job(
    travel_left_m: npt.ArrayLike,
    travel_right_m: npt.ArrayLike,
    track_m: npt.ArrayLike,
    offsets: npt.ArrayLike | None,
    start: npt.ArrayLike,
    scheme: str,
) -> _Job:
    """Check the input and lay it flat."""
    if scheme not in _BEHIND:
        raise BadInputError(f"scheme: found {scheme!r}; expected one of {', '.join(SCHEMES)}; choose one of them")
    left = np.ascontiguousarray(travel_left_m, dtype=np.float64)
    right = np.ascontiguousarray(travel_right_m, dtype=np.float64)
    shape = left.shape
    if right.shape != shape or left.ndim not in (1, 2):
        raise BadInputError(
            f"travel: found shapes {shape} (left) and {right.shape} (right); expected the same, of one or two axes; "
            "give one value a step for each wheel"
        )
    track = np.asarray(track_m, dtype=np.float64)
    if offsets is not None:
        edges = np.asarray(offsets, dtype=np.int64)
        if left.ndim != 1 or len(edges) < 1 or edges[0] != 0 or edges[-1] != len(left) or (np.diff(edges) < 0).any():
            raise BadInputError(
                f"offsets: found {len(edges)} values for travel of shape {shape}; expected rising values from 0 to the "
                "number of steps of a flat array; lay the runs end to end"
            )
    elif left.ndim == 2:
        edges = np.arange(shape[0] + 1, dtype=np.int64) * shape[1]
    else:
        edges = np.array([0, len(left)], dtype=np.int64)
    n_runs = len(edges) - 1
    pose = np.asarray(start, dtype=np.float64)
    if pose.shape not in {(3,), (n_runs, 3)}:
        raise BadInputError(f"start: found shape {pose.shape}; expected (3,) or ({n_runs}, 3); give x, y, theta")
    try:
        wide = None if track.size == 1 else np.ascontiguousarray(np.broadcast_to(track, shape)).reshape(-1)
    except ValueError:
        raise BadInputError(f"track: found shape {track.shape}; expected one that broadcasts to {shape}") from None
    runs = np.flatnonzero(np.diff(edges) > 0)
    return _Job(
        left=left.reshape(-1),
        right=right.reshape(-1),
        track=float(track.reshape(-1)[0]) if wide is None else wide,
        starts=edges[:-1][runs],
        runs=runs,
        pose=np.ascontiguousarray(np.broadcast_to(pose, (n_runs, 3)).T),
        behind=_BEHIND[scheme],
        curved=scheme == "exact",
        shape=shape,
        carried=np.zeros(3),
    )
