"""The report as one HTML page that opens from disk: blocks as plain markup, figures inside, no script needed."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from dataclasses import dataclass, replace
from html import escape
from importlib.resources import files
from typing import Final

from calib.report.blocks import Block, Column, Equation, Facts, Heading, Items, Notice, Picture, Section, Table, Text
from calib.report.content import Report
from calib.report.figures.style import render
from calib.report.statements.gap_pictures import GAP_PICTURES
from calib.report.text import EQUATIONS

HOW_TO_LOOK: Final = (
    "Choose runs by clicking or drawing a box in any panel, or a session, kind or run in the list: they light up in "
    "every panel. Colours are kinds. The gap can be shown for any channel, and against any covariate."
)
_SMALL: Final = ' class="small"'
_ALIGN: Final = {"left": "l", "right": "r", "center": "c"}


@dataclass(frozen=True, slots=True)
class Page:
    """What a page says."""

    #: what it is, its title, and the campaign
    kind: str
    title: str
    name: str
    #: the page says so
    simulated: bool
    #: facts under the title
    head: tuple[tuple[str, str], ...]
    sections: tuple[Section, ...]
    #: last line
    footer: str


def to_html(report: Report, panels: str = "") -> str:
    """Return a report as a self-contained page.

    `panels` (see `calib.report.interactive.interactive_panels`) take the place of the diagnosis' figures, which keeps
    the page light.
    """
    sections = report.sections
    if panels:
        sections = tuple(
            replace(section, blocks=tuple(block for block in section.blocks if not _in_panels(block)))
            for section in sections
        )
    page = Page(
        kind=f"Calibration report {report.report_id}",
        title=report.title,
        name=report.name,
        simulated=report.simulated,
        head=report.head,
        sections=sections,
        footer=f"Issued {report.issued}; report {report.report_id}",
    )
    return page_html(page, panels)


def _in_panels(block: Block) -> bool:
    return isinstance(block, Picture) and block.name in GAP_PICTURES


def page_html(page: Page, panels: str = "") -> str:
    """Return a page as markup that fetches nothing; see `to_html`."""
    style = (files("calib.report") / "page.css").read_text(encoding="utf-8")
    simulated = (
        block_html(Notice("simulated", "Simulated data", "A program made these data. No vehicle was measured."))
        if page.simulated
        else ""
    )
    contents = "".join(
        f'<li><a href="#s{number}">{escape(section.title)}</a></li>'
        for number, section in enumerate(page.sections, start=1)
    )
    sections = "\n".join(_section(number, section) for number, section in enumerate(page.sections, start=1))
    looking = (
        f'<section id="look" class="panels">\n<h2>To look into</h2>\n{block_html(Text(HOW_TO_LOOK, small=True))}\n'
        f"{panels}\n<noscript>The panels need scripts; all that is said stands above.</noscript>\n</section>"
        if panels
        else ""
    )
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(page.title)} – {escape(page.name)}</title>
<style>
{style}</style>
</head>
<body>
<header>
<p class="kind">{escape(page.kind)}</p>
<h1>{escape(page.title)}</h1>
<p class="name">{escape(page.name)}</p>
{simulated}
{block_html(Facts(page.head))}
</header>
<nav><ol>{contents}</ol></nav>
<main>
{sections}
{looking}
</main>
<footer>{escape(page.footer)}</footer>
</body>
</html>
"""


def _section(number: int, section: Section) -> str:
    blocks = "\n".join(block_html(block) for block in section.blocks)
    return f'<section id="s{number}">\n<h2>{number} {escape(section.title)}</h2>\n{blocks}\n</section>'


def blocks_html(blocks: Iterable[Block | Section]) -> str:
    """Return blocks as markup without a page around them, as a notebook shows them."""
    parts = []
    for block in blocks:
        inner = (Heading(block.title), *block.blocks) if isinstance(block, Section) else (block,)
        parts += [block_html(part) for part in inner]
    return "\n".join(parts)


def block_html(block: Block) -> str:
    """Return a block as markup; every text is escaped, pictures are held as vectors."""
    if isinstance(block, Heading):
        return f"<h3>{escape(block.text)}</h3>"
    if isinstance(block, Text):
        return f"<p{_SMALL if block.small else ''}>{escape(block.text)}</p>"
    if isinstance(block, Facts):
        rows = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in block.rows)
        return f"<dl>{rows}</dl>"
    if isinstance(block, Items):
        return "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in block.items) + "</ul>"
    if isinstance(block, Equation):
        return f'<p class="equation">{escape(EQUATIONS[block.name])}</p>'
    if isinstance(block, Notice):
        text = f"<p>{escape(block.text)}</p>" if block.text else ""
        return f'<div class="notice {escape(block.level)}"><strong>{escape(block.title)}</strong>{text}</div>'
    if isinstance(block, Table):
        return _table(block)
    assert isinstance(block, Picture)
    data = base64.b64encode(render(block.draw(), "svg")).decode("ascii")
    return (
        f'<figure><img alt="{escape(block.alt)}" src="data:image/svg+xml;base64,{data}">'
        f"<figcaption>{escape(block.caption)}</figcaption></figure>"
    )


def _table(table: Table) -> str:
    groups = ""
    if any(column.group for column in table.columns):
        spans: list[tuple[str, int]] = []
        for column in table.columns:
            if spans and column.group and spans[-1][0] == column.group:
                spans[-1] = (column.group, spans[-1][1] + 1)
            else:
                spans.append((column.group, 1))
        cells = "".join(f'<th class="c" colspan="{span}">{escape(title)}</th>' for title, span in spans)
        groups = f"<tr>{cells}</tr>"
    head = "".join(
        f'<th class="{_ALIGN[column.align]}">{escape(column.title)}'
        + (f"<br><span>{escape(column.unit)}</span>" if column.unit else "")
        + "</th>"
        for column in table.columns
    )
    body = "".join("<tr>" + "".join(map(_cell, table.columns, row)) + "</tr>\n" for row in table.rows)
    return (
        f'<div class="table"><table><caption>{escape(table.caption)}</caption>'
        f"<thead>{groups}<tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>"
    )


def _cell(column: Column, text: str) -> str:
    name = _ALIGN[column.align] + (" mono" if column.mono else "") + (" wide" if column.wide else "")
    return f'<td class="{name}">{escape(text)}</td>'
