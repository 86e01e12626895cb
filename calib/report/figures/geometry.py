"""The picture of a geometry: paths before and after the calibration, beside the reference, by kind of route."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from matplotlib.figure import Figure

from calib.geometry.parts import RunPath
from calib.report.figures.style import BLUE, GREY, INK, ORANGE, axes_grid, canvas, shared_legend, styled

COLUMNS: Final = 3
PANEL_CM: Final = 5.6
#: paths drawn a panel; more of one kind lie on one another
MOST: Final = 12


@styled
def draw_paths(paths: Sequence[RunPath], *, simulated: bool = False) -> Figure:
    """Draw the paths by kind of route: nominal odometry, calibrated odometry, and the reference.

    `simulated`: say that a program made the data.
    """
    kinds = list(dict.fromkeys(path.kind for path in paths))
    rows = -(-len(kinds) // COLUMNS)
    figure = canvas(PANEL_CM * rows + 1.2)
    grid = axes_grid(figure, rows, COLUMNS).ravel()
    handles: dict[str, Any] = {}
    for axes, kind in zip(grid, kinds, strict=False):
        chosen = [path for path in paths if path.kind == kind]
        for path in chosen[:MOST]:
            for points, colour, width, label in (
                (path.reference, INK, 1.6, "reference"),
                (path.before, ORANGE, 0.8, "odometry before"),
                (path.after, BLUE, 0.8, "odometry after"),
            ):
                (line,) = axes.plot(points[:, 0], points[:, 1], color=colour, lw=width, alpha=0.7, label=label)
                axes.plot(points[-1:, 0], points[-1:, 1], "o", color=colour, ms=2.5)
                handles.setdefault(label, line)
        axes.set_title(f"{kind or 'all runs'} ({len(chosen)})")
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(xlabel="x m", ylabel="y m")
    for axes in grid[len(kinds) :]:
        axes.set_axis_off()
    shared_legend(figure, list(handles.values()), list(handles))
    if simulated:
        figure.text(0.99, 0.01, "SIMULATED DATA", ha="right", color=GREY)
    return figure
