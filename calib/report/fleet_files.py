"""The files of a fleet's result: a table of the vehicles, everything as JSON, figures, a PDF and a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from calib.files import write_bytes, write_json, write_text
from calib.fleet.run import Fleet
from calib.fleet.survey import Survey

__all__ = ["write_fleet", "write_survey"]

FORMS = ("png", "svg")


def write_fleet(fleet: Fleet, into: Path) -> list[Path]:
    """Write a fleet's result; what an earlier run of the same folder wrote is replaced.

    Parameters
    ----------
    fleet : Fleet
        From `calib.fleet.run.fit_fleet`.
    into : Path
        Result folder.

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
    return written


def write_survey(survey: Survey, into: Path) -> list[Path]:
    """Write the result of a task over a fleet; see `write_fleet`."""
    return [write_json(into / f"{survey.what}.json", survey.to_dict(), force=True)]


def _table(vehicles: Sequence[Mapping[str, Any]]) -> str:
    """Return the vehicles as CSV; intervals as two columns."""
    import csv
    import io

    columns = list(dict.fromkeys(name for vehicle in vehicles for name in vehicle))
    heads = [part for name in columns for part in ([f"{name}_low", f"{name}_high"] if "_ci95_" in name else [name])]
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(heads)
    for vehicle in vehicles:
        cells: list[Any] = []
        for name in columns:
            value = vehicle.get(name)
            cells += (list(value) if value is not None else ["", ""]) if "_ci95_" in name else [_cell(value)]
        writer.writerow(cells)
    return stream.getvalue()


def _cell(value: Any) -> Any:
    if value is None:
        return ""
    # a text that a spreadsheet would take for a formula stays a text
    return f"'{value}" if isinstance(value, str) and value[:1] in "=+-@\t\r" and value else value
