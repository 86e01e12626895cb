"""The files of a fleet's result: a table of the vehicles, everything as JSON, figures, a PDF and a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calib.files import csv_text, write_bytes, write_json, write_text
from calib.fleet.run import Fleet
from calib.fleet.survey import Survey
from calib.report.blocks import Block
from calib.report.statements.fleet import fleet_content, survey_content

__all__ = ["Heads", "write_fleet", "write_survey"]

FORMS = ("png", "svg")


@dataclass(frozen=True, slots=True)
class Heads:
    """What the pages of a fleet say beside its result: name, date of issue (YYYY-MM-DD), whether data are simulated."""

    name: str
    issued: str
    simulated: bool


def write_fleet(fleet: Fleet, into: Path, heads: Heads | None = None) -> list[Path]:
    """Write a fleet's result; what an earlier run of the same folder wrote is replaced.

    Parameters
    ----------
    fleet : Fleet
        From `calib.fleet.run.fit_fleet`.
    into : Path
        Result folder.
    heads : Heads, optional
        For ``fleet.pdf`` and ``fleet.html``; without it they are not written.

    Returns
    -------
    list of Path
        The files written.
    """
    from calib.report.figures.fleet import fleet_distribution, fleet_drift
    from calib.report.figures.style import render

    document = fleet.to_dict()
    written = [
        write_json(into / "fleet.json", document, force=True),
        write_text(into / "vehicles.csv", _table(document["vehicles"]), force=True),
    ]
    if fleet.view.n_fitted:
        figures = {"distribution": fleet_distribution(fleet), "drift": fleet_drift(fleet)}
        written += [
            write_bytes(into / f"{name}.{form}", render(figure, form), force=True)
            for name, figure in figures.items()
            if figure is not None
            for form in FORMS
        ]
    return written + _pages(fleet_content(fleet, pictures=True), document, into, "fleet", heads)


def write_survey(survey: Survey, into: Path, heads: Heads | None = None) -> list[Path]:
    """Write the result of a task over a fleet; see `write_fleet`."""
    document = survey.to_dict()
    written = [write_json(into / f"{survey.what}.json", document, force=True)]
    return written + _pages(survey_content(survey, page=True), document, into, survey.what, heads)


def _pages(
    blocks: Sequence[Block], document: Mapping[str, Any], into: Path, stem: str, heads: Heads | None
) -> list[Path]:
    if heads is None:
        return []
    from calib.report.fleet_report import fleet_report
    from calib.report.html import to_html
    from calib.report.pdf import to_pdf

    report = fleet_report(heads.name, blocks, document, issued=heads.issued, simulated=heads.simulated)
    return [
        write_bytes(into / f"{stem}.pdf", to_pdf(report), force=True),
        write_text(into / f"{stem}.html", to_html(report), force=True),
    ]


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
