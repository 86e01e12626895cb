"""`calib deviation`: what a path beside the line does to a radius, and a verdict for each run (Figs 8 and 9)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from calib.cli import terminal

if TYPE_CHECKING:
    from calib.campaign.model import Campaign
    from calib.radius.run_deviation import RunDeviations

DISTANCE_M: Final = 40.0
AMPLITUDES_M: Final = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
WAVELENGTHS_M: Final = (40.0, 5.0)


def run(
    campaign: Annotated[
        Path | None,
        typer.Argument(metavar="[CAMPAIGN]", help="Campaign whose runs are judged; without it only the table is made."),
    ] = None,
    tolerance: Annotated[float, typer.Option(metavar="SHARE", help="Largest relative error of a radius.")] = 0.0005,
    amplitude: Annotated[
        list[float] | None, typer.Option(metavar="M", help="Amplitude of the weave in the table; may be given again.")
    ] = None,
    wavelength: Annotated[
        list[float] | None, typer.Option(metavar="M", help="Wavelength of the weave in the table; may be given again.")
    ] = None,
    distance: Annotated[
        float | None, typer.Option(metavar="M", help="Distance S_O of the table; 40 m, or the campaign's median.")
    ] = None,
    track: Annotated[
        float | None, typer.Option(metavar="M", help="Distance between the wheels; 0.7 m, or the campaign's.")
    ] = None,
    radius_ratio: Annotated[
        float | None, typer.Option(metavar="E_R", help="Also show the steady arc of wheels with r_R / r_L = E_R.")
    ] = None,
) -> int:
    """Show the error that a woven path or a steady arc adds to a radius, and judge each run.

    Exit status 1 where a run's path moved a radius by more than the tolerance.

    Example: calib deviation sample_runs/corridor --tolerance 0.0005; calib deviation --amplitude 0.5 --wavelength 5
    """
    from calib.radius import deviation as table
    from calib.reporting.topics.runs import arc_content, runs_content, weave_content

    with terminal.waiting("reading"):
        read, judged = _judged(campaign, tolerance)
    distance_m, track_m = table.table_setting(read, distance, track, default_distance_m=DISTANCE_M)
    rows = table.deviation_rows(amplitude or AMPLITUDES_M, wavelength or WAVELENGTHS_M, distance_m, track_m, tolerance)
    arc = None if radius_ratio is None else table.arc_row(radius_ratio, distance_m, track_m)
    document: dict[str, object] = {"tolerance": tolerance, "track_m": track_m, "table": rows, "arc": arc}
    content = weave_content(rows, tolerance, track_m) if judged is None or amplitude or wavelength else ()
    content += () if arc is None else arc_content(arc)
    if judged is not None and read is not None:
        content += runs_content(read.name, read.simulated, judged)
        document |= {
            "campaign": read.name,
            "simulated": read.simulated,
            "runs": judged.rows(),
            "left_out": [{"run_id": run.run_id, "reason": run.reason} for run in judged.left_out],
            "notes": list(judged.notes),
            "passed": judged.passed,
        }
    terminal.answer(document, content)
    terminal.then("deviation CAMPAIGN" if campaign else "deviation", c=campaign or "")
    return 0 if judged is None or judged.passed else 1


def _judged(folder: Path | None, tolerance: float) -> tuple[Campaign | None, RunDeviations | None]:
    """Return the campaign and the verdict on its runs; nothing without a folder."""
    from calib.campaign.read import read_campaign
    from calib.radius.run_deviation import judge_runs

    if folder is None:
        return None, None
    campaign = read_campaign(folder)
    return campaign, judge_runs(campaign, tolerance)
