"""Amplitude and wavelength of each run's weave about the line, and the length of its path, from the log (Fig. 8).

The wheels' paths give the heading against distance rolled. Two things look alike in it: a steady arc, and wheels whose
radii differ from those assumed; both are a straight trend. So the trend is fitted together with the weave and taken for
unequal radii, and only the weave about it counts as path; a heading measured at the end adds what the arc was.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from calib.arrays import BoolArray, FloatArray
from calib.campaign.model import Logs

POINTS: Final = 256
#: runs handled at once; keeps memory small in campaigns of many thousand runs
CHUNK: Final = 128
MIN_SAMPLES: Final = 16
#: a wave longer than twice the run cannot be told from a trend
MIN_PERIODS: Final = 0.5
MAX_PERIODS: Final = 42.0
PERIOD_STEP: Final = 0.25
#: headings about the axis may be so many times those about a straight trend, before the fit counts as diverged
MOST_OF_TREND: Final = 3.0
TINY_RAD: Final = 1e-9
ROUNDS: Final = 7


@dataclass(frozen=True, slots=True, eq=False)
class Weaves:
    """Weave and path of each run; arrays of shape (n_runs,), NaN where the log does not carry it."""

    #: of ``y = A sin(2 pi x / lambda + phase)``
    amplitude_m: FloatArray
    wavelength_m: FloatArray
    #: phase at the start
    phase_rad: FloatArray
    #: relative excess of the path of the axle's middle over its progress along the corridor
    excess: FloatArray
    #: heading at the end minus heading at the start, of the weave alone
    yaw_rad: FloatArray
    #: its standard uncertainty
    yaw_std_rad: FloatArray
    #: root mean square heading that the weave does not explain
    rest_rad: FloatArray

    @property
    def found(self) -> BoolArray:
        """Whether a run's log carried an estimate, shape (n_runs,)."""
        return np.asarray(np.isfinite(self.excess))


def estimate_weaves(logs: Logs, metres_per_count: tuple[float, float], track_m: float) -> Weaves:
    """Estimate the weave of every run that has a log.

    `logs`: of ``n_runs`` runs; uses ``counts_left`` and ``counts_right``; `metres_per_count`: left and right, by the
    assumed radii; a common error of 1 % changes lengths by 1 %, one wheel's error is taken out with the trend;
    `track_m`: distance between the wheels' contact points. Arrays over all runs.
    """
    n_runs = len(logs.lengths)
    out = np.full((7, n_runs), np.nan)
    if "counts_left" in logs.columns and "counts_right" in logs.columns:
        usable = np.flatnonzero(logs.lengths >= MIN_SAMPLES)
        for first in range(0, len(usable), CHUNK):
            runs = usable[first : first + CHUNK]
            rolled, heading, good = _headings(logs, runs, metres_per_count, track_m)
            if good.any():
                out[:, runs[good]] = fit_headings(rolled[good], heading[good])
    return Weaves(*out)


def _headings(
    logs: Logs, runs: npt.NDArray[np.int64], metres_per_count: tuple[float, float], track_m: float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return rolled distance (n,), heading on `POINTS` equal steps of it (n, POINTS), and which runs can be used."""
    rolled = np.zeros(len(runs))
    heading = np.zeros((len(runs), POINTS))
    good = np.zeros(len(runs), dtype=np.bool_)
    steps = np.linspace(0.0, 1.0, POINTS)
    left_all, right_all = logs.columns["counts_left"], logs.columns["counts_right"]
    for row, run in enumerate(runs):
        part = slice(int(logs.offsets[run]), int(logs.offsets[run + 1]))
        left = (left_all[part] - left_all[part.start]) * metres_per_count[0]
        right = (right_all[part] - right_all[part.start]) * metres_per_count[1]
        middle = 0.5 * (left + right)
        sign = 1.0 if middle[-1] >= 0 else -1.0
        middle = sign * middle
        known = np.isfinite(middle)
        if known.sum() < MIN_SAMPLES or not middle[known][-1] > track_m:
            continue
        # standstill at either end repeats a distance; interpolation wants it once
        middle, turned = middle[known], ((right - left) / track_m)[known]
        forward = np.concatenate(([True], np.diff(np.maximum.accumulate(middle)) > 0))
        if forward.sum() < MIN_SAMPLES:
            continue
        rolled[row] = middle[-1]
        heading[row] = np.interp(steps * middle[-1], middle[forward], turned[forward])
        good[row] = True
    return rolled, heading, good


def fit_headings(rolled_m: FloatArray, heading_rad: FloatArray) -> FloatArray:
    """Fit trend and weave to headings on equal steps of the distance rolled.

    The model is ``heading = offset + trend s + atan(dy/dx)`` with ``dy/dx = p cos(k x) + q sin(k x)``; it is fitted by
    Gauss-Newton over all runs at once, x being the progress along the axis under the present weave.

    `rolled_m` (shape (n,)): path of the axle's middle; `heading_rad` (shape (n, m)): heading from the counts at m equal
    steps from 0 to `rolled_m`. Shape (7, n).
    """
    n, m = heading_rad.shape
    u = np.broadcast_to(np.linspace(0.0, 1.0, m), (n, m))
    periods = _best_periods(heading_rad, np.minimum(rolled_m, MAX_PERIODS))
    line, wave = np.zeros((2, n)), np.zeros((2, n))
    x, angle = u, 2 * np.pi * periods[:, None] * u
    for number in range(ROUNDS):
        co, si = np.cos(angle), np.sin(angle)
        slope = wave[0, :, None] * co + wave[1, :, None] * si
        gain = 1.0 / (1.0 + slope**2)
        columns = [np.ones((n, m)), u, gain * co, gain * si]
        if number:
            columns.append(gain * 2 * np.pi * x * (wave[1, :, None] * co - wave[0, :, None] * si))
        step = _solve(
            np.stack(columns, axis=-1), heading_rad - line[0, :, None] - line[1, :, None] * u - np.arctan(slope)
        )
        line, wave = line + step[:2], wave + step[2:4]
        if number:
            # a step beyond a fifth of a period over the run would jump to another wave
            periods = np.clip(periods + np.clip(step[4], -0.2, 0.2), MIN_PERIODS / 2, 2 * MAX_PERIODS)
        weave = np.arctan(wave[0, :, None] * np.cos(angle) + wave[1, :, None] * np.sin(angle))
        # the wave keeps its number of periods over the run while the axis it is counted along is refined
        before, x = x[:, -1], _progress(weave)
        periods = periods * before / x[:, -1]
        angle = 2 * np.pi * periods[:, None] * x
    line, wave = _kept_near(heading_rad, u, line, wave)
    weave = np.arctan(wave[0, :, None] * np.cos(angle) + wave[1, :, None] * np.sin(angle))
    about_axis = heading_rad - line[0, :, None] - line[1, :, None] * u
    rest = about_axis - weave
    rms = np.sqrt(np.mean(rest**2, axis=1))
    power = np.maximum(np.einsum("nm,nm->n", rest, rest), 1e-300)
    alike = np.clip(np.einsum("nm,nm->n", rest[:, 1:], rest[:, :-1]) / power, 0.0, 0.999)
    independent = np.maximum(m * (1 - alike) / (1 + alike), 4.0)
    wavelength = rolled_m / periods
    return np.stack(
        (
            np.hypot(wave[0], wave[1]) * wavelength / (2 * np.pi),
            wavelength,
            np.arctan2(-wave[1], wave[0]),
            1.0 / _progress(about_axis)[:, -1] - 1.0,
            weave[:, -1] - weave[:, 0],
            # standard error of a straight trend over the run, times the run
            rms * np.sqrt(12.0 / independent),
            rms,
        )
    )


def _kept_near(
    heading_rad: FloatArray, u: FloatArray, line: FloatArray, wave: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return lines and waves; the straight trend alone where wave and line of a run grew against one another."""
    off = u - 0.5
    trend = (off * heading_rad).sum(axis=1) / (off * off).sum(axis=1)
    plain = np.stack([heading_rad.mean(axis=1) - 0.5 * trend, trend])

    def about(axis: FloatArray) -> FloatArray:
        left: FloatArray = np.sqrt(np.mean((heading_rad - axis[0, :, None] - axis[1, :, None] * u) ** 2, axis=1))
        return left

    # a wave is part of what a straight trend leaves: far more than that is two large terms that cancel
    diverged = about(line) > MOST_OF_TREND * about(plain) + TINY_RAD
    return np.where(diverged, plain, line), np.where(diverged, 0.0, wave)


def _solve(design: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the least-squares steps, shape (n_parameters, n), of `n` problems of shape (m, n_parameters)."""
    turned = design.transpose(0, 2, 1)
    gram = turned @ design
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", gram), 1e-300))
    # columns scaled to one; the ridge keeps a straight run, which has no wave to place, solvable
    scaled = gram / scale[:, :, None] / scale[:, None, :] + 1e-9 * np.eye(gram.shape[1])
    right = (turned @ wanted[:, :, None])[:, :, 0] / scale
    solution: FloatArray = np.linalg.solve(scaled, right[:, :, None])[:, :, 0] / scale
    return solution.T


def _progress(heading: FloatArray) -> FloatArray:
    """Return progress along the axis at each step as a share of the path, shape (n, m), by the trapezoidal rule."""
    along = np.cos(heading)
    out = np.zeros_like(heading)
    np.cumsum(0.5 * (along[:, 1:] + along[:, :-1]), axis=1, out=out[:, 1:])
    return np.asarray(out / (heading.shape[1] - 1))


def _best_periods(heading: FloatArray, most: FloatArray) -> FloatArray:
    """Return the number of periods, from a grid, whose sine with a trend explains each heading best, shape (n,)."""
    grid, first, second = _sines(heading.shape[1])
    power = (heading @ first) ** 2 + (heading @ second) ** 2
    power = np.where(grid[None, :] <= np.maximum(most, 2.0)[:, None], power, -1.0)
    return np.asarray(grid[np.argmax(power, axis=1)])


@lru_cache(maxsize=2)
def _sines(m: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a grid of numbers of periods, and for each the two waves on `m` steps, free of trends and unit vectors."""
    u = np.linspace(0.0, 1.0, m)
    grid = np.arange(MIN_PERIODS, MAX_PERIODS + PERIOD_STEP / 2, PERIOD_STEP)
    trend, _ = np.linalg.qr(np.column_stack((np.ones_like(u), u)))
    angle = 2 * np.pi * np.outer(u, grid)
    first, second = np.cos(angle), np.sin(angle)
    first = first - trend @ (trend.T @ first)
    first = first / np.linalg.norm(first, axis=0)
    second = second - trend @ (trend.T @ second)
    second = second - first * np.sum(first * second, axis=0)
    second = second / np.linalg.norm(second, axis=0)
    return grid, first, second
