"""`calib report`: the PDF that a customer gets."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli import terminal

if TYPE_CHECKING:
    from calib.campaign.model import Campaign
    from calib.radius.result import Fit
    from calib.reporting.content import Reported
    from calib.types import Progress


def run(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="CAMPAIGN|RESULT", help="Campaign folder, or result folder of calib fit, or its fit.json."
        ),
    ],
    into: Annotated[
        Path | None,
        typer.Option(metavar="FILE|FOLDER", help="PDF file, or folder for it; without it: reports/<campaign>.pdf."),
    ] = None,
    date: terminal.Date = None,
    figures: terminal.Figures = None,
    html: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the same as one HTML page, too; with --diagnosis, to look into."),
    ] = None,
    diagnosis: Annotated[
        bool, typer.Option("--diagnosis", help="Add the diagnosis of the gap between measured and simulated motion.")
    ] = False,
    seed: terminal.Seed = 0,
    accept_implausible: terminal.AcceptImplausible = "",
) -> int:
    """Write the report on a campaign as PDF/A-3, the coefficient file attached.

    The [report] section of campaign.toml states laboratory, customer, vehicle, instruments and dates. Exit status 1
    where a check says that the law should not be used as it is; the report is written all the same and says so.
    Runs that allow no law, as loops do, give a report of their geometry.

    Example: calib report sample_runs/corridor_crossed --into corridor_crossed.pdf --date 2025-03-31
    """
    from calib.io import write_bytes, write_text
    from calib.reporting.content import place_of, report_of
    from calib.reporting.figures.style import write_figures
    from calib.reporting.pages import to_pdf
    from calib.reporting.source import issue_date, opened

    terminal.refuse_outputs(html)
    issued = issue_date(date)
    _refuse_targets(source, into, figures)
    with terminal.progress("report") as tick:
        given = opened(source, progress=tick)
        content = report_of(
            given,
            issued=issued,
            accept=accept_implausible.strip(),
            seed=seed if diagnosis else None,
            where=source,
            progress=tick,
        )
        report = content.report
        target = place_of(report.name, into, force=terminal.forced())
        drawn = (
            [] if figures is None else write_figures(report.figures(), figures, force=terminal.forced(), progress=tick)
        )
        page = "" if html is None else _page(content, given, tick)
        write_bytes(target, to_pdf(report, tick), force=terminal.forced())
    if html is not None:
        write_text(html, page, force=terminal.forced())
    _tell(content, target, html, f"{len(drawn)} figure files to {figures}" if drawn else "")
    terminal.then(_next_step(content), c=source)
    document: dict[str, object] = {"file": str(target), "figures": [str(path) for path in drawn], **report.to_dict()}
    terminal.emit_json(document)
    return 0 if report.passed else 1


def _next_step(content: Reported) -> str:
    from calib.reporting.present import after_diagnosis, after_geometry

    if content.diagnosis is not None:
        return after_diagnosis(content.diagnosis)
    if content.geometry is not None:
        return after_geometry(content.geometry, None)
    return "report" if content.report.passed else "report failed"


def _tell(content: Reported, target: Path, html: Path | None, drawn: str) -> None:
    """Say what was written, and whether the law or the geometry can be used."""
    report, geometry = content.report, content.geometry
    marked = ", simulated data" if report.simulated else ""
    terminal.wrote([], what=f"{target} (report {report.report_id}{marked})")
    terminal.wrote([] if html is None else [html])
    if drawn:
        terminal.wrote([], what=drawn)
    if not report.passed:
        what = "law" if geometry is None else "geometry"
        terminal.say(f"A check failed: the {what} should not be used as it is; the report says why.")


def _refuse_targets(source: Path, into: Path | None, figures: Path | None) -> None:
    """Refuse existing targets before the work, as far as their names are known before it."""
    from calib.campaign.settings_file import read_settings
    from calib.reporting.content import place_of

    settings = source / "campaign.toml"
    if settings.is_file():
        place_of(read_settings(settings, str(settings)).name, into, force=terminal.forced())
    if figures is not None:
        from calib.reporting.figures.gap import GAP_PICTURES
        from calib.reporting.figures.style import figure_paths
        from calib.reporting.topics.fit import FIT_PICTURES

        terminal.refuse_outputs(*figure_paths(figures, (*FIT_PICTURES, *GAP_PICTURES)))


def _page(content: Reported, given: Fit | Campaign, tick: Progress) -> str:
    """Return the page, with linked panels where there is a diagnosis to look into."""
    from calib.campaign.model import Campaign
    from calib.reporting.pages import to_html

    tick(0, 0, "page")
    if content.diagnosis is None or not isinstance(given, Campaign):
        return to_html(content.report)
    from calib.reporting.interactive import interactive_panels

    return to_html(content.report, interactive_panels(content.diagnosis, given))
