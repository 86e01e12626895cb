"""Whether the gap opens in the turns or at the stops, by windows of about a metre."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.gap.data.channels import Channel
from calib.gap.data.windows import edges_along
from calib.gap.where.result import PlaceLine
from calib.gap.where.traces import Trace

WINDOW_M: Final = 1.0
FEWEST_WINDOWS: Final = 10
FEWEST_STOPS: Final = 5
TURNING_PER_M: Final = 0.1
#: with fewer runs, errors are not clustered by run
FEWEST_CLUSTERS: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """What each window gained in gap, way, turn and stops, each shape (n_windows,); `run` is the number of its run."""

    along: FloatArray
    heading: FloatArray
    way: FloatArray
    turn: FloatArray
    stops: FloatArray
    run: IntArray

    @property
    def bend(self) -> FloatArray:
        """Turn either way, shape (n_windows,)."""
        return np.abs(self.turn)

    def gap(self, channel: Channel) -> FloatArray:
        """Return what was gained in a channel, shape (n_windows,)."""
        return self.along if channel is Channel.ALONG else self.heading


def compare_windows(traces: list[Trace]) -> list[PlaceLine]:
    """Return how much of the gap goes with turns and with stops, beside the way, each with its own p."""
    windows = _cut(traces)
    lines = []
    for channel in (Channel.ALONG, Channel.HEADING):
        on = np.isfinite(windows.gap(channel)) & (windows.way > 1e-6)
        turning = on & (windows.bend > TURNING_PER_M * windows.way)
        straight = on & ~turning
        questions = []
        if turning.sum() >= FEWEST_WINDOWS and straight.sum() >= FEWEST_WINDOWS:
            questions.append(("turns", windows.turn, "per rad of signed turn"))
            questions.append(("turns", windows.bend, "per rad of turn either way"))
        if (windows.stops[on] > 0).sum() >= FEWEST_STOPS and (windows.stops[on] == 0).sum() >= FEWEST_STOPS:
            questions.append(("stops", windows.stops, "per stop"))
        lines += [_line(windows, channel, on, values, where, what) for where, values, what in questions]
    return lines


def _cut(traces: list[Trace]) -> _Windows:
    """Cut the runs into windows of about a metre."""
    parts: dict[str, list[FloatArray]] = {name: [] for name in ("along", "heading", "way", "turn", "stops")}
    run: list[IntArray] = []
    numbers = {name: number for number, name in enumerate(sorted({trace.run_id for trace in traces}))}
    for trace in traces:
        edges = edges_along(trace.way_m, float(trace.way_m[-1]) / WINDOW_M)
        gained = (trace.along_m, trace.heading_rad, trace.way_m, trace.turn_rad, trace.stops)
        for values, windows in zip(gained, parts.values(), strict=True):
            windows.append(np.diff(values[edges]))
        run.append(np.full(len(edges) - 1, numbers[trace.run_id]))
    return _Windows(**{name: np.concatenate(windows) for name, windows in parts.items()}, run=np.concatenate(run))


def _line(windows: _Windows, channel: Channel, on: BoolArray, values: FloatArray, where: str, what: str) -> PlaceLine:
    """Return the regression of a channel's gap on the way and on `values`, all shape (n_windows,), as a line."""
    from scipy.special import stdtr

    design = np.stack([windows.way[on], values[on]], axis=1)
    size, error, dof = _slope(design, windows.gap(channel)[on], windows.run[on])
    return PlaceLine(
        where=where,
        channel=channel,
        what=what,
        size=size,
        ci95=(size - 2 * error, size + 2 * error),
        unit=f"{channel.unit}/rad" if where == "turns" else channel.unit,
        p_value=float(2.0 * stdtr(dof, -abs(size) / max(error, 1e-15))),
        n_runs=len(np.unique(windows.run[on])),
    )


def _slope(design: FloatArray, gap: FloatArray, run: IntArray) -> tuple[float, float, float]:
    """Return the second coefficient of a regression on way and what is asked (n, 2), its standard error and dof.

    Errors are clustered by run where there are enough runs. By hand: statsmodels divides the clustered squares by other
    degrees of freedom than the t that is read with them, and its import takes longer than the diagnosis' tables.
    """
    gram = np.linalg.inv(design.T @ design + 1e-12 * np.eye(2))
    beta = gram @ (design.T @ gap)
    left = gap - design @ beta
    runs, cluster = np.unique(run, return_inverse=True)
    if len(runs) >= FEWEST_CLUSTERS:
        summed = np.zeros((len(runs), 2))
        np.add.at(summed, cluster, design * left[:, None])
        dof = float(len(runs) - 2)
        middle = summed.T @ summed * (len(runs) / dof)
    else:
        dof = float(len(gap) - 2)
        middle = design.T @ design * float(left @ left) / dof
    return float(beta[1]), float(np.sqrt((gram @ middle @ gram)[1, 1])), dof
