"""The report as PDF/A-3 with its coefficient file attached, and as one HTML page that opens from disk.

Same input, same bytes. A page of HTML is plain markup with its figures inside; it needs no script.
"""

from __future__ import annotations

import base64
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from importlib.resources import files
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

from calib.documents import plain, templates_of, to_json
from calib.errors import CalibError
from calib.reporting.blocks import Block, Heading, Picture, Section
from calib.reporting.content import Report
from calib.reporting.figures.style import render
from calib.reporting.formatting import EQUATIONS
from calib.types import Progress, silent, stepped

if TYPE_CHECKING:
    from jinja2 import Template

    from calib.campaign.model import Campaign
    from calib.gap.decision.diagnosis import Diagnosis

#: PDF/A-3 at its accessible level: tagged, with alternative texts
STANDARD: Final = "a-3a"
#: pictures of a diagnosis, which linked panels replace
GAP_PICTURES: Final = ("gap-map", "gap-by-covariate", "gap-before-after")
#: missing signs replaced one by one, beyond whole scripts that the fonts lack
MAX_MISSING_SIGNS: Final = 24


def to_pdf(report: Report, progress: Progress = silent) -> bytes:
    """Return the report as PDF/A-3a.

    The same for the same report: its date is the date of issue, and only built-in fonts are used, unless a name holds
    signs that these lack. Raises CalibError where the page cannot be set.
    """
    sources: dict[str, bytes] = {
        "main.typ": (files("calib.reporting") / "page.typ").read_bytes(),
        "data.json": to_json(report.to_dict()).encode("utf-8"),
    }
    for picture in stepped(report.pictures, progress, "figures of the PDF"):
        sources[f"{picture.name}.svg"] = render(picture.draw(), "svg")
    for attachment in report.attachments:
        sources[attachment.name] = attachment.data
    if report.logo is not None:
        sources |= dict([report.logo])
    with TemporaryDirectory(prefix="calib-report-") as folder:
        for name, data in sources.items():
            (Path(folder) / name).write_bytes(data)
        return _compile_with_fallback(Path(folder), report)


def _compile_with_fallback(folder: Path, report: Report) -> bytes:
    """Set the page with the built-in fonts.

    Where a sign is in none of them, those of the system are used, too; where it is in none of these either, it is
    replaced by its code point.
    """
    text = (folder / "data.json").read_text(encoding="utf-8")
    with suppress(_MissingSign):
        return _compiled(folder, report, system_fonts=False)
    for _ in range(MAX_MISSING_SIGNS):
        try:
            return _compiled(folder, report, system_fonts=True)
        except _MissingSign as error:
            for sign in {sign for sign in text if _of_rare_script(sign)} | set(str(error)):
                text = text.replace(sign, f"[U+{ord(sign):X}]")
            (folder / "data.json").write_text(text, encoding="utf-8")
    raise CalibError("the report's page cannot be set: too many signs that no font has; expected common scripts")


def _of_rare_script(sign: str) -> bool:
    """Return whether a sign is of a script that the built-in fonts lack as a whole."""
    common = unicodedata.name(sign, "").startswith(("LATIN", "GREEK", "CYRILLIC"))
    return unicodedata.category(sign) in {"Lo", "So", "Cn", "Co"} and not common


class _MissingSign(Exception):
    """Signs that no font has."""


def _compiled(folder: Path, report: Report, *, system_fonts: bool) -> bytes:
    import typst

    try:
        compiled = typst.compile(
            str(folder / "main.typ"),
            root=str(folder),
            format="pdf",
            pdf_standards=[STANDARD],
            ignore_system_fonts=not system_fonts,
            timestamp=datetime.fromisoformat(report.issued).replace(tzinfo=UTC),
        )
    except RuntimeError as error:
        missing = re.search(r'the text `"(.+?)"` could not be displayed', str(error))
        if missing:
            raise _MissingSign(missing[1]) from error
        if report.logo is not None and re.search(r"image|svg", str(error), re.IGNORECASE):
            raise CalibError(
                f"campaign.toml, report.logo: found a file that cannot be drawn ({error}); expected a picture as its "
                "name says; save it again as SVG, PNG or JPEG"
            ) from error
        raise CalibError(
            f"the report's page cannot be set: {error}; expected a page for any content, so please report it"
        ) from error
    return bytes(compiled)


def to_html(report: Report, panels: str = "") -> str:
    """Return a report as a self-contained page, with linked panels in place of the figures of the diagnosis."""
    sections = report.sections
    if panels:
        sections = tuple(
            replace(part, blocks=tuple(each for each in part.blocks if getattr(each, "name", "") not in GAP_PICTURES))
            for part in sections
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
    pictures = (block for block in blocks if isinstance(block, Picture))
    return {one.name: base64.b64encode(render(one.draw(), "svg")).decode("ascii") for one in pictures}


@cache
def _template() -> Template:
    environment = templates_of("calib.reporting", markup=True)
    environment.globals |= {"equations": EQUATIONS, "groups": _groups}
    return environment.get_template("page.html.j2")


def _groups(columns: Sequence[Mapping[str, str]]) -> list[tuple[str, int]]:
    """Return the common titles of neighbouring columns with the number of columns of each."""
    keys = ((column["group"] or number, column["group"]) for number, column in enumerate(columns))
    return [(run[0][1], len(run)) for run in (list(group) for _, group in groupby(keys, key=lambda key: key[0]))]
