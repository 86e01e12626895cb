"""Report as one HTML page that opens from disk: blocks as plain markup, figures inside, no script needed."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib.resources import files
from itertools import groupby
from typing import TYPE_CHECKING, Any

from calib.reporting.blocks import Block, Heading, Picture, Section
from calib.reporting.content import Report
from calib.reporting.figures.gap import GAP_PICTURES
from calib.reporting.figures.style import render
from calib.reporting.text import EQUATIONS
from calib.result import plain

if TYPE_CHECKING:
    from jinja2 import Template

    from calib.campaign.model import Campaign
    from calib.gap.decision.diagnosis import Diagnosis


def to_html(report: Report, panels: str = "") -> str:
    """Return a report as a self-contained page.

    `panels` (see `calib.reporting.interactive.interactive_panels`) replace the figures of the diagnosis, which keeps
    the page small.
    """
    sections = report.sections
    if panels:
        sections = tuple(
            replace(section, blocks=tuple(block for block in section.blocks if not _in_panels(block)))
            for section in sections
        )
    page = {
        "kind": f"Calibration report {report.report_id}",
        "title": report.title,
        "name": report.name,
        "simulated": report.simulated,
        "head": report.head,
        "footer": f"Issued {report.issued}; report {report.report_id}",
    }
    return _page(page, sections, panels)


def _in_panels(block: Block) -> bool:
    return isinstance(block, Picture) and block.name in GAP_PICTURES


def diagnosis_page(diagnosis: Diagnosis, campaign: Campaign) -> str:
    """Return a diagnosis as a self-contained HTML page; raises MissingExtraError where Bokeh is not installed."""
    from calib.reporting.interactive import interactive_panels
    from calib.reporting.topics.diagnosis import diagnosis_content, page_one_notice

    page = {
        "kind": "Diagnosis",
        "title": "Gap between measured and simulated motion",
        "name": diagnosis.campaign,
        "simulated": diagnosis.simulated,
        "head": (
            ("Verdict", str(diagnosis.kind).replace("_", " ")),
            ("In words", page_one_notice(diagnosis).text),
            ("Judged against", diagnosis.judged_against),
        ),
        "footer": f"Campaign {diagnosis.campaign}",
    }
    sections = (Section("Findings", diagnosis_content(diagnosis)),)
    return _page(page, sections, interactive_panels(diagnosis, campaign))


def _page(page: Mapping[str, Any], sections: Sequence[Section], panels: str) -> str:
    """Return a page as markup that fetches nothing; `page`: kind, title, name, simulated, head and footer."""
    style = (files("calib.reporting") / "page.css").read_text(encoding="utf-8")
    pictures = _pictures(block for section in sections for block in section.blocks)
    return _template().render(page=page, sections=plain(sections), panels=panels, style=style, pictures=pictures)


def blocks_html(blocks: Iterable[Block | Section]) -> str:
    """Return blocks as markup without a page around them, as a notebook shows them; every text is escaped."""
    flat: list[Block] = []
    for block in blocks:
        flat += (Heading(block.title), *block.blocks) if isinstance(block, Section) else (block,)
    return _template().render(page=None, blocks=plain(flat), pictures=_pictures(flat)).strip()


def _pictures(blocks: Iterable[Block]) -> dict[str, str]:
    """Return the pictures among blocks as SVG in base64, by name."""
    pictures = (block for block in blocks if isinstance(block, Picture))
    return {one.name: base64.b64encode(render(one.draw(), "svg")).decode("ascii") for one in pictures}


@cache
def _template() -> Template:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(loader=PackageLoader("calib.reporting", "."), autoescape=True, undefined=StrictUndefined)
    environment.globals |= {"equations": EQUATIONS, "groups": _groups}
    return environment.get_template("page.html.j2")


def _groups(columns: Sequence[Mapping[str, str]]) -> list[tuple[str, int]]:
    """Return the common titles of neighbouring columns with the number of columns of each."""
    keys = ((column["group"] or number, column["group"]) for number, column in enumerate(columns))
    return [(run[0][1], len(run)) for run in (list(group) for _, group in groupby(keys, key=lambda key: key[0]))]
