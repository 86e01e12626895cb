"""Path deviation: excess of weaving and turning paths, and its effect on the radii."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.radius.deviation import allowed_amplitude_m, radius_error
from calib.radius.result import Fit
from calib.reporting.blocks import Block, Picture, Section, Text, items, picture, table
from calib.reporting.formatting import MISSING, fixed, plural, prose
from calib.types import FloatArray

if TYPE_CHECKING:
    from calib.radius.run_deviation import RunDeviations
    from calib.reporting.source import Source


def weave_content(rows: Sequence[Mapping[str, float]], tolerance: float, track_m: float) -> tuple[Block, ...]:
    """Return the excess of woven paths, and the amplitude that a tolerance allows."""
    heads = {
        "whole periods (%)": ("excess_whole_periods", 6),
        "(πA/λ)² (%)": ("excess_small_amplitude", 6),
        "This distance | centre (%)": ("excess_centre", 4),
        "This distance | left (%)": ("excess_left", 4),
        "This distance | right (%)": ("excess_right", 4),
        "Error of the radius | of periods (%)": ("radius_error_whole_periods", 4),
        "Error of the radius | left (%)": ("radius_error_left", 4),
        "Error of the radius | right (%)": ("radius_error_right", 4),
    }
    excess = table(
        f"y = A sin(2πx/λ), Sₒ = {rows[0]['distance_m']:g} m, track {track_m:g} m: excess of the path, and what it "
        "does to a radius.",
        ("A (m)", "λ (m)", *heads),
        [
            [
                *(f"{row[key]:g}" for key in ("amplitude_m", "wavelength_m")),
                *(fixed(100 * row[key], decimals) for key, decimals in heads.values()),
            ]
            for row in rows
        ],
    )
    allowed = {row["wavelength_m"]: row["allowed_amplitude_m"] for row in rows}
    sentences = (
        f"At a wavelength of {wavelength:g} m a radius stays within {100 * tolerance:g} % up to an amplitude of "
        f"{1e3 * amplitude:.1f} mm (whole periods)."
        for wavelength, amplitude in allowed.items()
    )
    return (excess, *map(Text, sentences))


def arc_content(arc: Mapping[str, float]) -> tuple[Block, ...]:
    """Return what wheels of different radii do on a straight line."""
    longer = ", ".join(f"{fixed(100 * arc[f'excess_{at}'], 4)} % ({at})" for at in ("centre", "left", "right"))
    text = (
        f"Wheels with r_R / r_L = {arc['radius_ratio']:g} taken for equal: over {arc['distance_m']:g} m a turn of "
        f"{arc['turn_rad']:+.4f} rad and {arc['offset_m']:+.3f} m beside the line; the path is longer by {longer}."
    )
    return (Text(text),)


def runs_content(name: str, simulated: bool, judged: RunDeviations) -> tuple[Block, ...]:
    """Return the verdict on each run of a campaign."""
    heads = {
        "A (mm)": ("amplitude_m", 1e3, 1),
        "λ (m)": ("wavelength_m", 1.0, 2),
        "Excess | centre (%)": ("excess_centre", 100.0, 5),
        "~Excess | small A (%)": ("small_amplitude", 100.0, 5),
        "Error of radius | left (µm)": ("error_left_m", 1e6, 1),
        "Error of radius | right (µm)": ("error_right_m", 1e6, 1),
        "allowed A (mm)": ("allowed_amplitude_m", 1e3, 1),
    }
    rows = [
        (
            *(str(row[key]) for key in ("run_id", "source")),
            *(MISSING if row[key] is None else fixed(k * row[key], places) for key, k, places in heads.values()),
            str(row["verdict"]),
        )
        for row in judged.rows()
    ]
    mark = " SIMULATED DATA." if simulated else ""
    notes = [*judged.notes, *(f"Not used: {run.run_id} {run.reason}" for run in judged.left_out)]
    errors = table(
        f"{name}: error that each path adds to its radii.{mark}", ("<Run", "<From", *heads, "<Verdict"), rows
    )
    return (errors, *items(map(prose, notes)), Text(prose(judged.summary)))


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


def deviation_section(source: Source) -> Section:
    """Return how much longer than the measured distance the wheels' paths were, and what was corrected."""
    radii = source.fit.radii
    known = np.isfinite(radii.amplitude_m) & np.isfinite(radii.wavelength_m)
    paths = np.array((radii.path_left, radii.path_right))
    worst = 1e6 * float(np.abs(paths).max())
    blocks: list[Block] = [
        Text(
            "The rangefinder sees the straight distance, the wheels roll along the path. A weave of amplitude A and "
            "wavelength λ makes the path longer by about (πA/λ)², a turn makes one wheel's path longer and the other's "
            f"shorter. The radii of this report are corrected for it; the largest correction of a run is {worst:.0f} "
            "ppm."
        ),
        deviation_picture(source.fit),
    ]
    rows = []
    for name in dict.fromkeys(radii.path_source.tolist()):
        on = radii.path_source == name
        corrections = 1e6 * np.sqrt(np.mean(paths[:, on] ** 2, axis=1))
        rows.append(
            (
                _SOURCES.get(name, name),
                str(int(on.sum())),
                fixed(1e3 * _median(radii.amplitude_m[on & known]), 1),
                fixed(_median(radii.wavelength_m[on & known]), 1),
                *(fixed(float(value), 0) for value in corrections),
            )
        )
    blocks.append(
        table(
            "Where the corrections come from; medians of amplitude and wavelength, root mean square corrections.",
            ("*Correction from", "Runs", "Amplitude (mm)", "Wavelength (m)", "Left (ppm)", "Right (ppm)"),
            rows,
        )
    )
    if known.any():
        off = int((np.abs(radius_error(paths)).max(axis=0) > TOLERANCE).sum())
        wavelength = _median(radii.wavelength_m[known])
        allowed = 1e3 * float(allowed_amplitude_m(TOLERANCE, wavelength))
        blocks.append(
            Text(
                f"Without the correction, {plural(off, 'run') if off else 'no run'} would show a radius more than "
                f"{1e6 * TOLERANCE:.0f} ppm off. A weave of the median wavelength of {wavelength:.1f} m stays within "
                f"that up to an amplitude of {allowed:.0f} mm."
            )
        )
    return Section("Path deviation", tuple(blocks))


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if len(values) else float("nan")


def deviation_picture(fit: Fit) -> Picture:
    """Return what weaving and turning added to the paths."""
    radii = fit.radii
    known = np.isfinite(radii.amplitude_m) & np.isfinite(radii.wavelength_m)
    worst = 1e6 * float(max(np.abs(radii.path_left).max(), np.abs(radii.path_right).max()))
    return picture(
        "path-deviation",
        "Left: excess of a weaving path over the straight distance, by amplitude and wavelength over whole periods, "
        "and the runs of this campaign. Right: correction of each run's radius for weave and turn.",
        f"Excess of the path by amplitude for five wavelengths with {int(known.sum())} runs; corrections of all runs "
        f"up to {worst:.0f} ppm",
        "radius.path_deviation",
        radii,
    )
