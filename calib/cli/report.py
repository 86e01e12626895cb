"""`calib report`: the PDF that a customer gets."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from calib.cli.output import FORCE, JSON, emit_json, say
from calib.cli.threads import one_blas_thread

if TYPE_CHECKING:
    from calib.campaign.model import Campaign
    from calib.report.content import Report
    from calib.report.source import Source

__all__ = ["register"]

EPILOG = "Example: calib report sample_runs/corridor_crossed --into corridor_crossed.pdf --date 2025-03-31"


def register(application: typer.Typer, name: str) -> None:
    """Add the command to `application`."""

    @application.command(name, epilog=EPILOG)
    def report(
        source: Path = typer.Argument(
            ..., metavar="CAMPAIGN|RESULT", help="Campaign folder, or result folder of calib fit, or its fit.json."
        ),
        into: Path | None = typer.Option(
            None,
            "--into",
            metavar="FILE|FOLDER",
            help="PDF file, or folder for it; without it: reports/<campaign>.pdf.",
        ),
        date: str | None = typer.Option(
            None, "--date", metavar="YYYY-MM-DD", help="Date of issue; without it: today. Fixes the bytes of the PDF."
        ),
        figures: Path | None = typer.Option(
            None, "--figures", metavar="FOLDER", help="Write every figure there, too, as PNG, SVG and PDF."
        ),
        diagnosis: bool = typer.Option(
            False, "--diagnosis", help="Add the diagnosis of the gap between measured and simulated motion."
        ),
        seed: int = typer.Option(0, "--seed", metavar="N", help="Seed of the diagnosis."),
        json_target: str | None = JSON,
        force: bool = FORCE,
    ) -> int:
        """Write the report on a campaign as PDF/A-3, the coefficient file attached.

        The [report] section of campaign.toml states laboratory, customer, vehicle, instruments and dates. Exit status 1
        where a check says that the law should not be used as it is; the report is written all the same and says so.
        With --diagnosis, runs that allow no law, as loops do, still give a report of the diagnosis.
        """
        if diagnosis:
            one_blas_thread()
        from calib.errors import RefusedError
        from calib.files import write_bytes
        from calib.report.content import compose
        from calib.report.pdf import to_pdf, write_figures
        from calib.report.place import place_of
        from calib.report.source import issue_date, source_of

        issued = issue_date(date)
        try:
            found, campaign = source_of(source, issued=issued)
        except RefusedError as error:
            if not diagnosis:
                raise
            made, target = _without_law(source, into, issued, str(error), seed, force=force)
        else:
            target = place_of(found.fit.name, into, force=force)
            made = compose(_diagnosed(found, campaign, source, seed) if diagnosis else found)
        drawn = [] if figures is None else write_figures(made, figures, force=force)
        write_bytes(target, to_pdf(made), force=force)
        say(
            f"wrote {target} (report {made.report_id}{', simulated data' if made.simulated else ''})",
            target=json_target,
        )
        if figures is not None:
            say(f"wrote {len(drawn)} figure files to {figures}", target=json_target)
        if not made.passed:
            say("A check failed: the law should not be used as it is; the report says why.", target=json_target)
        document: dict[str, Any] = {"file": str(target), "figures": [str(path) for path in drawn], **made.to_dict()}
        emit_json(document, json_target, force=force)
        return 0 if made.passed else 1


def _without_law(
    path: Path, into: Path | None, issued: str, why: str, seed: int, *, force: bool
) -> tuple[Report, Path]:
    """Return the report of the diagnosis alone and its file; refused where the path is no campaign."""
    from calib.campaign.read import read_campaign
    from calib.report.gap_report import diagnosis_report
    from calib.report.place import place_of

    campaign = read_campaign(path)
    target = place_of(campaign.name, into, force=force)
    return diagnosis_report(campaign, issued=issued, why=why.removeprefix(f"{path}: "), seed=seed), target


def _diagnosed(found: Source, campaign: Campaign | None, path: Path, seed: int) -> Source:
    from calib.errors import BadInputError
    from calib.report.gap_source import with_diagnosis

    if campaign is None:
        raise BadInputError(
            f"{path}: found the result of a fit; expected a campaign folder, which a diagnosis needs; give the campaign"
        )
    return with_diagnosis(found, campaign, seed=seed)
