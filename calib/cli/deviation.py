"""`calib deviation`: what a path beside the line does to a radius, and a verdict for each run (Figs 8 and 9)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from calib.cli.output import FORCE, JSON, emit_json, say, table, wants_stdout

if TYPE_CHECKING:
    from calib.radius.run_deviation import RunDeviations

__all__ = ["register"]

EPILOG = (
    "Examples: calib deviation sample_runs/corridor --tolerance 0.0005; "
    "calib deviation --amplitude 0.5 --wavelength 5 --distance 37.5"
)
DISTANCE_M = 40.0
AMPLITUDES_M = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
WAVELENGTHS_M = (40.0, 5.0)


def register(application: typer.Typer, name: str) -> None:
    """Add the command to `application`."""

    @application.command(name, epilog=EPILOG)
    def deviation(
        campaign: Path | None = typer.Argument(
            None, metavar="[CAMPAIGN]", help="Campaign whose runs are judged; without it only the table is made."
        ),
        tolerance: float = typer.Option(
            0.0005, "--tolerance", metavar="SHARE", help="Largest relative error of a radius; 0.0005 is 0.05 %."
        ),
        amplitude: list[float] = typer.Option(
            [], "--amplitude", metavar="M", help="Amplitude of the weave in the table; may be given again."
        ),
        wavelength: list[float] = typer.Option(
            [], "--wavelength", metavar="M", help="Wavelength of the weave in the table; may be given again."
        ),
        distance: float | None = typer.Option(
            None, "--distance", metavar="M", help="Distance S_O of the table; 40 m, or the campaign's median."
        ),
        track: float | None = typer.Option(
            None, "--track", metavar="M", help="Distance between the wheels; 0.7 m, or the campaign's."
        ),
        radius_ratio: float | None = typer.Option(
            None, "--radius-ratio", metavar="E_R", help="Also show the steady arc of wheels with r_R / r_L = E_R."
        ),
        json_target: str | None = JSON,
        force: bool = FORCE,
    ) -> int:
        """Show the error that a woven path or a steady arc adds to a radius, and judge each run.

        Exit status 1 where a run's path moved a radius by more than the tolerance.
        """
        from calib.radius.run_deviation import arc_row, deviation_rows, judge_runs, table_setting

        judged = None
        read = None
        if campaign is not None:
            from calib.campaign.read import read_campaign

            read = read_campaign(campaign)
            judged = judge_runs(read, tolerance)
        distance_m, track_m = table_setting(read, distance, track, default_distance_m=DISTANCE_M)
        rows = deviation_rows(amplitude or AMPLITUDES_M, wavelength or WAVELENGTHS_M, distance_m, track_m, tolerance)
        arc = None if radius_ratio is None else arc_row(radius_ratio, distance_m, track_m)
        if not wants_stdout(json_target):
            if judged is None or amplitude or wavelength:
                _show_table(rows, tolerance, track_m, json_target)
            if arc is not None:
                _show_arc(arc, json_target)
            if judged is not None and read is not None:
                _show_runs(read.name, read.simulated, judged, json_target)
        document: dict[str, Any] = {"tolerance": tolerance, "track_m": track_m, "table": rows, "arc": arc}
        if judged is not None and read is not None:
            document |= {
                "campaign": read.name,
                "simulated": read.simulated,
                "runs": judged.rows(),
                "left_out": [{"run_id": one.run_id, "reason": one.reason} for one in judged.left_out],
                "notes": list(judged.notes),
                "passed": judged.passed,
            }
        emit_json(document, json_target, force=force)
        return 0 if judged is None or judged.passed else 1


def _percent(share: float | None, digits: int = 4) -> str:
    return "-" if share is None else f"{100 * share:.{digits}f}"


def _show_table(rows: list[dict[str, float]], tolerance: float, track_m: float, target: str | None) -> None:
    distance = rows[0]["distance_m"]
    table(
        f"y = A sin(2 pi x / lambda), S_O = {distance:g} m, track {track_m:g} m: excess of the path, %",
        [
            "A m",
            "lambda m",
            "whole periods",
            "(pi A/lambda)^2",
            "centre",
            "left",
            "right",
            "error of r_e",
            "r_e left",
            "r_e right",
        ],
        [
            [
                f"{row['amplitude_m']:g}",
                f"{row['wavelength_m']:g}",
                _percent(row["excess_whole_periods"], 6),
                _percent(row["excess_small_amplitude"], 6),
                _percent(row["excess_centre"]),
                _percent(row["excess_left"]),
                _percent(row["excess_right"]),
                _percent(row["radius_error_whole_periods"]),
                _percent(row["radius_error_left"]),
                _percent(row["radius_error_right"]),
            ]
            for row in rows
        ],
        target=target,
    )
    allowed = {row["wavelength_m"]: row["allowed_amplitude_m"] for row in rows}
    for wavelength, amplitude in allowed.items():
        say(
            f"At a wavelength of {wavelength:g} m a radius stays within {100 * tolerance:g} % up to an amplitude of "
            f"{1e3 * amplitude:.1f} mm (whole periods).",
            target=target,
        )


def _show_arc(arc: dict[str, float], target: str | None) -> None:
    say(
        f"Wheels with r_R / r_L = {arc['radius_ratio']:g} taken for equal: over {arc['distance_m']:g} m a turn of "
        f"{arc['turn_rad']:+.4f} rad and {arc['offset_m']:+.3f} m beside the line; the path is longer by "
        f"{_percent(arc['excess_centre'])} % (centre), {_percent(arc['excess_left'])} % (left), "
        f"{_percent(arc['excess_right'])} % (right).",
        target=target,
    )


def _show_runs(name: str, simulated: bool, judged: RunDeviations, target: str | None) -> None:
    def length(value: float | None, scale: float, digits: int) -> str:
        return "-" if value is None else f"{scale * value:.{digits}f}"

    rows = judged.rows()
    table(
        f"{name}: error that each path adds to its radii{' - SIMULATED DATA' if simulated else ''}",
        [
            "run",
            "from",
            "A mm",
            "lambda m",
            "excess %",
            "small A %",
            "r_e left um",
            "r_e right um",
            "allowed A mm",
            "verdict",
        ],
        [
            [
                row["run_id"],
                row["source"],
                length(row["amplitude_m"], 1e3, 1),
                length(row["wavelength_m"], 1, 2),
                _percent(row["excess_centre"], 5),
                _percent(row["small_amplitude"], 5),
                length(row["error_left_m"], 1e6, 1),
                length(row["error_right_m"], 1e6, 1),
                length(row["allowed_amplitude_m"], 1e3, 1),
                row["verdict"],
            ]
            for row in rows
        ],
        target=target,
    )
    for note in judged.notes:
        say(note, target=target)
    for run in judged.left_out:
        say(f"Left out: {run.run_id} {run.reason}", target=target)
    say(judged.summary, target=target)
