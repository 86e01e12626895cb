"""What a plan of runs can tell apart, as a picture: effect by effect, in standard deviations."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from calib.gap.plan.outlook import Outlook
from calib.report.figures.style import INK, canvas, styled

#: bounds of the classes in standard deviations; below 3 two effects cannot be told apart
BOUNDS: Final = (0.0, 1.0, 3.0, 5.0, 10.0, 1e12)
SHADES: Final = ("#B2482C", "#E39A72", "#F1E3C8", "#8FBBD3", "#2F78A8")


@styled
def plan_matrix(outlook: Outlook) -> Figure:
    """Draw the matrix: row, the effect at work at its typical size; column, the effect that might be mistaken for it.

    The first column says how well the effect is seen at all.
    """
    n = len(outlook.effects)
    figure = canvas(float(np.clip(5.0 + 0.36 * n, 8.0, 21.0)))
    axis = figure.add_subplot()
    distance = np.column_stack((outlook.signal, np.where(np.isfinite(outlook.distance), outlook.distance, np.nan)))
    shown = np.ma.masked_invalid(distance)
    colours = ListedColormap(list(SHADES)).with_extremes(bad="white")
    image = axis.imshow(shown, cmap=colours, norm=BoundaryNorm(list(BOUNDS), colours.N), aspect="auto")
    names = [name.replace("_", " ") for name in outlook.effects]
    axis.set_xticks(range(n + 1), ["(seen at all)", *names], rotation=90)
    told = outlook.told_apart
    axis.set_yticks(
        range(n), [f"{name}  {'told apart' if yes else '–'}" for name, yes in zip(names, told, strict=True)]
    )
    axis.tick_params(length=0, labelsize=5.5)
    axis.set_xticks(np.arange(-0.5, n + 1), minor=True)
    axis.set_yticks(np.arange(-0.5, n), minor=True)
    axis.grid(visible=False, which="major")
    axis.grid(which="minor", color="white", lw=0.5)
    axis.tick_params(which="minor", length=0)
    axis.axvline(0.5, color=INK, lw=0.8)
    axis.set_title(f"{int(told.sum())} of {n + len(outlook.absent)} effects can be told apart at their typical size")
    axis.set_ylabel("effect at work")
    axis.set_xlabel("effect that might be named instead")
    bar = figure.colorbar(image, ax=axis, spacing="uniform", shrink=0.5, pad=0.01)
    bar.set_ticks([0.5, 2.0, 4.0, 7.5, 5e11], labels=["below 1", "1 to 3", "3 to 5", "5 to 10", "above 10"])
    bar.ax.tick_params(which="both", length=0)
    bar.set_label("distance (standard deviations)")
    return figure
