"""Steps of odometry, gone through block by block, so that the arrays in use stay in the processor's cache.

Sums run within a block and are carried from block to block, which keeps their rounding below that of a
sample-by-sample loop. Sine and cosine both come from the tangent of half the angle: one vectorised function instead of
two scalar ones. A sequential sum waits for each addition: here the steps stand in short rows, a product with a triangle
of ones gives the sums within all rows, and only the totals of the rows are summed one after the other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import factorial, isfinite, sqrt
from typing import Final

import numpy as np
import numpy.typing as npt

from calib.errors import BadInputError
from calib.types import FloatArray, IntArray

#: sin(d/2)/d as a series in d^2: half the ratio of chord to arc for a turn of d
_SERIES: Final = tuple((-1) ** k / (2 ** (2 * k + 1) * factorial(2 * k + 1)) for k in range(12))

#: how many of its terms are good exactly up to which d
_TERMS: Final = ((3, 8e-3), (4, 4e-2), (5, 0.2), (7, 1.0), (9, 2.0), (12, 3.2))

#: turn up to which two terms do, if the second one bears its part of the third
_SMALL_RAD: Final = 1.2e-3

#: the third term, d^4 / 3840, as a multiple of d^2 that misses it least up to there: by 2e-16 of the path
_TWO: Final = (0.5, _SERIES[1] + 2.0 * (sqrt(2.0) - 1.0) * _SERIES[2] * _SMALL_RAD**2)


def sinc(u: npt.ArrayLike) -> FloatArray:
    """Return sin(u) / u, 1 at 0; any shape, u in rad: the ratio of chord to arc for a turn of 2 u."""
    return np.asarray(np.sinc(np.asarray(u, dtype=np.float64) / np.pi))


def shorten(path: FloatArray, turn: FloatArray, square: FloatArray, work: FloatArray, *, unit: float = 1.0) -> None:
    """Turn twice the length of arcs into the length of their chords, in place.

    Parameters
    ----------
    path : array of float, shape (n,)
        Twice the length of each arc in m; becomes the chord.
    turn : array of float, shape (n,)
        Turn of each arc, in units of `unit`.
    square, work : array of float, shape (n,)
        Overwritten.
    unit : float
        Unit of `turn` in rad.
    """
    np.square(turn, out=square)
    largest = float(square.max()) * unit * unit
    if largest <= _SMALL_RAD**2:
        square *= _TWO[1] * unit * unit
        square += _TWO[0]
        path *= square
        return
    for terms, limit in _TERMS:
        if largest <= limit * limit:
            series = [coefficient * unit ** (2 * k) for k, coefficient in enumerate(_SERIES[:terms])]
            np.multiply(square, series[-1], out=work)
            for coefficient in series[-2:0:-1]:
                work += coefficient
                work *= square
            work += series[0]
            path *= work
            return
    path *= 0.5 * sinc(0.5 * unit * turn)


@dataclass(slots=True, eq=False)
class Flat:
    """Steps of runs laid end to end, and how far the sums over them have come."""

    #: left, right: shape (n,): travel of the wheels in m
    left: FloatArray
    right: FloatArray
    per_m: FloatArray | None  #: shape (n,): one over the track; None where it is `unit` throughout
    unit: float  #: what the difference of the wheels' travel (times `per_m`) is multiplied by to give the turn
    #: starts, runs: shape (filled,): first step and number of each run that has steps
    starts: IntArray
    runs: IntArray
    pose: FloatArray  #: shape (3, n_runs): start poses
    shape: tuple[int, ...]  #: shape that the travel came in
    #: carried, rest: where x, y and theta stand before the next step, and what rounding omitted of that
    carried: list[float] = field(default_factory=lambda: [0.0] * 3)
    rest: list[float] = field(default_factory=lambda: [0.0] * 3)


def lay_flat(
    travel_left_m: npt.ArrayLike,
    travel_right_m: npt.ArrayLike,
    track_m: npt.ArrayLike,
    offsets: npt.ArrayLike | None,
    start: npt.ArrayLike,
) -> Flat:
    """Check the input and lay it flat.

    Parameters
    ----------
    travel_left_m, travel_right_m : array_like of float, shape (n,) or (runs, n)
        Travel of each wheel in each step.
    track_m : array_like of float
        Track; anything that broadcasts to the travel's shape.
    offsets : array_like of int, shape (runs + 1,), or None
        Where runs of unlike length begin and end.
    start : array_like of float, shape (3,) or (runs, 3)
        Start poses.

    Raises
    ------
    BadInputError
        Where shapes do not fit.
    """
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
    return Flat(
        left=left.reshape(-1),
        right=right.reshape(-1),
        per_m=None if wide is None else 1.0 / wide,
        unit=1.0 / float(track.reshape(-1)[0]) if wide is None else 1.0,
        starts=edges[:-1][runs],
        runs=runs,
        pose=np.ascontiguousarray(np.broadcast_to(pose, (n_runs, 3)).T),
        shape=shape,
    )


def cut(flat: Flat, block: int) -> int:
    """Return where to cut the steps in two: between two runs where that halves the work fairly, else in the middle."""
    n = len(flat.left)
    middle = n // 2 // block * block or n // 2
    near = int(flat.starts[int(np.argmin(np.abs(flat.starts - middle)))])
    return near if near > 0 and abs(near - middle) < n // 16 else middle


def before(flat: Flat, step: int) -> Flat:
    """Return the steps before `step`."""
    keep = flat.starts < step
    return _piece(flat, slice(0, step), flat.starts[keep], flat.runs[keep], flat.pose)


def after(flat: Flat, step: int) -> Flat:
    """Return the steps from `step` on; a run that is cut goes on from the origin, with its heading."""
    run = int(np.searchsorted(flat.starts, step, side="right")) - 1
    pose = flat.pose
    if flat.starts[run] != step:
        head = slice(int(flat.starts[run]), step)
        if flat.per_m is None:
            turned = float(flat.right[head].sum() - flat.left[head].sum())
        else:
            turned = float((flat.right[head] - flat.left[head]) @ flat.per_m[head])
        pose = pose.copy()
        pose[:, flat.runs[run]] = 0.0, 0.0, pose[2, flat.runs[run]] + turned * flat.unit
    return _piece(flat, slice(step, len(flat.left)), np.maximum(flat.starts[run:] - step, 0), flat.runs[run:], pose)


def _piece(flat: Flat, part: slice, starts: IntArray, runs: IntArray, pose: FloatArray) -> Flat:
    return replace(
        flat,
        left=flat.left[part],
        right=flat.right[part],
        per_m=None if flat.per_m is None else flat.per_m[part],
        starts=starts,
        runs=runs,
        pose=pose,
        carried=[0.0] * 3,
        rest=[0.0] * 3,
    )


#: steps a row
ROW: Final = 16

#: rows a product: so few that no BLAS starts threads of its own
_ROWS: Final = 1024

_ONES: Final = np.ones(ROW)
_TRIANGLE: Final = np.triu(np.ones((ROW, ROW)))


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """What is wanted of running sums: them times `factor`, without the share `left_out` of the last step."""

    left_out: float
    factor: float
    triangle: FloatArray

    @staticmethod
    def scaled(left_out: float = 0.0, factor: float = 1.0) -> Part:
        """Return the part of a share and a factor."""
        return Part(left_out, factor, np.ascontiguousarray(factor * (_TRIANGLE - left_out * np.eye(ROW))))


def prefix_sums(steps: FloatArray, before: float, wanted: list[tuple[FloatArray, Part]]) -> float:
    """Write running sums of `steps` (n,), begun at `before`, to each array wanted; return the sum of the steps alone.

    `steps` is contiguous, and used up.
    """
    if len(steps) % ROW == 0:
        rows = steps.reshape(-1, ROW)
        totals = np.dot(rows, _ONES)
        np.add.accumulate(totals, out=totals)
        total = float(totals[-1])
        # a product would spread a single NaN over its row
        if isfinite(total):
            totals[1:] = totals[:-1]
            totals[0] = 0.0
            totals += before
            rows[:, 0] += totals
            for out, part in wanted:
                sums_of_rows = out.reshape(-1, ROW)
                for k in range(0, len(rows), _ROWS):
                    np.dot(rows[k : k + _ROWS], part.triangle, out=sums_of_rows[k : k + _ROWS])
                if part.left_out:
                    totals *= part.left_out * part.factor
                    sums_of_rows[:, 0] += totals
            return total
    sums = np.cumsum(steps)
    for out, part in wanted:
        np.add(sums, before, out=out)
        if part.left_out:
            out -= part.left_out * steps
        out *= part.factor
    return float(sums[-1])


WHOLE: Final = Part.scaled()


@dataclass(slots=True, eq=False)
class Block:
    """A stretch of the flat steps, with the pieces of runs that lie in it."""

    steps: slice  #: where it stands
    runs: slice  #: which of the filled runs lie in it
    local: IntArray  #: shape (pieces,): first step of each piece, counted from the block's own
    continues: bool  #: whether the first piece goes on from the block before
    #: dx, dy: shape (n,): motion in each step in m; overwritten by the next block
    dx: FloatArray
    dy: FloatArray
    turned: FloatArray  #: shape (pieces,): turn of each piece in rad; empty where nobody asked

    def sums(self, steps: FloatArray) -> FloatArray:
        """Return the sum of the steps of each piece, shape (pieces,)."""
        return np.add.reduceat(steps, self.local) if len(self.local) > 1 else np.array([steps.sum()])

    def running(
        self, flat: Flat, steps: FloatArray, which: int, wanted: list[tuple[FloatArray, Part]], *, unit: float = 1.0
    ) -> None:
        """Write the running sums of each run, from its start or from the block before.

        Parameters
        ----------
        flat : Flat
            Holds what is carried from block to block.
        steps : array of float, shape (n,)
            Of this block, in units of `unit`; used up.
        which : int
            0, 1, 2 for x, y, theta.
        wanted : list of (array, Part)
            Where to write and what; the factor of a part holds the unit.
        unit : float
            Unit of `steps` in m or rad.
        """
        first = self.runs.start
        start = flat.carried[which] + flat.rest[which] if self.continues else float(flat.pose[which, flat.runs[first]])
        if len(self.local) > 1:
            base = flat.pose[which, flat.runs[self.runs]]
            base[0] = start
            ends = base + (self.turned if which == 2 else self.sums(steps))
            flat.carried[which], flat.rest[which] = float(ends[-1]), 0.0
            # the first step of a run leads from the end of the run before to its own start
            lead, firsts = base[1:] - ends[:-1], self.local[1:]
            lead /= unit
            steps[firsts] += lead
            prefix_sums(steps, start / unit, wanted)
            for out, part in wanted:
                if part.left_out:
                    lead *= part.left_out * part.factor
                    out[firsts] += lead
            return
        # the carry is summed with its rounding (Neumaier), so that equal steps do not add up a bias
        so_far, rest = (flat.carried[which], flat.rest[which]) if self.continues else (start, 0.0)
        total = prefix_sums(steps, start / unit, wanted) * unit
        ahead = so_far + total
        lost = (so_far - ahead) + total if abs(so_far) >= abs(total) else (total - ahead) + so_far
        flat.carried[which], flat.rest[which] = ahead, rest + lost


def blocks(flat: Flat, size: int, *, behind: float, curved: bool, theta: FloatArray | None) -> Iterator[Block]:
    """Go over the steps block by block; the next block overwrites a block's arrays.

    Parameters
    ----------
    flat : Flat
        The steps.
    size : int
        Steps a block.
    behind : float
        By which part of its turn the heading used in a step lies behind the heading at its end.
    curved : bool
        Whether a step is an arc, not a straight line.
    theta : array of float, shape (n,), or None
        Headings after each step are written there; None: only the turn of each piece is found.
    """
    n = len(flat.left)
    store = np.empty((4, min(size, n)))
    half_heading, heading = Part.scaled(behind, 0.5 * flat.unit), Part.scaled(0.0, flat.unit)
    edges = np.append(np.arange(0, n, size), n)
    first_runs = np.searchsorted(flat.starts, edges[:-1], side="right") - 1
    last_runs = np.searchsorted(flat.starts, edges[1:], side="left")
    for first, k0, k1 in zip(edges[:-1].tolist(), first_runs.tolist(), last_runs.tolist(), strict=True):
        last = min(first + size, n)
        turn, chord, tangent, work = store[:, : last - first]
        local = flat.starts[k0:k1] - first
        continues = bool(local[0] < 0)
        local[0] = 0
        left, right = flat.left[first:last], flat.right[first:last]
        np.subtract(right, left, out=turn)
        if flat.per_m is not None:
            turn *= flat.per_m[first:last]
        np.add(right, left, out=chord)
        if curved:
            shorten(chord, turn, tangent, work, unit=flat.unit)
        else:
            chord *= 0.5
        block = Block(slice(first, last), slice(k0, k1), local, continues, dx=turn, dy=tangent, turned=np.empty(0))
        if theta is None or len(local) > 1:
            block.turned = block.sums(turn) * flat.unit
        wanted = [(tangent, half_heading)] if theta is None else [(theta[first:last], heading), (tangent, half_heading)]
        block.running(flat, turn, 2, wanted, unit=flat.unit)
        # cos a = 2 / (1 + t^2) - 1 and sin a = 2 t / (1 + t^2) with t = tan(a / 2)
        np.tan(tangent, out=tangent)
        dx = turn
        np.square(tangent, out=dx)
        dx += 1.0
        np.divide(chord, dx, out=dx)
        dx *= 2.0
        tangent *= dx
        dx -= chord
        yield block
