"""The stretch of a route over which the gap grows: a zone of the floor, a joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.gap.data.channels import Channel
from calib.gap.where.result import PlaceLine
from calib.gap.where.traces import Trace

#: channels whose gap is traced along the way
CHANNELS: Final = (Channel.ALONG, Channel.HEADING)
BOOTSTRAPS: Final = 300
GRID_M: Final = 0.25
MOST_BINS: Final = 120
#: a longer zone looks like a scale of the whole run
LONGEST_SHARE: Final = 0.4
FEWEST_RUNS: Final = 4
LEAST_TURN_RAD: Final = 0.3
#: runs shorter than this share of the usual length are left out, and the last part of the route with them
WHOLE: Final = 0.95
#: what a stretch keeps of itself beside the trend, at least, as a share of the grid
LEAST_LEFT: Final = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class _Route:
    """Runs of one route on a common grid."""

    traces: list[Trace]  #: those long enough
    grid: FloatArray  #: shape (n_grid,): way from the start; of corridors driven both ways the place on the floor
    #: spacing_m, length_m: of the grid, and of the route
    spacing_m: float
    length_m: float
    on_floor: bool  #: whether the grid is a place on the floor

    def read(self, trace: Trace, values: FloatArray) -> FloatArray:
        """Return what a run accumulated on the grid, shape (n_grid,); of a run back, accumulated from its far end."""
        if self.on_floor and trace.back:
            # gained between two places on the floor, whichever way they are passed
            return -np.interp(self.length_m - self.grid, trace.way_m, values)
        return np.interp(self.grid, trace.way_m, values)

    def on_the_floor(self, place_m: float) -> tuple[float, float]:
        """Return x and y of a place of the grid on the floor, by the first run."""
        trace = self.traces[0]
        way = self.length_m - place_m if self.on_floor and trace.back else place_m
        x, y = float(np.interp(way, trace.way_m, trace.x_m)), float(np.interp(way, trace.way_m, trace.y_m))
        return (self.length_m - x, -y) if trace.back else (x, y)


def scan_route(
    kind: str, traces: list[Trace], channel: Channel, rng: np.random.Generator, *, signed: bool
) -> tuple[PlaceLine, int] | None:
    """Search a route for the stretch over which a channel's gap grows, and count the stretches searched.

    Parameters
    ----------
    kind : str
        The route.
    traces : list of Trace
        Its runs.
    channel : Channel
        Along or heading.
    rng : numpy.random.Generator
        For the bootstrap.
    signed : bool
        Look for a gap that has the other sign on the way back.

    Returns
    -------
    tuple of PlaceLine and int, or None
        The p value is that of the best stretch alone. None where there are too few whole runs.
    """
    from scipy.special import stdtr

    traces = [trace for trace in traces if np.isfinite(_gap(trace, channel)).all()]
    route = _route(traces)
    if route is None:
        return None
    gaps = np.stack([route.read(trace, _gap(trace, channel)) for trace in route.traces])
    if signed:
        gaps *= np.where([trace.back for trace in route.traces], -1.0, 1.0)[:, None]
    sizes, norm, starts, ends = _sizes(route, gaps)
    n = len(route.traces)
    best = int(np.argmax(sizes.mean(axis=0) ** 2 * norm))
    own = sizes[:, best]
    t = abs(float(own.mean())) / max(float(np.std(own, ddof=1) / np.sqrt(n)), 1e-12)
    draws = rng.multinomial(n, np.full(n, 1.0 / n), BOOTSTRAPS) / n
    picked = np.argmax((draws @ sizes) ** 2 * norm, axis=1)
    half = 0.5 * route.spacing_m
    first, last = (
        (
            float(np.quantile(route.grid[index[picked]], 0.025) - half),
            float(np.quantile(route.grid[index[picked]], 0.975) + half),
        )
        for index in (starts, ends)
    )
    spread = float(np.quantile((draws @ own), 0.975) - np.quantile((draws @ own), 0.025)) / 2
    place = (float(route.grid[starts[best]]), float(route.grid[ends[best]]))
    line = PlaceLine(
        where="joint" if place[1] - place[0] <= 2 * route.spacing_m else "zone",
        channel=channel,
        route=kind,
        coordinate="x on the floor" if route.on_floor else "way from the start",
        place=place,
        place_ci95=(first, last),
        by_direction=signed,
        floor=(route.on_the_floor(place[0]), route.on_the_floor(place[1])),
        size=float(own.mean()),
        ci95=(float(own.mean()) - spread, float(own.mean()) + spread),
        unit=channel.unit,
        p_value=float(2.0 * stdtr(n - 1.0, -t)),
        n_runs=n,
    )
    return line, len(starts)


def _gap(trace: Trace, channel: Channel) -> FloatArray:
    return trace.along_m if channel is Channel.ALONG else trace.heading_rad


def _route(traces: list[Trace]) -> _Route | None:
    """Return the runs that are about as long as usual, with their grid; None where they are too few or too short."""
    if len(traces) < FEWEST_RUNS:
        return None
    length = float(np.median([float(trace.way_m[-1]) for trace in traces]))
    traces = [trace for trace in traces if float(trace.way_m[-1]) > WHOLE * length]
    if len(traces) < FEWEST_RUNS or length < 8 * GRID_M:
        return None
    spacing = max(GRID_M, length / MOST_BINS)
    grid = np.arange(0.0, WHOLE * length + 1e-9, spacing)
    on_floor = any(trace.back for trace in traces)
    if on_floor:
        grid = grid[grid >= 0.05 * length]
    return _Route(traces, grid, spacing, length, on_floor)


def _sizes(route: _Route, gaps: FloatArray) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
    """Return by how much each run's gap (n_runs, n_grid) grows over each stretch, what a run's calibration does aside.

    Returns
    -------
    sizes : array of float, shape (n_runs, n_stretches)
    norm : array of float, shape (n_stretches,)
        Squares of the stretch beside the calibration.
    starts, ends : array of int, shape (n_stretches,)
        On the grid.
    """
    grid = route.grid
    starts, ends = _stretches(len(grid))
    ramp = np.clip((grid[None, :] - grid[starts][:, None]) / (grid[ends] - grid[starts])[:, None], 0.0, 1.0)
    # what goes with the turns is no matter of a place: it is asked of the turns
    turned = np.stack([route.read(trace, trace.turn_rad) for trace in route.traces]).mean(axis=0)
    trend = [np.ones_like(grid), grid - grid.mean()]
    if np.ptp(turned) > LEAST_TURN_RAD:
        trend.append(turned)
        bend = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(turned)))))
        if not np.allclose(bend, np.abs(turned - turned[0]), atol=0.1):
            trend.append(bend)
    basis, _ = np.linalg.qr(np.stack(trend, axis=1))
    ramp = ramp - (ramp @ basis) @ basis.T
    gaps = gaps - (gaps @ basis) @ basis.T
    norm = (ramp**2).sum(axis=1)
    ok = norm > LEAST_LEFT * len(grid)
    return gaps @ ramp[ok].T / norm[ok], norm[ok], starts[ok], ends[ok]


def _stretches(n: int) -> tuple[IntArray, IntArray]:
    """Return start and end (grid indices) of every stretch that is searched."""
    longest = max(2, int(LONGEST_SHARE * n))
    lengths = np.unique(
        np.concatenate([np.arange(1, min(9, longest)), np.geomspace(8, max(longest, 9), 8).astype(int)])
    )
    starts, ends = np.meshgrid(np.arange(n), lengths, indexing="ij")
    ends = starts + ends
    ok = (ends < n - 1) & (starts > 0)
    return starts[ok], ends[ok]
