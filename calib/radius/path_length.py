"""Excess of each wheel's path over S_O in each run, with its uncertainty, from the headings of its log (Fig. 8).

See `docs/report.md`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ellipe

from calib.campaign.model import Campaign, Logs
from calib.campaign.read import looks_ahead
from calib.types import BoolArray, FloatArray, IntArray, StrArray, floats

#: least share of real turns in the variance of measured headings for these to be used
MIN_RELIABILITY: Final = 0.05
#: steps on which headings are fitted: six a period of the shortest weave
HEADING_POINTS: Final = 256
#: runs fitted at once, to save memory
RUN_CHUNK: Final = 128
#: fewest samples of a log, for the five parameters of trend and weave
MIN_SAMPLES: Final = 16
#: a wave longer than twice the run cannot be told from a trend
MIN_PERIODS: Final = 0.5
#: six points a period at the most, see `HEADING_POINTS`
MAX_PERIODS: Final = 42.0
#: step of the starting values, in periods: below half, Gauss-Newton finds the right wave
PERIOD_STEP: Final = 0.25
#: a fit diverged whose residuals are this factor above a straight line's
MAX_TREND_RATIO: Final = 3.0
TINY_RAD: Final = 1e-9
#: powers of the radii in the fields of `Weaves`
RADIUS_POWERS: Final = (2, 1, 0, 2, 1, 1, 2)
#: Gauss-Newton steps; the first keeps the wavelength
GAUSS_NEWTON_STEPS: Final = 7
#: largest change of the number of periods in a step: a larger one jumps to another wave
MAX_PERIOD_CHANGE: Final = 0.2
#: u = (2 pi A / lambda)^2 below which a series keeps digits that subtractions lose: relative truncation 5 u^2 / 64
SERIES_BELOW: Final = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class PathExcess:
    """Relative excess of the paths over S_O, S / S_O - 1; arrays of one shape."""

    centre: FloatArray
    left: FloatArray
    right: FloatArray
    #: heading at the end minus heading at the start
    yaw_rad: FloatArray

    @staticmethod
    def of(centre: FloatArray, yaw_rad: FloatArray, distance_m: FloatArray, track_m: float) -> "PathExcess":
        """Return the excess of paths by that of their middle; the wheels keep half a track from it."""
        half = 0.5 * track_m * yaw_rad / distance_m
        return PathExcess(centre, centre - half, centre + half, np.asarray(yaw_rad))


def whole_period_excess(amplitude_m: ArrayLike, wavelength_m: ArrayLike) -> FloatArray:
    """Return the relative excess of ``y = A sin(2 pi x / lambda)`` over whole periods, equal for centre and wheels.

    ``(2 / pi) sqrt(1 + u) E(m) - 1`` with ``u = (2 pi A / lambda)^2``, E the complete elliptic integral of the second
    kind and ``m = u / (1 + u)`` (Fig. 9). A and lambda broadcast.
    """
    u = (2 * np.pi * floats(amplitude_m) / floats(wavelength_m)) ** 2
    exact = 2 / np.pi * np.sqrt(1 + u) * ellipe(u / (1 + u)) - 1
    return np.asarray(np.where(u < SERIES_BELOW, u / 4 - 3 * u**2 / 64, exact))


def small_amplitude_excess(amplitude_m: ArrayLike, wavelength_m: ArrayLike) -> FloatArray:
    """Return the small-amplitude form ``(pi A / lambda)^2`` of `whole_period_excess`."""
    return np.asarray((np.pi * (floats(amplitude_m) / floats(wavelength_m))) ** 2)


def arc_excess(yaw_rad: ArrayLike, distance_m: ArrayLike, track_m: float) -> PathExcess:
    """Return the relative excess of a steady arc over its chord `distance_m` (Fig. 8a).

    `yaw_rad`: turn, left positive. The arguments broadcast.
    """
    yaw, distance = np.broadcast_arrays(floats(yaw_rad), floats(distance_m))
    return PathExcess.of(1.0 / np.sinc(0.5 * yaw / np.pi) - 1.0, yaw, distance, track_m)


@dataclass(frozen=True, slots=True, eq=False)
class RunPaths(PathExcess):
    """Path of each run; arrays of shape (n_runs,), 0 where nothing is known."""

    #: standard uncertainties of turn and excess
    yaw_std_rad: FloatArray
    centre_std: FloatArray
    #: of the weave, NaN where unknown; the phase is known from logs only
    amplitude_m: FloatArray
    wavelength_m: FloatArray
    phase_rad: FloatArray
    #: ``log``, ``columns`` or ``none``, with ``+heading`` where the measured heading was used
    source: StrArray
    notes: tuple[str, ...]


def correct_paths(campaign: Campaign) -> RunPaths:
    """Return each run's path by log, else measured weave, and by measured final heading."""
    runs, track = campaign.runs, campaign.vehicle.track_m
    distance = np.abs(runs.number("distance_m"))
    radii = campaign.model.radius_left_m, campaign.model.radius_right_m
    per_rev = campaign.encoder.counts_per_rev_left, campaign.encoder.counts_per_rev_right
    metres_per_count = 2 * np.pi * radii[0] / per_rev[0], 2 * np.pi * radii[1] / per_rev[1]
    weaves = estimate_weaves(campaign.logs, metres_per_count, track)
    # the measured distance corrects the model's radii, and with them the headings
    left, right = (np.abs(runs.number(f"counts_{side}")) for side in ("left", "right"))
    rolled = left * metres_per_count[0] / 2 + right * metres_per_count[1] / 2
    scale = distance * (1 + weaves.excess) / rolled
    weaves = Weaves(*(part * scale**power for part, power in zip(weaves, RADIUS_POWERS, strict=True)))
    logged = weaves.known
    amplitude, wavelength = np.abs(runs.number("amplitude_m")), np.abs(runs.number("wavelength_m"))
    listed = ~logged & np.isfinite(amplitude) & (wavelength > 0)

    # a turn within two standard uncertainties is not corrected
    significant = np.abs(weaves.yaw_rad) > 2.0 * weaves.yaw_std_rad
    turn = np.where(significant, weaves.yaw_rad, 0.0)
    turn_std = np.hypot(weaves.yaw_std_rad, np.where(significant, 0.0, weaves.yaw_rad))
    of_logs = weaves.excess, weaves.excess_std, turn, turn_std
    centre, centre_std, yaw, yaw_std = np.where(logged, of_logs, 0.0)
    if listed.any():
        slope = 2 * np.pi * amplitude[listed] / wavelength[listed]
        turns = 2 * np.pi * distance[listed] / wavelength[listed]
        centre[listed] = whole_period_excess(amplitude[listed], wavelength[listed])
        # phases are unknown: equally likely
        yaw_std[listed] = slope * np.sqrt(np.maximum(1 - np.cos(turns), 0.0))
        centre_std[listed] = slope**2 * np.abs(np.sin(turns)) / (4 * np.sqrt(2) * turns)

    arc, reliability = _arc_turns(campaign, yaw, yaw_std)
    used = reliability > MIN_RELIABILITY
    arc = np.where(used, arc, 0.0)
    ends = (runs.number(name) for name in ("ref_x_m", "ref_y_m"))
    # an arc is longer than its chord by a 24th of the squared turn, than its way along the start heading by a 6th
    ahead = campaign.reference.frame != "map" and looks_ahead(distance, *ends)
    centre = (1 + centre) * (1 + arc_excess(2.0 * arc if ahead else arc, 1.0, 0.0).centre) - 1
    yaw = yaw + arc
    yaw_std = np.where(used, campaign.reference.sigma_theta_rad * np.sqrt(reliability), yaw_std)
    half = 0.5 * track * yaw / np.where(distance > 0, distance, np.nan)
    source = np.where(logged, "log", np.where(listed, "columns", "none")).astype("<U16")
    source = np.where(used, np.char.add(source, "+heading"), source)
    amplitude = np.where(logged, weaves.amplitude_m, amplitude)
    wavelength = np.where(logged, weaves.wavelength_m, wavelength)
    weave, notes = (amplitude, wavelength, weaves.phase_rad), tuple(_notes(logged, listed, used))
    return RunPaths(centre, centre - half, centre + half, yaw, yaw_std, centre_std, *weave, source, notes)


def _arc_turns(campaign: Campaign, yaw_rad: FloatArray, yaw_std_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    # measured turns beyond the logs', shrunk by their reliability: the share of real arcs in their variance
    heading = campaign.runs.number("ref_theta_rad")
    measured = np.isfinite(heading)
    if not measured.any():
        return np.zeros_like(yaw_rad), np.zeros_like(yaw_rad)
    noise, of_logs = campaign.reference.sigma_theta_rad, yaw_std_rad**2
    surplus = np.where(measured, heading - yaw_rad, 0.0)
    # real arcs: scatter of the measured headings beyond their noise and the logs' uncertainty
    expected = float(np.mean((noise**2 + of_logs)[measured]))
    observed = float(np.mean((surplus**2)[measured]))
    arcs = observed - expected if observed > expected * (1 + 3 * np.sqrt(2 / measured.sum())) else 0.0
    unknown = arcs + of_logs
    reliability = np.where(measured & (unknown > 0), unknown / np.maximum(unknown + noise**2, 1e-300), 0.0)
    return reliability * surplus, reliability


def _notes(logged: BoolArray, listed: BoolArray, used: BoolArray) -> Iterator[str]:
    n, nothing = len(logged), ~(logged | listed | used)
    if logged.any():
        yield f"Path of {logged.sum()} of {n} runs corrected for the weave in their logs."
    if listed.any():
        yield (
            f"Path of {listed.sum()} of {n} runs corrected by amplitude_m and wavelength_m over whole periods; "
            "where in the period they began and ended is not known and counts as uncertainty."
        )
    if used.any():
        yield f"Turn of {used.sum()} of {n} runs corrected by the measured heading at their end."
    if nothing.any():
        yield (
            f"Path of {nothing.sum()} of {n} runs not corrected: no log, no weave columns, no measured heading. "
            "Weave makes such radii too small and its turn scatters them; add logs, or keep the vehicle on the line."
        )


class Weaves(NamedTuple):
    """Weave and path of each run by its log; arrays of shape (n_runs,), NaN without an estimate."""

    #: of ``y = A sin(2 pi x / lambda + phase)``
    amplitude_m: FloatArray
    wavelength_m: FloatArray
    #: phase at the start
    phase_rad: FloatArray
    #: relative excess of the path of the axle's middle over its progress along the corridor
    excess: FloatArray
    #: heading at the end minus heading at the start, by the counts, about the trend
    yaw_rad: FloatArray
    yaw_std_rad: FloatArray
    excess_std: FloatArray

    @property
    def known(self) -> BoolArray:
        """Whether the log of a run gave an estimate, shape (n_runs,)."""
        return np.isfinite(self.excess)


def estimate_weaves(logs: Logs, metres_per_count: tuple[float, float], track_m: float) -> Weaves:
    """Estimate the weave of every run that has a log.

    `metres_per_count`: left and right; a common error goes into lengths, one of a wheel into the trend.
    """
    out = np.full((7, len(logs.lengths)), np.nan)
    if "counts_left" in logs.columns and "counts_right" in logs.columns:
        usable = np.flatnonzero(logs.lengths >= MIN_SAMPLES)
        for first in range(0, len(usable), RUN_CHUNK):
            runs = usable[first : first + RUN_CHUNK]
            rolled, heading, good = _headings(logs, runs, metres_per_count, track_m)
            if good.any():
                out[:, runs[good]] = fit_headings(rolled[good], heading[good])
    return Weaves(*out)


def _headings(
    logs: Logs, runs: IntArray, metres_per_count: tuple[float, float], track_m: float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    rolled, heading = np.zeros(len(runs)), np.zeros((len(runs), HEADING_POINTS))
    good, steps = np.zeros(len(runs), dtype=np.bool_), np.linspace(0.0, 1.0, HEADING_POINTS)
    columns = [logs.columns[name] for name in ("counts_left", "counts_right")]
    for row, run in enumerate(runs):
        counts = (column[logs.offsets[run] : logs.offsets[run + 1]] for column in columns)
        left, right = ((part - part[0]) * size for part, size in zip(counts, metres_per_count, strict=True))
        middle = 0.5 * (left + right)
        middle *= 1.0 if middle[-1] >= 0 else -1.0
        known = np.isfinite(middle)
        if known.sum() < MIN_SAMPLES or not middle[known][-1] > track_m:
            continue
        # standstill at either end repeats a distance
        middle, turned = middle[known], ((right - left) / track_m)[known]
        forward = np.concatenate(([True], np.diff(np.maximum.accumulate(middle)) > 0))
        if forward.sum() < MIN_SAMPLES:
            continue
        rolled[row] = middle[-1]
        heading[row] = np.interp(steps * middle[-1], middle[forward], turned[forward])
        good[row] = True
    return rolled, heading, good


def fit_headings(rolled_m: FloatArray, heading_rad: FloatArray) -> FloatArray:
    """Fit trend and weave to headings on equal steps of the distance rolled; return the fields of `Weaves`, (7, n).

    The model is ``heading = offset + trend s + atan(dy/dx)`` with ``dy/dx = p cos(k x) + q sin(k x)``.

    `rolled_m` (shape (n,)): path of the axle's middle; `heading_rad` (shape (n, m)): at m equal steps from 0 to that.
    """
    n, m = heading_rad.shape
    u = np.broadcast_to(np.linspace(0.0, 1.0, m), (n, m))
    taper = np.sin(np.pi * u)
    periods = _best_periods(heading_rad, np.minimum(rolled_m, MAX_PERIODS))
    line, wave = np.zeros((2, 2, n))
    x, angle = u, 2 * np.pi * periods[:, None] * u
    for number in range(GAUSS_NEWTON_STEPS):
        co, si = np.cos(angle), np.sin(angle)
        slope = wave[0, :, None] * co + wave[1, :, None] * si
        gain = 1.0 / (1.0 + slope**2)
        columns = [np.ones((n, m)), u, gain * co, gain * si]
        if number:
            columns.append(gain * 2 * np.pi * x * (wave[1, :, None] * co - wave[0, :, None] * si))
        wanted = heading_rad - line[0, :, None] - line[1, :, None] * u - np.arctan(slope)
        step = _solve(np.stack(columns, axis=-1) * taper[..., None], wanted * taper)
        line, wave = line + step[:2], wave + step[2:4]
        if number:
            changed = periods + np.clip(step[4], -MAX_PERIOD_CHANGE, MAX_PERIOD_CHANGE)
            periods = np.clip(changed, MIN_PERIODS / 2, 2 * MAX_PERIODS)
        weave = np.arctan(wave[0, :, None] * np.cos(angle) + wave[1, :, None] * np.sin(angle))
        # the wave keeps its number of periods while its axis is refined
        before, x = x[:, -1], _progress(weave)
        periods = periods * before / x[:, -1]
        angle = 2 * np.pi * periods[:, None] * x
    line, wave = _without_diverged(heading_rad, u, line, wave, weave)
    about_axis = heading_rad - line[0, :, None] - line[1, :, None] * u
    residual = about_axis - np.arctan(wave[0, :, None] * np.cos(angle) + wave[1, :, None] * np.sin(angle))
    rms = np.sqrt(np.mean(residual**2, axis=1))
    power = np.maximum(np.einsum("nm,nm->n", residual, residual), 1e-300)
    correlation = np.clip(np.einsum("nm,nm->n", residual[:, 1:], residual[:, :-1]) / power, 0.0, 0.999)
    independent = np.maximum(m * (1 - correlation) / (1 + correlation), 4.0)
    wavelength = rolled_m / periods
    return np.stack(
        (
            np.hypot(wave[0], wave[1]) * wavelength / (2 * np.pi),
            wavelength,
            np.arctan2(-wave[1], wave[0]),
            1.0 / _progress(about_axis)[:, -1] - 1.0,
            about_axis[:, -1] - about_axis[:, 0],
            # standard error of a straight trend over the run, times the run
            rms * np.sqrt(12.0 / independent),
            # noise lengthens a path by half its square, and the axis is off by that trend
            rms**2 * (0.5 * (1.0 - correlation) + 1.0 / independent),
        )
    )


def _without_diverged(
    heading_rad: FloatArray, u: FloatArray, line: FloatArray, wave: FloatArray, weave: FloatArray
) -> tuple[FloatArray, FloatArray]:
    # where the fit diverged, a straight line and no wave
    off = u - 0.5
    trend = (off * heading_rad).sum(axis=1) / (off * off).sum(axis=1)
    plain = np.stack([heading_rad.mean(axis=1) - 0.5 * trend, trend])

    def about(axis: FloatArray, course: FloatArray | float = 0.0) -> FloatArray:
        left = heading_rad - axis[0, :, None] - axis[1, :, None] * u - course
        return np.asarray(np.sqrt(np.mean(left**2, axis=1)))

    # diverged: line and wave are large and cancel
    straight = about(plain)
    diverged = (about(line) > MAX_TREND_RATIO * straight + TINY_RAD) | (about(line, weave) > straight + TINY_RAD)
    return np.where(diverged, plain, line), np.where(diverged, 0.0, wave)


def _solve(design: FloatArray, target: FloatArray) -> FloatArray:
    transposed = design.transpose(0, 2, 1)
    gram = transposed @ design
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", gram), 1e-300))
    # columns scaled to one; a small ridge keeps a run without a wave solvable
    scaled = gram / scale[:, :, None] / scale[:, None, :] + 1e-9 * np.eye(gram.shape[1])
    right = (transposed @ target[:, :, None])[:, :, 0] / scale
    solution: FloatArray = np.linalg.solve(scaled, right[:, :, None])[:, :, 0] / scale
    return solution.T


def _progress(heading: FloatArray) -> FloatArray:
    from scipy.integrate import cumulative_trapezoid

    return np.asarray(cumulative_trapezoid(np.cos(heading), dx=1.0 / (heading.shape[1] - 1), axis=1, initial=0.0))


def _best_periods(heading: FloatArray, most: FloatArray) -> FloatArray:
    grid, first, second = _sines(heading.shape[1])
    power = (heading @ first) ** 2 + (heading @ second) ** 2
    power = np.where(grid[None, :] <= np.maximum(most, 2.0)[:, None], power, -1.0)
    return np.asarray(grid[np.argmax(power, axis=1)])


@lru_cache(maxsize=2)
def _sines(m: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    u = np.linspace(0.0, 1.0, m)
    grid = np.arange(MIN_PERIODS, MAX_PERIODS + PERIOD_STEP / 2, PERIOD_STEP)
    trend, _ = np.linalg.qr(np.column_stack((np.ones_like(u), u)))
    angle = 2 * np.pi * np.outer(u, grid)
    first, second = (wave - trend @ (trend.T @ wave) for wave in (np.cos(angle), np.sin(angle)))
    first = first / np.linalg.norm(first, axis=0)
    second = second - first * np.sum(first * second, axis=0)
    return grid, first, second / np.linalg.norm(second, axis=0)
