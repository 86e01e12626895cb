"""The uncertainty budget as bars: which contribution rules."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from calib.radius.effective import Component
from calib.report.figures.style import BLUE, GREY, ORANGE, canvas, legible, shared_legend, styled


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
