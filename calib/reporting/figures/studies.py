"""Figures of wheel loads, of Section 7, of errors along a path; of a fleet's radii, and of the score of a challenge."""

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch
from matplotlib.ticker import MaxNLocator

from calib.fleet.run import Fleet, drifts_of
from calib.fleet.vehicle import WHEELS, Drift, VehicleRecord
from calib.odometry.law_path import LawPath
from calib.odometry.poses import COMPONENTS, ellipses
from calib.odometry.replay import Replay
from calib.odometry.simulation import Sweep, TableRow
from calib.radius.law import WheelLaw
from calib.reporting import Drawings, catalogue, figures
from calib.reporting.figures import BLUE, GREY, INK, ORANGE, SKY, canvas, colour, figure_title, round_down, styled
from calib.vehicle import LoadSweep

if TYPE_CHECKING:
    from calib.challenge.score import Score, Share

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
    major_m, minor_m, angle_rad = ellipses(path.corrected.systematic + path.corrected.random)
    route = path.corrected.poses
    extent = max(float(np.ptp(path.reference.x_m)), float(np.ptp(path.reference.y_m)), 1.0)
    scale = round_down(0.125 * extent / max(float(major_m.max()), 1e-9))
    for k in np.unique(np.linspace(0, len(route) - 1, 13).astype(int))[1:]:
        size = 2 * scale * major_m[k], 2 * scale * minor_m[k]
        angle = float(np.degrees(angle_rad[k]))
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


@styled
def board_figure(score: "Score") -> Figure:
    """Draw the board, detection by signal, reliability of probabilities, and closure."""
    figure = canvas(19.0, 24.0)
    halves = figure.add_gridspec(2, 1, height_ratios=(1.25, 1.0))
    _board(figure.add_subfigure(halves[0]).add_subplot(), score)
    lower = figure.add_subfigure(halves[1])
    left, middle, right = (lower.add_subplot(1, 3, place) for place in (1, 2, 3))
    _signals(left, score)
    _reliability(middle, score)
    _closure(right, score)
    about = f"{len(score.cases)} sealed cases ({score.purpose or 'unnamed'} seeds), truth {score.truth_sha256[:12]}"
    figure_title(figure, about)
    return figure


def _board(axes: Axes, score: "Score") -> None:
    lines = [(name, share) for name, share in score.board.items() if share.total]
    for row, (name, share) in enumerate(reversed(lines)):
        met = score.meets(name)
        color = GREY if met is None else figures.GREEN if met else ORANGE
        axes.plot(share.wilson95, [row, row], color=color, lw=2.5, solid_capstyle="butt")
        axes.plot([share.rate or 0.0], [row], "o", color=color, ms=6)
        if target := score.target(name):
            wanted, sense = target
            axes.plot([wanted], [row], "|", color=INK, ms=14, mew=1.5)
            axes.annotate("≥" if sense == "at least" else "≤", (wanted, row), (-10, 5), textcoords="offset points")
        axes.annotate(f"{share.hits}/{share.total}", (1.005, row), xycoords=("axes fraction", "data"), va="center")
    axes.set_yticks(range(len(lines)), [name for name, _ in reversed(lines)])
    about = "share of cases, with Wilson's 95 % interval; black bar: target"
    axes.set(xlim=(-0.01, 1.01), ylim=(-0.7, len(lines) - 0.3), xlabel=about)


def _signals(axes: Axes, score: "Score") -> None:
    styles = {
        "detected": (GREY, "s", "a gap seen"),
        "first": (BLUE, "o", "named first"),
        "in_group": (figures.GREEN, "^", "named, or in its group"),
        "covered": (ORANGE, "v", "in the 95 % set"),
    }
    ticks = [float(signal) for signal in score.by_signal]
    for number, (key, (color, marker, words)) in enumerate(styles.items()):
        points = [(float(signal), row[key]) for signal, row in score.by_signal.items() if row[key].total]
        if not points:
            continue
        x = np.array([signal for signal, _ in points]) * (1 + 0.03 * (number - 1.5))
        _with_bars(axes, x, [share for _, share in points], color=color, marker=marker, label=words)
    axes.set_xscale("log")
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set(ylim=(-0.02, 1.02), ylabel="share of single-effect cases", title="Detection by signal")
    axes.set_xlabel("signal (whitened norm after recalibration)")
    if axes.lines:
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)


def _with_bars(axes: Axes, x: np.ndarray, shares: "list[Share]", *, color: str, marker: str, label: str) -> None:
    rates = np.array([part.rate or 0.0 for part in shares])
    bars = np.array([part.wilson95 for part in shares])
    spread = np.abs(np.stack([rates - bars[:, 0], bars[:, 1] - rates]))
    axes.errorbar(x, rates, yerr=spread, color=color, marker=marker, ms=5, lw=1.2, capsize=2, label=label)


def _reliability(axes: Axes, score: "Score") -> None:
    axes.plot([0, 1], [0, 1], color=GREY, lw=1)
    axes.fill_between([0, 1], [-0.05, 0.95], [0.05, 1.05], color=GREY, alpha=0.15, lw=0)
    if score.reliability:
        stated, shares = np.array([one.stated for one in score.reliability]), [one.true for one in score.reliability]
        _with_bars(axes, stated, shares, color=BLUE, marker="o", label="")
        for x, line in zip(stated, shares, strict=True):
            axes.annotate(str(line.total), (x, 0.02), ha="center", color=GREY)
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02), ylabel="share that is true", title="Reliability")
    axes.set_xlabel("stated probability of a named cause (below: statements)")


def _closure(axes: Axes, score: "Score") -> None:
    pairs = [
        (one.predicted, one.achieved) for one in score.cases if one.predicted is not None and one.achieved is not None
    ]
    axes.set_title("Closure")
    if pairs:
        values = np.clip(np.array(pairs), -0.5, 1.1)
        axes.plot([-0.5, 1.1], [-0.5, 1.1], color=GREY, lw=1)
        axes.plot(values[:, 0], values[:, 1], "o", color=BLUE, ms=4, alpha=0.6)
        axes.set(xlabel="predicted on held-out runs", ylabel="achieved on a fresh campaign")
    else:
        stated = [case.predicted for case in score.cases if case.predicted is not None]
        axes.hist(np.clip(stated, -0.5, 1.1), bins=np.linspace(-0.5, 1.1, 17).tolist(), color=BLUE)
        axes.set(xlabel="closure stated by the verdicts", ylabel="cases")


@styled
def confusion_figure(score: "Score") -> Figure:
    """Draw what was named first for each truth; the diagonal is right."""
    truths = list(score.confusion)
    answers = {name for row in score.confusion.values() for name in row}
    plain = [name for name in truths if not name.startswith(("deleted: ", "outside:", "nothing"))]
    words = [name for name in ("no_gap", "unknown", "ambiguous", "error", "missing") if name in answers]
    columns = [name for name in plain if name in answers] + sorted(answers - set(plain) - set(words)) + words
    rows = plain + [name for name in truths if name not in plain]
    counts = np.array([[score.confusion[truth].get(name, 0) for name in columns] for truth in rows], dtype=np.float64)
    counts = counts.reshape(len(rows), len(columns))
    figure = canvas(6.0 + 0.42 * len(rows), 8.0 + 0.5 * len(columns))
    axes = figure.add_subplot()
    axes.grid(visible=False)
    total = np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(counts / total, cmap="Blues", vmin=0, vmax=2.2, aspect="auto")
    for row, column in zip(*np.nonzero(counts), strict=True):
        hidden = rows[row].startswith(("deleted: ", "outside:"))
        wanted = "unknown" if hidden else "no_gap" if rows[row] == "nothing" else rows[row]
        fine = columns[column] == wanted
        axes.text(column, row, f"{counts[row, column]:.0f}", ha="center", va="center", color=INK if fine else ORANGE)
    axes.set_xticks(range(len(columns)), columns, rotation=90)
    axes.set_yticks(range(len(rows)), rows)
    axes.set(xlabel="named first, or the verdict", ylabel="truth")
    return figure


def fleet_figures(fleet: Fleet) -> Drawings:
    """Return what draws the vehicles' radii and slopes in order of size, and with days their drift."""
    fitted = [record for record in fleet.records if record.status == "fitted"]
    if not fitted:
        return {}
    odd = {outlier.vehicle for outlier in fleet.view.outliers}
    named = {(one.vehicle, one.wheel) for one in fleet.view.drifting}
    drifts = [(drift, (record.vehicle, side) in named) for record, side, drift in drifts_of(fitted)]
    drawings = {"distribution": partial(_distribution, fitted, odd)}
    return drawings | ({"drift": partial(_drift, *zip(*drifts, strict=True))} if drifts else {})


@styled
def _distribution(fitted: Sequence[VehicleRecord], odd: set[str]) -> Figure:
    figure = canvas(10.0)
    grid = figure.subplots(2, 2)
    marked = np.array([record.vehicle in odd for record in fitted])
    for column, side in enumerate(WHEELS):
        lines = [getattr(record, side) for record in fitted]
        for axes, value, ends, scale in (
            (grid[0, column], "radius_ref_m", "radius_ci95_m", 1e3),
            (grid[1, column], "slope_m_per_N", "slope_ci95_m_per_N", 1e6),
        ):
            values, intervals = (scale * np.array([getattr(line, key) for line in lines]) for key in (value, ends))
            figures.draw_ordered(axes, values, intervals, marked)
            axes.axhline(float(np.median(values[~marked] if (~marked).any() else values)), color=BLUE, linewidth=0.8)
        grid[0, column].set(title=f"{side} wheel", ylabel="radius at reference load (mm)")
        grid[1, column].set(ylabel="slope (µm/N)", xlabel="vehicles in order of size (orange: outlying)")
    return figure


@styled
def _drift(drifts: Sequence[Drift], marked: Sequence[bool]) -> Figure:
    from scipy.special import stdtrit

    rate = np.array([1e9 * drift.per_day_m for drift in drifts])
    half = np.array([1e9 * drift.std_m * float(stdtrit(drift.dof, 0.975)) for drift in drifts])
    figure = canvas(6.0)
    axes = figure.add_subplot()
    figures.draw_ordered(axes, rate, np.column_stack((rate - half, rate + half)), np.array(marked))
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.set(ylabel="drift of the radius (nm/day)", xlabel="wheels in order of drift (orange: drifts)")
    return figure
