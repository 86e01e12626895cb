"""The pictures of a diagnosis: floor plan, gap by covariate, before and after; each only where its arrays are known."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib.arrays import FloatArray
from calib.report.blocks import Picture
from calib.report.gap_findings import GapFindings
from calib.report.numbers import length
from calib.report.statements.causes import effect_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: names of all of them
GAP_PICTURES: Final = ("gap-map", "gap-by-covariate", "gap-before-after")


def map_picture(gap: GapFindings) -> list[Picture]:
    """Return the gap on the floor plan."""
    if gap.offset_m is None or not gap.paths_m:
        return []
    largest = float(np.nanmax(np.hypot(*gap.offset_m.T), initial=0.0))
    return [
        Picture(
            "gap-map",
            "The gap on the floor plan: paths driven, and arrows from the simulated to the measured end of each run.",
            f"Floor plan of {len(gap.paths_m)} runs with the gap at their ends, at most {length(largest)}",
            partial(_drawn, "gap_map", gap.paths_m, gap.offset_m, gap.group),
        )
    ]


def covariate_picture(gap: GapFindings) -> list[Picture]:
    """Return the channel that stands furthest above its floor, against what varied between the runs."""
    if gap.before is None or not gap.covariates or not gap.channels:
        return []
    varied = {
        name: values
        for name, values in gap.covariates.items()
        if np.isfinite(values).sum() >= 3 and float(np.nanmax(values)) > float(np.nanmin(values))
    }
    ratios = []
    for k in range(len(gap.channels)):
        values = gap.before[:, k]
        known = values[np.isfinite(values)]
        floor = 1.0 if gap.floor is None else _rms(gap.floor[:, k])
        ratios.append(_rms(known) / floor if len(known) >= 3 and floor > 0 else -1.0)
    if not varied or max(ratios) <= 0:
        return []
    worst = int(np.argmax(ratios))
    channel, unit = gap.channels[worst]
    title = effect_name(channel)
    # what the channel depends on most comes first: only so many panels are drawn
    lines = sorted(gap.verdict.where.covariates, key=lambda line: not line.significant)
    rank = {line.name: number for number, line in reversed(list(enumerate(lines)))}
    varied = dict(sorted(varied.items(), key=lambda item: rank.get(item[0], len(rank))))
    floor_value = None if gap.floor is None else _rms(gap.floor[:, worst])
    draw = partial(
        _drawn,
        "gap_by_covariate",
        gap.before[:, worst],
        title,
        unit,
        varied,
        floor=floor_value,
        group=gap.group,
    )
    return [
        Picture(
            "gap-by-covariate",
            f"The {title} gap against what varied between the runs; squares are means with their 95 % intervals, the "
            "grey band is the floor.",
            f"Gap of the channel {title} against {', '.join(effect_name(name) for name in list(varied)[:6])}",
            draw,
        )
    ]


def before_after_picture(gap: GapFindings) -> list[Picture]:
    """Return the gap of every run before and after the fix, channel by channel."""
    if gap.before is None or gap.after is None or gap.floor is None or not np.isfinite(gap.before).any():
        return []
    sizes = [
        f"{effect_name(name)} {_rms(gap.before[:, k]):.3g} to {_rms(gap.after[:, k]):.3g} {unit}"
        for k, (name, unit) in enumerate(gap.channels)
        if np.isfinite(gap.before[:, k]).any()
    ]
    channels = [(effect_name(name), unit) for name, unit in gap.channels]
    return [
        Picture(
            "gap-before-after",
            "The gap of every run before and after, channel by channel, on runs that the fit has not seen; bars "
            "are root mean squares, the grey band is the floor.",
            "Gap before and after by channel: " + "; ".join(sizes),
            partial(_drawn, "before_after", channels, gap.before, gap.after, gap.floor),
        )
    ]


def _drawn(name: str, *values: Any, **settings: Any) -> Figure:
    # drawn where a page is made; a terminal does not pay for the import
    from calib.report.figures import gap

    figure: Figure = getattr(gap, name)(*values, **settings)
    return figure


def _rms(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else 0.0
