"""`calib report`: the PDF that a customer gets."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calib.cli.options import AcceptImplausible, Force, JsonTarget, refuse_existing
from calib.cli.terminal import emit_json, say, waiting, wrote
from calib.cli.threads import one_blas_thread
from calib.errors import BadInputError, RefusedError

if TYPE_CHECKING:
    from calib.report.content import Report

__all__ = ["EPILOG", "run"]

EPILOG = "Example: calib report sample_runs/corridor_crossed --into corridor_crossed.pdf --date 2025-03-31"


def run(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="CAMPAIGN|RESULT", help="Campaign folder, or result folder of calib fit, or its fit.json."
        ),
    ],
    into: Annotated[
        Path | None,
        typer.Option(
            "--into", metavar="FILE|FOLDER", help="PDF file, or folder for it; without it: reports/<campaign>.pdf."
        ),
    ] = None,
    date: Annotated[
        str | None,
        typer.Option(
            "--date", metavar="YYYY-MM-DD", help="Date of issue; without it: today. Fixes the bytes of the PDF."
        ),
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option("--figures", metavar="FOLDER", help="Write every figure there, too, as PNG, SVG and PDF."),
    ] = None,
    html: Annotated[
        Path | None, typer.Option("--html", metavar="FILE", help="Write the same as one HTML page, too.")
    ] = None,
    diagnosis: Annotated[
        bool, typer.Option("--diagnosis", help="Add the diagnosis of the gap between measured and simulated motion.")
    ] = False,
    seed: Annotated[int, typer.Option("--seed", metavar="N", help="Seed of the diagnosis.")] = 0,
    accept_implausible: AcceptImplausible = "",
    json: JsonTarget = None,
    force: Force = False,
) -> int:
    """Write the report on a campaign as PDF/A-3, the coefficient file attached.

    The [report] section of campaign.toml states laboratory, customer, vehicle, instruments and dates. Exit status 1
    where a check says that the law should not be used as it is; the report is written all the same and says so.
    With --diagnosis, runs that allow no law, as loops do, still give a report of the diagnosis.
    """
    if diagnosis:
        one_blas_thread()
    from calib.files import write_bytes, write_text
    from calib.report.html import to_html
    from calib.report.pdf import to_pdf, write_figures
    from calib.report.source import issue_date

    refuse_existing([json, html], force=force)
    issued = issue_date(date)
    with waiting("writing the report"):
        accept = accept_implausible.strip()
        report, target = _report(source, into, issued, accept, seed=seed, diagnosis=diagnosis, force=force)
        drawn = [] if figures is None else write_figures(report, figures, force=force)
        write_bytes(target, to_pdf(report), force=force)
    marked = ", simulated data" if report.simulated else ""
    wrote([], target=json, what=f"{target} (report {report.report_id}{marked})")
    if html is not None:
        wrote([write_text(html, to_html(report), force=force)], target=json)
    if figures is not None:
        wrote([], target=json, what=f"{len(drawn)} figure files to {figures}")
    if not report.passed:
        say("A check failed: the law should not be used as it is; the report says why.", target=json)
    document: dict[str, Any] = {"file": str(target), "figures": [str(path) for path in drawn], **report.to_dict()}
    emit_json(document, json, force=force)
    return 0 if report.passed else 1


def _report(
    path: Path, into: Path | None, issued: str, accept: str, *, seed: int, diagnosis: bool, force: bool
) -> tuple[Report, Path]:
    """Return the report and its file; runs that allow no law give one of the diagnosis alone, where asked for."""
    from calib.campaign.read import read_campaign
    from calib.report.content import compose
    from calib.report.gap_report import diagnosis_report
    from calib.report.gap_source import with_diagnosis
    from calib.report.place import place_of
    from calib.report.source import source_of

    try:
        source, campaign = source_of(path, issued=issued, accept=accept)
    except RefusedError as error:
        if not diagnosis:
            raise
        read = read_campaign(path)
        target = place_of(read.name, into, force=force)
        return diagnosis_report(read, issued=issued, why=str(error).removeprefix(f"{path}: "), seed=seed), target
    target = place_of(source.fit.name, into, force=force)
    if diagnosis:
        if campaign is None:
            raise BadInputError(
                f"{path}: found the result of a fit; expected a campaign folder, which a diagnosis needs; give the "
                "campaign"
            )
        source = with_diagnosis(source, campaign, seed=seed)
    return compose(source), target
