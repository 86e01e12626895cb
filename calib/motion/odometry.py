"""Odometry over whole logs as arrays: wheel travel in, poses out (Eqs 7 to 9).

Everything is done block by block, so that the intermediate arrays stay in the processor's cache, and in place. Sums run
within a block and are carried from block to block, which keeps their rounding below that of a sample-by-sample loop.
Sine and cosine both come from the tangent of half the angle: one vectorised function instead of two scalar ones.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from math import factorial, isfinite
from typing import Final

import numpy as np
import numpy.typing as npt

from calib.errors import BadInputError
from calib.motion.poses import FloatArray, Poses

__all__ = ["SCHEMES", "Poses", "end_poses", "integrate", "shorten", "sinc"]

IntArray = npt.NDArray[np.int64]

#: how a step is drawn -> by which part of its turn the heading used lies behind the heading at its end
_BEHIND: Final = {"exact": 0.5, "mid_point": 0.5, "euler": 1.0, "end_point": 0.0}

#: ``end_point`` is Eq. 7 as printed: the heading at the end of the step
SCHEMES: Final = tuple(_BEHIND)

#: samples a block: the arrays in use stay in the second-level cache
BLOCK: Final = 32768

#: steps from which on a second thread is worth its start
MANY_STEPS: Final = 1_000_000

#: running sums are taken over rows of this many samples by one product with a triangle of ones
ROW: Final = 16

#: sin(d/2)/d as a series in d^2: half the ratio of chord to arc for a turn of d
_SERIES: Final = tuple((-1) ** k / (2 ** (2 * k + 1) * factorial(2 * k + 1)) for k in range(12))

#: how many of its terms are good to the last digit up to which d
_TERMS: Final = ((2, 2e-4), (3, 8e-3), (4, 4e-2), (5, 0.2), (7, 1.0), (9, 2.0), (12, 3.2))

#: a product with this triangle turns a row of steps into its running sums
_SUMS: Final = np.triu(np.ones((ROW, ROW)))
_ONES: Final = np.ones(ROW)


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Running sums that leave out part of each last step, times a factor: a product with a triangle."""

    left_out: float
    factor: float
    triangle: FloatArray

    @staticmethod
    def of(left_out: float, factor: float) -> _Part:
        return _Part(left_out, factor, np.ascontiguousarray(factor * (_SUMS - left_out * np.eye(ROW))))


_WHOLE: Final = _Part.of(0.0, 1.0)

#: half the heading that a scheme uses in each step
_HALF_HEADING: Final = {behind: _Part.of(behind, 0.5) for behind in set(_BEHIND.values())}


def integrate(
    travel_left_m: npt.ArrayLike,
    travel_right_m: npt.ArrayLike,
    track_m: npt.ArrayLike,
    *,
    offsets: npt.ArrayLike | None = None,
    start: npt.ArrayLike = (0.0, 0.0, 0.0),
    scheme: str = "exact",
    out: Poses | None = None,
    threads: int | None = None,
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
    out : Poses, optional
        Contiguous arrays of the travel's shape to write to; new memory costs as much as the arithmetic.
    threads : {1, 2}, optional
        Work on both halves of the steps at once; None: where there are two processors and a million steps. Where a
        run is cut, its last digit depends on it.

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
    if out is None:
        out = Poses(np.empty(job.shape), np.empty(job.shape), np.empty(job.shape))
    elif any(a.shape != job.shape or not a.flags.c_contiguous for a in (out.x_m, out.y_m, out.theta_rad)):
        raise BadInputError(f"out: found arrays of shape {out.shape}; expected contiguous ones of shape {job.shape}")
    x, y, theta = out.x_m.reshape(n), out.y_m.reshape(n), out.theta_rad.reshape(n)
    if threads is None:
        threads = 2 if n >= MANY_STEPS and (os.cpu_count() or 1) > 1 else 1
    if threads == 1 or n < 2:
        _fill(job, x, y, theta)
        return out
    cut = _cut(job)
    halves = (slice(0, cut), slice(cut, n))
    jobs = (_head(job, cut), _tail(job, cut))
    with ThreadPoolExecutor(2) as pool:
        waiting = [pool.submit(_fill, j, x[h], y[h], theta[h]) for j, h in zip(jobs, halves, strict=True)]
        for one in waiting:
            one.result()
        run = int(np.searchsorted(job.starts, cut, side="right")) - 1
        if job.starts[run] != cut:
            # the second half was driven from the origin: put it where the first one ended
            stop = int(job.starts[run + 1]) if run + 1 < len(job.starts) else n
            moved = [pool.submit(np.add, a[cut:stop], a[cut - 1], out=a[cut:stop]) for a in (x, y)]
            for done in moved:
                done.result()
    return out


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
    for block in _blocks(job, None):
        runs = job.runs[block.runs]
        end[0, runs] += block.sums(block.dx)
        end[1, runs] += block.sums(block.dy)
        end[2, runs] += block.turned
    if offsets is None and len(job.shape) == 1:
        return Poses(end[0, 0], end[1, 0], end[2, 0])
    return Poses(end[0], end[1], end[2])


def sinc(u: npt.ArrayLike) -> FloatArray:
    """Return sin(u) / u, 1 at 0; any shape, u in rad: the ratio of chord to arc for a turn of 2 u."""
    return np.asarray(np.sinc(np.asarray(u, dtype=np.float64) / np.pi))


@dataclass(slots=True, eq=False)
class _Job:
    """Input, laid flat; `carried` is where the block before ended, `rest` what its rounding left out."""

    left: FloatArray
    right: FloatArray
    per_m: FloatArray | float
    starts: IntArray
    runs: IntArray
    pose: FloatArray
    behind: float
    curved: bool
    shape: tuple[int, ...]
    carried: list[float]
    rest: list[float]


def _fill(job: _Job, x: FloatArray, y: FloatArray, theta: FloatArray) -> None:
    """Write the poses of a job."""
    for block in _blocks(job, theta):
        part = slice(block.first, block.last)
        block.running(job, block.dx, 0, [(x[part], _WHOLE)])
        block.running(job, block.dy, 1, [(y[part], _WHOLE)])


def _cut(job: _Job) -> int:
    """Return where to cut the steps in two: between two runs where that halves the work fairly, else in the middle."""
    n = len(job.left)
    middle = n // 2 // BLOCK * BLOCK or n // 2
    near = int(job.starts[int(np.argmin(np.abs(job.starts - middle)))])
    return near if near > 0 and abs(near - middle) < n // 16 else middle


def _head(job: _Job, cut: int) -> _Job:
    """Return the job of the steps before `cut`."""
    keep = job.starts < cut
    return replace(
        job,
        left=job.left[:cut],
        right=job.right[:cut],
        per_m=job.per_m if isinstance(job.per_m, float) else job.per_m[:cut],
        starts=job.starts[keep],
        runs=job.runs[keep],
        carried=[0.0, 0.0, 0.0],
        rest=[0.0, 0.0, 0.0],
    )


def _tail(job: _Job, cut: int) -> _Job:
    """Return the job of the steps from `cut` on; a run that is cut goes on from the origin, with its heading."""
    run = int(np.searchsorted(job.starts, cut, side="right")) - 1
    pose = job.pose
    if job.starts[run] != cut:
        before = slice(int(job.starts[run]), cut)
        if isinstance(job.per_m, float):
            turned = (job.right[before].sum() - job.left[before].sum()) * job.per_m
        else:
            turned = ((job.right[before] - job.left[before]) * job.per_m[before]).sum()
        pose = pose.copy()
        pose[:, job.runs[run]] = 0.0, 0.0, pose[2, job.runs[run]] + turned
    return replace(
        job,
        left=job.left[cut:],
        right=job.right[cut:],
        per_m=job.per_m if isinstance(job.per_m, float) else job.per_m[cut:],
        starts=np.maximum(job.starts[run:] - cut, 0),
        runs=job.runs[run:],
        pose=pose,
        carried=[0.0, 0.0, 0.0],
        rest=[0.0, 0.0, 0.0],
    )


@dataclass(slots=True, eq=False)
class _Block:
    """A stretch of the flat steps, with the pieces of runs that lie in it."""

    first: int
    last: int
    runs: slice
    local: IntArray
    continues: bool
    dx: FloatArray
    dy: FloatArray
    turned: FloatArray

    def sums(self, steps: FloatArray) -> FloatArray:
        """Return the sum of the steps of each piece, shape (pieces,)."""
        return np.add.reduceat(steps, self.local) if len(self.local) > 1 else np.array([steps.sum()])

    def running(self, job: _Job, steps: FloatArray, which: int, wanted: list[tuple[FloatArray, _Part]]) -> None:
        """Write the running sums of each run, from its start or from the block before; `steps` is used up."""
        base = job.pose[which, job.runs[self.runs]]
        if self.continues:
            base[0] = job.carried[which] + job.rest[which]
        if len(base) > 1:
            ends = base + (self.turned if which == 2 else self.sums(steps))
            job.carried[which], job.rest[which] = float(ends[-1]), 0.0
            # the first step of a run leads from the end of the run before to its own start
            lead, firsts = base[1:] - ends[:-1], self.local[1:]
            steps[firsts] += lead
            _running_sums(steps, float(base[0]), wanted)
            for out, part in wanted:
                if part.left_out:
                    out[firsts] += part.left_out * part.factor * lead
            return
        # the carry is summed with its rounding (Neumaier), so that equal steps do not add up a bias
        before, rest = (job.carried[which], job.rest[which]) if self.continues else (float(base[0]), 0.0)
        total = _running_sums(steps, float(base[0]), wanted)
        after = before + total
        lost = (before - after) + total if abs(before) >= abs(total) else (total - after) + before
        job.carried[which], job.rest[which] = after, rest + lost


def _running_sums(steps: FloatArray, before: float, wanted: list[tuple[FloatArray, _Part]]) -> float:
    """Write running sums of `steps`, begun at `before`; return the sum of the steps alone. `steps` is used up."""
    if len(steps) % ROW == 0:
        rows = steps.reshape(-1, ROW)
        totals = rows @ _ONES
        np.cumsum(totals, out=totals)
        total = float(totals[-1])
        # a product would spread a single NaN over its row
        if isfinite(total):
            totals[1:] = totals[:-1]
            totals[0] = 0.0
            totals += before
            rows[:, 0] += totals
            for out, part in wanted:
                made = out.reshape(-1, ROW)
                # in pieces so small that no BLAS starts threads of its own
                for k in range(0, len(rows), 1024):
                    np.matmul(rows[k : k + 1024], part.triangle, out=made[k : k + 1024])
                if part.left_out:
                    totals *= part.left_out * part.factor
                    made[:, 0] += totals
            return total
    sums = np.cumsum(steps)
    for out, part in wanted:
        np.add(sums, before, out=out)
        if part.left_out:
            out -= part.left_out * steps
        out *= part.factor
    return float(sums[-1])


def _blocks(job: _Job, theta: FloatArray | None) -> Iterator[_Block]:
    """Go over the steps block by block, writing headings to `theta`; the next block overwrites a block's arrays."""
    n = len(job.left)
    store = np.empty((4, min(BLOCK, n)))
    for first in range(0, n, BLOCK):
        last = min(first + BLOCK, n)
        turn, chord, tangent, work = (row[: last - first] for row in store)
        k0 = int(np.searchsorted(job.starts, first, side="right")) - 1
        k1 = int(np.searchsorted(job.starts, last, side="left"))
        local = job.starts[k0:k1] - first
        continues = bool(local[0] < 0)
        local[0] = 0
        left, right = job.left[first:last], job.right[first:last]
        np.subtract(right, left, out=turn)
        turn *= job.per_m if isinstance(job.per_m, float) else job.per_m[first:last]
        np.add(right, left, out=chord)
        if job.curved:
            shorten(chord, turn, work, tangent)
        else:
            chord *= 0.5
        block = _Block(first, last, slice(k0, k1), local, continues, dx=work, dy=tangent, turned=turn)
        block.turned = block.sums(turn)
        wanted = [] if theta is None else [(theta[first:last], _WHOLE)]
        block.running(job, turn, 2, [*wanted, (tangent, _HALF_HEADING[job.behind])])
        # cos a = 2 / (1 + t^2) - 1 and sin a = 2 t / (1 + t^2) with t = tan(a / 2)
        np.tan(tangent, out=tangent)
        np.multiply(tangent, tangent, out=work)
        work += 1.0
        np.divide(2.0, work, out=work)
        work *= chord
        tangent *= work
        work -= chord
        yield block


def shorten(path: FloatArray, turn: FloatArray, square: FloatArray, work: FloatArray) -> None:
    """Turn twice the length of arcs into the length of their chords, in place.

    Parameters
    ----------
    path : array of float, shape (n,)
        Twice the length of each arc in m; becomes the chord.
    turn : array of float, shape (n,)
        Turn of each arc in rad.
    square, work : array of float, shape (n,)
        Overwritten.
    """
    np.multiply(turn, turn, out=square)
    largest = float(square.max())
    for terms, limit in _TERMS:
        if largest <= limit * limit:
            np.multiply(square, _SERIES[terms - 1], out=work)
            for coefficient in _SERIES[terms - 2 : 0 : -1]:
                work += coefficient
                work *= square
            work += _SERIES[0]
            path *= work
            return
    path *= 0.5 * sinc(0.5 * turn)


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
        per_m=1.0 / float(track.reshape(-1)[0]) if wide is None else 1.0 / wide,
        starts=edges[:-1][runs],
        runs=runs,
        pose=np.ascontiguousarray(np.broadcast_to(pose, (n_runs, 3)).T),
        behind=_BEHIND[scheme],
        curved=scheme == "exact",
        shape=shape,
        carried=[0.0, 0.0, 0.0],
        rest=[0.0, 0.0, 0.0],
    )
