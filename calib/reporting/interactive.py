"""Linked panels of a diagnosis: selecting a run or a session highlights it in every panel.

Needs Bokeh: importing this module raises MissingExtraError where it is not installed.
"""

import base64
import gzip
from collections.abc import Mapping
from html import escape
from importlib.resources import files
from typing import Any, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.errors import MissingExtraError
from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.localise import traces_of
from calib.gap.observations import Observations
from calib.gap.observations.from_campaign import measured_poses
from calib.reporting.exports.mcap_paths import tracks_of
from calib.reporting.figures.gap import GapArrays, rms
from calib.reporting.formatting import natural, percent, with_unit
from calib.types import FloatArray, evenly, in_frame

try:
    from bokeh import models
    from bokeh.embed import components
    from bokeh.layouts import column, row
    from bokeh.models import ColumnDataSource, Label, Model, MultiChoice, Select, Slider, Slope, Whisker
    from bokeh.plotting import figure
    from bokeh.resources import Resources
except ImportError as error:
    raise MissingExtraError("an interactive page", "bokeh", "html") from error

#: Okabe and Ito's, told apart by colour-blind readers
COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#999999")
#: scale of numbers, light to dark (matplotlib's viridis, reversed)
RAMP: Final = ("#FDE725", "#7AD151", "#22A884", "#2A788E", "#414487", "#440154")
#: a run's paths (model alone, corrected, measured): line, mark, name in the legend
PATH_STYLES: Final = {
    "before": ("dashed", "circle", "simulated"),
    "after": ("solid", "square", "simulated with the causes"),
    "reference": ("dotted", "x", "measured"),
}
ALIASES_NAMED: Final = 3
#: opacity of what is not selected, and a panel's size in pixels
FADED_ALPHA: Final = 0.12
PANEL_LEAST_WIDTH: Final = 300
PANEL_HEIGHT: Final = 380
LEGEND_NAMES: Final = 24


def interactive_panels(diagnosis: Diagnosis, campaign: Campaign) -> str:
    """Return the panels, and Bokeh itself, as HTML for a page's body: nothing is fetched."""
    resources = Resources(mode="inline", components=["bokeh", "bokeh-widgets"])
    gap, along = GapArrays.of(diagnosis), gap_along_runs(diagnosis.observations, campaign)
    columns = panel_columns(gap, along, run_paths(diagnosis, campaign), COLOURS)
    layout = _layout(gap, along, ColumnDataSource(columns, name="observations"), diagnosis)
    script, div = components(layout, wrap_script=False)
    data = [gzip.compress(one.encode("utf-8"), 9, mtime=0) for one in [*resources.js_raw, script]]
    packed = "\n".join(
        f'<script type="application/gzip">{base64.b64encode(one).decode("ascii")}</script>' for one in data
    )
    return f"{div}\n{packed}\n<script>{_script('unpack')}</script>"


def _script(name: str) -> str:
    scripts = (files("calib.reporting") / "panels.js").read_text(encoding="utf-8")
    return scripts.partition(f"//: {name}\n")[2].partition("//: ")[0]


def _layout(gap: GapArrays, along: list[FloatArray], source: ColumnDataSource, verdict: Diagnosis) -> Model:
    after, band = _before_after_panel(gap, source)
    by_covariate, tools = _covariate_panel(gap, source, after, band)
    legend = _legend(gap)
    figures = [by_covariate, after]
    columns = {"session": "session", "kind": "kind", "run": "run_id"}
    options = [f"{label} {name}" for label, key in columns.items() for name in natural(gap.labels[key])]
    choice = MultiChoice(name="choice", title="highlight", options=options, value=[], width=300)
    tools = [_changed(choice, "highlight", source=source), _colour_choice(gap, source, legend), *tools]
    shown = [name for name, place in ALONG.items() if any(np.isfinite(path[:, place]).any() for path in along)]
    runs = [_along_panel(source, name) for name in shown]
    if gap.offset_m is not None:
        plan, slider = _map_panel(gap, source)
        figures = [plan, *figures]
        tools += [slider, _moment_slider(source)]
    if runs:
        axes = list(RUN_AXES)
        along_by = Select(name="axis", title="along the run against", value=axes[0], options=axes, width=180)
        tools.append(_changed(along_by, "axis", source=source, axes=[plot.xaxis[0] for plot in runs]))
    figures += runs
    if verdict.causes:
        figures.append(_cause_panel(verdict))
    return column(_wrapped(tools), legend, _wrapped(figures), sizing_mode="stretch_width")


def _changed(control: Any, script: str, **arguments: Any) -> Any:
    control.js_on_change("value", models.CustomJS(args=arguments, code=_script(script)))
    return control


def _wrapped(children: list[Any]) -> Model:
    sheet = models.InlineStyleSheet(css=":host { flex-wrap: wrap; gap: 0.6rem; }")
    return row(*children, sizing_mode="stretch_width", stylesheets=[sheet])


def _figure(title: str, x: str, y: str, **further: Any) -> figure:
    plot = figure(
        title=title,
        x_axis_label=x,
        y_axis_label=y,
        min_width=PANEL_LEAST_WIDTH,
        height=PANEL_HEIGHT,
        sizing_mode="stretch_width",
        styles={"flex": "1 1 28rem"},
        tools="tap,box_select,pan,wheel_zoom,reset,save",
        active_scroll=None,
        toolbar_location="above",
        **further,
    )
    plot.toolbar.logo = None
    return plot


def _hover(plot: figure, renderer: Model) -> None:
    plot.add_tools(models.HoverTool(renderers=[renderer], tooltips=[(name, f"@{name}") for name in LABELS]))


def _lines(plot: figure, x: str, y: str, source: ColumnDataSource, **style: Any) -> Model:
    return plot.multi_line(x, y, source=source, line_color="colour", nonselection_line_alpha=FADED_ALPHA, **style)


def _points(plot: figure, x: str, y: str, source: ColumnDataSource) -> None:
    _hover(plot, plot.scatter(x, y, source=source, size=7, color="colour", alpha=0.8, nonselection_alpha=FADED_ALPHA))


def _map_panel(gap: GapArrays, source: ColumnDataSource) -> tuple[figure, Model]:
    plot = _figure("Floor plan: paths, and the gap at each end", "x (m)", "y (m)", match_aspect=True)
    data = source.data
    for which, (dash, mark, name) in PATH_STYLES.items():
        if not any(len(path) for path in data[f"{which}_x"]):
            continue
        lines = _lines(
            plot, f"{which}_x", f"{which}_y", source, line_alpha=0.6, line_dash=dash, legend_label=f"{name} ({dash})"
        )
        plot.scatter(
            f"now_{which}_x", f"now_{which}_y", source=source, size=6, marker=mark, color="colour",
            nonselection_alpha=FADED_ALPHA,
        )  # fmt: skip
        _hover(plot, lines)
    assert gap.offset_m is not None
    size = float(np.nanmax(np.hypot(gap.offset_m[:, 0], gap.offset_m[:, 1]), initial=1e-6))
    ends = np.column_stack((data["end_x"], data["end_y"]))
    extent = max(float(np.abs(np.concatenate([*data["before_x"], *data["before_y"]])).max()), 1e-3)
    factor = max(1.0, round(0.15 * extent / size))
    tips = ends + factor * gap.offset_m
    source.add(list(np.stack((ends[:, 0], tips[:, 0]), axis=1)), "arrow_x")
    source.add(list(np.stack((ends[:, 1], tips[:, 1]), axis=1)), "arrow_y")
    _lines(plot, "arrow_x", "arrow_y", source, line_width=2, legend_label="gap at the end, enlarged (thick)")
    look = {"label_text_font_size": "11px", "background_fill_alpha": 0.6, "spacing": 0, "padding": 4}
    plot.legend[0].update(click_policy="hide", **look)
    slider = Slider(start=1, end=max(10 * factor, 10), value=factor, step=1, title="gap drawn enlarged by", width=220)
    return plot, _changed(slider, "enlarge", source=source)


def _moment_slider(source: ColumnDataSource) -> Model:
    longest = max(float(path[-1]) for path in source.data["before_t"])
    slider = Slider(
        name="moment", start=0.0, end=longest, value=longest, step=longest / 200, title="time since the start (s)",
        width=220, format="0.0",
    )  # fmt: skip
    return _changed(slider, "moment", source=source, paths=list(PATH_STYLES))


def _covariate_panel(
    gap: GapArrays, source: ColumnDataSource, after: figure, band: Model
) -> tuple[figure, list[Model]]:
    first, units = _first_channel(gap), _channel_units(gap)
    plot = _figure("The gap against covariates", "order driven", f"{first} ({units[first]})")
    _points(plot, "x", "y", source)
    titles = _covariate_titles(gap)
    by = Select(title="gap against", value="order driven", options=list(titles.items()), width=160)
    channel = Select(title="channel", value=first, options=list(units), width=120)
    axes = {"x": plot.xaxis[0], "y": plot.yaxis[0], "b": after.xaxis[0], "a": after.yaxis[0]}
    texts = {"units": units, "labels": titles, "limits": _noise_limits(gap)}
    chosen = {"source": source, "by": by, "channel": channel, "band": band, **axes, **texts}
    return plot, [_changed(control, "choose", **chosen) for control in (channel, by)]


def _before_after_panel(gap: GapArrays, source: ColumnDataSource) -> tuple[figure, Model]:
    first = _first_channel(gap)
    unit, limit = _channel_units(gap)[first], _noise_limits(gap)[first]
    plot = _figure(
        "Before and after the correction, on held-out runs", f"{first} before ({unit})", f"{first} after ({unit})"
    )
    band = models.BoxAnnotation(bottom=-limit, top=limit, fill_alpha=0.08, fill_color="#009E73")
    plot.add_layout(band)
    corner = {"x": 6, "y": 6, "x_units": "screen", "y_units": "screen", "text_font_size": "11px"}
    plot.add_layout(Label(text="green: noise, ± 2 standard deviations; dashed: no change", **corner))
    plot.add_layout(Slope(gradient=1.0, y_intercept=0.0, line_dash="dashed", line_color="#999999"))
    _points(plot, "b", "a", source)
    return plot, band


def _along_panel(source: ColumnDataSource, name: str) -> figure:
    plot = _figure(f"The gap along the run: {name.partition(' ')[0]}", next(iter(RUN_AXES)), name)
    _hover(plot, _lines(plot, "way", f"gap {name}", source, line_alpha=0.6))
    return plot


def _cause_panel(verdict: Diagnosis) -> figure:
    causes = verdict.causes[::-1]
    sizes = [f"{percent(cause.share)}, probability {percent(cause.probability)}" for cause in causes]
    labels = [f"{_with_aliases(cause.effect, verdict)}\n{size}" for cause, size in zip(causes, sizes, strict=True)]
    plot = _figure("Causes: share of the gap", "share of the gap", "", y_range=labels, x_range=(0.0, 1.05))
    plot.hbar(y=labels, right=[cause.share for cause in causes], height=0.4, color=COLOURS[0], alpha=0.7)
    known = [(label, *cause.share_ci95) for label, cause in zip(labels, causes, strict=True) if cause.share_ci95]
    if known:
        table = ColumnDataSource(dict(zip(("y", "low", "high"), zip(*known, strict=True), strict=True)))
        plot.add_layout(Whisker(source=table, base="y", lower="low", upper="high", dimension="width"))
    return plot


def _with_aliases(effect: str, verdict: Diagnosis) -> str:
    others = [name for group in verdict.groups if effect in group for name in group if name != effect]
    remainder = [f"and {len(others) - ALIASES_NAMED} more"] if len(others) > ALIASES_NAMED else []
    return "\n".join([effect, *(f"or {other}" for other in others[:ALIASES_NAMED]), *remainder])


def _legend(gap: GapArrays) -> Model:
    names = natural(gap.labels["kind"])
    marks = [
        f'<span style="white-space:nowrap"><span style="color:{COLOURS[number % len(COLOURS)]}">&#9679;</span> '
        f"{escape(name) or '(none)'}</span>"
        for number, name in enumerate(names[:LEGEND_NAMES])
    ]
    remainder = [f"and {len(names) - LEGEND_NAMES} more"] if len(names) > LEGEND_NAMES else []
    return models.Div(name="legend", text=f"kind: {' &emsp; '.join(marks + remainder)}", sizing_mode="stretch_width")


def _colour_choice(gap: GapArrays, source: ColumnDataSource, legend: Model) -> Model:
    titles = _covariate_titles(gap)
    columns = {name: name for name in LABELS} | {f"by {name}": title for name, title in titles.items()}
    choice = Select(name="colour", title="colour by", value=LABELS[0], options=list(columns.items()), width=160)
    scales = {"palette": COLOURS, "ramp": RAMP, "titles": columns, "most": LEGEND_NAMES}
    return _changed(choice, "colour", source=source, legend=legend, **scales)


#: most points of all paths, of one, and of a gap along a run
ALL_POINTS: Final = 12_000
PATH_POINTS: Final = 60
TRACE_POINTS: Final = 120
#: gap along a run -> column of `gap_along_runs`
ALONG: Final = {"along (mm)": 1, "heading (mrad)": 2}
#: what the gap along a run is drawn against -> its column there
RUN_AXES: Final = {"travelled distance (m)": 0, "time (s)": 3}
LABELS: Final = ("kind", "session", "run")


def run_paths(diagnosis: Diagnosis, campaign: Campaign) -> dict[str, list[FloatArray]]:
    """Return the paths of the observations by `PATH_STYLES`: time, x, y from the start, shape (n_samples, 3)."""
    observations = diagnosis.observations
    limit = int(np.clip(ALL_POINTS // max(len(observations), 1), 8, PATH_POINTS))
    paths = {
        which: [np.column_stack((time_s, poses[:, :2])) for time_s, poses in tracks_of(path)]
        for which, path in (("before", diagnosis.nominal), ("after", diagnosis.correction.path))
    }
    paths["reference"] = _measured(observations, campaign.included())
    return {which: [path[evenly(len(path), limit)] for path in drawn] for which, drawn in paths.items()}


def _measured(s: Observations, campaign: Campaign) -> list[FloatArray]:
    paths = []
    for measured, from_log in zip(measured_poses(campaign, s), s.from_log, strict=True):
        path = np.zeros((0, 3))
        if measured is not None and from_log:
            t_s, poses = measured
            seen = in_frame((poses - poses[0]).T, np.full(len(poses), poses[0, 2]))
            path = np.column_stack((t_s, seen[:, :2]))
        paths.append(path)
    return paths


def gap_along_runs(observations: Observations, campaign: Campaign) -> list[FloatArray]:
    """Return distance (m), gap along (m) and in heading (rad), and time (s) of each observation, shape (n_samples, 4).

    Empty for observations without a continuous reference or range; NaN where not measured.
    """
    along: list[FloatArray] = [np.zeros((0, 4))] * len(observations)
    first = {str(name): k for k, name in reversed(list(enumerate(observations.labels["run_id"])))}
    for trace in traces_of(campaign, observations):
        columns = np.stack((trace.way_m, trace.along_m, trace.heading_rad, trace.time_s), axis=1)
        along[first[trace.run_id]] = columns[:: max(1, len(trace.way_m) // TRACE_POINTS)]
    return along


def panel_columns(
    gap: GapArrays, along: list[FloatArray], paths: Mapping[str, list[FloatArray]], palette: tuple[str, ...]
) -> dict[str, object]:
    """Return the columns of all panels, a row an observation."""
    names = natural(gap.labels["kind"])
    columns: dict[str, object] = {label: gap.labels["run_id" if label == "run" else label] for label in LABELS}
    columns["colour"] = [palette[names.index(str(name)) % len(palette)] for name in gap.labels["kind"]]
    columns["by order driven"] = np.arange(1.0, len(gap.before) + 1)
    columns |= {f"by {name}": values for name, values in gap.covariates.items()}
    for channel, (name, _) in enumerate(gap.channels):
        columns[f"before {name}"] = 1e3 * gap.before[:, channel]
        columns[f"after {name}"] = 1e3 * gap.after[:, channel]
    first = _first_channel(gap)
    columns["x"] = columns["by order driven"]
    columns["y"] = columns["b"] = columns[f"before {first}"]
    columns["a"] = columns[f"after {first}"]
    if gap.offset_m is not None:
        for place, axis in enumerate("txy"):
            for which, drawn in paths.items():
                columns[f"{which}_{axis}"] = [path[:, place].astype(np.float32) for path in drawn]
                if place:
                    columns[f"now_{which}_{axis}"] = [path[-1, place] if len(path) else np.nan for path in drawn]
            if place:
                columns[f"end_{axis}"] = np.array([path[-1, place] for path in paths["before"]])
                columns[f"off_{axis}"] = gap.offset_m[:, place - 1]
    if any(len(path) for path in along):
        for name, place in RUN_AXES.items():
            columns[f"way {name}"] = [np.round(path[:, place], 4) for path in along]
        columns["way"] = columns[f"way {next(iter(RUN_AXES))}"]
        columns |= {f"gap {name}": [1e3 * path[:, place] for path in along] for name, place in ALONG.items()}
    return columns


def _first_channel(gap: GapArrays) -> str:
    ratios = [rms(column) for column in (gap.before / np.where(gap.noise_level > 0, gap.noise_level, np.nan)).T]
    return gap.channels[int(np.nanargmax(ratios)) if np.isfinite(ratios).any() else 0][0]


def _channel_units(gap: GapArrays) -> dict[str, str]:
    measured = np.asarray(np.isfinite(gap.before).any(axis=0))
    return {name: f"m{unit}" for (name, unit), on in zip(gap.channels, measured, strict=True) if on}


def _noise_limits(gap: GapArrays) -> dict[str, float]:
    limits = {name: 2e3 * rms(column) for (name, _), column in zip(gap.channels, gap.noise_level.T, strict=True)}
    return {name: float(np.nan_to_num(limits[name])) for name in _channel_units(gap)}


def _covariate_titles(gap: GapArrays) -> dict[str, str]:
    return {"order driven": "order driven"} | {name: with_unit(name) for name in gap.covariates}
