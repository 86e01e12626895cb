"""Undo the overflow of counters of 13, 16 and 32 bits, in logs and in totals."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import FloatArray, IntArray

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
        if not (np.abs(magnitude - full) < full / 8).any():
            continue
        rest = magnitude[np.abs(magnitude - full) >= full / 8]
        if not len(rest) or np.nanmax(rest) < full / 8:
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
