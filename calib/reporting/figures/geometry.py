"""Figures of a geometry and of effects.

Paths coloured by error, residuals in time, how parameters correlate; the signature of an effect, and the matrix of the
effects that a plan of runs can tell apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize
from matplotlib.figure import Figure

from calib.kinematics.result import RunTrace
from calib.reporting.figures import style
from calib.reporting.figures.style import BLUE, GREY, INK, MANY, axes_grid, canvas, colour, shared_legend, styled
from calib.types import FloatArray, StrArray, evenly

if TYPE_CHECKING:
    from calib.gap.effects.library import EffectSignature
    from calib.gap.plan.identifiability import Outlook
    from calib.gap.predict import Path

COLUMNS: Final = 3
#: two rows of panels and six rows of residuals fill a page
PANEL_CM: Final = 4.8
LONE_PANEL_CM: Final = 8.5
#: paths drawn a panel; more of one kind lie on one another
MOST_PATHS: Final = 12
#: runs with residuals in time drawn in a figure; more say the same
MOST_RUNS: Final = 6
#: points of a line: the width of a panel in half a point
MOST_POINTS: Final = 200
#: signs of a run's name beside its row of residuals
NAME_LENGTH: Final = 10
#: share of the errors that the colours span: a single failed measurement does not bleach the others
SPANNED: Final = 98.0
#: channels of a residual: title, unit, factor
CHANNELS: Final = (("along", "mm", 1e3), ("lateral", "mm", 1e3), ("heading", "mrad", 1e3))


@styled
def draw_paths(traces: Sequence[RunTrace], *, simulated: bool = False) -> Figure:
    """Draw the sensor's paths by kind of route: nominal, calibrated, coloured by its error, and the reference."""
    traces = [_thinned(trace) for trace in traces]
    kinds = list(dict.fromkeys(trace.kind for trace in traces))
    rows = -(-len(kinds) // COLUMNS)
    figure = canvas((PANEL_CM if len(kinds) > 1 else LONE_PANEL_CM) * rows + 1.2)
    grid = axes_grid(figure, rows, min(COLUMNS, len(kinds))).ravel()
    known = np.concatenate([np.zeros(0), *(_error_mm(trace) for trace in traces)])
    known = known[np.isfinite(known)]
    scale = Normalize(0.0, float(np.percentile(known, SPANNED)) if len(known) else 1.0)
    handles: dict[str, Artist] = {}
    colours = None
    # beyond that many pieces as pixels inside a vector figure
    pixels = sum(len(trace.seen) for trace in traces) > MANY
    for axes, kind in zip(grid, kinds, strict=False):
        chosen = [trace for trace in traces if trace.kind == kind]
        for trace in chosen[:MOST_PATHS]:
            (handles["odometry before"],) = axes.plot(*trace.before_m.T, color=GREY, lw=0.7, alpha=0.7)
            colours = _coloured(axes, trace, scale, pixels=pixels) or colours
            (handles["reference"],) = axes.plot(*trace.reference_m.T, color=INK, lw=0.6, ls=":")
            axes.plot(*trace.reference_m[-1:].T, "o", color=INK, ms=2.5)
        axes.set_title(f"{kind or 'all runs'} ({len(chosen)})")
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(xlabel="x (m)", ylabel="y (m)")
        axes.autoscale_view()
    for axes in grid[len(kinds) :]:
        axes.set_axis_off()
    if colours is not None:
        figure.colorbar(colours, ax=list(grid), label="odometry after: distance from the reference (mm)", shrink=0.8)
    shared_legend(figure, list(handles.values()), list(handles))
    if simulated:
        figure.text(0.99, 0.01, "SIMULATED DATA", ha="right", color=GREY)
    return figure


def _thinned(trace: RunTrace) -> RunTrace:
    """Return a trace of at most `MOST_POINTS` poses and samples: more are not seen, and make the page heavy."""
    poses = evenly(len(trace.seen), MOST_POINTS)
    names = ("seen", "t_s", "reference_m", "residual_before", "residual_after")
    kept = {name: getattr(trace, name)[poses] for name in names}
    return replace(trace, before_m=trace.before_m[evenly(len(trace.before_m), MOST_POINTS)], **kept)


def _error_mm(trace: RunTrace) -> FloatArray:
    return np.asarray(1e3 * np.hypot(*trace.residual_after[:, :2].T))


def _coloured(axes: Axes, trace: RunTrace, scale: Normalize, *, pixels: bool) -> LineCollection | None:
    """Draw the calibrated path in the colours of its error; in one colour where only its end was measured."""
    error_mm = np.nan_to_num(_error_mm(trace))
    if len(trace.seen) < 2:
        axes.plot(*trace.after_m.T, color=BLUE, lw=1.0)
        x, y = trace.after_m[-1:].T
        axes.scatter(x, y, c=error_mm, norm=scale, cmap="viridis", s=14, zorder=3)
        return None
    points = trace.after_m[trace.seen]
    pieces = np.stack([points[:-1], points[1:]], axis=1)
    lines = LineCollection(list(pieces), norm=scale, cmap="viridis", linewidths=1.4, rasterized=pixels)
    lines.set_array(0.5 * (error_mm[1:] + error_mm[:-1]))
    axes.add_collection(lines)
    return lines


@styled
def residuals_in_time(traces: Sequence[RunTrace]) -> Figure:
    """Draw the residuals of each run along its path, before (grey) and after: a row a run, a column a channel."""
    chosen = [_thinned(trace) for trace in traces if len(trace.seen) > 1][:MOST_RUNS]
    figure = canvas(1.45 * len(chosen) + 1.6)
    grid = axes_grid(figure, len(chosen), 3, sharex=True, sharey="col")
    limits = _limits(chosen)
    for place, (row, trace) in enumerate(zip(grid, chosen, strict=True)):
        for number, (axes, (title, unit, factor)) in enumerate(zip(row, CHANNELS, strict=True)):
            axes.plot(trace.t_s, factor * trace.residual_before[:, number], color=GREY, lw=0.6)
            axes.plot(trace.t_s, factor * trace.residual_after[:, number], color=BLUE, lw=0.8)
            axes.set_ylim(-limits[number], limits[number])
            if place == 0:
                axes.set_title(f"{title} ({unit})")
            if place == len(chosen) - 1:
                axes.set_xlabel("time (s)")
        name = trace.run_id
        row[0].set_ylabel(name if len(name) <= NAME_LENGTH else f"…{name[1 - NAME_LENGTH :]}", fontsize=6)
    handles = [grid[0, 0].lines[1], grid[0, 0].lines[0]]
    shared_legend(figure, handles, ["after", "before, cut off where it is larger"])
    return figure


def _limits(traces: Sequence[RunTrace]) -> list[float]:
    left = np.concatenate([np.abs(trace.residual_after) for trace in traces])
    limits = []
    for values, (_, _, factor) in zip(left.T, CHANNELS, strict=True):
        known = values[np.isfinite(values)]
        limits.append(1.3 * factor * float(np.percentile(known, 99.5)) if len(known) and known.any() else 1.0)
    return limits


@styled
def residuals_by_run(traces: Sequence[RunTrace]) -> Figure:
    """Draw the residuals at the end of each run in the order driven, before above and after below, by kind of route."""
    figure = canvas(9.0)
    grid = axes_grid(figure, 2, 3, sharex=True)
    kinds = style.Groups.of(np.array([trace.kind for trace in traces]), "all runs")
    order = np.arange(1.0, len(traces) + 1)
    for row, word, values in (
        (grid[0], "before", [trace.residual_before[-1] for trace in traces]),
        (grid[1], "after", [trace.residual_after[-1] for trace in traces]),
    ):
        for axes, column, (title, unit, factor) in zip(row, np.transpose(values), CHANNELS, strict=True):
            kinds.draw(axes, order, factor * column, marker="o", ms=2.8)
            axes.axhline(0.0, color=INK, lw=0.5)
            axes.set_title(f"{word}: {title} ({unit})")
    for axes in grid[1]:
        style.over_runs(axes)
    shared_legend(figure, *grid[0, 0].get_legend_handles_labels())
    return figure


@styled
def correlations(names: Sequence[str], covariance: FloatArray) -> Figure:
    """Draw the correlation of every two parameters, its number in the cell."""
    std = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(std, std)
    size = len(names)
    figure = canvas(min(0.58 * size + 2.4, 8.6), 12.5)
    axes = figure.subplots()
    axes.imshow(np.abs(correlation), cmap="Blues", vmin=0.0, vmax=1.6)
    for (row, column), value in np.ndenumerate(correlation):
        weight = "bold" if row != column and abs(value) > 0.9 else "normal"
        text = f"{value:.2f}".replace("-", "\u2212")
        axes.text(column, row, text, ha="center", va="center", color=INK, fontsize=6.0, fontweight=weight)
    axes.set_xticks(range(size), names, rotation=45, ha="right")
    axes.set_yticks(range(size), names)
    axes.grid(visible=False)
    return figure


SIGNED = ("distance", "along", "lateral", "heading", "front", "steering")
ANGLES = frozenset({"heading", "steering"})
#: a channel that changes by less (m or rad) counts as unchanged: no instrument resolves a micrometre
UNCHANGED = 1e-6


@styled
def signature_figure(signature: EffectSignature, nominal: Path) -> Figure:
    """Draw a signature beside the model alone on the same runs (`nominal`).

    Left the floor plan, one run of each kind, without the effect in grey and with it, enlarged, in colour; right the
    change of each channel at the typical size, a dot a run.
    """
    kinds = nominal.s.labels["kind"]
    names = list(np.unique(kinds))
    moved = np.flatnonzero(np.abs(np.nan_to_num(signature.change)).max(axis=0) > UNCHANGED).tolist()
    figure = canvas(6.4)
    plan, channels = figure.subfigures(1, 2, width_ratios=(1.0, 1.25), squeeze=False)[0]
    _draw_plan(plan.subplots(), signature, nominal, names)
    panels = channels.subplots(max(len(moved), 1), 1, sharex=True, squeeze=False)[:, 0]
    for axes, channel in zip(panels, moved, strict=False):
        _draw_channel(axes, signature.change[:, channel], SIGNED[channel], kinds, names)
    panels[0].set_title("change at its typical size, channels that move")
    panels[-1].set_xticks(range(len(names)), names, rotation=20, ha="right")
    return figure


def _draw_plan(axes: Axes, signature: EffectSignature, nominal: Path, names: list[str]) -> None:
    s, enlarged = nominal.s, signature.enlarged
    for number, name in enumerate(names):
        units = np.flatnonzero(s.labels["kind"] == name)
        unit = int(units[np.argmax(np.nansum(signature.change[units] ** 2, axis=1))])
        part, tint = slice(int(s.starts[unit]), int(s.starts[unit + 1])), colour(number)
        axes.plot(nominal.steps.x_m[part], nominal.steps.y_m[part], color=GREY, linewidth=0.8)
        axes.plot(enlarged.steps.x_m[part], enlarged.steps.y_m[part], color=tint, linewidth=1.1, label=name)
        axes.plot(*enlarged.end[unit, :2], marker="o", markersize=3, color=tint)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x, m", ylabel="y, m")
    bent = signature.factor > 1.0 and bool(np.ptp(enlarged.end[:, :2] - nominal.end[:, :2]) > 0)
    axes.set_title(f"paths, effect x {signature.factor:.3g}" if bent else "paths (the effect bends none)")


def _draw_channel(axes: Axes, change: FloatArray, name: str, kinds: StrArray, names: list[str]) -> None:
    for number, kind in enumerate(names):
        values = 1e3 * change[kinds == kind]
        spread = number + np.linspace(-0.25, 0.25, len(values))
        axes.plot(spread, values, ".", markersize=2.5, color=colour(number))
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    axes.margins(y=0.2)
    axes.set_ylabel(f"{name}\n{'mrad' if name in ANGLES else 'mm'}", rotation=0, ha="right", va="center")
    axes.set_xlim(-0.5, len(names) - 0.5)


#: bounds of the classes in standard deviations; below 3 two effects cannot be told apart
BOUNDS: Final = (0.0, 1.0, 3.0, 5.0, 10.0, 1e12)
SHADES: Final = ("#B2482C", "#E39A72", "#F1E3C8", "#8FBBD3", "#2F78A8")


@styled
def plan_matrix(outlook: Outlook) -> Figure:
    """Draw the matrix: row, the effect at work at its typical size; column, the effect that might be named instead.

    The first column says how well the effect is detected at all.
    """
    n = len(outlook.effects)
    figure = canvas(float(np.clip(5.0 + 0.36 * n, 8.0, 21.0)))
    axis = figure.add_subplot()
    distance = np.column_stack((outlook.signal, np.where(np.isfinite(outlook.distance), outlook.distance, np.nan)))
    shown = np.ma.masked_invalid(distance)
    colours = ListedColormap(list(SHADES)).with_extremes(bad="white")
    image = axis.imshow(shown, cmap=colours, norm=BoundaryNorm(list(BOUNDS), colours.N), aspect="auto")
    names = [name.replace("_", " ") for name in outlook.effects]
    axis.set_xticks(range(n + 1), ["(detected)", *names], rotation=90)
    told = outlook.told_apart
    rows = [f"{name}  {'told apart' if yes else '–'}" for name, yes in zip(names, told, strict=True)]
    axis.set_yticks(range(n), rows)
    axis.tick_params(length=0, labelsize=5.5)
    axis.set_xticks(np.arange(-0.5, n + 1), minor=True)
    axis.set_yticks(np.arange(-0.5, n), minor=True)
    axis.grid(visible=False, which="major")
    axis.grid(which="minor", color="white", lw=0.5)
    axis.tick_params(which="minor", length=0)
    axis.axvline(0.5, color=INK, lw=0.8)
    axis.set_title(f"{int(told.sum())} of {n + len(outlook.absent)} effects can be told apart at their typical size")
    axis.set_ylabel("effect at work")
    axis.set_xlabel("effect that might be named instead")
    bar = figure.colorbar(image, ax=axis, spacing="uniform", shrink=0.5, pad=0.01)
    bar.set_ticks([0.5, 2.0, 4.0, 7.5, 5e11], labels=["below 1", "1 to 3", "3 to 5", "5 to 10", "above 10"])
    bar.ax.tick_params(which="both", length=0)
    bar.set_label("distance (standard deviations)")
    return figure
