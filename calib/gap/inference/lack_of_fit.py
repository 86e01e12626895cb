"""Lack of fit: random effects that no effect of the library explains, beside every hypothesis.

y = C beta + sum_k S_k theta_k + R + noise. R is an offset that each condition (or cell) has of its own, or a trend on
the surroundings; its scale is averaged over a grid with zero.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from calib.gap.inference.fit import CALIBRATION_SD, whitened_rows
from calib.gap.inference.noise import Noise
from calib.gap.inference.noise_components import ambient_interactions, ambient_trends
from calib.gap.observations import Observations
from calib.gap.predict import Path
from calib.types import BoolArray, FloatArray, IntArray

INTERACTION: Final = "interaction"
#: radii that scatter between recordings: noise that windows share
SCATTER: Final = "recordings"
#: fewest recordings that show a scatter beside their mean
MIN_RECORDINGS: Final = 3
#: largest relative scatter of radii: the largest plausible step between sessions
LARGEST_SCATTER: Final = 1e-2
#: fewest offsets: a recalibration and an effect make some too
MIN_CELLS: Final = 8
#: standard deviation of the lack of fit, in noise levels of one run
LACK_OF_FIT_SCALES: Final = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0)


@dataclass(frozen=True, slots=True, eq=False)
class BlockColumns:
    """Own columns, of one number, of blocks of one length."""

    group: int  #: of the length in `Blocks.alike`
    same: IntArray | slice  #: which of the blocks of that length
    part: FloatArray  #: shape (n, length, q)


class Blocks:
    """Rows of the whitened system, a condition's together, conditions of as many rows side by side."""

    def __init__(self, s: Observations) -> None:
        unit, channel = np.nonzero(s.usable)
        _, condition, count = np.unique(s.condition[unit], return_inverse=True, return_counts=True)
        #: shape (n_rows,): of each ordered row among the usable (unit, channel) rows
        self.order = np.lexsort((condition, count[condition]))
        first = np.flatnonzero(np.diff(condition[self.order], prepend=-1))
        #: shape (n_blocks + 1,): rows of block b stand at ``starts[b]:starts[b + 1]``
        self.starts = np.append(first, len(self.order))
        #: shape (n_rows,): of each ordered row
        self.unit, self.channel = unit[self.order], channel[self.order]

    def __len__(self) -> int:
        return len(self.starts) - 1

    @cached_property
    def alike(self) -> list[tuple[IntArray, IntArray]]:
        """Blocks of each length: their numbers (n,), and the rows of each (n, length)."""
        lengths = np.diff(self.starts)
        groups = []
        for length in np.unique(lengths):
            numbers = np.flatnonzero(lengths == length)
            groups.append((numbers, self.starts[numbers][:, None] + np.arange(length)))
        return groups

    def alike_rows(self, values: FloatArray, group: int) -> FloatArray:
        """Return values (n_rows, k) of blocks of one length, a view (n, length, k)."""
        _, places = self.alike[group]
        return values[places[0, 0] : places[-1, -1] + 1].reshape(*places.shape, values.shape[1])

    def stacked(self, parts: Sequence[FloatArray]) -> list[BlockColumns]:
        """Join columns of each block's own, (n_rows of the block, q), where of one shape."""
        stacks = []
        for group, (numbers, _) in enumerate(self.alike):
            widths = np.array([parts[number].shape[1] for number in numbers])
            for width in np.unique(widths[widths > 0]):
                same = np.flatnonzero(widths == width)
                part = np.stack([parts[number] for number in numbers[same]])
                stacks.append(BlockColumns(group, slice(None) if len(same) == len(numbers) else same, part))
        return stacks

    def slices(self) -> list[slice]:
        """Return the rows of each block."""
        return [slice(int(a), int(b)) for a, b in zip(self.starts[:-1], self.starts[1:], strict=True)]


@dataclass(frozen=True, slots=True, eq=False)
class LackOfFit:
    """One component of lack of fit."""

    name: str  #: what varies, and from where to where
    stacks: Sequence[BlockColumns] = ()  #: whitened, scaled to about the noise of a run
    common: FloatArray | None = None  #: shape (n_rows, q): whitened columns common to all blocks
    relative: float = 0.0  #: scatter of radii between recordings at a scale of 1

    @property
    def is_interaction(self) -> bool:
        """Whether it is a trend under other loads, speeds or turns."""
        return self.name == INTERACTION

    @property
    def is_scatter(self) -> bool:
        """Whether it is noise that windows of a recording share."""
        return self.name == SCATTER

    def is_plausible(self, scale: float) -> bool:
        """Whether radii scatter by so much."""
        return self.relative * scale <= LARGEST_SCATTER


def lack_of_fit_components(path: Path, noise: Noise, blocks: Blocks) -> list[LackOfFit]:
    """Return the components of lack of fit that these runs could show, linearised about `path`.

    What was driven once has no offset of its own.
    """
    s = path.s
    calibration = whitened_rows(path, noise, path.calibration * CALIBRATION_SD)[:, :3]
    norm = np.sqrt((calibration**2).sum(axis=0) / max(len(s), 1))
    present = np.flatnonzero(s.usable.any(axis=0))
    wide = np.zeros((*s.usable.shape, len(present)))
    wide[:, present, np.arange(len(present))] = noise.floor[:, present]
    own = (calibration / np.maximum(norm, 1e-12))[blocks.order]
    white = whitened_rows(path, noise, wide)[blocks.order]
    offsets = {
        "calibration": own,
        "radii": own[:, :2],
        "track": own[:, 2:],
        "channels": white,
        "heading": white[:, present == 3],
        "position": white[:, present < 3],
    }
    kinds = []
    cell, condition = (np.unique(labels, return_inverse=True)[1] for labels in (s.cell, s.condition))
    for grouping, cells in (("condition", s.condition), ("cell", s.cell)):
        by_cell, repeated = grouping == "cell", np.bincount(cells)[cells] > 1
        if len(np.unique(cells[repeated])) < MIN_CELLS or (by_cell and np.array_equal(cell, condition)):
            continue
        for name, columns in offsets.items():
            if not columns.any() or (by_cell and name not in ("calibration", "channels")):
                continue
            on = [(columns[rows], blocks.unit[rows]) for rows in blocks.slices()]
            parts = [_spread(some, cells[unit], repeated[unit]) for some, unit in on]
            kinds.append(LackOfFit(f"{name} by {grouping}", blocks.stacked(parts)))
    run = s.run[blocks.unit]
    if s.windowed and len(np.unique(run)) >= MIN_RECORDINGS and own[:, :2].any():
        radii = own[:, :2].sum(axis=1, keepdims=True) if s.by_front else own[:, :2]
        columns = _spread(radii, run, np.ones(len(run), dtype=bool))
        kinds.append(LackOfFit(SCATTER, common=columns, relative=float(np.mean(CALIBRATION_SD[:2] / norm[:2]))))
    for number, trend in enumerate((ambient_trends(path), *ambient_interactions(path))):
        if trend.shape[2]:
            white = whitened_rows(path, noise, trend)[blocks.order]
            scaled = white / np.maximum(np.sqrt((white**2).mean(axis=0)), 1e-12)
            kinds.append(LackOfFit("surroundings" if number == 0 else INTERACTION, common=scaled))
    return kinds


def _spread(columns: FloatArray, cells: IntArray, repeated: BoolArray) -> FloatArray:
    labels, index = np.unique(cells[repeated], return_inverse=True)
    columns_by_cell = np.zeros((len(columns), len(labels), columns.shape[1]))
    columns_by_cell[np.flatnonzero(repeated), index] = columns[repeated]
    return columns_by_cell.reshape(len(columns), -1)
