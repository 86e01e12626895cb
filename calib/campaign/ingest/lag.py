"""The lag between two streams: where their speeds correlate best, with an interval by leaving blocks out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import FloatArray

_BLOCKS: Final = 12
_GOLDEN: Final = 0.6180339887498949
_MOST_POINTS: Final = 40_000
#: smoothing of both speeds, which come from differences of rounded readings
_SMOOTH_S: Final = 0.2
_LEAST_CORRELATION: Final = 0.5
#: least change of speed, as a share of it, that a lag shows in
_LEAST_CHANGE: Final = 0.02


@dataclass(frozen=True, slots=True)
class Lag:
    """How far a stream lags behind another."""

    #: positive where the second stream's clock is late
    lag_s: float
    #: 95 % interval, by leaving out each twelfth of the recording in turn
    ci95_s: tuple[float, float]
    #: of the speeds at that lag
    correlation: float


def estimate_lag(
    time_s: FloatArray,
    travelled: FloatArray,
    other_time_s: FloatArray,
    other_travelled: FloatArray,
    *,
    largest_s: float = 2.0,
) -> Lag | None:
    """Estimate how far the second stream lags behind the first.

    Both speeds are taken by central differences on one grid, smoothed alike; the lag is the peak of their correlation,
    found on the grid and then between its points.

    Parameters
    ----------
    time_s, travelled : array of float, shape (n_samples,)
        A path (or a heading) of the first stream, at its own times.
    other_time_s, other_travelled : array of float, shape (n_other,)
        The same of the second.
    largest_s : float
        Largest lag looked for.

    Returns
    -------
    Lag or None
        None where the speeds change too little to tell, or do not go together.
    """
    from scipy.optimize import minimize_scalar
    from scipy.stats import t as student

    start, end = max(time_s[0], other_time_s[0]), min(time_s[-1], other_time_s[-1])
    step = max(float(np.median(np.diff(time_s))), float(np.median(np.diff(other_time_s))), 1e-3)
    if not end - start > 4 * largest_s:
        return None
    # a grid in step with neither stream: between samples the noise of an interpolated path is less than at them, and a
    # grid in step with one would find the lag that puts it between the other's samples
    spacing = max(_GOLDEN * float(np.median(np.diff(time_s))), (end - start) / _MOST_POINTS)
    grid = np.arange(start + largest_s, end - largest_s, spacing)
    half_window = max(_SMOOTH_S, step)

    def speed(at: FloatArray, times: FloatArray, path: FloatArray) -> FloatArray:
        """Mean speed over the window around each time: differences of an interpolated path, no grid of its own."""
        late, early = (np.interp(at + sign * half_window, times, path) for sign in (1.0, -1.0))
        difference: FloatArray = (late - early) / (2 * half_window)
        return difference

    own = speed(grid, time_s, travelled)
    if not np.std(own) > _LEAST_CHANGE * np.mean(np.abs(own)):
        return None

    def correlation(lag: float, keep: np.ndarray) -> float:
        there = speed(grid[keep] + lag, other_time_s, other_travelled)
        here = own[keep]
        spread = float(np.std(here) * np.std(there))
        return float(np.mean((here - here.mean()) * (there - there.mean())) / spread) if spread > 0 else 0.0

    everything = np.ones(len(grid), dtype=np.bool_)
    candidates = np.arange(-largest_s, largest_s + step, max(step, 0.01))
    rough = candidates[int(np.argmax([correlation(lag, everything) for lag in candidates]))]

    reach = max(0.05, 2.0 * step)

    def peak(keep: np.ndarray) -> float:
        around = (rough - reach, rough + reach)
        found = minimize_scalar(
            lambda lag: -correlation(lag, keep), bounds=around, method="bounded", options={"xatol": 1e-6}
        )
        return float(found.x)

    best = peak(everything)
    strength = correlation(best, everything)
    if strength < _LEAST_CORRELATION:
        return None
    block = np.minimum(np.arange(len(grid)) * _BLOCKS // len(grid), _BLOCKS - 1)
    left_out = np.asarray([peak(block != number) for number in range(_BLOCKS)])
    deviation = float(np.sqrt((_BLOCKS - 1) / _BLOCKS * np.sum((left_out - left_out.mean()) ** 2)))
    half = float(student.ppf(0.975, _BLOCKS - 1)) * deviation
    return Lag(best, (best - half, best + half), strength)
