"""The score of a challenge, and the radii of a fleet, as pictures."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib.challenge.score import TARGETS, Score, Share, wilson
from calib.errors import BadInputError
from calib.fleet.run import Fleet, drifts_of
from calib.fleet.vehicle import WHEELS, Drift, VehicleRecord
from calib.io import write_bytes
from calib.reporting.blocks import Drawings
from calib.reporting.figures import style
from calib.reporting.figures.style import BLUE, GREY, INK, ORANGE, canvas, draw_ordered, figure_title, render, styled

GREEN: Final = style.PALETTE[2]


@styled
def board_figure(score: Score) -> Figure:
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


def _board(axes: Axes, score: Score) -> None:
    lines = [(name, share) for name, share in score.board.items() if share.total]
    for row, (name, share) in enumerate(reversed(lines)):
        low, high = wilson(share.hits, share.total)
        met = score.meets(name)
        color = GREY if met is None else GREEN if met else ORANGE
        axes.plot([low, high], [row, row], color=color, lw=2.5, solid_capstyle="butt")
        axes.plot([share.rate or 0.0], [row], "o", color=color, ms=6)
        if name in TARGETS:
            wanted, sense = TARGETS[name]
            axes.plot([wanted], [row], "|", color=INK, ms=14, mew=1.5)
            axes.annotate("≥" if sense == "at least" else "≤", (wanted, row), (-10, 5), textcoords="offset points")
        axes.annotate(f"{share.hits}/{share.total}", (1.005, row), xycoords=("axes fraction", "data"), va="center")
    axes.set_yticks(range(len(lines)), [name for name, _ in reversed(lines)])
    about = "share of cases, with Wilson's 95 % interval; black bar: target"
    axes.set(xlim=(-0.01, 1.01), ylim=(-0.7, len(lines) - 0.3), xlabel=about)


def _signals(axes: Axes, score: Score) -> None:
    styles = {
        "detected": (GREY, "s", "a gap seen"),
        "first": (BLUE, "o", "named first"),
        "in_group": (GREEN, "^", "named, or in its group"),
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


def _with_bars(axes: Axes, x: np.ndarray, shares: list[Share], *, color: str, marker: str, label: str) -> None:
    rates = np.array([part.rate or 0.0 for part in shares])
    bars = np.array([wilson(part.hits, part.total) for part in shares])
    spread = np.abs(np.stack([rates - bars[:, 0], bars[:, 1] - rates]))
    axes.errorbar(x, rates, yerr=spread, color=color, marker=marker, ms=5, lw=1.2, capsize=2, label=label)


def _reliability(axes: Axes, score: Score) -> None:
    axes.plot([0, 1], [0, 1], color=GREY, lw=1)
    axes.fill_between([0, 1], [-0.05, 0.95], [0.05, 1.05], color=GREY, alpha=0.15, lw=0)
    if score.reliability:
        stated, shares = np.array([one.stated for one in score.reliability]), [one.true for one in score.reliability]
        _with_bars(axes, stated, shares, color=BLUE, marker="o", label="")
        for x, line in zip(stated, shares, strict=True):
            axes.annotate(str(line.total), (x, 0.02), ha="center", color=GREY)
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02), ylabel="share that is true", title="Reliability")
    axes.set_xlabel("stated probability of a named cause (below: statements)")


def _closure(axes: Axes, score: Score) -> None:
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
def confusion_figure(score: Score) -> Figure:
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
        text = f"{counts[row, column]:.0f}"
        axes.text(column, row, text, ha="center", va="center", color=INK if fine else ORANGE)
    axes.set_xticks(range(len(columns)), columns, rotation=90)
    axes.set_yticks(range(len(rows)), rows)
    axes.set(xlabel="named first, or the verdict", ylabel="truth")
    return figure


def save(figure: Figure, path: Path, *, force: bool = False) -> Path:
    """Save a figure as PNG, SVG or PDF; raises BadInputError for another suffix, or a file that exists."""
    form = path.suffix.lower()[1:]
    if form not in style.FORMS:
        raise BadInputError(f"{path}: found {path.suffix!r}; expected .png, .svg or .pdf; choose one of these")
    return write_bytes(path, render(figure, form), force=force)


def fleet_figures(fleet: Fleet) -> Drawings:
    """Return what draws the vehicles' radii and slopes in order of size, and with days their drift."""
    fitted = [record for record in fleet.records if record.status == "fitted"]
    if not fitted:
        return {}
    odd = {outlier.vehicle for outlier in fleet.view.outliers}
    named = {(one.vehicle, one.wheel) for one in fleet.view.drifting}
    drifts = [(drift, (record.vehicle, side) in named) for record, side, drift in drifts_of(fitted)]
    figures = {"distribution": partial(_distribution, fitted, odd)}
    return figures | ({"drift": partial(_drift, *zip(*drifts, strict=True))} if drifts else {})


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
            draw_ordered(axes, values, intervals, marked)
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
    draw_ordered(axes, rate, np.column_stack((rate - half, rate + half)), np.array(marked))
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.set(ylabel="drift of the radius (nm/day)", xlabel="wheels in order of drift (orange: drifts)")
    return figure
