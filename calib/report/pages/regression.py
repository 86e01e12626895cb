"""The regressions with both bands."""

from __future__ import annotations

import numpy as np

from calib.radius.regression import WheelFit
from calib.report.blocks import Block, Column, Section, Table, Text
from calib.report.numbers import aligned, fixed, places, two_digits
from calib.report.source import Source
from calib.report.statements.fit_pictures import regressions_picture
from calib.report.statements.law import quality_text


def section(source: Source) -> Section:
    """Return figure and table of both wheels' laws with the band of the mean and the prediction band."""
    fit = source.fit
    blocks: list[Block] = [
        Text(
            "The band of the mean holds the law itself: it answers how well the mean radius at a load is known. The "
            "prediction band holds the radius of one further run, driven in a session of its own: it answers how far "
            "off the next journey can be. Both have a coverage of 95 % at each load."
        ),
        regressions_picture(fit),
        Table(
            "The law at loads of the valid range, with the half widths of both bands.",
            (
                Column("Load", "N"),
                *(
                    Column(title, unit, group=f"{wheel} wheel")
                    for wheel in ("Left", "Right")
                    for title, unit in (("radius", "mm"), ("mean", "± µm"), ("single run", "± µm"))
                ),
            ),
            aligned(_rows(fit.left, fit.right), 2, 3, 5, 6),
        ),
        Text(" ".join(quality_text(wheel) for wheel in fit.wheels.values())),
    ]
    return Section("Regression on load", tuple(blocks))


def _rows(left: WheelFit, right: WheelFit) -> tuple[tuple[str, ...], ...]:
    low = max(left.law.load_min_N, right.law.load_min_N)
    high = min(left.law.load_max_N, right.law.load_max_N)
    if not high > low:
        low, high = min(left.law.load_min_N, right.law.load_min_N), max(left.law.load_max_N, right.law.load_max_N)
    loads = _round_loads(low, high)
    cells = []
    for wheel in (left, right):
        mean = 0.5e3 * np.subtract(*reversed(wheel.mean_band_m(loads)))
        single = 0.5e3 * np.subtract(*reversed(wheel.prediction_band_m(loads)))
        radius = 1e3 * wheel.law.radius_m(loads)
        # one number of decimals for all radii: that of the narrowest band
        decimals = places(float(mean.min()))
        widths = ([two_digits(1e3 * float(value)) for value in column] for column in (mean, single))
        cells.append([[fixed(float(value), decimals) for value in radius], *widths])
    return tuple(
        (fixed(float(load), 0), *(column[k] for wheel_cells in cells for column in wheel_cells))
        for k, load in enumerate(loads)
    )


def _round_loads(low: float, high: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return round loads inside the range; its ends where nothing round lies in it."""
    for step in (100.0, 200.0, 500.0, 1000.0, 50.0, 20.0, 10.0, 5.0, 1.0):
        first, last = np.ceil(low / step), np.floor(high / step)
        if 3 <= last - first + 1 <= 9:
            return np.asarray(step * np.arange(first, last + 1), dtype=np.float64)
    return np.unique(np.array([low, 0.5 * (low + high), high]))
