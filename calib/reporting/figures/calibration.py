"""The figures of radius laws and geometries."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from calib.radius import Groups
from calib.radius.effective import Component, EffectiveRadii
from calib.radius.path_length import whole_period_excess
from calib.radius.regression import WheelFit
from calib.reporting import figures as style
from calib.reporting.figures import BLUE, GREY, INK, LEGEND_LIMIT, MANY, ORANGE, canvas, styled
from calib.types import FloatArray, StrArray, evenly

if TYPE_CHECKING:
    from calib.kinematics.result import RunTrace

MM: Final = 1e3
UM: Final = 1e6
PPM: Final = 1e6
WHEELS: Final = ("left", "right")
LEAST_EXCESS_PPM: Final = 1e-4
NO_SESSION: Final = "(no session)"
#: light to dark, told apart in print and by colour-blind readers
LOAD_COLOURS: Final = "viridis_r"
#: relative to the largest load
LOADS_ALIKE: Final = 0.05


@styled
def runs_by_series(radii: EffectiveRadii) -> Figure:
    """Draw each wheel's radius in the order driven (Fig. 10), coloured by load where it varies, else by session."""
    figure = canvas(8.0)
    axes = figure.subplots(2, 1, sharex=True, sharey=True)
    order = np.arange(1.0, len(radii) + 1)
    sessions = style.named_groups(radii.session, NO_SESSION)
    loads = np.stack((radii.load_left_N, radii.load_right_N))
    sides = zip((radii.radius_left_m, radii.radius_right_m), (radii.std_left_m, radii.std_right_m), loads, strict=True)
    span = Normalize(float(loads.min()), float(loads.max())) if varies(loads) else None
    scale = mpl.colormaps[LOAD_COLOURS].resampled(32)
    for axis, wheel, (radius, std, load) in zip(axes, WHEELS, sides, strict=True):
        if len(order) <= MANY:
            axis.errorbar(order, MM * radius, yerr=2 * MM * np.nan_to_num(std), fmt="none", ecolor=GREY, elinewidth=0.6)
        if span is None:
            style.draw_groups(axis, sessions, order, MM * radius, ms=3.6)
        else:
            axis.scatter(order, MM * radius, c=load, norm=span, cmap=scale, s=9, lw=0, zorder=3)
            _mark_sessions(axis, sessions)
        axis.set(title=f"{wheel.capitalize()} wheel", ylabel="effective radius (mm)")
        axis.margins(x=0.015, y=0.08)
    style.over_runs(axes[-1])
    if span is None:
        style.group_legend(figure, axes[0], sessions.names)
    else:
        figure.colorbar(ScalarMappable(span, scale), ax=axes, pad=0.01, aspect=40, label="wheel load (N)")
    return figure


def varies(load: FloatArray) -> bool:
    """Return whether loads differ by more than 5 % of the largest."""
    return bool(np.ptp(load) > LOADS_ALIKE * np.abs(load).max())


def _mark_sessions(axis: Any, sessions: Groups) -> None:
    names = sessions.names
    changes = np.flatnonzero(np.diff(sessions.index)) + 1
    if len(changes) > len(names) + LEGEND_LIMIT:  # sessions that alternate
        return
    for change in changes:
        axis.axvline(change + 0.5, color=GREY, lw=0.5, ls=(0, (4, 3)))
    for first in np.concatenate(([0], changes)) if 1 < len(names) <= LEGEND_LIMIT else ():
        axis.annotate(
            names[sessions.index[first]], (first + 0.7, 1.0), xycoords=("data", "axes fraction"), xytext=(1, -1),
            textcoords="offset points", fontsize=6, color="#555555", va="top",
        )  # fmt: skip


@styled
def regressions(left: WheelFit, right: WheelFit, session: StrArray) -> Figure:
    """Draw radius against load with law, mean band and prediction band (Fig. 11), below as deviation from the law."""
    figure = canvas(10.0)
    axes = figure.subplots(2, 2, sharex="col", sharey="row", height_ratios=(1.15, 1.0))
    sessions = style.named_groups(session, NO_SESSION)
    for column, fit in enumerate((left, right)):
        law = fit.law
        span = max(law.load_max_N - law.load_min_N, 0.04 * abs(law.load_max_N), 1.0)
        load = np.linspace(law.load_min_N - 0.04 * span, law.load_max_N + 0.04 * span, 161)
        centre = law.radius_m(load)
        upper, lower = axes[0, column], axes[1, column]
        for axis, scale, zero in ((upper, MM, np.zeros_like(load)), (lower, UM, centre)):
            for label, alpha, single_run in (("prediction band", 0.13, True), ("band of the mean", 0.38, False)):
                low, high = (scale * (end - zero) for end in fit.band_m(load, single_run=single_run))
                axis.fill_between(load, low, high, color=BLUE, alpha=alpha, lw=0, label=label)
            axis.plot(load, scale * (centre - zero), color=style.INK, lw=1.0, label="law")
            axis.tick_params(labelleft=True)
        style.draw_groups(upper, sessions, fit.load_N, MM * fit.radius_m, ms=3.2)
        style.draw_groups(lower, sessions, fit.load_N, UM * fit.residual_m, ms=3.2)
        upper.set_title(f"{fit.wheel.capitalize()} wheel")
        lower.set_xlabel("wheel load (N)")
        upper.margins(x=0)
    axes[0, 0].set_ylabel("effective radius (mm)")
    axes[1, 0].set_ylabel("radius minus law (µm)")
    prediction, mean, line, *runs = zip(*axes[0, 0].get_legend_handles_labels(), strict=True)
    entries = [line, mean, prediction, *(runs if 1 < len(sessions.names) <= LEGEND_LIMIT else ())]
    style.shared_legend(figure, [handle for handle, _ in entries], [label for _, label in entries])
    return figure


@styled
def path_deviation(radii: EffectiveRadii) -> Figure:
    """Draw the weave's excess by amplitude and wavelength (Fig. 9), and each run's correction."""
    figure = canvas(7.6)
    chart, strip = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    known = (radii.amplitude_m > 0) & (radii.wavelength_m > 0)
    amplitude, wavelength = radii.amplitude_m[known], radii.wavelength_m[known]
    low, high = 1e-3, 1.0
    if len(amplitude):
        low, high = min(low, 0.5 * float(amplitude.min())), max(high, 2 * float(amplitude.max()))
    grid = np.geomspace(low, high, 121)
    for number, value in enumerate((2.5, 5.0, 10.0, 20.0, 40.0)):
        shade = str(0.25 + 0.11 * number)
        excess = PPM * whole_period_excess(grid, value)
        chart.plot(grid, excess, color=shade, lw=0.9)
        chart.annotate(
            f"λ = {value:g} m", (grid[-1], float(excess[-1])), xytext=(3, 3 * (2 - number)),
            textcoords="offset points", fontsize=6,
            va="center", color=shade, annotation_clip=False,
        )  # fmt: skip
    if len(amplitude):
        excess = np.maximum(PPM * whole_period_excess(amplitude, wavelength), LEAST_EXCESS_PPM)
        chart.plot(amplitude, excess, ".", ms=4, color=ORANGE, label="runs", rasterized=len(amplitude) > MANY)
        chart.legend(loc="upper left")
    chart.set(xscale="log", yscale="log", xlabel="amplitude A (mm)", ylabel="excess of the path (ppm)")
    chart.set_title("Weave of amplitude A and wavelength λ")
    chart.set_xlim(low, high)
    chart.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{1e3 * value:g}"))
    for axis in (chart.xaxis, chart.yaxis):
        axis.set_minor_formatter(NullFormatter())
    chart.set_ylim(bottom=max(chart.get_ylim()[0], 0.5 * LEAST_EXCESS_PPM))
    bottom, top = np.log10(chart.get_ylim())
    decades = np.arange(int(np.ceil(bottom)), int(np.floor(top)) + 1, 2)
    chart.set_yticks(10.0**decades, [f"{10.0**k:,.{max(-int(k), 0)}f}" for k in decades])

    order = np.arange(1, len(radii) + 1)
    for wheel, part, tint, mark in (("left", radii.path_left, BLUE, "o"), ("right", radii.path_right, ORANGE, "s")):
        strip.plot(
            order, PPM * part, mark, ms=2.4, mew=0, color=tint, label=f"{wheel} wheel", rasterized=len(order) > MANY
        )
    strip.axhline(0.0, color=GREY, lw=0.6)
    strip.set(ylabel="correction of the radius (ppm)", title="What each run's path added")
    style.over_runs(strip)
    strip.margins(y=0.18)
    strip.legend(loc="upper right", ncols=2, handletextpad=0.2, columnspacing=1.0)
    return figure


@styled
def residuals(left: WheelFit, right: WheelFit, session: StrArray) -> Figure:
    """Draw the residuals of both wheels against load, in the order driven, and against normal quantiles."""
    from scipy.special import ndtri
    from scipy.stats import rankdata

    figure = canvas(8.0)
    axes = figure.subplots(2, 3, sharey=True)
    sessions = style.named_groups(session, NO_SESSION)
    for row, fit in enumerate((left, right)):
        residual_um = UM * fit.residual_m
        # Blom's plotting positions
        quantile = ndtri((rankdata(residual_um, method="ordinal") - 0.375) / (len(residual_um) + 0.25))
        for column, x in enumerate((fit.load_N, np.arange(1.0, len(residual_um) + 1), quantile)):
            axis = axes[row, column]
            axis.axhline(0.0, color=GREY, lw=0.6)
            style.draw_groups(axis, sessions, x, residual_um, ms=3)
            axis.tick_params(labelleft=column == 0)
            axis.margins(x=0.05, y=0.08)
        style.over_runs(axes[row, 1], "")
        reach = np.array([quantile.min(), quantile.max()])
        axes[row, 2].plot(reach, residual_um.mean() + residual_um.std(ddof=1) * reach, color=style.INK, lw=0.8)
        axes[row, 0].set(ylabel="radius minus law (µm)", title=f"{fit.wheel.capitalize()} wheel, against load")
        axes[row, 1].set_title("in the order driven")
        axes[row, 2].set_title("against a normal distribution")
    for axis, text in zip(axes[1], ("wheel load (N)", "run", "normal quantile"), strict=True):
        axis.set_xlabel(text)
    return figure


@styled
def budget_bars(budget: Sequence[Component]) -> Figure:
    """Draw the budget of a single radius, left and right, with the total."""
    names = [style.legible(part.name.replace("_", " ")) for part in budget] + ["combined"]
    sides = [[1e6 * part.std_left_m for part in budget], [1e6 * part.std_right_m for part in budget]]
    figure = canvas(2.2 + 0.62 * len(names))
    axis = figure.add_subplot()
    place = np.arange(len(names), dtype=np.float64)
    for wheel, values, tint, shift in zip(WHEELS, sides, (BLUE, ORANGE), (-0.18, 0.18), strict=True):
        combined = float(np.sqrt(np.sum(np.square(values))))
        axis.barh(place + shift, [*values, combined], height=0.34, color=tint, lw=0, label=f"{wheel} wheel")
    axis.axhline(len(budget) - 0.5, color=GREY, lw=0.6)
    axis.set_yticks(place, names)
    axis.invert_yaxis()
    axis.grid(visible=False, axis="y")
    axis.set_xlabel("contribution to the standard uncertainty of one radius (µm, k = 1)")
    axis.margins(y=0.02)
    style.shared_legend(figure, *axis.get_legend_handles_labels())
    return figure


COLUMNS: Final = 3
PANEL_CM: Final = 4.8
LONE_PANEL_CM: Final = 8.5
MOST_PATHS: Final = 12
MOST_RUNS: Final = 6
#: of a line: a panel's width in half points
MOST_POINTS: Final = 200
NAME_LENGTH: Final = 10
#: parameters whose correlations have room for a zero before the point
MOST_WITH_ZERO: Final = 6
#: percentile of the errors that colours span
SPANNED: Final = 98.0
#: channels of a residual: title, unit, factor
CHANNELS: Final = (("along", "mm", 1e3), ("lateral", "mm", 1e3), ("heading", "mrad", 1e3))


@styled
def draw_paths(traces: "Sequence[RunTrace]") -> Figure:
    """Draw paths by kind of route: nominal, calibrated, coloured by error, and reference."""
    traces = [_thinned(trace) for trace in traces]
    kinds = list(dict.fromkeys(trace.kind for trace in traces))
    rows = -(-len(kinds) // COLUMNS)
    figure = canvas((PANEL_CM if len(kinds) > 1 else LONE_PANEL_CM) * rows + 1.2)
    grid = figure.subplots(rows, min(COLUMNS, len(kinds)), squeeze=False).ravel()
    known = np.concatenate([np.zeros(0), *(_error_mm(trace) for trace in traces)])
    known = known[np.isfinite(known)]
    scale = Normalize(0.0, float(np.percentile(known, SPANNED)) if len(known) else 1.0)
    handles: dict[str, Artist] = {}
    colours = None
    pixels = sum(len(trace.seen) for trace in traces) > MANY
    for axes, kind in zip(grid, kinds, strict=False):
        chosen = [trace for trace in traces if trace.kind == kind]
        for trace in chosen[:MOST_PATHS]:
            (handles["odometry before"],) = axes.plot(*trace.before_m.T, color=GREY, lw=0.7, alpha=0.7)
            colours = _coloured(axes, trace, scale, pixels=pixels)
            handles |= {line.get_label(): line for line in axes.lines[-1:] if len(trace.seen) < 2}
            end = {"marker": "o", "markevery": [-1], "ms": 1.2, "zorder": 4}
            dots = ":" if len(trace.seen) > 1 else "none"
            (handles["reference"],) = axes.plot(*trace.reference_m.T, color=INK, lw=0.6, ls=dots, **end)
        share = f"{MOST_PATHS} of " if len(chosen) > MOST_PATHS else ""
        axes.set_title(f"{kind or 'all runs'} ({share}{len(chosen)})")
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(xlabel="x (m)", ylabel="y (m)")
        axes.autoscale_view()
    for axes in grid[len(kinds) :]:
        axes.set_axis_off()
    if colours is not None:
        figure.colorbar(colours, ax=list(grid), label="odometry after: distance from the reference (mm)", shrink=0.8)
    style.shared_legend(figure, list(handles.values()), list(handles))
    return figure


def _thinned(trace: "RunTrace") -> "RunTrace":
    poses = evenly(len(trace.seen), MOST_POINTS)
    names = ("seen", "t_s", "reference_m", "residual_before", "residual_after")
    kept = {name: getattr(trace, name)[poses] for name in names}
    return replace(trace, before_m=trace.before_m[evenly(len(trace.before_m), MOST_POINTS)], **kept)


def _error_mm(trace: "RunTrace") -> FloatArray:
    return np.asarray(1e3 * np.hypot(*trace.residual_after[:, :2].T))


def _coloured(axes: Axes, trace: "RunTrace", scale: Normalize, *, pixels: bool) -> ScalarMappable:
    error_mm = np.nan_to_num(_error_mm(trace))
    if len(trace.seen) < 2:
        axes.plot(*trace.after_m.T, color=BLUE, lw=1.0, label="odometry after")
        x, y = trace.after_m[-1:].T
        return axes.scatter(x, y, c=error_mm, norm=scale, cmap="viridis", s=14, zorder=3)
    points = trace.after_m[trace.seen]
    pieces = np.stack([points[:-1], points[1:]], axis=1)
    lines = LineCollection(list(pieces), norm=scale, cmap="viridis", linewidths=1.4, rasterized=pixels)
    lines.set_array(0.5 * (error_mm[1:] + error_mm[:-1]))
    axes.add_collection(lines)
    return lines


@styled
def residuals_in_time(traces: "Sequence[RunTrace]") -> Figure:
    """Draw residuals along each path, before (grey) and after: a row a run, a column a channel."""
    chosen = [_thinned(trace) for trace in traces if len(trace.seen) > 1][:MOST_RUNS]
    figure = canvas(1.45 * len(chosen) + 1.6)
    grid = figure.subplots(len(chosen), 3, sharex=True, sharey="col", squeeze=False)
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
    style.shared_legend(figure, handles, ["after", "before, cut off where it is larger"])
    return figure


def _limits(traces: "Sequence[RunTrace]") -> list[float]:
    left = np.concatenate([np.abs(trace.residual_after) for trace in traces])
    limits = []
    for values, (_, _, factor) in zip(left.T, CHANNELS, strict=True):
        known = values[np.isfinite(values)]
        limits.append(1.3 * factor * float(np.percentile(known, 99.5)) if len(known) and known.any() else 1.0)
    return limits


@styled
def residuals_by_run(traces: "Sequence[RunTrace]") -> Figure:
    """Draw end residuals before and after, in the order driven, by kind of route."""
    figure = canvas(9.0)
    grid = figure.subplots(2, 3, sharex=True)
    kinds = style.named_groups(np.array([trace.kind for trace in traces]), "all runs")
    order = np.arange(1.0, len(traces) + 1)
    for row, word in zip(grid, ("before", "after"), strict=True):
        values = [getattr(trace, f"residual_{word}")[-1] for trace in traces]
        for axes, column, (title, unit, factor) in zip(row, np.transpose(values), CHANNELS, strict=True):
            style.draw_groups(axes, kinds, order, factor * column, marker="o", ms=2.8)
            axes.axhline(0.0, color=INK, lw=0.5)
            axes.set_title(f"{word}: {title} ({unit})")
    for axes in grid[1]:
        style.over_runs(axes)
    style.shared_legend(figure, *grid[0, 0].get_legend_handles_labels())
    return figure


@styled
def correlations(names: Sequence[str], covariance: FloatArray) -> Figure:
    """Draw the correlation of every two parameters."""
    std = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(std, std)
    size = len(names)
    figure = canvas(min(0.58 * size + 1.2 + 0.1 * max(map(len, names)), 10.0), 12.5)
    axes = figure.subplots()
    axes.imshow(np.abs(correlation), cmap="Blues", vmin=0.0, vmax=1.6)
    for (row, column), value in np.ndenumerate(correlation):
        weight = "bold" if row != column and abs(value) > 0.9 else "normal"
        text = f"{value:.2f}".replace("-", "\u2212")
        # beside many others there is no room for the zero
        text = text if size <= MOST_WITH_ZERO else text.replace("0.", ".")
        axes.text(column, row, text, ha="center", va="center", color=INK, fontsize=6.0, fontweight=weight)
    axes.set_xticks(range(size), names, rotation=45, ha="right")
    axes.set_yticks(range(size), names)
    axes.grid(visible=False)
    return figure
