"""Logs of all runs end to end, with the overflow of their counters (13, 16 and 32 bits) undone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from calib.campaign.model import LOG_COLUMNS, Border, Logs
from calib.campaign.settings import Encoder
from calib.types import FloatArray, IntArray

#: widths that are looked for where the settings name none
WIDTHS: Final = (13, 16, 32)


def detect_wrap_bits(counts: FloatArray, offsets: IntArray) -> int | None:
    """Find the width of a counter that overflows inside the logs.

    A jump counts as an overflow where it comes within an eighth of 2^bits, and the log's range never leaves one span of
    the counter, so that a jump of the wheel itself is never mistaken for one.

    `counts` (shape (n_samples,)): logs laid end to end; `offsets` (shape (n_runs + 1,)): where each log begins. 13, 16
    or 32, or None where nothing overflows.
    """
    if not len(counts) or np.isnan(counts).all():
        return None
    low, high = np.nanmin(counts), np.nanmax(counts)
    for bits in WIDTHS:
        full = 2.0**bits
        unsigned, signed = low >= 0 and high < full, low >= -full / 2 and high < full / 2
        if not (unsigned or signed) or high - low < 0.875 * full:
            continue
        magnitude = np.abs(_steps(counts, offsets))
        overflows = np.abs(magnitude - full) < full / 8
        if overflows.any() and not (magnitude[~overflows] >= full / 8).any():
            return bits
    return None


def unwrap(counts: FloatArray, offsets: IntArray, bits: int) -> tuple[FloatArray, IntArray]:
    """Undo overflows: every step is taken as the shortest one around the counter.

    `counts` (shape (n_samples,)): logs laid end to end; `offsets` (shape (n_runs + 1,)): where each log begins; `bits`:
    width of the counter. Returns `counts` (shape (n_samples,)): each log continues from its own first value; `wraps`
    (shape (n_runs,)): overflows undone in each log.
    """
    full = 2.0**bits
    step = _steps(counts, offsets)
    turns = np.where(np.isnan(step), 0.0, -np.rint(step / full))
    if not turns.any():
        return counts, np.zeros(len(offsets) - 1, dtype=np.int64)
    total = np.cumsum(turns)
    start = np.repeat(total[np.minimum(offsets[:-1], len(total) - 1)], np.diff(offsets))
    wraps = np.add.reduceat(np.append(np.abs(turns), 0.0), offsets[:-1])
    wraps[np.diff(offsets) == 0] = 0
    return counts + full * (total - start), wraps.astype(np.int64)


def rewrap_total(total: FloatArray, expected: FloatArray, bits: int, tolerance: FloatArray) -> FloatArray:
    """Return how many full counters to add to `total` so that it meets `expected`; 0 where none fits.

    `total`, `expected`, `tolerance` (shape (n_runs,)): counts found, counts expected, and how far they may be apart;
    `bits`: width of the counter. Shape (n_runs,): whole numbers.
    """
    full = 2.0**bits
    turns = np.rint((expected - total) / full)
    fits = np.abs(total + turns * full - expected) <= tolerance
    return np.where(fits & np.isfinite(turns), turns, 0.0)


def _steps(counts: FloatArray, offsets: IntArray) -> FloatArray:
    """Return the step to each sample from the one before, 0 at the first of each log."""
    step = np.diff(counts, prepend=counts[:1])
    starts = offsets[:-1]
    step[starts[starts < len(step)]] = 0.0
    return step


#: samples by which the columns grow at least, and the share of what they hold
_GROWTH: Final = 1 << 16
_GROWTH_SHARE: Final = 0.125


class LogStack:
    """Columns that grow as logs come, one array each, so that no log is held twice.

    `n_runs`: rows of the run table.
    """

    def __init__(self, n_runs: int) -> None:
        self._lengths = np.zeros(n_runs, dtype=np.int64)
        self._columns: dict[str, FloatArray] = {}
        self._size = 0
        self._next = 0

    def add(self, run: int, columns: Mapping[str, FloatArray]) -> None:
        """Add the log of a run, whose columns each have shape (n_samples,); runs come in their order."""
        if run < self._next:
            raise ValueError(f"run: found {run} after {self._next - 1}; expected rising numbers")
        begin, self._next = self._size, run + 1
        self._lengths[run] = n_samples = len(columns["t_s"])
        self._size += n_samples
        for name in LOG_COLUMNS:
            if name in columns and name not in self._columns:
                self._columns[name] = np.full(begin, np.nan)
        for name, column in self._columns.items():
            if len(column) < self._size:
                # not copied where the system can move pages
                column.resize(self._size + max(_GROWTH, int(_GROWTH_SHARE * self._size)), refcheck=False)
            column[begin : self._size] = columns.get(name, np.nan)

    def finished(self, encoder: Encoder, names: Mapping[int, tuple[str, str]], border: Border) -> Logs:
        """Return the logs of all runs with the overflow of their counters undone; the stack is empty afterwards.

        `encoder`: ``wrap_bits`` where the settings name it; else overflows are looked for; `names`: run id and name of
        the log, for messages. Of all runs, end to end.
        """
        offsets = np.concatenate(([0], np.cumsum(self._lengths))).astype(np.int64)
        columns: dict[str, FloatArray] = {}
        for name in LOG_COLUMNS:
            column = self._columns.pop(name, None)
            if column is None:
                continue
            column.resize(self._size, refcheck=False)
            bits = encoder.wrap_bits or detect_wrap_bits(column, offsets) if name.startswith("counts_") else None
            if bits is not None and len(column):
                column, wraps = unwrap(column, offsets, bits)
                for run in np.flatnonzero(wraps):
                    run_id, shown = names[int(run)]
                    how = _STATED if encoder.wrap_bits else _DETECTED
                    text = f"{int(wraps[run])} overflow(s) of a {bits}-bit counter were undone ({how})"
                    border.say(f"{shown}, column {name}", text, "wrap", run_id=run_id)
            columns[name] = column
        return Logs(offsets=offsets, columns=columns)


#: how the width of a counter is known
_STATED: Final = "as the settings say"
_DETECTED: Final = "found in the jumps; give encoder.wrap_bits to make it sure"
