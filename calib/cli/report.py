"""`calib report`: the PDF that a customer gets."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli import terminal
from calib.errors import BadInputError, RefusedError

if TYPE_CHECKING:
    from calib.campaign.model import Campaign
    from calib.gap.decision.diagnosis import Diagnosis
    from calib.kinematics.result import Geometry
    from calib.reporting.content import Report
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
    from calib.reporting.content import place_of
    from calib.reporting.figures.style import write_figures
    from calib.reporting.next_step import after_diagnosis, after_geometry
    from calib.reporting.pages import to_pdf
    from calib.reporting.source import issue_date

    terminal.refuse_outputs(html)
    issued = issue_date(date)
    _refuse_targets(source, into, figures)
    with terminal.progress("report") as tick:
        content = _content(source, issued, accept_implausible.strip(), seed if diagnosis else None, tick)
        report = content.report
        target = place_of(report.name, into, force=terminal.forced())
        drawn = (
            [] if figures is None else write_figures(report.figures(), figures, force=terminal.forced(), progress=tick)
        )
        page = "" if html is None else _page(content, tick)
        write_bytes(target, to_pdf(report, tick), force=terminal.forced())
    if html is not None:
        write_text(html, page, force=terminal.forced())
    _tell(content, target, html, f"{len(drawn)} figure files to {figures}" if drawn else "")
    if content.diagnosis is not None:
        step = after_diagnosis(content.diagnosis)
    elif content.geometry is not None:
        step = after_geometry(content.geometry, None)
    else:
        step = "report" if report.passed else "report failed"
    terminal.then(step, c=source)
    document: dict[str, object] = {"file": str(target), "figures": [str(path) for path in drawn], **report.to_dict()}
    terminal.emit_json(document)
    return 0 if report.passed else 1


def _tell(content: _Content, target: Path, html: Path | None, drawn: str) -> None:
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


@dataclass(frozen=True, slots=True)
class _Content:
    """A report, and the diagnosis with its campaign where one was asked for."""

    report: Report
    diagnosis: Diagnosis | None = None
    campaign: Campaign | None = None
    geometry: Geometry | None = None


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


def _content(path: Path, issued: str, accept: str, seed: int | None, tick: Progress) -> _Content:
    """Return the report; runs that allow no law give one of the geometry, with the diagnosis where its seed asks."""
    from calib.reporting.content import compose
    from calib.reporting.source import source_of

    try:
        source, campaign = source_of(path, issued=issued, accept=accept, progress=tick)
    except RefusedError as error:
        return _without_law(path, error, issued, accept, seed, tick)
    if seed is None:
        return _Content(compose(source))
    if campaign is None:
        raise BadInputError(
            f"{path}: found the result of a fit; expected a campaign folder, which a diagnosis needs; give the campaign"
        )
    from calib.gap.diagnose import diagnose_in_full

    diagnosis = diagnose_in_full(campaign, seed=seed, progress=tick)
    return _Content(compose(source.with_diagnosis(diagnosis)), diagnosis, campaign)


def _without_law(
    path: Path, refusal: RefusedError, issued: str, accept: str, seed: int | None, tick: Progress
) -> _Content:
    """Return the report on runs that allow no law: of their geometry, and of the diagnosis where it is asked for."""
    from calib.campaign.read import read_campaign
    from calib.coefficients.build import from_geometry
    from calib.gap.diagnose import diagnose_in_full
    from calib.kinematics.estimate import estimate_geometry, traces_of
    from calib.reporting.content import report_without_law

    read = read_campaign(path, progress=tick)
    diagnosis = None if seed is None else diagnose_in_full(read, seed=seed, progress=tick)
    estimated, file = None, None
    try:
        estimated = estimate_geometry(read, progress=tick)
    except RefusedError:
        if diagnosis is None:
            raise refusal from None
    else:
        estimated = replace(estimated, paths=traces_of(read, estimated))
        if estimated.passed or accept:
            file = from_geometry(estimated, read, created=issued, accept=accept).to_bytes()
    report = report_without_law(
        read,
        issued=issued,
        why=str(refusal).removeprefix(f"{path}: "),
        geometry=estimated,
        coefficients=file,
        diagnosis=diagnosis,
    )
    return _Content(report, diagnosis, read, estimated)


def _page(content: _Content, tick: Progress) -> str:
    """Return the page, with linked panels where there is a diagnosis to look into."""
    from calib.reporting.pages import to_html

    tick(0, 0, "page")
    if content.diagnosis is None or content.campaign is None:
        return to_html(content.report)
    from calib.reporting.interactive import interactive_panels

    return to_html(content.report, interactive_panels(content.diagnosis, content.campaign))
