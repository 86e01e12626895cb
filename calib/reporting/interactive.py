"""Linked panels of a diagnosis: selecting a run or a session highlights it in every panel."""

from __future__ import annotations

import base64
import gzip
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.errors import MissingExtraError
from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.localise.along_run import traces_of
from calib.gap.observations.arrays import Observations
from calib.reporting.figures.gap import GapArrays, rms
from calib.reporting.formatting import with_unit
from calib.types import FloatArray

if TYPE_CHECKING:
    from bokeh.models import ColumnDataSource, Model
    from bokeh.plotting import figure

#: Okabe and Ito's colours, told apart by colour-blind readers
COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#999999")
#: points of a drawn path, and of a gap along a run: more are invisible and make the page heavy
PATH_POINTS: Final = 60
TRACE_POINTS: Final = 120
#: gap along a run -> its column in the arrays of `gap_along_runs`
ALONG: Final = {"along, mm": 1, "heading, mrad": 2}
#: confounded effects named beside a cause
ALIASES_NAMED: Final = 3
#: opacity of what is not selected, and size of a panel in pixels
FADED_ALPHA: Final = 0.12
PANEL_WIDTH: Final = 540
PANEL_HEIGHT: Final = 380


def interactive_panels(diagnosis: Diagnosis, campaign: Campaign) -> str:
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
    layout = _layout(GapArrays.of(diagnosis), gap_along_runs(diagnosis.observations, campaign), diagnosis)
    script, div = components(layout, wrap_script=False)
    packed = "\n".join(map(_packed, [*resources.js_raw, script]))
    return f"{div}\n{packed}\n<script>{_script('unpack')}</script>"


def _script(name: str) -> str:
    return (files("calib.reporting") / "scripts" / f"{name}.js").read_text(encoding="utf-8")


def _packed(script: str) -> str:
    """Return a script as packed text, the same for the same script."""
    data = base64.b64encode(gzip.compress(script.encode("utf-8"), 9, mtime=0)).decode("ascii")
    return f'<script type="application/gzip">{data}</script>'


def gap_along_runs(observations: Observations, campaign: Campaign) -> list[FloatArray]:
    """Return distance (m), gap along (m) and in heading (rad) of each observation, shape (n_samples, 3).

    Empty for observations without a continuous reference or range; NaN where not measured.
    """
    along: list[FloatArray] = [np.zeros((0, 3))] * len(observations)
    first = {str(name): k for k, name in reversed(list(enumerate(observations.labels["run_id"])))}
    for trace in traces_of(campaign, observations):
        step = max(1, len(trace.way_m) // TRACE_POINTS)
        along[first[trace.run_id]] = np.stack((trace.way_m, trace.along_m, trace.heading_rad), axis=1)[::step]
    return along


def panel_source(gap: GapArrays, along: list[FloatArray]) -> ColumnDataSource:
    """Return the one table of all panels, a row an observation: a selection in one panel is a selection in all."""
    from bokeh.models import ColumnDataSource

    _, number = np.unique(gap.labels["kind"], return_inverse=True)
    columns: dict[str, Any] = {
        "run": gap.labels["run_id"],
        "session": gap.labels["session"],
        "kind": gap.labels["kind"],
        "colour": [COLOURS[int(k) % len(COLOURS)] for k in number],
        "by order driven": np.arange(len(gap.before), dtype=np.float64),
    }
    columns |= {f"by {name}": values for name, values in gap.covariates.items()}
    for channel, (name, _) in enumerate(gap.channels):
        columns[f"before {name}"] = 1e3 * gap.before[:, channel]
        columns[f"after {name}"] = 1e3 * gap.after[:, channel]
    first = first_channel(gap)
    columns["x"] = columns["by order driven"]
    columns["y"] = columns["b"] = columns[f"before {first}"]
    columns["a"] = columns[f"after {first}"]
    if gap.offset_m is not None:
        thin = [path[:: max(1, len(path) // PATH_POINTS)] for path in gap.paths_m]
        for k, axis in enumerate("xy"):
            columns[f"path_{axis}"] = [path[:, k].astype(np.float32) for path in thin]
            columns[f"end_{axis}"] = np.array([path[-1, k] for path in gap.paths_m])
            columns[f"off_{axis}"] = gap.offset_m[:, k]
    if any(len(path) for path in along):
        columns["way"] = [np.round(path[:, 0], 4) for path in along]
        columns |= {f"way {name}": [1e3 * path[:, column] for path in along] for name, column in ALONG.items()}
    return ColumnDataSource(columns, name="observations")


def first_channel(gap: GapArrays) -> str:
    """Return the channel whose gap is largest against its noise level."""
    ratios = [rms(column) for column in (gap.before / np.where(gap.noise_level > 0, gap.noise_level, np.nan)).T]
    return gap.channels[int(np.nanargmax(ratios)) if np.isfinite(ratios).any() else 0][0]


def channel_units(gap: GapArrays) -> dict[str, str]:
    """Return the unit that each measured channel is drawn in, by its name."""
    return {
        name: "mrad" if unit == "rad" else "mm"
        for (name, unit), values in zip(gap.channels, gap.before.T, strict=True)
        if np.isfinite(values).any()
    }


def noise_limits(gap: GapArrays) -> dict[str, float]:
    """Return two standard deviations of the noise of each measured channel, in mm or mrad, by its name."""
    limits = {name: 2e3 * rms(column) for (name, _), column in zip(gap.channels, gap.noise_level.T, strict=True)}
    return {name: limits[name] if np.isfinite(limits[name]) else 0.0 for name in channel_units(gap)}


def _layout(gap: GapArrays, along: list[FloatArray], verdict: Diagnosis) -> Model:
    from bokeh.layouts import column, gridplot, row

    source = panel_source(gap, along)
    after, band = _before_after_panel(gap, source)
    by_covariate, tools = _covariate_panel(gap, source, after, band)
    figures = [by_covariate, after]
    if gap.offset_m is not None:
        plan, slider = _map_panel(gap, source)
        figures, tools = [plan, *figures], [slider, *tools]
    for name, place in ALONG.items():
        if any(np.isfinite(path[:, place]).any() for path in along):
            figures.append(_along_panel(source, name))
    if verdict.causes:
        figures.append(_cause_panel(verdict))
    return column(
        row(_session_choice(gap, source), *tools),
        _legend(gap),
        gridplot(
            [figures[k : k + 2] for k in range(0, len(figures), 2)], merge_tools=False, toolbar_options={"logo": None}
        ),
        sizing_mode="stretch_width",
    )


def _figure(title: str, x: str, y: str, **further: Any) -> figure:
    from bokeh.plotting import figure as bokeh_figure

    plot = bokeh_figure(
        title=title,
        x_axis_label=x,
        y_axis_label=y,
        width=PANEL_WIDTH,
        height=PANEL_HEIGHT,
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
    return plot.multi_line(x, y, source=source, line_color="colour", nonselection_line_alpha=FADED_ALPHA, **style)


def _points(plot: figure, x: str, y: str, source: ColumnDataSource) -> None:
    points = plot.scatter(x, y, source=source, size=7, color="colour", alpha=0.8, nonselection_alpha=FADED_ALPHA)
    _hover(plot, points)


def _map_panel(gap: GapArrays, source: ColumnDataSource) -> tuple[figure, Model]:
    """Draw the paths from a common start and, at each end, the gap as an arrow, enlarged by the slider."""
    from bokeh.models import CustomJS, Slider

    plot = _figure("Floor plan: predicted paths, and the gap at each end", "x, m", "y, m", match_aspect=True)
    lines = _lines(plot, "path_x", "path_y", source, line_alpha=0.5)
    assert gap.offset_m is not None
    size = float(np.nanmax(np.hypot(gap.offset_m[:, 0], gap.offset_m[:, 1]), initial=1e-6))
    extent = max(float(np.ptp(np.concatenate(gap.paths_m), axis=0).max()), 1e-3)
    factor = max(1.0, round(0.15 * extent / size))
    ends = np.array([path[-1] for path in gap.paths_m])
    tips = ends + factor * gap.offset_m
    source.add(list(np.stack((ends[:, 0], tips[:, 0]), axis=1)), "arrow_x")
    source.add(list(np.stack((ends[:, 1], tips[:, 1]), axis=1)), "arrow_y")
    _lines(plot, "arrow_x", "arrow_y", source, line_width=2)
    plot.scatter("end_x", "end_y", source=source, size=5, color="colour", nonselection_alpha=FADED_ALPHA)
    _hover(plot, lines)
    slider = Slider(start=1, end=max(10 * factor, 10), value=factor, step=1, title="gap drawn enlarged by")
    slider.js_on_change("value", CustomJS(args={"source": source}, code=_script("enlarge")))
    return plot, slider


def _covariate_panel(
    gap: GapArrays, source: ColumnDataSource, after: figure, band: Model
) -> tuple[figure, list[Model]]:
    """Draw one channel's gap against one covariate; both can be chosen, the channel for the panel `after`, too."""
    from bokeh.models import CustomJS, Select

    first, units = first_channel(gap), channel_units(gap)
    plot = _figure("The gap against covariates", "order driven", f"{first}, {units[first]}")
    _points(plot, "x", "y", source)
    names = ["order driven", *gap.covariates]
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
            "labels": {"order driven": "order driven"} | {name: with_unit(name) for name in gap.covariates},
            "b": after.xaxis[0],
            "a": after.yaxis[0],
            "band": band,
            "limits": noise_limits(gap),
        },
        code=_script("choose"),
    )
    by.js_on_change("value", code)
    channel.js_on_change("value", code)
    return plot, [channel, by]


def _before_after_panel(gap: GapArrays, source: ColumnDataSource) -> tuple[figure, Model]:
    """Draw the gap after the correction against that before; the noise level as a band, the diagonal as a line."""
    from bokeh.models import BoxAnnotation, Slope

    first = first_channel(gap)
    unit, limit = channel_units(gap)[first], noise_limits(gap)[first]
    plot = _figure(
        "Before and after the correction, on held-out runs", f"{first} before, {unit}", f"{first} after, {unit}"
    )
    band = BoxAnnotation(bottom=-limit, top=limit, fill_alpha=0.08, fill_color="#009E73")
    plot.add_layout(band)
    plot.add_layout(Slope(gradient=1.0, y_intercept=0.0, line_dash="dashed", line_color="#999999"))
    _points(plot, "b", "a", source)
    return plot, band


def _along_panel(source: ColumnDataSource, name: str) -> figure:
    """Draw how the gap grows with the travelled distance, where the log has a continuous reference or range."""
    plot = _figure(f"The gap along the run: {name.partition(',')[0]}", "travelled distance, m", name)
    _hover(plot, _lines(plot, "way", f"way {name}", source, line_alpha=0.6))
    return plot


def _cause_panel(verdict: Diagnosis) -> figure:
    """Draw each named cause's share of the gap with its 95 % interval."""
    from bokeh.models import ColumnDataSource, Whisker

    causes = verdict.causes[::-1]
    labels = [f"{_with_aliases(cause.effect, verdict)}\n(p = {cause.probability:.2f})" for cause in causes]
    title = "Causes, with the effects confounded with them: share of the gap"
    plot = _figure(title, "share", "", y_range=labels, x_range=(0.0, 1.05))
    plot.hbar(y=labels, right=[cause.share for cause in causes], height=0.5, color=COLOURS[0], alpha=0.7)
    known = [(label, *cause.share_ci95) for label, cause in zip(labels, causes, strict=True) if cause.share_ci95]
    if known:
        table = ColumnDataSource(dict(zip(("y", "low", "high"), zip(*known, strict=True), strict=True)))
        plot.add_layout(Whisker(source=table, base="y", lower="low", upper="high", dimension="width"))
    return plot


def _with_aliases(effect: str, verdict: Diagnosis) -> str:
    """Return an effect with those confounded with it, a line each."""
    others = [
        other for group in verdict.groups if effect in group.effects for other in group.effects if other != effect
    ]
    more = [f"and {len(others) - ALIASES_NAMED} more"] if len(others) > ALIASES_NAMED else []
    return "\n".join([effect, *(f"or {other}" for other in others[:ALIASES_NAMED]), *more])


def _legend(gap: GapArrays) -> Model:
    """Return the colours of the kinds in words."""
    from bokeh.models import Div

    names = [str(name) or "(none)" for name in np.unique(gap.labels["kind"])]
    marks = (
        f'<span style="color:{COLOURS[number % len(COLOURS)]}">&#9679;</span> {escape(name)}'
        for number, name in enumerate(names)
    )
    return Div(text=" &emsp; ".join(marks), sizing_mode="stretch_width")


def _session_choice(gap: GapArrays, source: ColumnDataSource) -> Model:
    """Return a list of sessions, kinds and runs whose choice highlights their runs in every panel."""
    from bokeh.models import CustomJS, MultiChoice

    labels = (("session", gap.labels["session"]), ("kind", gap.labels["kind"]), ("run", gap.labels["run_id"]))
    options = [f"{title} {name}" for title, names in labels for name in sorted(set(map(str, names)))]
    choice = MultiChoice(name="choice", title="highlight", options=options, value=[], width=320)
    choice.js_on_change("value", CustomJS(args={"source": source}, code=_script("highlight")))
    return choice
