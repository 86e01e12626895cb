"""Running sums of whole blocks by products with a triangle of ones.

A sequential sum waits for each addition. Here the steps stand in short rows; a product with a triangle gives the sums
within all rows, and only the totals of the rows are summed one after the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Final

import numpy as np

from calib.arrays import FloatArray

__all__ = ["ROW", "Part", "running_sums"]

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
    def of(left_out: float = 0.0, factor: float = 1.0) -> Part:
        """Return the part of a share and a factor."""
        return Part(left_out, factor, np.ascontiguousarray(factor * (_TRIANGLE - left_out * np.eye(ROW))))


def running_sums(steps: FloatArray, before: float, wanted: list[tuple[FloatArray, Part]]) -> float:
    """Write running sums of `steps`, begun at `before`; return the sum of the steps alone.

    Parameters
    ----------
    steps : array of float, shape (n,)
        Contiguous; used up.
    before : float
        Sum before the first step.
    wanted : list of (array, Part)
        Where to write, shape (n,), and what.
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
                made = out.reshape(-1, ROW)
                for k in range(0, len(rows), _ROWS):
                    np.dot(rows[k : k + _ROWS], part.triangle, out=made[k : k + _ROWS])
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
