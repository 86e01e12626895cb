"""Lay the logs of all runs end to end, and undo the overflow of their counters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.campaign.faults import Border
from calib.campaign.model import LOG_COLUMNS, Logs
from calib.campaign.settings import Encoder
from calib.campaign.wraps import detect_wrap_bits, unwrap

_COUNTS: Final = tuple(name for name in LOG_COLUMNS if name.startswith("counts_"))
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
            if column is not None:
                column.resize(self._size, refcheck=False)
                columns[name] = column
        for name in _COUNTS:
            if name in columns:
                columns[name] = _continuous(columns[name], offsets, name, encoder, names, border)
        return Logs(offsets=offsets, columns=columns)


def _continuous(
    counts: FloatArray,
    offsets: IntArray,
    column: str,
    encoder: Encoder,
    names: Mapping[int, tuple[str, str]],
    border: Border,
) -> FloatArray:
    if not len(counts):
        return counts
    bits = encoder.wrap_bits or detect_wrap_bits(counts, offsets)
    if bits is None:
        return counts
    counts, wraps = unwrap(counts, offsets, bits)
    how = "as the settings say" if encoder.wrap_bits else "found in the jumps; give encoder.wrap_bits to make it sure"
    for index in np.flatnonzero(wraps):
        run_id, shown = names[int(index)]
        border.say(
            f"{shown}, column {column}",
            f"{int(wraps[index])} overflow(s) of a {bits}-bit counter were undone ({how})",
            "wrap",
            run_id=run_id,
        )
    return counts
