"""The files of a fleet's result: a table of the vehicles, everything as JSON, figures, a PDF and a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calib.files import csv_text, to_json
from calib.fleet.run import Fleet
from calib.fleet.survey import Survey
from calib.folders import write_files
from calib.report.blocks import Block, Heading, Section
from calib.report.content import Attachment, Report, number_of
from calib.report.statements.fleet import fleet_content, survey_content

FORMS = ("png", "svg")


@dataclass(frozen=True, slots=True)
class Heads:
    """What the pages of a fleet say beside its result: name, date of issue (YYYY-MM-DD), whether data are simulated."""

    name: str
    issued: str
    simulated: bool


def write_fleet(fleet: Fleet, into: Path, heads: Heads | None = None) -> list[Path]:
    """Write a fleet's result, all of it or none; what an earlier run of the same folder wrote is replaced.

    `into`: result folder; `heads`: for ``fleet.pdf`` and ``fleet.html``; without it they are not written.
    """
    from calib.report.figures.fleet import fleet_distribution, fleet_drift
    from calib.report.figures.style import render_all

    document = fleet.to_dict()
    files = {"fleet.json": _bytes(to_json(document)), "vehicles.csv": _bytes(_table(document["vehicles"]))}
    if fleet.view.n_fitted:
        figures = {"distribution": fleet_distribution(fleet), "drift": fleet_drift(fleet)}
        files |= {
            f"{name}.{form}": data
            for name, figure in figures.items()
            if figure is not None
            for form, data in render_all(figure, FORMS).items()
        }
    return write_files(into, files | _pages(fleet_content(fleet, pictures=True), document, "fleet", heads), force=True)


def write_survey(survey: Survey, into: Path, heads: Heads | None = None) -> list[Path]:
    """Write the result of a task over a fleet; see `write_fleet`."""
    document = survey.to_dict()
    files = {f"{survey.what}.json": _bytes(to_json(document))}
    pages = _pages(survey_content(survey, page=True), document, survey.what, heads)
    return write_files(into, files | pages, force=True)


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "backslashreplace")


def _pages(blocks: Sequence[Block], document: Mapping[str, Any], stem: str, heads: Heads | None) -> dict[str, bytes]:
    if heads is None:
        return {}
    from calib.report.html import to_html
    from calib.report.pdf import to_pdf

    report = _report(blocks, document, heads)
    return {f"{stem}.pdf": to_pdf(report), f"{stem}.html": _bytes(to_html(report))}


def _report(blocks: Sequence[Block], document: Mapping[str, Any], heads: Heads) -> Report:
    """Return the report on a fleet: the blocks of the terminal with figures, the result attached as JSON."""
    data = to_json(document)
    number = number_of("FR", data)
    fleet = document["fleet"]
    failed = int(fleet["n_failed"])
    return Report(
        report_id=number,
        title="A fleet of vehicles",
        name=heads.name,
        issued=heads.issued,
        simulated=heads.simulated,
        passed=not failed,
        author="",
        head=(
            ("Report", number),
            ("Date of issue", heads.issued),
            ("Vehicles", f"{fleet['n_vehicles']}, of which {failed} failed"),
        ),
        sections=_sections(blocks),
        attachments=(
            Attachment(
                name="fleet.json",
                data=data.encode("utf-8"),
                mime="application/json",
                description="Every vehicle and the fleet's view, as a program reads it",
            ),
        ),
    )


def _sections(blocks: Sequence[Block]) -> tuple[Section, ...]:
    """Return a section for each heading with what follows it."""
    titles: list[tuple[str, list[Block]]] = []
    for block in blocks:
        if isinstance(block, Heading):
            titles.append((block.text, []))
        elif titles:
            titles[-1][1].append(block)
        else:
            titles.append(("Fleet", [block]))
    return tuple(Section(title, tuple(inner)) for title, inner in titles)


def _table(vehicles: Sequence[Mapping[str, Any]]) -> str:
    """Return the vehicles as CSV; intervals as two columns."""
    columns = list(dict.fromkeys(name for vehicle in vehicles for name in vehicle))
    heads = [part for name in columns for part in ([f"{name}_low", f"{name}_high"] if "_ci95_" in name else [name])]
    rows = []
    for vehicle in vehicles:
        cells: list[Any] = []
        for name in columns:
            value = vehicle.get(name)
            cells += (list(value) if value is not None else ["", ""]) if "_ci95_" in name else [value]
        rows.append(cells)
    return csv_text(heads, rows)
