"""By how much the reference and the rangefinder lag behind the wheels: the correlation of their speeds."""

from __future__ import annotations

from collections.abc import Mapping as MappingType
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.campaign.ingest.mapping import MappedColumn
from calib.campaign.logs import detect_wrap_bits, unwrap
from calib.campaign.model import Border
from calib.campaign.readers.recording import Recording, Stream
from calib.campaign.readers.sheets import COUNT_UNITS
from calib.campaign.readers.table import NS_PER_S
from calib.types import BoolArray, FloatArray, floats

#: blocks of the jackknife that gives a lag's interval
_JACKKNIFE_BLOCKS: Final = 12
#: grid points of a correlation; a long recording takes wider steps
_MAX_GRID_POINTS: Final = 40_000
#: ratio of the grid's step to the wheels' (the golden section): the grid stays in step with neither stream
_GRID_RATIO: Final = 0.6180339887498949
#: half the window over which a speed is taken, since it comes from differences of rounded readings
_SPEED_WINDOW_S: Final = 0.2
#: correlation of two speeds below which no lag is given
_LEAST_CORRELATION: Final = 0.5
#: least change of speed, as a share of it, that shows a lag
_LEAST_SPEED_CHANGE: Final = 0.02
#: samples of another stream below which no lag is estimated, and lags that are looked at
_LEAST_LAG_SAMPLES, _LARGEST_LAG_S = 20, 2.0
#: spacing of the poses of a travelled distance, wide enough that their noise lengthens it little
_POSE_SPACING_S: Final = 0.1

#: an angle that spans more than one turn by this share does not start again at each turn
_ONE_TURN: Final = 1.001

#: calib's column -> its source
Lines = MappingType[str, MappedColumn]


@dataclass(frozen=True, slots=True)
class Lag:
    """By how much a stream lags behind another."""

    #: positive where the second stream's clock is late
    lag_s: float
    #: 95 % interval, by leaving out each twelfth of the recording in turn
    ci95_s: tuple[float, float]


def continuous_counts(
    counts: FloatArray, bits: int | None = None, time_s: FloatArray | None = None
) -> tuple[FloatArray, int | None]:
    """Return counts without overflows, and the counter's width; None where none is seen."""
    offsets = np.asarray([0, len(counts)])
    width = bits or detect_wrap_bits(counts, offsets, time_s)
    return (counts, None) if width is None else (unwrap(counts, offsets, width)[0], width)


def continuous_angle(angle: FloatArray, turn: float) -> FloatArray:
    """Return an angle that may start again after each `turn` as one that goes on; what is not known stays NaN."""
    known = np.isfinite(angle)
    if not known.any() or np.ptp(angle[known]) > _ONE_TURN * turn:
        return angle
    out = angle.copy()
    out[known] = np.unwrap(angle[known], period=turn)
    return out


def estimate_lags(recording: Recording, lines: Lines, base: Stream, shown: str, border: Border) -> dict[str, Lag]:
    """Estimate by how much the reference and the rangefinder lag behind the wheels, and note it.

    The lags are those of ``reference`` and ``range_m``, where there is one.

    Parameters
    ----------
    recording, lines
        A recording with the columns that the mapping names: calib's column -> the recording's.
    base
        The stream of the wheels.
    shown, border
        The recording's name in messages, and what takes the notes.
    """
    counts = [line for name, line in lines.items() if name.startswith("counts_") and line.column in base.columns]
    wheels = [base.columns[line.column] for line in counts if COUNT_UNITS[line.wheel_unit][0] in {"counts", "angle"}]
    if not wheels or base.time_ns is None:
        return {}
    origin = int(base.time_ns[0])
    time = (base.time_ns - origin) / NS_PER_S
    turned = np.mean([continuous_counts(counts, None, time)[0] for counts in wheels], axis=0)
    travelled = np.cumsum(np.abs(np.diff(turned, prepend=turned[:1])))
    lags: dict[str, Lag] = {}
    for name, columns in (("reference", ("ref_x_m", "ref_y_m")), ("range_m", ("range_m",))):
        sources = [lines[column].column for column in columns if column in lines]
        stream = recording.stream_of(sources[0]) if len(sources) == len(columns) else None
        if stream is None or stream.name == base.name or not set(sources) <= set(stream.columns):
            continue
        if stream.time_ns is None or len(stream) < _LEAST_LAG_SAMPLES:
            continue
        other = _travelled(stream, np.column_stack([stream.columns[source] for source in sources]))
        lag = estimate_lag(time, travelled, (stream.time_ns - origin) / NS_PER_S, other)
        if lag is None:
            continue
        lags[name] = lag
        low, high = lag.ci95_s
        text = f"the {name} lags {1e3 * lag.lag_s:+.1f} ms behind the wheels"
        text += f" (95 %: {1e3 * low:+.1f} .. {1e3 * high:+.1f}, by their speeds)"
        border.say(f"{shown}, {stream.name}", text, "lag")
    return lags


def _travelled(stream: Stream, positions: FloatArray) -> FloatArray:
    """Return the distance travelled through positions of shape (n_samples, 1 or 2), at every sample."""
    stride = max(1, round(_POSE_SPACING_S * stream.contents().rate_Hz))
    index = np.flatnonzero(np.isfinite(positions).all(axis=1))[::stride]
    steps = np.linalg.norm(np.diff(positions[index], axis=0), axis=1)
    total = np.concatenate(([0.0], np.cumsum(steps)))
    return floats(np.interp(np.arange(len(positions)), index, total))


def estimate_lag(
    time_s: FloatArray, travelled: FloatArray, other_time_s: FloatArray, other_travelled: FloatArray
) -> Lag | None:
    """Estimate by how much the second stream lags behind the first.

    Both speeds are taken by central differences on one grid, smoothed alike; the lag is the peak of their correlation,
    found on the grid and then between its points.

    None where the speeds change too little to tell, or do not correlate.

    Parameters
    ----------
    time_s, travelled : array of float, shape (n_samples,)
        A travelled distance (or a heading) of the first stream, at its own times.
    other_time_s, other_travelled : array of float, shape (n_other,)
        The same of the second.
    """
    from scipy.optimize import minimize_scalar
    from scipy.stats import t as student

    start, end = max(time_s[0], other_time_s[0]), min(time_s[-1], other_time_s[-1])
    own_step, other_step = float(np.median(np.diff(time_s))), float(np.median(np.diff(other_time_s)))
    step = max(own_step, other_step, 1e-3)
    if not end - start > 4 * _LARGEST_LAG_S:
        return None
    # an interpolated distance is less noisy between samples: a grid in step with one stream would prefer such a lag
    grid = np.arange(
        start + _LARGEST_LAG_S, end - _LARGEST_LAG_S, max(_GRID_RATIO * own_step, (end - start) / _MAX_GRID_POINTS)
    )
    half_window = max(_SPEED_WINDOW_S, step)

    def speed(at: FloatArray, times: FloatArray, distance: FloatArray) -> FloatArray:
        """Return the mean speed over the window around each time."""
        late, early = (np.interp(at + sign * half_window, times, distance) for sign in (1.0, -1.0))
        return floats((late - early) / (2 * half_window))

    own = speed(grid, time_s, travelled)
    if not np.std(own) > _LEAST_SPEED_CHANGE * np.mean(np.abs(own)):
        return None

    def correlation(lag: float, keep: BoolArray) -> float:
        there, here = speed(grid[keep] + lag, other_time_s, other_travelled), own[keep]
        spread = float(np.std(here) * np.std(there))
        return float(np.mean((here - here.mean()) * (there - there.mean())) / spread) if spread > 0 else 0.0

    everything = np.ones(len(grid), dtype=np.bool_)
    candidates = np.arange(-_LARGEST_LAG_S, _LARGEST_LAG_S + step, max(step, 0.01))
    rough = candidates[int(np.argmax([correlation(lag, everything) for lag in candidates]))]
    bounds = (rough - max(0.05, 2.0 * step), rough + max(0.05, 2.0 * step))

    def peak(keep: BoolArray) -> float:
        found = minimize_scalar(lambda lag: -correlation(lag, keep), bounds=bounds, options={"xatol": 1e-6})
        return float(found.x)

    lag = peak(everything)
    if correlation(lag, everything) < _LEAST_CORRELATION:
        return None
    # the 95 % interval, with each block of the grid held out in turn
    block = np.arange(len(grid)) * _JACKKNIFE_BLOCKS // len(grid)
    estimates = np.asarray([peak(block != number) for number in range(_JACKKNIFE_BLOCKS)])
    half = float(student.ppf(0.975, _JACKKNIFE_BLOCKS - 1) * np.std(estimates) * np.sqrt(_JACKKNIFE_BLOCKS - 1))
    return Lag(lag, (lag - half, lag + half))
