"""Steps gone through block by block, so that the arrays in use stay in the processor's cache.

Sums run within a block and are carried from block to block, which keeps their rounding below that of a
sample-by-sample loop. Sine and cosine both come from the tangent of half the angle: one vectorised function instead of
two scalar ones. A sequential sum waits for each addition: here the steps stand in short rows, a product with a triangle
of ones gives the sums within all rows, and only the totals of the rows are summed one after the other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from typing import Final

import numpy as np

from calib.odometry.steps import Flat, shorten
from calib.types import FloatArray, IntArray

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
