"""The signature of an effect: where it bends the paths, and what it leaves in each channel, kind by kind."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calib.arrays import FloatArray, StrArray
from calib.gap.effects.signatures import EffectSignature
from calib.gap.predict.path import Path
from calib.report.figures.style import GREY, canvas, colour, styled

CHANNELS = ("distance", "along", "lateral", "heading", "front", "steering")
ANGLES = frozenset({"heading", "steering"})
#: a channel that changes by less (m or rad) counts as still: no instrument sees a micrometre
STILL = 1e-6


@styled
def signature_figure(signature: EffectSignature, nominal: Path) -> Figure:
    """Draw a signature.

    `nominal`: the model alone on the same runs. Left the floor plan, one run of each kind, without the effect in grey
    and with it, enlarged, in colour; right the change of each channel at the typical size, a dot a run.
    """
    kinds = nominal.s.labels["kind"]
    names = list(np.unique(kinds))
    size = np.nan_to_num(np.nanmax(np.abs(np.where(np.isfinite(signature.change), signature.change, 0.0)), axis=0))
    moved = [k for k in range(len(CHANNELS)) if size[k] > STILL]
    figure = canvas(6.4)
    floor, channels = figure.subfigures(1, 2, width_ratios=(1.0, 1.25), squeeze=False)[0]
    _draw_plan(floor.subplots(), signature, nominal, names)
    panels = channels.subplots(max(len(moved), 1), 1, sharex=True, squeeze=False)[:, 0]
    for axes, channel in zip(panels, moved, strict=False):
        _draw_channel(axes, signature.change[:, channel], CHANNELS[channel], kinds, names)
    panels[0].set_title("change at its typical size, channels that move")
    panels[-1].set_xticks(range(len(names)), names, rotation=20, ha="right")
    return figure


def _draw_plan(axes: Axes, signature: EffectSignature, nominal: Path, names: list[str]) -> None:
    s = nominal.s
    for number, name in enumerate(names):
        units = np.flatnonzero(s.labels["kind"] == name)
        sizes = np.nansum(signature.change[units] ** 2, axis=1)
        unit = int(units[np.argmax(sizes)])
        part = slice(int(s.starts[unit]), int(s.starts[unit + 1]))
        axes.plot(nominal.x_m[part], nominal.y_m[part], color=GREY, linewidth=0.8)
        tint = colour(number)
        axes.plot(signature.enlarged.x_m[part], signature.enlarged.y_m[part], color=tint, linewidth=1.1, label=name)
        axes.plot(*signature.enlarged.end[unit, :2], marker="o", markersize=3, color=tint)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x, m", ylabel="y, m")
    bent = signature.factor > 1.0 and bool(np.ptp(signature.enlarged.end[:, :2] - nominal.end[:, :2]) > 0)
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
