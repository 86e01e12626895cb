"""Least squares beside one scale of the rest: estimates, their covariance, and what they would be without some runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.gap.evidence.fit import SIZE_SD
from calib.gap.evidence.system import LinearSystem

#: keeps a covariance positive definite, relative to its diagonal
_ROUNDING: Final = 1e-11


def prior_precision(n_columns: int) -> FloatArray:
    """Return the prior precision of a recalibration and sizes after it, shape (n_columns,)."""
    return np.concatenate([np.ones(4), np.full(n_columns - 4, 1.0 / SIZE_SD**2)])


@dataclass(frozen=True, slots=True, eq=False)
class Weighting:
    """The covariance of the whitened gap beside one scale of the rest.

    Parameters
    ----------
    system : LinearSystem
        Rows and their order.
    name : str
        Kind of rest; empty where there is none.
    scale : float
        Its standard deviation in floors of one unit; 0 where there is none.
    covariance : tuple of array, each shape (n_b, n_b)
        Of each block's rows.
    common : array of float, shape (n_rows, q)
        Columns of a rest common to all blocks, scaled to unit prior variance.
    """

    system: LinearSystem
    name: str
    scale: float
    covariance: tuple[FloatArray, ...]
    common: FloatArray

    @staticmethod
    def from_rest(system: LinearSystem, kind: int, scale: float, deviations: FloatArray) -> Weighting:
        """Make it of a kind of rest (-1: none), its scale, and what each block may deviate by, (n_rows, k)."""
        rest = system.kinds[kind] if kind >= 0 else None
        blocks = []
        for number, rows_b in enumerate(system.blocks.slices()):
            own = deviations[rows_b]
            covariance = np.eye(len(own)) + own @ own.T
            if rest is not None and rest.by_block is not None:
                part = rest.by_block[number]
                covariance += scale**2 * part @ part.T
            # what a form far beyond its size may deviate by leaves the noise below rounding
            blocks.append(covariance + _ROUNDING * np.diag(np.diag(covariance)))
        common = np.zeros((len(system.gap), 0))
        if rest is not None and rest.common is not None:
            common = scale * rest.common
        return Weighting(system, "" if rest is None else rest.name, scale, tuple(blocks), common)

    def solve(
        self, columns: FloatArray, precision: FloatArray, use: BoolArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return estimates (p,) and covariance (p, p) of columns (n_rows, p) on the gap.

        Parameters
        ----------
        columns : array of float, shape (n_rows, p)
            Whitened columns.
        precision : array of float, shape (p,)
            Prior precision of each.
        use : array of bool, shape (n_units,), optional
            Units to learn from; all by default.
        """
        system = self.system
        whole = np.concatenate([columns, self.common, system.gap[:, None]], axis=1)
        n = whole.shape[1] - 1
        normal = np.diag(np.concatenate([precision, np.ones(self.common.shape[1])]))
        right = np.zeros(n)
        for numbers, places in system.blocks.alike:
            part = whole[places]
            covariance = np.stack([self.covariance[number] for number in numbers])
            if use is not None:
                on = use[system.blocks.unit[places]]
                some = on.any(axis=1)
                part, covariance, on = part[some], covariance[some], on[some]
                # a row that is left out stands alone, and says nothing
                part = part * on[:, :, None]
                covariance = covariance * (on[:, :, None] & on[:, None, :]) + np.eye(on.shape[1]) * ~on[:, :, None]
            solved = np.linalg.solve(covariance, part).reshape(-1, n + 1)
            weighed = part.reshape(-1, n + 1)[:, :n].T @ solved
            normal += weighed[:, :n]
            right += weighed[:, n]
        # scaled to a unit diagonal, a little added: columns exactly alike stay solvable
        root = np.sqrt(np.diag(normal))
        inverse = np.linalg.inv(normal / np.outer(root, root) + 1e-11 * np.eye(n)) / np.outer(root, root)
        p = columns.shape[1]
        return (inverse @ right)[:p], inverse[:p, :p]

    def square(self, gap: FloatArray) -> float:
        """Return y^T V^-1 y of a gap y, shape (n_rows,)."""
        inside = np.zeros((1 + self.common.shape[1],) * 2)
        whole = np.concatenate([gap[:, None], self.common], axis=1)
        for numbers, places in self.system.blocks.alike:
            part = whole[places]
            solved = np.linalg.solve(np.stack([self.covariance[number] for number in numbers]), part)
            inside += part.reshape(-1, part.shape[2]).T @ solved.reshape(-1, part.shape[2])
        common = inside[0, 1:] @ np.linalg.solve(np.eye(len(inside) - 1) + inside[1:, 1:], inside[1:, 0])
        return float(inside[0, 0] - common)

    def spread(self, change: FloatArray, units: BoolArray) -> float:
        """Return the standard deviation of the gap along a change (n_rows,) of some units: sqrt(change^T V change)."""
        system, total = self.system, 0.0
        for rows_b, covariance in zip(system.blocks.slices(), self.covariance, strict=True):
            on = units[system.blocks.unit[rows_b]]
            part = change[rows_b] * on
            total += float(part @ covariance @ part)
        along = (self.common * (change * units[system.blocks.unit])[:, None]).sum(axis=0)
        return float(np.sqrt(total + along @ along))
