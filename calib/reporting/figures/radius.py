"""The figures of a calibration: runs by series, regressions with both bands, path deviation, residuals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from calib.radius.deviation import whole_period_excess
from calib.radius.effective import Component, EffectiveRadii
from calib.radius.regression import WheelFit
from calib.radius.sessions import groups_of
from calib.reporting.figures.style import (
    BLUE,
    GREY,
    INK,
    LEGEND_LIMIT,
    MANY,
    ORANGE,
    axes_grid,
    canvas,
    colour,
    group_legend,
    legible,
    shared_legend,
    styled,
)

MM: Final = 1e3
UM: Final = 1e6
PPM: Final = 1e6
WHEELS: Final = ("left", "right")
#: a smaller excess is drawn as this one: a hair's breadth over a corridor
LEAST_EXCESS_PPM: Final = 1e-4
#: light to dark, told apart in print and by colour-blind readers
LOAD_COLOURS: Final = "viridis_r"
#: loads within this share of the largest are one load that scatters
LOADS_ALIKE: Final = 0.05


@styled
def runs_by_series(radii: EffectiveRadii) -> Figure:
    """Draw each wheel's radius by run, in the order driven (Fig. 10).

    `radii`: of a fit. One panel a wheel, one vertical scale; coloured by load where it varies, with lines between the
    sessions, else by session.
    """
    figure = canvas(8.0)
    axes = axes_grid(figure, 2, 1, sharex=True, sharey=True)[:, 0]
    order = np.arange(1, len(radii) + 1)
    names, group = _sessions(radii.session)
    sides = (
        (radii.radius_left_m, radii.std_left_m, radii.load_left_N),
        (radii.radius_right_m, radii.std_right_m, radii.load_right_N),
    )
    loads = np.concatenate((radii.load_left_N, radii.load_right_N))
    span = Normalize(float(loads.min()), float(loads.max())) if varies(loads) else None
    # few steps, which stay vectors
    scale = mpl.colormaps[LOAD_COLOURS].resampled(32)
    for axis, wheel, (radius, std, load) in zip(axes, WHEELS, sides, strict=True):
        if span is None:
            for number, name in enumerate(names):
                on = group == number
                _errorbars(axis, order[on], MM * radius[on], MM * std[on], colour(number), name)
        else:
            _errorbars(axis, order, MM * radius, MM * std, GREY, None)
            axis.scatter(order, MM * radius, c=load, norm=span, cmap=scale, s=9, lw=0, zorder=3)
            _mark_sessions(axis, group, names)
        axis.set(title=f"{wheel.capitalize()} wheel", ylabel="effective radius (mm)")
        axis.margins(x=0.015, y=0.08)
    axes[-1].set_xlabel("run, in the order driven")
    if span is None:
        group_legend(figure, axes[0], names)
    else:
        figure.colorbar(ScalarMappable(span, scale), ax=axes, pad=0.01, aspect=40, label="wheel load (N)")
    return figure


def varies(load: npt.NDArray[np.float64]) -> bool:
    """Return whether loads differ by more than 5 % of the largest, so that colours can order them."""
    return bool(np.ptp(load) > LOADS_ALIKE * np.abs(load).max())


def _mark_sessions(axis: Any, group: npt.NDArray[np.int64], names: list[str]) -> None:
    """Draw a line where the session changes, and name the sessions where there is room."""
    changes = np.flatnonzero(np.diff(group)) + 1
    if len(changes) > len(names) + LEGEND_LIMIT:  # sessions that alternate
        return
    for change in changes:
        axis.axvline(change + 0.5, color=GREY, lw=0.5, ls=(0, (4, 3)))
    for first in np.concatenate(([0], changes)) if 1 < len(names) <= LEGEND_LIMIT else ():
        axis.annotate(
            names[group[first]], (first + 0.7, 1.0), xycoords=("data", "axes fraction"), xytext=(1, -1),
            textcoords="offset points", fontsize=6, color="#555555", va="top",
        )  # fmt: skip


@styled
def regressions(left: WheelFit, right: WheelFit, session: npt.NDArray[np.str_]) -> Figure:
    """Draw radius against load with the law, the band of the mean and the prediction band (Fig. 11).

    `session` (shape (n_runs,)). Below each wheel's law the same as deviation from it, where the bands can be read.
    """
    figure = canvas(10.0)
    axes = axes_grid(figure, 2, 2, sharex="col", sharey="row", height_ratios=(1.15, 1.0))
    names, group = _sessions(session)
    for column, fit in enumerate((left, right)):
        law = fit.law
        span = max(law.load_max_N - law.load_min_N, 0.04 * abs(law.load_max_N), 1.0)
        load = np.linspace(law.load_min_N - 0.04 * span, law.load_max_N + 0.04 * span, 161)
        centre = law.radius_m(load)
        upper, lower = axes[0, column], axes[1, column]
        for axis, scale, zero in ((upper, MM, np.zeros_like(load)), (lower, UM, centre)):
            for band, alpha, label in (
                (fit.prediction_band_m(load), 0.13, "prediction band"),
                (fit.mean_band_m(load), 0.38, "band of the mean"),
            ):
                low, high = (scale * (end - zero) for end in band)
                axis.fill_between(load, low, high, color=BLUE, alpha=alpha, lw=0, label=label)
            axis.plot(load, scale * (centre - zero), color=INK, lw=1.0, label="law")
        for number, name in enumerate(names):
            on = group == number
            style = {"ms": 3.2, "color": colour(number), "label": name, "rasterized": len(group) > MANY}
            upper.plot(fit.load_N[on], MM * fit.radius_m[on], ".", **style)
            lower.plot(fit.load_N[on], UM * fit.residual_m[on], ".", **style)
        upper.set_title(f"{fit.wheel.capitalize()} wheel")
        upper.tick_params(labelleft=True)
        lower.tick_params(labelleft=True)
        lower.set_xlabel("wheel load (N)")
        upper.margins(x=0)
    axes[0, 0].set_ylabel("effective radius (mm)")
    axes[1, 0].set_ylabel("radius minus law (µm)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    bands = [labels.index(text) for text in ("law", "band of the mean", "prediction band")]
    shown = bands + ([k for k, text in enumerate(labels) if k not in bands] if 1 < len(names) <= LEGEND_LIMIT else [])
    shared_legend(figure, [handles[k] for k in shown], [labels[k] for k in shown])
    return figure


@styled
def path_deviation(radii: EffectiveRadii) -> Figure:
    """Draw the weave's relative excess by amplitude and wavelength (Fig. 9) with the runs on it.

    `radii`: of a fit; runs of unknown amplitude are missing in the first panel. Left the curves and runs, right the
    correction of each run and wheel.
    """
    figure = canvas(7.6)
    chart, strip = axes_grid(figure, 1, 2, width_ratios=(1.15, 1.0))[0]
    known = np.isfinite(radii.amplitude_m) & np.isfinite(radii.wavelength_m) & (radii.amplitude_m > 0)
    known &= radii.wavelength_m > 0
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
            # the lines run together where the weave is steep: their names are held apart
            f"λ = {value:g} m", (grid[-1], float(excess[-1])), xytext=(3, 3 * (2 - number)),
            textcoords="offset points", fontsize=6,
            va="center", color=shade, annotation_clip=False,
        )  # fmt: skip
    if len(amplitude):
        excess = np.maximum(PPM * whole_period_excess(amplitude, wavelength), LEAST_EXCESS_PPM)
        chart.plot(amplitude, excess, ".", ms=4, color=ORANGE, label="runs", rasterized=len(amplitude) > MANY)
        chart.legend(loc="upper left")
    chart.set(xscale="log", yscale="log", xlabel="amplitude A (m)", ylabel="excess of the path (ppm)")
    chart.set_title("Weave of amplitude A and wavelength λ")
    chart.set_xlim(low, high)
    chart.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    for axis in (chart.xaxis, chart.yaxis):
        axis.set_minor_formatter(NullFormatter())
    chart.set_ylim(bottom=max(chart.get_ylim()[0], 0.5 * LEAST_EXCESS_PPM))
    decades = np.arange(*_decades(chart.get_ylim()), 2)
    chart.set_yticks(10.0**decades, [f"{10.0**k:,.{max(-int(k), 0)}f}" for k in decades])

    order = np.arange(1, len(radii) + 1)
    for wheel, part, tint, mark in (("left", radii.path_left, BLUE, "o"), ("right", radii.path_right, ORANGE, "s")):
        strip.plot(
            order, PPM * part, mark, ms=2.4, mew=0, color=tint, label=f"{wheel} wheel", rasterized=len(order) > MANY
        )
    strip.axhline(0.0, color=GREY, lw=0.6)
    strip.set_xlabel("run, in the order driven")
    strip.set_ylabel("correction of the radius (ppm)")
    strip.set_title("What each run's path added")
    strip.margins(y=0.18)
    strip.legend(loc="upper right", ncols=2, handletextpad=0.2, columnspacing=1.0)
    return figure


@styled
def residuals(left: WheelFit, right: WheelFit, session: npt.NDArray[np.str_]) -> Figure:
    """Draw the residuals of both wheels against load, in the order driven, and against normal quantiles.

    `session` (shape (n_runs,)). Two rows (wheels) of three panels.
    """
    from scipy.special import ndtri

    figure = canvas(8.0)
    axes = axes_grid(figure, 2, 3, sharey=True)
    names, group = _sessions(session)
    for row, fit in enumerate((left, right)):
        rest = UM * fit.residual_m
        n = len(rest)
        rank = np.empty(n)
        rank[np.argsort(rest, kind="stable")] = np.arange(1, n + 1)
        # Blom's plotting positions
        quantile = ndtri((rank - 0.375) / (n + 0.25))
        for column, x in enumerate((fit.load_N, np.arange(1.0, n + 1), quantile)):
            axis = axes[row, column]
            axis.axhline(0.0, color=GREY, lw=0.6)
            for number in range(len(names)):
                on = group == number
                axis.plot(x[on], rest[on], ".", ms=3, color=colour(number), rasterized=n > MANY)
            axis.tick_params(labelleft=column == 0)
            axis.margins(x=0.05, y=0.08)
        reach = np.array([quantile.min(), quantile.max()])
        axes[row, 2].plot(reach, rest.mean() + rest.std(ddof=1) * reach, color=INK, lw=0.8)
        axes[row, 0].set(ylabel="radius minus law (µm)", title=f"{fit.wheel.capitalize()} wheel, against load")
        axes[row, 1].set_title("in the order driven")
        axes[row, 2].set_title("against a normal distribution")
    for axis, text in zip(axes[1], ("wheel load (N)", "run", "normal quantile"), strict=True):
        axis.set_xlabel(text)
    return figure


@styled
def budget_bars(budget: Sequence[Component]) -> Figure:
    """Draw each contribution to the standard uncertainty of a single radius, left and right, with the total.

    `budget`: of `calib.radius.effective.EffectiveRadii`. One pair of bars a contribution, the total last.
    """
    names = [legible(part.name.replace("_", " ")) for part in budget] + ["combined"]
    sides = [[1e6 * part.std_left_m for part in budget], [1e6 * part.std_right_m for part in budget]]
    figure = canvas(2.2 + 0.62 * len(names))
    axis = figure.add_subplot()
    place = np.arange(len(names), dtype=np.float64)
    handles = []
    for side, tint, shift in ((0, BLUE, -0.18), (1, ORANGE, 0.18)):
        values = [*sides[side], float(np.sqrt(np.sum(np.square(sides[side]))))]
        handles.append(axis.barh(place + shift, values, height=0.34, color=tint, lw=0))
    axis.axhline(len(budget) - 0.5, color=GREY, lw=0.6)
    axis.set_yticks(place, names)
    axis.invert_yaxis()
    axis.grid(visible=False, axis="y")
    axis.set_xlabel("contribution to the standard uncertainty of one radius (µm, k = 1)")
    axis.margins(y=0.02)
    shared_legend(figure, handles, ["left wheel", "right wheel"])
    return figure


def _sessions(session: npt.NDArray[np.str_]) -> tuple[list[str], npt.NDArray[np.int64]]:
    """Return the sessions in order of first appearance, and the number of each run's."""
    groups = groups_of(session)
    return [_short(str(name)) for name in groups.names], groups.index


def _short(name: str, limit: int = 18) -> str:
    """Return a label that fits a legend; a leading underscore would hide it."""
    text = legible(name.strip()) or "(no session)"
    text = text if len(text) <= limit else text[: limit - 1] + "…"
    return f"\u200b{text}" if text.startswith("_") else text


def _decades(limits: tuple[float, float]) -> tuple[int, int]:
    return int(np.ceil(np.log10(limits[0]))), int(np.floor(np.log10(limits[1]))) + 1


def _errorbars(axis: Any, x: Any, y: Any, std: Any, tint: str, label: str | None) -> None:
    many = len(x) > MANY
    axis.errorbar(
        x, y, yerr=None if many else 2 * np.nan_to_num(std), fmt=".", ms=3.6, color=tint, elinewidth=0.6, label=label,
        rasterized=many,
    )  # fmt: skip
