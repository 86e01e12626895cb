"""Figures of wheel loads, of Section 7, of errors along a path, and of calibrated paths."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch
from matplotlib.ticker import MaxNLocator

from calib.odometry.law_path import LawPath
from calib.odometry.poses import COMPONENTS, ellipses
from calib.odometry.replay import Replay
from calib.odometry.simulation import Sweep, TableRow
from calib.radius.law import WheelLaw
from calib.reporting.blocks import catalogue
from calib.reporting.figures.style import BLUE, GREY, INK, ORANGE, SKY, canvas, colour, figure_title, round_down, styled
from calib.vehicle import LoadSweep

DASHES: Final[dict[str, Any]] = {"right": "-", "left": "--", "both": ":", "equal": "-", "given": "-"}


@styled
def load_figure(sweep: LoadSweep) -> Figure:
    """Return the wheel loads over a sweep (Fig. 3)."""
    figure = canvas(8.0, 11.0)
    axes = figure.add_subplot()
    swept = sweep.swept or "payload_kg"
    along = getattr(sweep, swept)
    for side, tint, dash in (("left", BLUE, "-"), ("right", ORANGE, "--"), ("front", GREY, ":")):
        axes.plot(along, getattr(sweep, f"{side}_N"), dash, color=tint, label=f"{side} wheel", linewidth=1.6)
    axes.set(xlabel=catalogue()["sweep"][swept], ylabel="wheel load (N)")
    axes.set_ylim(bottom=0.0)
    axes.legend()
    return figure


def _sweep_styles(sweep: Sweep) -> list[Any]:
    shades = _shades(sweep)
    return [{"color": shades[c.ratio], "linestyle": DASHES[c.which], "linewidth": 1.3} for c in sweep.cases]


def _sweep_keys(sweep: Sweep) -> list[Line2D]:
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
    """Return the routes driven (a) and one error along them (b), as in Figs 12 to 14 and 16."""
    figure = canvas(8.0)
    route, graph = figure.subplots(1, 2)
    values = getattr(sweep.errors, error)
    for number, style in enumerate(_sweep_styles(sweep)):
        route.plot(sweep.poses.x_m[number], sweep.poses.y_m[number], **style)
        graph.plot(sweep.distance_m, values[number], **style)
    route.plot(sweep.reference.x_m, sweep.reference.y_m, color=INK, linewidth=0.8)
    if np.ptp(sweep.reference.y_m) >= 1e-9:
        route.set_aspect("equal", adjustable="box")
    route.set(xlabel="x (m)", ylabel="y (m)", title="path of the middle of the rear axle")
    graph.set(xlabel="distance along the route (m)", ylabel=_AXES[error][0], title="error")
    figure.legend(handles=_sweep_keys(sweep), loc="outside lower center", ncols=6)
    figure_title(figure, f"{title}; track {sweep.track_m:g} m")
    return figure


@styled
def ratio_figure(rows: Sequence[TableRow], left: WheelLaw, right: WheelLaw) -> Figure:
    """Return the 95 % bands' limits over the mean radius, by load (Fig. 15)."""
    figure = canvas(7.4)
    loads = np.array([row.load_N for row in rows])
    first, second = figure.subplots(1, 2, sharey=True)
    for axes, side, law in ((first, "left", left), (second, "right", right)):
        radius = np.array([getattr(row, f"radius_{side}_m") for row in rows])
        for band, tint in (("prediction", SKY), ("mean", BLUE)):
            half = np.array([getattr(row, f"{band}_{side}_m") for row in rows]) / radius
            if not np.isfinite(half).any():
                continue
            name = "of a single run" if band == "prediction" else "of the mean"
            axes.fill_between(loads, 1 - half, 1 + half, color=tint, alpha=0.35, label=f"95 % band {name}")
            axes.plot(loads, np.stack([1 - half, 1 + half], axis=1), color=tint, linewidth=1.0)
        axes.axvspan(law.load_min_N, law.load_max_N, color=INK, alpha=0.05, label="valid loads")
        axes.set(xlabel="wheel load (N)", title=f"{side.capitalize()} wheel")
        axes.tick_params(labelleft=True)
    first.set_ylabel("radius over the law's mean radius")
    figure.legend(*first.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


@styled
def replay_figure(replayed: Replay) -> Figure:
    """Return the end errors of logged runs, by constant radii and by ones that follow the load."""
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
    plan.set(xlabel="along (m)", ylabel="lateral (m)", title="end error in the frame of the reference")
    plan.axhline(0.0, color=INK, linewidth=0.6)
    plan.axvline(0.0, color=INK, linewidth=0.6)
    graph.set(xlabel="load of both rear wheels (N)", ylabel="distance to the reference (m)", title="end error by load")
    graph.set_yscale("log")
    graph.yaxis.set_major_formatter("{x:g}")
    graph.yaxis.set_minor_formatter("")
    plan.legend()
    return figure


#: component -> its axis's title and factor
_AXES: Final = {
    "along_m": ("along the route (m)", 1.0),
    "lateral_m": ("left of the route (m)", 1.0),
    "heading_rad": ("heading (mrad)", 1e3),
    "global_x_m": ("global x (m)", 1.0),
    "global_y_m": ("global y (m)", 1.0),
    "distance_m": ("distance to the route's pose (m)", 1.0),
}

#: how the paths of a journey under a law are drawn
_WITHOUT: Final[Any] = {"color": ORANGE, "ls": "--", "lw": 1.3, "label": "radii of the reference load, kept"}
_WITH: Final[Any] = {"color": BLUE, "ls": "-", "lw": 1.3, "label": "radii that follow the load"}


@styled
def sweep_errors_figure(sweep: Sweep, *, title: str) -> Figure:
    """Return the errors of a sweep along the route, by component."""
    figure, axes = _grid(f"{title}; track {sweep.track_m:g} m", float(sweep.distance_m[-1]))
    for name, graph in axes.items():
        for row, style in zip(_AXES[name][1] * getattr(sweep.errors, name), _sweep_styles(sweep), strict=True):
            graph.plot(sweep.distance_m, row, **style)
    figure.legend(handles=_sweep_keys(sweep)[:-1], loc="outside lower center", ncols=6)
    return figure


@styled
def law_errors_figure(path: LawPath, *, title: str) -> Figure:
    """Return the errors of a journey under a law along the route."""
    figure, axes = _grid(title, float(path.distance_m[-1]))
    for name, graph in axes.items():
        factor = _AXES[name][1]
        half = 2.0 * factor * path.corrected.std[name]
        middle = factor * getattr(path.corrected.errors, name)
        graph.fill_between(path.distance_m, middle - half, middle + half, color=SKY, alpha=0.5, linewidth=0)
        graph.plot(path.distance_m, middle, **_WITH)
        graph.plot(path.distance_m, factor * getattr(path.without.errors, name), **_WITHOUT)
        _mark_changes(graph, path)
    keys: list[Any] = [Line2D([], [], **look) for look in (_WITHOUT, _WITH)]
    keys.append(Patch(facecolor=SKY, alpha=0.5, label="its 2 standard uncertainties"))
    if len(path.loading.from_m) > 1:
        keys.append(Line2D([], [], color=GREY, linestyle=":", label="the load changes"))
    figure.legend(handles=keys, loc="outside lower center", ncols=4)
    return figure


def _mark_changes(graph: Axes, path: LawPath) -> None:
    for place in path.loading.from_m[1:].tolist():
        graph.axvline(place, color=GREY, linestyle=":", linewidth=1.0)


@styled
def law_path_figure(path: LawPath, *, title: str) -> Figure:
    """Return the paths of a journey under a law with 95 % ellipses, and the band of the lateral error."""
    figure = canvas(8.6)
    plan, graph = figure.subplots(1, 2)
    drawn_ellipses = ellipses(path.corrected.systematic + path.corrected.random)
    route = path.corrected.poses
    extent = max(float(np.ptp(path.reference.x_m)), float(np.ptp(path.reference.y_m)), 1.0)
    scale = round_down(0.125 * extent / max(float(drawn_ellipses.major_m.max()), 1e-9))
    for k in np.unique(np.linspace(0, len(route) - 1, 13).astype(int))[1:]:
        size = 2 * scale * drawn_ellipses.major_m[k], 2 * scale * drawn_ellipses.minor_m[k]
        angle = float(np.degrees(drawn_ellipses.angle_rad[k]))
        place = (route.x_m[k], route.y_m[k])
        plan.add_patch(Ellipse(place, *size, angle=angle, facecolor=SKY, edgecolor=BLUE, alpha=0.6))
    plan.plot(path.without.poses.x_m, path.without.poses.y_m, **_WITHOUT)
    plan.plot(route.x_m, route.y_m, **_WITH | {"lw": 2.6})
    plan.plot(path.reference.x_m, path.reference.y_m, color=INK, linewidth=0.8, label="route")
    stops = np.searchsorted(path.distance_m, path.loading.from_m[1:] - 1e-9)
    if len(stops):
        plan.plot(route.x_m[stops], route.y_m[stops], "v", color=GREY, label="the load changes")
    plan.set_aspect("equal", adjustable="datalim")
    drawn = f"drawn {scale:g} times as large" if scale > 1.0 else "true to scale"
    plan.set(xlabel="x (m)", ylabel="y (m)", title=f"paths and 95 % ellipses, {drawn}")
    for factor, tint, name in ((2.0, SKY, "2 standard uncertainties"), (1.0, BLUE, "1 standard uncertainty")):
        half = factor * path.corrected.std["lateral_m"]
        graph.fill_between(path.distance_m, -half, half, color=tint, alpha=0.4, linewidth=0, label=name)
    graph.axhline(0.0, color=INK, linewidth=0.8)
    _mark_changes(graph, path)
    graph.set(xlabel="distance along the route (m)", ylabel=f"error {_AXES['lateral_m'][0]}")
    graph.set_title("lateral error with radii that follow the load")
    handles, names = (a + b for a, b in zip(*(x.get_legend_handles_labels() for x in (plan, graph)), strict=True))
    figure.legend(handles, names, loc="outside lower center", ncols=3)
    figure_title(figure, title)
    return figure


def _grid(title: str, end_m: float) -> tuple[Figure, dict[str, Axes]]:
    figure = canvas(10.0)
    cells = figure.subplots(2, 3, sharex=True)
    axes: dict[str, Axes] = dict(zip(COMPONENTS, cells.ravel(), strict=False))
    cells[1, 2].set_axis_off()
    cells[0, 0].set_xlim(0.0, end_m)
    cells[0, 0].xaxis.set_major_locator(MaxNLocator(nbins=6, steps=[1, 2, 5, 10]))
    for number, (name, graph) in enumerate(axes.items()):
        graph.set_title(f"error: {_AXES[name][0]}")
        graph.axhline(0.0, color=INK, linewidth=0.6)
        if number >= 2:
            graph.set_xlabel("distance along the route (m)")
            graph.tick_params(labelbottom=True)
    figure_title(figure, title)
    return figure, axes
