"""Path deviation: what weaving and turning added to each run's path."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.radius.deviation import allowed_amplitude_m, radius_error
from calib.report.blocks import Block, Column, Section, Table, Text
from calib.report.numbers import fixed, left, plural
from calib.report.source import Source
from calib.report.statements.fit_pictures import deviation_picture

#: relative error of a radius against which the runs are held
TOLERANCE: Final = 5e-4
_SOURCES: Final = {
    "log": "weave in the log",
    "log+heading": "weave in the log and measured heading at the end",
    "columns": "measured amplitude and wavelength",
    "columns+heading": "measured amplitude and wavelength, and heading at the end",
    "none+heading": "measured heading at the end",
    "none": "not corrected",
}


def _beyond(source: Source) -> str:
    radii = source.fit.radii
    off = np.maximum(np.abs(radius_error(radii.path_left)), np.abs(radius_error(radii.path_right))) > TOLERANCE
    count = int(off.sum())
    return "no run would show" if count == 0 else f"{plural(count, 'run')} would show"


def section(source: Source) -> Section:
    """Return how much longer than the measured distance the wheels' paths were, and what was corrected."""
    radii = source.fit.radii
    known = np.isfinite(radii.amplitude_m) & np.isfinite(radii.wavelength_m)
    worst = 1e6 * float(max(np.abs(radii.path_left).max(), np.abs(radii.path_right).max()))
    blocks: list[Block] = [
        Text(
            "The rangefinder sees the straight distance, the wheels roll along the path. A weave of amplitude A and "
            "wavelength λ makes the path longer by about (πA/λ)², a turn makes one wheel's path longer and the other's "
            f"shorter. The radii of this report are corrected for it; the largest correction of a run is {worst:.0f} "
            "ppm."
        ),
        deviation_picture(source.fit),
    ]
    counted = {name: int((radii.path_source == name).sum()) for name in dict.fromkeys(radii.path_source.tolist())}
    rows = []
    for name, count in counted.items():
        on = radii.path_source == name
        amplitude, wavelength = radii.amplitude_m[on & known], radii.wavelength_m[on & known]
        corrections = [1e6 * float(np.sqrt(np.mean(part[on] ** 2))) for part in (radii.path_left, radii.path_right)]
        rows.append(
            (
                _SOURCES.get(name, name),
                str(count),
                fixed(1e3 * float(np.median(amplitude)) if len(amplitude) else None, 1),
                fixed(float(np.median(wavelength)) if len(wavelength) else None, 1),
                *(fixed(value, 0) for value in corrections),
            )
        )
    blocks.append(
        Table(
            "Where the corrections come from; medians of amplitude and wavelength, root mean square corrections.",
            (
                left("Correction from", wide=True),
                Column("Runs"),
                Column("Amplitude", "mm"),
                Column("Wavelength", "m"),
                Column("Left", "ppm"),
                Column("Right", "ppm"),
            ),
            tuple(rows),
        )
    )
    if known.any():
        wavelength = float(np.median(radii.wavelength_m[known]))
        allowed = 1e3 * float(allowed_amplitude_m(TOLERANCE, wavelength))
        blocks.append(
            Text(
                f"Without the correction, {_beyond(source)} a radius more than {1e6 * TOLERANCE:.0f} ppm off. A weave "
                f"of the median wavelength of {wavelength:.1f} m stays within that up to an amplitude of {allowed:.0f} "
                "mm."
            )
        )
    return Section("Path deviation", tuple(blocks))
