"""The score as pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.challenge.intervals import Share, wilson
from calib.challenge.score import TARGETS, Score
from calib.errors import BadInputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["board_figure", "confusion_figure", "save"]

_BLUE: Final = "#0072b2"
_ORANGE: Final = "#d55e00"
_GREEN: Final = "#009e73"
_GREY: Final = "#666666"
_SUFFIXES: Final = (".png", ".svg", ".pdf")


def board_figure(score: Score) -> Figure:
    """Draw the board against its targets, detection by signal, reliability of probabilities, and closure."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 9.5), layout="constrained")
    halves = figure.add_gridspec(2, 1, height_ratios=(1.25, 1.0))
    _board(figure.add_subfigure(halves[0]).add_subplot(), score)
    lower = figure.add_subfigure(halves[1])
    left, middle, right = (lower.add_subplot(1, 3, place) for place in (1, 2, 3))
    _signals(left, score)
    _reliability(middle, score)
    _closure(right, score)
    about = f"{len(score.cases)} sealed cases ({score.purpose or 'unnamed'} seeds), truth {score.truth_sha256[:12]}"
    figure.suptitle(about, fontsize=11, color=_GREY)
    return figure


def _board(axes: Axes, score: Score) -> None:
    lines = [(name, one) for name, one in score.board.items() if one.total]
    for row, (name, one) in enumerate(reversed(lines)):
        low, high = wilson(one.hits, one.total)
        met = score.meets(name)
        color = _GREY if met is None else _GREEN if met else _ORANGE
        axes.plot([low, high], [row, row], color=color, lw=2.5, solid_capstyle="butt")
        axes.plot([one.rate or 0.0], [row], "o", color=color, ms=6)
        if name in TARGETS:
            wanted, sense = TARGETS[name]
            axes.plot([wanted], [row], "|", color="black", ms=16, mew=1.5)
            axes.annotate(
                "≥" if sense == "at least" else "≤", (wanted, row), (-10, 5), textcoords="offset points", fontsize=8
            )
        axes.annotate(
            f"{one.hits}/{one.total}", (1.005, row), xycoords=("axes fraction", "data"), va="center", fontsize=8.5
        )
    axes.set_yticks(range(len(lines)), [name for name, _ in reversed(lines)], fontsize=9)
    axes.set_xlim(-0.01, 1.01)
    axes.set_ylim(-0.7, len(lines) - 0.3)
    axes.set_xlabel("share of cases, with Wilson's 95 % interval; black bar: target")
    axes.grid(axis="x", alpha=0.3)


def _signals(axes: Axes, score: Score) -> None:
    styles = {"detected": (_GREY, "s"), "first": (_BLUE, "o"), "in_group": (_GREEN, "^"), "covered": (_ORANGE, "v")}
    words = {
        "detected": "a gap seen",
        "first": "named first",
        "in_group": "named, or in its group",
        "covered": "in the 95 % set",
    }
    ticks = [float(signal) for signal in score.by_signal]
    for number, (key, (color, marker)) in enumerate(styles.items()):
        points = [(float(signal), row[key]) for signal, row in score.by_signal.items() if row[key].total]
        if not points:
            continue
        x = np.array([signal for signal, _ in points]) * (1 + 0.03 * (number - 1.5))
        _with_bars(axes, x, [one for _, one in points], color=color, marker=marker, label=words[key])
    axes.set_xscale("log")
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set_ylim(-0.02, 1.02)
    axes.set_xlabel("signal (whitened norm after recalibration)")
    axes.set_ylabel("share of single-effect cases")
    axes.set_title("Detection by signal", loc="left", fontsize=10)
    axes.grid(alpha=0.3)
    if axes.lines:
        axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2)


def _with_bars(axes: Axes, x: np.ndarray, shares: list[Share], *, color: str, marker: str, label: str) -> None:
    rates = np.array([part.rate or 0.0 for part in shares])
    bars = np.array([wilson(part.hits, part.total) for part in shares])
    spread = np.abs(np.stack([rates - bars[:, 0], bars[:, 1] - rates]))
    axes.errorbar(x, rates, yerr=spread, color=color, marker=marker, ms=5, lw=1.2, capsize=2, label=label)


def _reliability(axes: Axes, score: Score) -> None:
    axes.plot([0, 1], [0, 1], color=_GREY, lw=1)
    axes.fill_between([0, 1], [-0.05, 0.95], [0.05, 1.05], color=_GREY, alpha=0.15, lw=0)
    if score.reliability:
        stated = np.array([line["stated"] for line in score.reliability])
        shares = [Share(line["true"]["hits"], line["true"]["total"]) for line in score.reliability]
        _with_bars(axes, stated, shares, color=_BLUE, marker="o", label="")
        for x, line in zip(stated, shares, strict=True):
            axes.annotate(str(line.total), (x, 0.02), ha="center", fontsize=7.5, color=_GREY)
    axes.set_xlim(0, 1.02)
    axes.set_ylim(0, 1.02)
    axes.set_xlabel("stated probability of a named cause (below: statements)")
    axes.set_ylabel("share that is true")
    axes.set_title("Reliability", loc="left", fontsize=10)
    axes.grid(alpha=0.3)


def _closure(axes: Axes, score: Score) -> None:
    pairs = [
        (case.predicted, case.achieved)
        for case in score.cases
        if case.predicted is not None and case.achieved is not None
    ]
    axes.set_title("Closure", loc="left", fontsize=10)
    if pairs:
        values = np.clip(np.array(pairs), -0.5, 1.1)
        axes.plot([-0.5, 1.1], [-0.5, 1.1], color=_GREY, lw=1)
        axes.plot(values[:, 0], values[:, 1], "o", color=_BLUE, ms=4, alpha=0.6)
        axes.set_xlabel("predicted on held-out runs")
        axes.set_ylabel("achieved on a fresh campaign")
    else:
        stated = [case.predicted for case in score.cases if case.predicted is not None]
        axes.hist(np.clip(stated, -0.5, 1.1), bins=np.linspace(-0.5, 1.1, 17).tolist(), color=_BLUE)
        axes.set_xlabel("closure stated by the verdicts")
        axes.set_ylabel("cases")
    axes.grid(alpha=0.3)


def confusion_figure(score: Score) -> Figure:
    """Draw what was named first for each truth; the diagonal is right."""
    from matplotlib.figure import Figure

    truths = list(score.confusion)
    answers = {name for row in score.confusion.values() for name in row}
    plain = [name for name in truths if not name.startswith(("deleted: ", "outside:", "nothing"))]
    words = [name for name in ("no_gap", "unknown", "ambiguous", "error", "missing") if name in answers]
    columns = [name for name in plain if name in answers] + sorted(answers - set(plain) - set(words)) + words
    rows = plain + [name for name in truths if name not in plain]
    counts = np.array([[score.confusion[truth].get(name, 0) for name in columns] for truth in rows], dtype=np.float64)
    counts = counts.reshape(len(rows), len(columns))
    figure = Figure(figsize=(3.5 + 0.27 * len(columns), 2.5 + 0.2 * len(rows)), layout="constrained")
    axes = figure.add_subplot()
    total = np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(counts / total, cmap="Blues", vmin=0, vmax=1.3, aspect="auto")
    for row, column in zip(*np.nonzero(counts), strict=True):
        hidden = rows[row].startswith(("deleted: ", "outside:"))
        wanted = "unknown" if hidden else "no_gap" if rows[row] == "nothing" else rows[row]
        fine = columns[column] == wanted
        text = f"{counts[row, column]:.0f}"
        axes.text(column, row, text, ha="center", va="center", fontsize=7, color="black" if fine else _ORANGE)
    axes.set_xticks(range(len(columns)), columns, rotation=90, fontsize=7)
    axes.set_yticks(range(len(rows)), rows, fontsize=7)
    axes.set_xlabel("named first, or the verdict")
    axes.set_ylabel("truth")
    return figure


def save(figure: Figure, path: Path, *, force: bool = False) -> Path:
    """Save a figure as PNG, SVG or PDF, whole.

    Raises
    ------
    BadInputError
        Where the suffix is another, or the file exists and `force` is False.
    """
    from io import BytesIO

    from calib.files import refuse_existing, write_bytes

    path = Path(path)
    if path.suffix.lower() not in _SUFFIXES:
        raise BadInputError(f"{path}: found {path.suffix!r}; expected .png, .svg or .pdf; choose one of these")
    refuse_existing([path], force=force)
    stream = BytesIO()
    # no date in the file: the same score gives the same bytes
    bare = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(path.suffix.lower())
    figure.savefig(stream, format=path.suffix.lower()[1:], dpi=150, metadata=bare)
    return write_bytes(path, stream.getvalue(), force=force)
