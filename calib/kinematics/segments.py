"""Segments of runs that are compared: whole runs, or windows along the path."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from calib.errors import RefusedError
from calib.kinematics.drives import moved_between
from calib.kinematics.recording import Recording, parts_seen
from calib.types import BoolArray, FloatArray, IntArray

#: windows as parts of a block: whole, half, quarter
LEVELS: Final = (1.0, 0.5, 0.25)


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """Stretches and what the reference says of them."""

    #: number of the run, first and last sample, shape (n,)
    run: IntArray
    first: IntArray
    last: IntArray
    #: displacement of the sensor in its own frame at the start: forward, left, turn, shape (n, 3)
    measured: FloatArray
    #: which of these were measured, shape (n, 3)
    seen: BoolArray
    #: stretches of one block share their noise; they are nested in it, shape (n,)
    block: IntArray
    #: 0 for the longest windows, shape (n,)
    level: IntArray
    #: whose turn a gyro measured, shape (n,)
    gyro: BoolArray

    def __len__(self) -> int:
        return len(self.run)

    def are_runs_of(self, recording: Recording) -> bool:
        """Return whether the stretches are whole runs."""
        return bool(np.array_equal(self.first, recording.offsets[self.run]))

    def between(self, values: FloatArray) -> FloatArray:
        """Return the sums over each stretch of values of the steps, shape (..., n_samples) in, (..., n) out."""
        total = np.cumsum(values, axis=-1)
        return np.asarray(total[..., self.last] - total[..., self.first])

    def select(self, keep: BoolArray) -> Segments:
        """Return the stretches that `keep` picks."""
        return Segments(*(getattr(self, column.name)[keep] for column in fields(self)))


def end_pose_segments(recording: Recording) -> Segments:
    """Return each run with an end pose as one stretch.

    Raises RefusedError where no run has an end pose.
    """
    runs = np.flatnonzero(np.isfinite(recording.end_pose).any(axis=1))
    if not len(runs):
        raise RefusedError("end poses: found none; expected ref_x_m, ref_y_m, ref_theta_rad of some runs; measure them")
    measured = recording.end_pose[runs]
    return Segments(
        run=runs,
        first=recording.offsets[runs],
        last=recording.offsets[runs + 1] - 1,
        measured=np.nan_to_num(measured),
        seen=np.isfinite(measured),
        block=np.arange(len(runs)),
        level=np.zeros(len(runs), dtype=np.int64),
        gyro=recording.by_gyro[runs],
    )


def window_segments(recording: Recording, blocks: int) -> Segments:
    """Return windows of three lengths, nested in blocks of equal travel.

    `recording`: with a reference along the path; `blocks`: how many blocks all runs together are cut into, about; a run
    is one at least. Raises RefusedError where the reference follows the vehicle nowhere.

    The travel of the wheels, not the time, sets the length, so that a standing vehicle makes no windows. Shorter
    windows overlap by half. No window reaches over the end of its block. Of positions alone every window begins where
    its run does, with a heading of zero.
    """
    travel = recording.travel_rad
    ends = np.array([travel[stop - 1] for stop in recording.offsets[1:]])
    length = float(ends.sum()) / max(blocks, 1)
    pieces: list[tuple[IntArray, IntArray, IntArray, IntArray, IntArray]] = []
    block = 0
    seen: list[BoolArray] = []
    for run in range(len(recording)):
        reference = recording.reference[:, recording.offsets[run] : recording.offsets[run + 1]]
        parts = parts_seen(reference)
        samples = np.flatnonzero(np.isfinite(reference[parts]).all(axis=0) & parts.any()) + recording.offsets[run]
        if len(samples) < 2 or length <= 0.0:
            continue
        n_blocks = max(1, round(float(ends[run]) / length)) if parts[2] else 1
        edges = np.linspace(travel[samples[0]], travel[samples[-1]], n_blocks + 1)
        low, size = edges[:-1, None], np.diff(edges)[:, None]
        for level, share in enumerate(LEVELS):
            starts = np.arange(0.0, 1.0 - share + 1e-9, 0.5 * share if share < 1.0 else 1.0)
            starts = starts if parts[2] else starts[:1]
            first = samples[_nearest(travel[samples], (low + starts * size).ravel())]
            last = samples[_nearest(travel[samples], (low + (starts + share) * size).ravel())]
            real = last > first
            seen.append(np.repeat(parts[None], real.sum(), axis=0))
            n, of = int(real.sum()), np.repeat(block + np.arange(n_blocks), len(starts))
            pieces.append((first[real], last[real], np.full(n, run), of[real], np.full(n, level)))
        block += n_blocks
    if not pieces or not sum(len(piece[0]) for piece in pieces):
        raise RefusedError(
            "windows: found no reference along the path; expected ref_x_m, ref_y_m, ref_theta_rad in logs; "
            "use end poses instead"
        )
    first, last, run_of, block_of, level_of = (np.concatenate(part) for part in zip(*pieces, strict=True))
    measured = moved_between(np.nan_to_num(recording.reference), first, last)
    no_gyro = np.zeros(len(first), dtype=np.bool_)
    return Segments(run_of, first, last, measured, np.concatenate(seen), block_of, level_of, no_gyro)


def _nearest(travel: FloatArray, wanted: FloatArray) -> IntArray:
    """Return the samples where the travel is nearest to `wanted`."""
    after = np.clip(np.searchsorted(travel, wanted), 1, len(travel) - 1)
    return np.asarray(after - (wanted - travel[after - 1] < travel[after] - wanted))
