"""Figures, drawn without a display: style and files, of the same bytes each time."""

import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache, wraps
from pathlib import Path
from typing import Any, Final, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib.errors import BadInputError
from calib.io import refuse_existing, write_bytes, write_files
from calib.radius import Groups, groups_of
from calib.types import BoolArray, FloatArray, Progress, StrArray, silent, stepped

P = ParamSpec("P")

#: Okabe and Ito's, told apart by colour-blind readers, dark first
PALETTE: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#7A5C00", "#56B4E9", "#E69F00", "#5D5D5D")
BLUE, ORANGE, GREEN, SKY = PALETTE[0], PALETTE[1], PALETTE[2], PALETTE[5]
INK: Final = "#222222"
GREY: Final = "#8A8A8A"
#: of the text on the page
WIDTH_CM: Final = 17.0
CM_PER_INCH: Final = 2.54
#: legend's characters in the width
LINE_CHARACTERS: Final = 118
LEGEND_LIMIT: Final = 8
#: more markers are pixels inside the vector figure
MANY: Final = 2000
LEGEND_GAP: Final = 6
LABEL_LIMIT: Final = 18


def styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Make `draw` use the report's style alone."""

    @wraps(draw)
    def inner(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with mpl.rc_context(_rc()):
            return draw(*args, **kwargs)

    return inner


_STYLE: Final[Any] = mpl.rc_params_from_file(Path(__file__).with_name("calib.mplstyle"), use_default_template=False)


def _rc() -> Any:
    return {**mpl.rcParamsDefault, "backend": mpl.rcParams["backend"], **_STYLE}


def canvas(height_cm: float, width_cm: float = WIDTH_CM) -> Figure:
    """Return an empty figure of a size given in cm; needs no display."""
    return Figure(figsize=(width_cm / CM_PER_INCH, height_cm / CM_PER_INCH), layout="constrained")


def figure_title(figure: Figure, text: str) -> None:
    """Put a title over all axes, at the left."""
    figure.suptitle(text, x=0.01, ha="left")


def shared_legend(figure: Figure, handles: Sequence[Any], labels: Sequence[str], *, below: bool = False) -> None:
    """Put one legend outside the axes, in as many columns as labels allow."""
    if labels:
        lengths = [len(text) + LEGEND_GAP for text in labels]
        columns = len(labels) if sum(lengths) <= LINE_CHARACTERS else max(1, LINE_CHARACTERS // max(lengths))
        look: Any = {"loc": "outside lower center" if below else "outside upper center", "ncols": columns}
        figure.legend(handles, labels, handlelength=1.2, handletextpad=0.5, columnspacing=1.4, **look)


def group_legend(figure: Figure, axis: Any, names: Sequence[str] | StrArray, *, below: bool = False) -> None:
    """Put a legend of groups outside the axes, unless there are too many."""
    if 1 < len(names) <= LEGEND_LIMIT:
        shared_legend(figure, *axis.get_legend_handles_labels(), below=below)


def named_groups(labels: StrArray, none: str, limit: int = LABEL_LIMIT) -> Groups:
    """Return runs (n,) by label under names that fit a legend; an empty one is `none`."""
    groups = groups_of(labels)
    return replace(groups, names=np.array([_short(str(name), none, limit) for name in groups.names]))


def draw_groups(axis: Axes, groups: Groups, x: FloatArray, y: FloatArray, **style: Any) -> None:
    """Draw runs at `x` and `y` (n,) as dots in the colours of their groups; `style`: see `Axes.plot`."""
    style = {"marker": ".", "linestyle": "none", "rasterized": len(groups.index) > MANY, **style}
    for number, name in enumerate(groups.names):
        on = groups.index == number
        axis.plot(x[on], y[on], color=colour(number), label=name, **style)


def _short(name: str, none: str, limit: int) -> str:
    text = legible(name.strip()) or none
    text = text if len(text) <= limit else f"{text[: limit // 2]}…{text[1 - (limit + 1) // 2 :]}"
    return f"\u200b{text}" if text.startswith("_") else text


def over_runs(axis: Axes, label: str = "run, in the order driven") -> None:
    """Label an axis that counts runs, in whole numbers."""
    axis.set_xlabel(label)
    axis.locator_params(axis="x", integer=True)


def draw_ordered(axis: Axes, values: FloatArray, intervals: FloatArray, marked: BoolArray) -> None:
    """Draw values (n,) in order of size with their intervals (n, 2), those `marked` in orange."""
    order = np.argsort(values)
    place = np.arange(1, len(order) + 1)
    axis.locator_params(axis="x", integer=True)
    axis.vlines(place, *intervals[order].T, color=GREY, linewidth=0.6)
    for chosen, mark, tint, size in ((~marked[order], ".", BLUE, 2.5), (marked[order], "o", ORANGE, 4.0)):
        axis.plot(place[chosen], values[order][chosen], mark, color=tint, markersize=size)


def panels(count: int, head_cm: float, row_cm: float, **options: Any) -> tuple[Figure, Any]:
    """Return a figure of two or three panels a row, and its axes, (rows, columns), those left over hidden."""
    columns = 2 if count in {2, 4} else min(3, max(count, 1))
    rows = max(-(-count // columns), 1)
    figure = canvas(head_cm + row_cm * rows)
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    for axis in axes.flat[count:]:
        axis.set_visible(False)
    return figure, axes


@cache
def _known_signs() -> frozenset[int]:
    from matplotlib.font_manager import findfont
    from matplotlib.ft2font import FT2Font

    return frozenset(FT2Font(findfont("DejaVu Sans")).get_charmap())


def legible(text: str) -> str:
    """Return a text with code points for signs that the font lacks."""
    if text.isascii():
        return text
    return "".join(sign if known(sign) else f"U+{ord(sign):X} " for sign in text).strip()


def known(sign: str) -> bool:
    """Return whether the figures' font can show a sign."""
    return ord(sign) in _known_signs()


def round_down(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above `value`, 1 at least."""
    power = 10.0 ** np.floor(np.log10(max(value, 1.0)))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= max(value, 1.0)))


def colour(number: int) -> str:
    """Return the colour of group `number`; they repeat after eight."""
    return PALETTE[number % len(PALETTE)]


def render(figure: Figure, form: str) -> bytes:
    """Return a figure as bytes of ``svg``, ``png`` or ``pdf``, without a date."""
    named = {"svg": ("Date", "Creator"), "pdf": ("CreationDate", "Creator", "Producer"), "png": ("Software",)}
    metadata: Any = dict.fromkeys(named[form])
    out = io.BytesIO()
    with mpl.rc_context(_rc()):
        figure.savefig(out, format=form, metadata=metadata)
    return out.getvalue()


def render_all(figure: Figure, forms: Sequence[str]) -> dict[str, bytes]:
    """Return a figure in several formats, laid out once: the layout takes as long as a drawing.

    ``svg`` is as `render` gives it, others differ by less than a pixel.
    """
    layout = figure.get_layout_engine()
    drawn: dict[str, bytes] = {}
    try:
        for form in sorted(forms, key=lambda form: form != "svg"):
            drawn[form] = render(figure, form)
            with mpl.rc_context(_rc()):
                figure.set_layout_engine(None)
    finally:
        with mpl.rc_context(_rc()):
            figure.set_layout_engine(layout)
    return {form: drawn[form] for form in forms}


FORMS: Final = ("png", "svg", "pdf")


def save(figure: Figure, path: Path, *, force: bool = False) -> Path:
    """Save a figure as PNG, SVG or PDF; raises BadInputError for another suffix, or a file that exists."""
    form = path.suffix.lower()[1:]
    if form not in FORMS:
        raise BadInputError(f"{path}: found {path.suffix!r}; expected .png, .svg or .pdf; choose one of these")
    return write_bytes(path, render(figure, form), force=force)


def figure_paths(folder: Path, names: Iterable[str]) -> list[Path]:
    """Return the files that figures of these names are written to."""
    return [folder / f"{name}.{form}" for name in names for form in FORMS]


def marked(figure: Figure, *, simulated: bool) -> Figure:
    """Return a figure that marks simulated data at its right edge."""
    if not simulated:
        return figure
    layout: Any = figure.get_layout_engine()
    if layout is not None:
        layout.set(rect=(0.0, 0.0, 0.97, 1.0))
    figure.text(0.995, 0.5, "SIMULATED DATA", ha="right", va="center", rotation=90, color=GREY)
    return figure


def write_figures(
    figures: Mapping[str, Figure],
    folder: Path,
    *,
    simulated: bool = False,
    force: bool = False,
    progress: Progress = silent,
) -> list[Path]:
    """Write figures, by name, into a folder in every format of `FORMS`; `simulated`: see `marked`.

    Raises BadInputError where a file exists, unless `force`; nothing is then written.
    """
    if folder.exists() and not folder.is_dir():
        raise BadInputError(f"{folder}: found a file; expected a folder for the figures; choose another path")
    refuse_existing(figure_paths(folder, figures), force=force)
    drawn: dict[str, bytes] = {}
    for name, figure in stepped(figures.items(), progress, "figures"):
        data = render_all(marked(figure, simulated=simulated), FORMS)
        drawn |= {f"{name}.{form}": content for form, content in data.items()}
    return write_files(folder, drawn, force=force) if drawn else []
