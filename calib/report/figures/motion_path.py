"""Figures of what happens along a path: all components of the error, trajectories with error ellipses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch
from matplotlib.ticker import MaxNLocator

from calib.motion.pose_covariance import ellipses
from calib.motion.poses import COMPONENTS
from calib.motion.studies.law_path import LawPath
from calib.motion.studies.sweeps import Sweep
from calib.report.figures.motion import sweep_keys, sweep_styles
from calib.report.figures.style import BLUE, GREY, INK, ORANGE, SKY, canvas, figure_title, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: component -> what its axis says, and by what its values are multiplied
_AXES: Final = {
    "along_m": ("along the route (m)", 1.0),
    "lateral_m": ("left of the route (m)", 1.0),
    "heading_rad": ("heading (mrad)", 1e3),
    "global_x_m": ("global x (m)", 1.0),
    "global_y_m": ("global y (m)", 1.0),
}

#: how the paths of a journey under a law are drawn
_WITHOUT: Final[dict[str, Any]] = {"color": ORANGE, "linestyle": "--", "linewidth": 1.3}
_WITH: Final[dict[str, Any]] = {"color": BLUE, "linewidth": 1.3}


@styled
def sweep_errors_figure(sweep: Sweep, *, title: str) -> Figure:
    """Return the errors of all vehicles of a sweep along the route, component by component."""
    figure, axes = _grid(f"{title}; track {sweep.track_m:g} m", float(sweep.distance_m[-1]))
    for name, graph in axes.items():
        values = _AXES[name][1] * getattr(sweep.errors, name)
        for row, style in zip(values, sweep_styles(sweep), strict=True):
            graph.plot(sweep.distance_m, row, **style)
    figure.legend(handles=sweep_keys(sweep)[:-1], loc="outside lower center", ncols=8)
    return figure


@styled
def law_errors_figure(path: LawPath, *, title: str) -> Figure:
    """Return the errors of a journey under a law along the route, without the correction and with it."""
    figure, axes = _grid(title, float(path.distance_m[-1]))
    for name, graph in axes.items():
        factor = _AXES[name][1]
        half = 2.0 * factor * path.corrected.std[name]
        middle = factor * getattr(path.corrected.errors, name)
        graph.fill_between(path.distance_m, middle - half, middle + half, color=SKY, alpha=0.5, linewidth=0)
        graph.plot(path.distance_m, middle, **_WITH)
        graph.plot(path.distance_m, factor * getattr(path.without.errors, name), **_WITHOUT)
        for place in path.loading.from_m[1:].tolist():
            graph.axvline(place, color=GREY, linestyle=":", linewidth=1.0)
    keys = [
        Line2D([], [], label="radii of the reference load, kept", **_WITHOUT),
        Line2D([], [], label="radii that follow the load", **_WITH),
        Patch(facecolor=SKY, alpha=0.5, label="its 2 standard uncertainties"),
    ]
    if len(path.loading.from_m) > 1:
        keys.append(Line2D([], [], color=GREY, linestyle=":", label="the load changes"))
    figure.legend(handles=keys, loc="outside lower center", ncols=4)
    return figure


@styled
def law_path_figure(path: LawPath, *, title: str) -> Figure:
    """Return the trajectories of a journey under a law with 95 % ellipses, and the band of the lateral error."""
    figure = canvas(8.6)
    plan, graph = figure.subplots(1, 2)
    drawn_ellipses = ellipses(path.corrected.systematic + path.corrected.random)
    route = path.corrected.poses
    # so much larger that the largest axis is about an eighth of the plan
    extent = max(float(np.ptp(path.reference.x_m)), float(np.ptp(path.reference.y_m)), 1.0)
    wanted = 0.125 * extent / max(float(drawn_ellipses.major_m.max()), 1e-9)
    scale = max([1.0, *(m * 10.0**e for e in range(9) for m in (1.0, 2.0, 5.0) if m * 10.0**e <= wanted)])
    for k in np.unique(np.linspace(0, len(route) - 1, 13).astype(int))[1:]:
        plan.add_patch(
            Ellipse(
                (float(route.x_m[k]), float(route.y_m[k])),
                2 * scale * float(drawn_ellipses.major_m[k]),
                2 * scale * float(drawn_ellipses.minor_m[k]),
                angle=float(np.degrees(drawn_ellipses.angle_rad[k])),
                facecolor=SKY,
                edgecolor=BLUE,
                alpha=0.6,
            )
        )
    plan.plot(path.without.poses.x_m, path.without.poses.y_m, label="radii of the reference load, kept", **_WITHOUT)
    plan.plot(route.x_m, route.y_m, label="radii that follow the load", **(_WITH | {"linewidth": 2.6}))
    plan.plot(path.reference.x_m, path.reference.y_m, color=INK, linewidth=0.8, label="route")
    stops = np.searchsorted(path.distance_m, path.loading.from_m[1:] - 1e-9)
    if len(stops):
        plan.plot(route.x_m[stops], route.y_m[stops], "v", color=GREY, label="the load changes")
    plan.set_aspect("equal", adjustable="datalim")
    plan.set(xlabel="x (m)", ylabel="y (m)")
    drawn = f"drawn {scale:g} times as large" if scale > 1.0 else "true to scale"
    plan.set_title(f"paths and 95 % ellipses, {drawn}")
    lateral = path.corrected.std["lateral_m"]
    for factor, tint, name in (
        (2.0, SKY, "2 standard uncertainties"),
        (1.0, BLUE, "1 standard uncertainty"),
    ):
        graph.fill_between(
            path.distance_m, -factor * lateral, factor * lateral, color=tint, alpha=0.4, linewidth=0, label=name
        )
    graph.axhline(0.0, color=INK, linewidth=0.8)
    for place in path.loading.from_m[1:].tolist():
        graph.axvline(place, color=GREY, linestyle=":", linewidth=1.0)
    graph.set_xlabel("distance along the route (m)")
    graph.set_ylabel(f"error {_AXES['lateral_m'][0]}")
    graph.set_title("lateral error with radii that follow the load")
    handles, names = (a + b for a, b in zip(*(x.get_legend_handles_labels() for x in (plan, graph)), strict=True))
    figure.legend(handles, names, loc="outside lower center", ncols=3)
    figure_title(figure, title)
    return figure


def _grid(title: str, end_m: float) -> tuple[Figure, dict[str, Axes]]:
    """Return a figure with one graph for each component of the error: along the route above, global below."""
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
