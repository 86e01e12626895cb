"""Signature of an effect, and the matrix of the effects that a plan of runs can tell apart."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from calib.gap.effects.library import EffectSignature
from calib.gap.plan.identifiability import Outlook
from calib.gap.predict import Path
from calib.reporting.figures.style import GREY, INK, canvas, colour, styled
from calib.types import FloatArray, StrArray

CHANNELS = ("distance", "along", "lateral", "heading", "front", "steering")
ANGLES = frozenset({"heading", "steering"})
#: a channel that changes by less (m or rad) counts as unchanged: no instrument resolves a micrometre
UNCHANGED = 1e-6


@styled
def signature_figure(signature: EffectSignature, nominal: Path) -> Figure:
    """Draw a signature.

    `nominal`: the model alone on the same runs. Left the floor plan, one run of each kind, without the effect in grey
    and with it, enlarged, in colour; right the change of each channel at the typical size, a dot a run.
    """
    kinds = nominal.s.labels["kind"]
    names = list(np.unique(kinds))
    moved = np.flatnonzero(np.abs(np.nan_to_num(signature.change)).max(axis=0) > UNCHANGED).tolist()
    figure = canvas(6.4)
    plan, channels = figure.subfigures(1, 2, width_ratios=(1.0, 1.25), squeeze=False)[0]
    _draw_plan(plan.subplots(), signature, nominal, names)
    panels = channels.subplots(max(len(moved), 1), 1, sharex=True, squeeze=False)[:, 0]
    for axes, channel in zip(panels, moved, strict=False):
        _draw_channel(axes, signature.change[:, channel], CHANNELS[channel], kinds, names)
    panels[0].set_title("change at its typical size, channels that move")
    panels[-1].set_xticks(range(len(names)), names, rotation=20, ha="right")
    return figure


def _draw_plan(axes: Axes, signature: EffectSignature, nominal: Path, names: list[str]) -> None:
    s, enlarged = nominal.s, signature.enlarged
    for number, name in enumerate(names):
        units = np.flatnonzero(s.labels["kind"] == name)
        unit = int(units[np.argmax(np.nansum(signature.change[units] ** 2, axis=1))])
        part, tint = slice(int(s.starts[unit]), int(s.starts[unit + 1])), colour(number)
        axes.plot(nominal.steps.x_m[part], nominal.steps.y_m[part], color=GREY, linewidth=0.8)
        axes.plot(enlarged.steps.x_m[part], enlarged.steps.y_m[part], color=tint, linewidth=1.1, label=name)
        axes.plot(*enlarged.end[unit, :2], marker="o", markersize=3, color=tint)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x, m", ylabel="y, m")
    bent = signature.factor > 1.0 and bool(np.ptp(enlarged.end[:, :2] - nominal.end[:, :2]) > 0)
    axes.set_title(f"paths, effect x {signature.factor:.3g}" if bent else "paths (the effect bends none)")


def _draw_channel(axes: Axes, change: FloatArray, name: str, kinds: StrArray, names: list[str]) -> None:
    for number, kind in enumerate(names):
        values = 1e3 * change[kinds == kind]
        spread = number + np.linspace(-0.25, 0.25, len(values))
        axes.plot(spread, values, ".", markersize=2.5, color=colour(number))
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    axes.margins(y=0.2)
    axes.set_ylabel(f"{name}\n{'mrad' if name in ANGLES else 'mm'}", rotation=0, ha="right", va="center")
    axes.set_xlim(-0.5, len(names) - 0.5)


#: bounds of the classes in standard deviations; below 3 two effects cannot be told apart
BOUNDS: Final = (0.0, 1.0, 3.0, 5.0, 10.0, 1e12)
SHADES: Final = ("#B2482C", "#E39A72", "#F1E3C8", "#8FBBD3", "#2F78A8")


@styled
def plan_matrix(outlook: Outlook) -> Figure:
    """Draw the matrix: row, the effect at work at its typical size; column, the effect that might be named instead.

    The first column says how well the effect is detected at all.
    """
    n = len(outlook.effects)
    figure = canvas(float(np.clip(5.0 + 0.36 * n, 8.0, 21.0)))
    axis = figure.add_subplot()
    distance = np.column_stack((outlook.signal, np.where(np.isfinite(outlook.distance), outlook.distance, np.nan)))
    shown = np.ma.masked_invalid(distance)
    colours = ListedColormap(list(SHADES)).with_extremes(bad="white")
    image = axis.imshow(shown, cmap=colours, norm=BoundaryNorm(list(BOUNDS), colours.N), aspect="auto")
    names = [name.replace("_", " ") for name in outlook.effects]
    axis.set_xticks(range(n + 1), ["(detected)", *names], rotation=90)
    told = outlook.told_apart
    rows = [f"{name}  {'told apart' if yes else '–'}" for name, yes in zip(names, told, strict=True)]
    axis.set_yticks(range(n), rows)
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
