"""The whitened system about one path, whose columns every hypothesis is weighed with."""

from __future__ import annotations

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.gap.effects.effect import Form
from calib.gap.evidence.marginal import CALIBRATION_SD, form_columns, rows
from calib.gap.evidence.noise import Noise, interactions, surroundings
from calib.gap.evidence.system import LinearSystem
from calib.gap.predict.path import Path
from calib.gap.predict.residuals import residuals

__all__ = ["WhitenedSystem"]


class WhitenedSystem:
    """The whitened system about one path: residual, recalibration and form columns, made once each."""

    def __init__(self, path: Path, nominal: Path, noise: Noise) -> None:
        self.path, self.nominal, self.noise = path, nominal, noise
        self.gap = rows(path, noise, residuals(path, nominal)[:, :, None])[:, 0]
        self.calibration = rows(path, noise, path.calibration * CALIBRATION_SD)
        usable = path.s.usable
        self.unit: IntArray = np.repeat(np.arange(len(path.s))[:, None], 6, axis=1)[usable]
        self.channel: IntArray = np.repeat(np.arange(6)[None, :], len(path.s), axis=0)[usable]
        self.condition: IntArray = path.s.condition[self.unit]
        self._columns: dict[int, tuple[Form, FloatArray]] = {}
        self._known: LinearSystem | None = None
        self._places: dict[int, int] = {}
        self._back: IntArray = np.zeros(0, dtype=np.int64)

    def know(self, system: LinearSystem) -> None:
        """Take columns from a system about the same path with the same floor, instead of making them once more."""
        self._known, self._back = system, np.argsort(system.blocks.order)
        self._places = {id(form): number for number, form in enumerate(system.forms)}

    def columns(self, form: Form) -> FloatArray:
        """Return the whitened signatures of a form in typical sizes, shape (n_rows, n_parameters)."""
        if self._known is not None and id(form) in self._places:
            return self._known.of(self._places[id(form)])[self._back]
        found = self._columns.get(id(form))
        if found is None:
            # the form is kept with its columns, so that its id stays its own
            found = (form, rows(self.path, self.noise, form_columns(self.path, form)))
            self._columns[id(form)] = found
        return found[1]

    def by_condition(self, contribution: FloatArray) -> FloatArray:
        """Split a whitened contribution (n_rows,) by condition, shape (n_rows, n_conditions)."""
        labels, index = np.unique(self.condition, return_inverse=True)
        made = np.zeros((len(contribution), len(labels)))
        made[np.arange(len(contribution)), index] = contribution
        return made

    def unknown_columns(self) -> list[FloatArray]:
        """Return columns of an unknown cause: offsets of the calibration by condition, and of channels by condition.

        Each is scaled so that 1 is about the floor of one unit. What was driven once has no offset of its own: that
        would be noise by another name.
        """
        n = len(self.unit)
        norm = np.sqrt((self.calibration[:, :3] ** 2).sum(axis=0) / max(len(self.path.s), 1))
        present = np.flatnonzero(self.path.s.usable.any(axis=0))
        wide = np.zeros((len(self.path.s), 6, len(present)))
        for number, channel in enumerate(present):
            wide[:, channel, number] = self.noise.floor[:, channel]
        white = rows(self.path, self.noise, wide)
        made = []
        for cells in (self.path.s.condition, self.path.s.cell):
            repeated = (np.bincount(cells)[cells] > 1)[self.unit]
            if not repeated.any():
                continue
            labels, index = np.unique(cells[self.unit[repeated]], return_inverse=True)
            for columns in (self.calibration[:, :3] / np.maximum(norm, 1e-12), white):
                spread = np.zeros((n, len(labels), columns.shape[1]))
                spread[np.flatnonzero(repeated), index] = columns[repeated]
                made.append(spread.reshape(n, -1))
        for columns in (surroundings(self.path), *interactions(self.path)):
            if columns.shape[2]:
                trend = rows(self.path, self.noise, columns)
                made.append(trend / np.maximum(np.sqrt((trend**2).mean(axis=0)), 1e-12))
        return made
