"""Figures of wheel loads and of Section 7."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from calib.motion.studies.load_sweep import LoadSweep
from calib.motion.studies.sweeps import Sweep
from calib.report.figures.style import BLUE, GREY, INK, ORANGE, SKY, canvas, colour, figure_title, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from calib.motion.studies.law_journey import TableRow
    from calib.motion.studies.replay import Replay

DASHES: Final[dict[str, Any]] = {"right": "-", "left": "--", "both": ":", "equal": "-", "given": "-"}

_SWEEP_LABELS: Final = {
    "payload_kg": "payload (kg)",
    "payload_x_m": "payload ahead of the rear axle, x (m)",
    "payload_y_m": "payload left of the centre line, y (m)",
    "": "payload (kg)",
}


@styled
def load_figure(sweep: LoadSweep) -> Figure:
    """Return the wheel loads over a sweep (Fig. 3)."""
    figure = canvas(8.0, 11.0)
    axes = figure.add_subplot()
    along = getattr(sweep, sweep.swept or "payload_kg")
    for name, load, tint, dash in (
        ("left wheel", sweep.left_N, BLUE, "-"),
        ("right wheel", sweep.right_N, ORANGE, "--"),
        ("front wheel", sweep.front_N, GREY, ":"),
    ):
        axes.plot(along, load, dash, color=tint, label=name, linewidth=1.6)
    axes.set(xlabel=_SWEEP_LABELS[sweep.swept], ylabel="wheel load (N)")
    axes.set_ylim(bottom=0.0)
    axes.legend()
    return figure


def sweep_styles(sweep: Sweep) -> list[dict[str, Any]]:
    """Return how each vehicle of a sweep is drawn: colour by ratio, dashes by the wheel that is off."""
    shades = _shades(sweep)
    return [{"color": shades[c.ratio], "linestyle": DASHES[c.which], "linewidth": 1.3} for c in sweep.cases]


def sweep_keys(sweep: Sweep) -> list[Line2D]:
    """Return the entries of the legend of a sweep."""
    symbol = "E" if sweep.cases[0].which == "equal" else "E_r"
    keys = [Line2D([], [], color=shade, label=f"{symbol} = {ratio:.6g}") for ratio, shade in _shades(sweep).items()]
    wheels = {case.which: DASHES[case.which] for case in sweep.cases}
    if set(wheels) - {"equal", "given"}:
        keys += [Line2D([], [], color=GREY, linestyle=d, label=f"{w} off") for w, d in wheels.items()]
    return [*keys, Line2D([], [], color=INK, linewidth=0.8, label="route")]


def _shades(sweep: Sweep) -> dict[float, str]:
    return {ratio: colour(k) for k, ratio in enumerate(dict.fromkeys(c.ratio for c in sweep.cases))}


@styled
def sweep_figure(sweep: Sweep, *, error: str, title: str) -> Figure:
    """Return the routes driven (a) and one error along them (b), as in Figs 12 to 14 and 16.

    `error`: which error to draw: ``lateral_m``, ``global_x_m`` or ``distance_m``.
    """
    labels = {
        "lateral_m": "error to the left of the route (m)",
        "global_x_m": "error in global x (m)",
        "distance_m": "distance to the route's pose (m)",
    }
    figure = canvas(8.0)
    route, graph = figure.subplots(1, 2)
    values = getattr(sweep.errors, error)
    for number, style in enumerate(sweep_styles(sweep)):
        route.plot(sweep.poses.x_m[number], sweep.poses.y_m[number], **style)
        graph.plot(sweep.distance_m, values[number], **style)
    route.plot(sweep.reference.x_m, sweep.reference.y_m, color=INK, linewidth=0.8)
    straight = float(np.ptp(sweep.reference.y_m)) < 1e-9
    if not straight:
        route.set_aspect("equal", adjustable="box")
    route.set(xlabel="x (m)", ylabel="y (m)", title="path of the middle of the rear axle")
    graph.set(xlabel="distance along the route (m)", ylabel=labels[error], title="error")
    keys = sweep_keys(sweep)
    figure.legend(handles=keys, loc="outside lower center", ncols=9)
    figure_title(figure, f"{title}; track {sweep.track_m:g} m")
    return figure


@styled
def ratio_figure(rows: Sequence[TableRow], *, measured: tuple[tuple[float, float], tuple[float, float]]) -> Figure:
    """Return the ratio of the 95 % bands' limits to the mean radius over load, both wheels (Fig. 15).

    `rows`: the table of radii; `measured`: load ranges that the left and the right wheel were measured in.
    """
    figure = canvas(7.4)
    loads = np.array([row.load_N for row in rows])
    first: Axes | None = None
    for number, side in enumerate(("left", "right")):
        axes = figure.add_subplot(1, 2, number + 1, sharey=first)
        first = first or axes
        radius = np.array([getattr(row, f"radius_{side}_m") for row in rows])
        for band, tint in (("prediction", SKY), ("mean", BLUE)):
            half = np.array([getattr(row, f"{band}_{side}_m") for row in rows]) / radius
            name = "of a single run" if band == "prediction" else "of the mean"
            axes.fill_between(loads, 1 - half, 1 + half, color=tint, alpha=0.35, label=f"95 % band {name}")
            axes.plot(loads, np.stack([1 - half, 1 + half], axis=1), color=tint, linewidth=1.0)
        axes.axvspan(*measured[number], color=INK, alpha=0.05, label="loads measured")
        axes.set(xlabel="wheel load (N)", title=f"{side.capitalize()} wheel")
        axes.ticklabel_format(axis="y", useOffset=False)
    if first is not None:
        first.set_ylabel("radius over the law's mean radius")
        handles, names = first.get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=3)
    return figure


@styled
def replay_figure(replayed: Replay) -> Figure:
    """Return the end errors of the logged runs, by constant radii and by radii that follow the load."""
    figure = canvas(7.4)
    plan, graph = figure.subplots(1, 2)
    total = replayed.load_left_N + replayed.load_right_N
    for method, name, tint, mark in (
        ("constant", "radii of the unladen load", ORANGE, "x"),
        ("corrected", "radii of the load carried", BLUE, "o"),
    ):
        e = replayed.errors[method]
        plan.plot(e.along_m, e.lateral_m, mark, color=tint, markersize=4, label=name, fillstyle="none")
        graph.plot(total, e.distance_m, mark, color=tint, markersize=4, fillstyle="none")
    plan.set(xlabel="along (m)", ylabel="lateral (m)")
    plan.axhline(0.0, color=INK, linewidth=0.6)
    plan.axvline(0.0, color=INK, linewidth=0.6)
    plan.set_title("end error in the frame of the reference")
    graph.set_xlabel("load of both rear wheels (N)")
    graph.set_ylabel("distance to the reference (m)")
    graph.set_yscale("log")
    graph.set_title("end error by load")
    plan.legend()
    return figure
