"""The whitened system about one path, whose columns every hypothesis is weighed with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.gap.effects.effect import Form
from calib.gap.evidence.marginal import CALIBRATION_SD, columns_of_forms, rows
from calib.gap.evidence.noise import Noise
from calib.gap.evidence.system import LinearSystem
from calib.gap.predict.path import Path
from calib.gap.predict.residuals import residuals


class WhitenedSystem:
    """The whitened system about one path: residual, recalibration and form columns, made once each.

    Parameters
    ----------
    path : Path
        Where it is linear.
    nominal : Path
        The model alone.
    noise : Noise
        Covariance of each unit.
    offered : sequence of Form
        Forms that will be asked for: on a path that is worked through in parts, all at once.
    """

    def __init__(self, path: Path, nominal: Path, noise: Noise, offered: Sequence[Form] = ()) -> None:
        self.path, self.nominal, self.noise = path, nominal, noise
        self.gap = rows(path, noise, residuals(path, nominal)[:, :, None])[:, 0]
        self.calibration = rows(path, noise, path.calibration * CALIBRATION_SD)
        usable = path.s.usable
        self.unit: IntArray = np.repeat(np.arange(len(path.s))[:, None], 6, axis=1)[usable]
        self.channel: IntArray = np.repeat(np.arange(6)[None, :], len(path.s), axis=0)[usable]
        self.condition: IntArray = path.s.condition[self.unit]
        self._offered = () if path.kept is not None else tuple(offered)
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
        if id(form) not in self._columns:
            wanted = [form, *(other for other in self._offered if id(other) not in self._columns and other is not form)]
            self._offered = ()
            for other, columns in zip(wanted, columns_of_forms(self.path, wanted), strict=True):
                # the form is kept with its columns, so that its id stays its own
                self._columns[id(other)] = other, rows(self.path, self.noise, columns)
        return self._columns[id(form)][1]
