"""What paths beside the line do to a radius: the table of weaves, the steady arc, and each run's verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from calib.radius.run_deviation import RunDeviations
from calib.report.blocks import Block, Column, Table, Text, items
from calib.report.numbers import MISSING, fixed, left, number_columns, prose, text_columns


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
        left("Verdict"),
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
    notes = [*judged.notes, *(f"Left out: {run.run_id} {run.reason}" for run in judged.left_out)]
    table = Table(f"{name}: error that each path adds to its radii.{mark}", columns, rows)
    return (table, *items(map(prose, notes)), Text(prose(judged.summary)))
