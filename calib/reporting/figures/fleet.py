"""Figures of a fleet: how radii and slopes differ between vehicles, and which drift."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib.fleet.run import Fleet
from calib.fleet.vehicle import WHEELS, Drift, VehicleRecord
from calib.reporting.figures.style import GREY, ORANGE, axes_grid, canvas, colour, styled


@styled
def fleet_distribution(fleet: Fleet) -> Figure:
    """Draw each vehicle's radius and slope with its 95 % interval, in order of size, outliers marked."""
    fitted = [record for record in fleet.records if record.status == "fitted"]
    odd = {outlier.vehicle for outlier in fleet.view.outliers}
    figure = canvas(10.0)
    grid = axes_grid(figure, 2, 2)
    for column, side in enumerate(WHEELS):
        _ordered(grid[0, column], fitted, side, "radius_ref_m", 1e3, odd)
        grid[0, column].set(title=f"{side} wheel", ylabel="radius at reference load, mm")
        _ordered(grid[1, column], fitted, side, "slope_m_per_N", 1e9, odd)
        grid[1, column].set(ylabel="slope, nm/N", xlabel="vehicles in order of size (orange: stands apart)")
    return figure


def _ordered(axes: Axes, fitted: list[VehicleRecord], side: str, kind: str, scale: float, odd: set[str]) -> None:
    lines = [getattr(record, side) for record in fitted]
    values = scale * np.array([getattr(line, kind) for line in lines])
    ends = "radius_ci95_m" if kind == "radius_ref_m" else "slope_ci95_m_per_N"
    intervals = scale * np.array([getattr(line, ends) for line in lines])
    order = np.argsort(values)
    marked = np.array([record.vehicle in odd for record in fitted])[order]
    place = np.arange(len(order))
    axes.vlines(place, intervals[order, 0], intervals[order, 1], color=GREY, linewidth=0.6)
    axes.plot(place[~marked], values[order][~marked], ".", color=colour(0), markersize=2.5)
    axes.plot(place[marked], values[order][marked], "o", color=ORANGE, markersize=4.0)
    usual = values[order][~marked] if (~marked).any() else values
    axes.axhline(float(np.median(usual)), color=colour(0), linewidth=0.8)


def fleet_drift(fleet: Fleet) -> Figure | None:
    """Draw each wheel's drift with its 95 % interval, in order of size; None where no vehicle's journeys have days."""
    fitted = [record for record in fleet.records if record.status == "fitted"]
    lines = [(record.vehicle, side, getattr(record, side).drift) for record in fitted for side in WHEELS]
    lines = [line for line in lines if line[2] is not None]
    return _drift(lines, {(one.vehicle, one.wheel) for one in fleet.view.drifting}) if lines else None


@styled
def _drift(lines: list[tuple[str, str, Drift]], named: set[tuple[str, str]]) -> Figure:
    from scipy.special import stdtrit

    rate = np.array([1e9 * drift.per_day_m for _, _, drift in lines])
    half = np.array([1e9 * drift.std_m * float(stdtrit(drift.dof, 0.975)) for _, _, drift in lines])
    marked = np.array([(vehicle, side) in named for vehicle, side, _ in lines])
    order = np.argsort(rate)
    figure = canvas(6.0)
    axes = figure.add_subplot()
    place = np.arange(len(order))
    axes.vlines(place, (rate - half)[order], (rate + half)[order], color=GREY, linewidth=0.5)
    axes.plot(place[~marked[order]], rate[order][~marked[order]], ".", color=colour(0), markersize=2.0)
    axes.plot(place[marked[order]], rate[order][marked[order]], "o", color=ORANGE, markersize=4.0)
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.set(ylabel="drift of the radius, nm a day", xlabel="wheels in order of drift (orange: drifts)")
    return figure
