"""Path deviation: excess of weaving and turning paths, and its effect on the radii."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from calib.reporting.blocks import Block, Text, items, table
from calib.reporting.formatting import MISSING, fixed, prose

if TYPE_CHECKING:
    from calib.radius.run_deviation import RunDeviations


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
