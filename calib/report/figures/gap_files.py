"""The pictures of a diagnosis as files: map of the gap, gap by covariate channel by channel, before and after."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from calib.arrays import FloatArray
from calib.gap.data.channels import Channel
from calib.gap.diagnosis import Diagnosis
from calib.report.figures.gap import before_after, gap_by_covariate, gap_map
from calib.report.gap_source import findings_of

#: names of all figures that a diagnosis may give
GAP_FILES: Final = ("gap-map", "before-after", *(f"gap-by-covariate-{channel.label}" for channel in Channel))
MOST_PANELS: Final = 6


def gap_pictures(diagnosis: Diagnosis) -> dict[str, Figure]:
    """Return the figures of a diagnosis by name; those whose data are missing are left out."""
    gap = findings_of(diagnosis)
    figures: dict[str, Figure] = {}
    if gap.offset_m is not None and gap.paths_m:
        figures["gap-map"] = gap_map(gap.paths_m, gap.offset_m, gap.group)
    for number, (channel, unit) in enumerate(gap.channels):
        if gap.before is None or not np.isfinite(gap.before[:, number]).any():
            continue
        shown = {name: gap.covariates[name] for name in _telling(diagnosis, channel, gap.covariates)}
        floor = None if gap.floor is None else float(np.sqrt(np.nanmean(gap.floor[:, number] ** 2)))
        if shown:
            figures[f"gap-by-covariate-{channel}"] = gap_by_covariate(
                gap.before[:, number], channel, unit, shown, floor=floor, group=gap.group
            )
    if gap.before is not None and gap.after is not None and gap.floor is not None:
        figures["before-after"] = before_after(gap.channels, gap.before, gap.after, gap.floor)
    return figures


def _telling(diagnosis: Diagnosis, channel: str, numeric: Mapping[str, FloatArray]) -> list[str]:
    """Return the covariates to draw: those of the table first, those that show most in the channel before others."""
    lines = diagnosis.verdict.where.covariates
    ranked = [line.name for line in sorted(lines, key=lambda line: line.channel_label != channel)]
    return [name for name in dict.fromkeys([*ranked, *numeric]) if name in numeric][:MOST_PANELS]
