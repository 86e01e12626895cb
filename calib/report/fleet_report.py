"""A fleet's result as a report: the same blocks as on the terminal, with figures, for the PDF and the HTML page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from calib.files import to_json
from calib.report.blocks import Block, Heading, Section
from calib.report.content import Attachment, Report, number_of


def fleet_report(
    name: str, blocks: Sequence[Block], document: Mapping[str, Any], *, issued: str, simulated: bool
) -> Report:
    """Return the report on a fleet.

    Parameters
    ----------
    name : str
        Of the fleet.
    blocks : sequence of Block
        From `calib.report.statements.fleet`, with pictures.
    document : mapping
        The result as plain JSON values; attached to the PDF.
    issued : str
        Date of issue, YYYY-MM-DD.
    simulated : bool
        Whether a program made any of the data.
    """
    data = to_json(document)
    number = number_of("FR", data)
    fleet = document["fleet"]
    failed = int(fleet["n_failed"])
    return Report(
        report_id=number,
        title="A fleet of vehicles",
        name=name,
        issued=issued,
        simulated=simulated,
        passed=not failed,
        author="",
        head=(
            ("Report", number),
            ("Date of issue", issued),
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
