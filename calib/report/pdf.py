"""The report as PDF/A-3: figures drawn, page set, coefficient file attached; same input, same bytes."""

from __future__ import annotations

from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from calib.errors import CalibError
from calib.files import to_json
from calib.report.content import Report
from calib.report.figures.files import FORMS
from calib.report.figures.files import write_figures as files_of
from calib.report.figures.style import render

__all__ = ["FORMS", "to_pdf", "write_figures"]

#: PDF/A-3 at its accessible level: tagged, with alternative texts
STANDARD: Final = "a-3a"


def to_pdf(report: Report) -> bytes:
    """Return the report as PDF/A-3a.

    Parameters
    ----------
    report : Report
        From `calib.report.content.compose`.

    Returns
    -------
    bytes
        The same for the same report: its date is the date of issue, and only built-in fonts are used.

    Raises
    ------
    CalibError
        Where the page cannot be set.
    """
    import typst

    sources: dict[str, bytes] = {
        "main.typ": (files("calib.report") / "page.typ").read_bytes(),
        "data.json": to_json(report.to_dict()).encode("utf-8"),
    }
    for picture in report.pictures:
        sources[f"{picture.name}.svg"] = render(picture.draw(), "svg")
    for attachment in report.attachments:
        sources[attachment.name] = attachment.data
    with TemporaryDirectory(prefix="calib-report-") as folder:
        for name, data in sources.items():
            (Path(folder) / name).write_bytes(data)
        try:
            made = typst.compile(
                str(Path(folder) / "main.typ"),
                root=folder,
                format="pdf",
                pdf_standards=[STANDARD],
                ignore_system_fonts=True,
                timestamp=datetime.fromisoformat(report.issued).replace(tzinfo=UTC),
            )
        except RuntimeError as error:
            raise CalibError(
                f"the report's page cannot be set: {error}; expected a page for any content, so please report it"
            ) from error
    return bytes(made)


def write_figures(report: Report, folder: Path, *, force: bool = False) -> list[Path]:
    """Write every figure of a report as PNG, SVG and PDF; see `calib.report.figures.files.write_figures`."""
    return files_of({picture.name: picture.draw() for picture in report.pictures}, folder, force=force)
