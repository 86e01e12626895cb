"""Path deviation: excess of weaving and turning paths, and its effect on the radii."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.radius.deviation import allowed_amplitude_m, radius_error
from calib.radius.result import Fit
from calib.radius.run_deviation import RunDeviations
from calib.reporting.blocks import Block, Column, Picture, Section, Table, Text, drawn, items
from calib.reporting.formatting import MISSING, fixed, number_columns, plural, prose, text_column, text_columns

if TYPE_CHECKING:
    from calib.reporting.source import Source


def _percent(share: float | None, decimals: int = 4) -> str:
    return MISSING if share is None else fixed(100 * share, decimals)


def weave_content(rows: Sequence[Mapping[str, float]], tolerance: float, track_m: float) -> tuple[Block, ...]:
    """Return the excess of woven paths, and the amplitude that a tolerance allows."""
    table = Table(
        f"y = A sin(2πx/λ), Sₒ = {rows[0]['distance_m']:g} m, track {track_m:g} m: excess of the path, and what it "
        "does to a radius.",
        (
            *number_columns("A", "λ", unit="m"),
            *number_columns("whole periods", "(πA/λ)²", unit="%"),
            *(Column(title, "%", group="This distance") for title in ("centre", "left", "right")),
            Column("of periods", "%", group="Error of the radius"),
            *(Column(title, "%", group="Error of the radius") for title in ("left", "right")),
        ),
        tuple(
            (
                f"{row['amplitude_m']:g}",
                f"{row['wavelength_m']:g}",
                _percent(row["excess_whole_periods"], 6),
                _percent(row["excess_small_amplitude"], 6),
                *(_percent(row[f"excess_{part}"]) for part in ("centre", "left", "right")),
                *(_percent(row[f"radius_error_{part}"]) for part in ("whole_periods", "left", "right")),
            )
            for row in rows
        ),
    )
    allowed = {row["wavelength_m"]: row["allowed_amplitude_m"] for row in rows}
    return (
        table,
        *(
            Text(
                f"At a wavelength of {wavelength:g} m a radius stays within {100 * tolerance:g} % up to an amplitude "
                f"of {1e3 * amplitude:.1f} mm (whole periods)."
            )
            for wavelength, amplitude in allowed.items()
        ),
    )


def arc_content(arc: Mapping[str, float]) -> tuple[Block, ...]:
    """Return what wheels of different radii do on a straight line."""
    return (
        Text(
            f"Wheels with r_R / r_L = {arc['radius_ratio']:g} taken for equal: over {arc['distance_m']:g} m a turn of "
            f"{arc['turn_rad']:+.4f} rad and {arc['offset_m']:+.3f} m beside the line; the path is longer by "
            f"{_percent(arc['excess_centre'])} % (centre), {_percent(arc['excess_left'])} % (left), "
            f"{_percent(arc['excess_right'])} % (right)."
        ),
    )


def runs_content(name: str, simulated: bool, judged: RunDeviations) -> tuple[Block, ...]:
    """Return the verdict on each run of a campaign."""

    def length(value: float | None, scale: float, decimals: int) -> str:
        return MISSING if value is None else fixed(scale * value, decimals)

    columns = (
        *text_columns("Run", "From"),
        Column("A", "mm"),
        Column("λ", "m"),
        Column("centre", "%", group="Excess"),
        Column("small A", "%", group="Excess", detail=True),
        *number_columns("left", "right", unit="µm", group="Error of radius"),
        Column("allowed A", "mm"),
        text_column("Verdict"),
    )
    rows = tuple(
        (
            str(row["run_id"]),
            str(row["source"]),
            length(row["amplitude_m"], 1e3, 1),
            length(row["wavelength_m"], 1, 2),
            _percent(row["excess_centre"], 5),
            _percent(row["small_amplitude"], 5),
            length(row["error_left_m"], 1e6, 1),
            length(row["error_right_m"], 1e6, 1),
            length(row["allowed_amplitude_m"], 1e3, 1),
            str(row["verdict"]),
        )
        for row in judged.rows()
    )
    mark = " SIMULATED DATA." if simulated else ""
    notes = [*judged.notes, *(f"Not used: {run.run_id} {run.reason}" for run in judged.left_out)]
    table = Table(f"{name}: error that each path adds to its radii.{mark}", columns, rows)
    return (table, *items(map(prose, notes)), Text(prose(judged.summary)))


#: relative error of a radius that the runs are compared with
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


def deviation_section(source: Source) -> Section:
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
                text_column("Correction from", wide=True),
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


def deviation_picture(fit: Fit) -> Picture:
    """Return what weaving and turning added to the paths."""
    radii = fit.radii
    known = np.isfinite(radii.amplitude_m) & np.isfinite(radii.wavelength_m)
    worst = 1e6 * float(max(np.abs(radii.path_left).max(), np.abs(radii.path_right).max()))
    return Picture(
        "path-deviation",
        "Left: excess of a weaving path over the straight distance, by amplitude and wavelength over whole periods, "
        "and the runs of this campaign. Right: correction of each run's radius for weave and turn.",
        f"Excess of the path by amplitude for five wavelengths with {int(known.sum())} runs; corrections of all runs "
        f"up to {worst:.0f} ppm",
        partial(drawn, "radius.path_deviation", radii),
    )
