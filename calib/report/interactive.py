"""The interactive part of a page: linked panels in which choosing a run or a session lights it everywhere."""

from __future__ import annotations

import base64
import gzip
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib.errors import MissingExtraError
from calib.report.axis_names import with_unit
from calib.report.interactive_scripts import CHOOSE, ENLARGE, LIGHT, UNPACK
from calib.report.panel_data import (
    ALONG,
    COLOURS,
    CauseBar,
    PanelData,
    channel_floors,
    channel_units,
    first_channel,
    panel_source,
)

if TYPE_CHECKING:
    from bokeh.models import ColumnDataSource, Model
    from bokeh.plotting import figure

FADED: Final = 0.12
WIDTH: Final = 540
HEIGHT: Final = 380


def interactive_panels(data: PanelData) -> str:
    """Return the panels, and Bokeh itself, as HTML for a page's body: nothing is fetched when the page is opened.

    Scripts are packed, so that a page can be sent by mail; the browser unpacks them. Raises MissingExtraError where
    Bokeh is not installed.
    """
    try:
        from bokeh.embed import components
        from bokeh.resources import Resources
    except ImportError as error:
        raise MissingExtraError("an interactive page", "bokeh", "html") from error
    resources = Resources(mode="inline", components=["bokeh", "bokeh-widgets"])
    script, div = components(_layout(data), wrap_script=False)
    packed = "\n".join(map(_packed, [*resources.js_raw, script]))
    return f"{div}\n{packed}\n<script>{UNPACK}</script>"


def _packed(script: str) -> str:
    """Return a script as packed text, the same for the same script."""
    data = base64.b64encode(gzip.compress(script.encode("utf-8"), 9, mtime=0)).decode("ascii")
    return f'<script type="application/gzip">{data}</script>'


def _layout(data: PanelData) -> Model:
    from bokeh.layouts import column, gridplot, row

    source = panel_source(data)
    after, band = _before_after_panel(data, source)
    panels = [_covariate_panel(data, source, after.figure, band), after]
    if data.paths_m and data.offset_m is not None:
        panels.insert(0, _map_panel(data, source))
    for name, place in ALONG.items():
        if any(np.isfinite(path[:, place]).any() for path in data.along_m if len(path)):
            panels.append(_along_panel(source, name))
    if data.causes:
        panels.append(_cause_panel(data.causes))
    widgets = [panel.widgets for panel in panels]
    figures = [panel.figure for panel in panels]
    tools = [widget for group in widgets for widget in group]
    return column(
        row(_session_choice(data, source), *tools),
        _legend(data),
        gridplot(
            [figures[k : k + 2] for k in range(0, len(figures), 2)], merge_tools=False, toolbar_options={"logo": None}
        ),
        sizing_mode="stretch_width",
    )


@dataclass(frozen=True, slots=True)
class _Panel:
    figure: figure
    widgets: tuple[Model, ...] = ()


def _figure(title: str, x: str, y: str, **further: Any) -> figure:
    from bokeh.plotting import figure as bokeh_figure

    plot = bokeh_figure(
        title=title,
        x_axis_label=x,
        y_axis_label=y,
        width=WIDTH,
        height=HEIGHT,
        tools="tap,box_select,pan,wheel_zoom,reset,save",
        **further,
    )
    plot.toolbar.logo = None
    return plot


def _hover(plot: figure, renderer: Model) -> None:
    from bokeh.models import HoverTool

    plot.add_tools(
        HoverTool(renderers=[renderer], tooltips=[("run", "@run"), ("session", "@session"), ("kind", "@kind")])
    )


def _lines(plot: figure, x: str, y: str, source: ColumnDataSource, **style: Any) -> Model:
    return plot.multi_line(x, y, source=source, line_color="colour", nonselection_line_alpha=FADED, **style)


def _points(plot: figure, x: str, y: str, source: ColumnDataSource) -> None:
    points = plot.scatter(x, y, source=source, size=7, color="colour", alpha=0.8, nonselection_alpha=FADED)
    _hover(plot, points)


def _map_panel(data: PanelData, source: ColumnDataSource) -> _Panel:
    """Draw the paths from a common start and, at each end, the gap as an arrow, enlarged by what the slider says."""
    from bokeh.models import CustomJS, Slider

    plot = _figure("Floor plan: predicted paths, and the gap at each end", "x, m", "y, m", match_aspect=True)
    lines = _lines(plot, "path_x", "path_y", source, line_alpha=0.5)
    assert data.offset_m is not None
    size = float(np.nanmax(np.hypot(data.offset_m[:, 0], data.offset_m[:, 1]), initial=1e-6))
    extent = max(float(np.ptp(np.concatenate(data.paths_m), axis=0).max()), 1e-3)
    factor = max(1.0, round(0.15 * extent / size))
    ends = np.array([path[-1] for path in data.paths_m])
    tips = ends + factor * data.offset_m
    source.add(list(np.stack((ends[:, 0], tips[:, 0]), axis=1)), "arrow_x")
    source.add(list(np.stack((ends[:, 1], tips[:, 1]), axis=1)), "arrow_y")
    _lines(plot, "arrow_x", "arrow_y", source, line_width=2)
    plot.scatter("end_x", "end_y", source=source, size=5, color="colour", nonselection_alpha=FADED)
    _hover(plot, lines)
    slider = Slider(start=1, end=max(10 * factor, 10), value=factor, step=1, title="gap drawn enlarged by")
    slider.js_on_change("value", CustomJS(args={"source": source}, code=ENLARGE))
    return _Panel(plot, (slider,))


def _covariate_panel(data: PanelData, source: ColumnDataSource, after: figure, band: Model) -> _Panel:
    """Draw one channel's gap against one covariate; both can be chosen, the channel for the panel `after`, too."""
    from bokeh.models import CustomJS, Select

    first, units = first_channel(data), channel_units(data)
    plot = _figure("The gap against what was driven", "order driven", f"{first}, {units[first]}")
    _points(plot, "x", "y", source)
    names = ["order driven", *data.covariates]
    by = Select(title="against", value=names[0], options=names)
    channel = Select(title="channel", value=first, options=list(units))
    code = CustomJS(
        args={
            "source": source,
            "by": by,
            "channel": channel,
            "x": plot.xaxis[0],
            "y": plot.yaxis[0],
            "units": units,
            "labels": {"order driven": "order driven"} | {name: with_unit(name) for name in data.covariates},
            "b": after.xaxis[0],
            "a": after.yaxis[0],
            "band": band,
            "floors": channel_floors(data),
        },
        code=CHOOSE,
    )
    by.js_on_change("value", code)
    channel.js_on_change("value", code)
    return _Panel(plot, (channel, by))


def _before_after_panel(data: PanelData, source: ColumnDataSource) -> tuple[_Panel, Model]:
    """Draw what is left after the fix against what was there before; the floor as a band, the diagonal as a line."""
    from bokeh.models import BoxAnnotation, Slope

    first = first_channel(data)
    unit, floor = channel_units(data)[first], channel_floors(data)[first]
    plot = _figure("Before and after the fix, on runs left out", f"{first} before, {unit}", f"{first} after, {unit}")
    band = BoxAnnotation(bottom=-floor, top=floor, fill_alpha=0.08, fill_color="#009E73")
    plot.add_layout(band)
    plot.add_layout(Slope(gradient=1.0, y_intercept=0.0, line_dash="dashed", line_color="#999999"))
    _points(plot, "b", "a", source)
    return _Panel(plot), band


def _along_panel(source: ColumnDataSource, name: str) -> _Panel:
    """Draw how the gap grows along the way, where the log has a reference or a range all along."""
    plot = _figure(f"The gap along the run: {name.partition(',')[0]}", "distance on the way, m", name)
    _hover(plot, _lines(plot, "way", f"way {name}", source, line_alpha=0.6))
    return _Panel(plot)


def _cause_panel(causes: tuple[CauseBar, ...]) -> _Panel:
    """Draw each named cause's share of the gap with its 95 % interval."""
    from bokeh.models import ColumnDataSource, Whisker

    labels = [f"{cause.label}\n(p = {cause.probability:.2f})" for cause in causes][::-1]
    plot = _figure(
        "Causes, with what cannot be told from them: share of the gap", "share", "", y_range=labels, x_range=(0.0, 1.05)
    )
    plot.hbar(y=labels, right=[cause.share for cause in causes][::-1], height=0.5, color=COLOURS[0], alpha=0.7)
    known = [(label, cause.share_ci95) for label, cause in zip(labels[::-1], causes, strict=True) if cause.share_ci95]
    if known:
        table = ColumnDataSource(
            {
                "y": [label for label, _ in known],
                "low": [interval[0] for _, interval in known if interval],
                "high": [interval[1] for _, interval in known if interval],
            }
        )
        plot.add_layout(Whisker(source=table, base="y", lower="low", upper="high", dimension="width"))
    return _Panel(plot)


def _legend(data: PanelData) -> Model:
    """Return the colours of the kinds in words."""
    from bokeh.models import Div

    names = [str(name) or "(none)" for name in np.unique(data.kind)]
    marks = (
        f'<span style="color:{COLOURS[number % len(COLOURS)]}">&#9679;</span> {escape(name)}'
        for number, name in enumerate(names)
    )
    return Div(text=" &emsp; ".join(marks), sizing_mode="stretch_width")


def _session_choice(data: PanelData, source: ColumnDataSource) -> Model:
    """Return a list of sessions, kinds and runs whose choice lights their runs up in every panel."""
    from bokeh.models import CustomJS, MultiChoice

    labels = (("session", data.session), ("kind", data.kind), ("run", data.run_id))
    options = [f"{title} {name}" for title, names in labels for name in sorted(set(map(str, names)))]
    choice = MultiChoice(name="choice", title="light up", options=options, value=[], width=320)
    choice.js_on_change("value", CustomJS(args={"source": source}, code=LIGHT))
    return choice
