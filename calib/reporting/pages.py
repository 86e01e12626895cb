"""Reports as PDF/A-3 with the coefficient file attached, and as one HTML page; the result folder of a fleet."""

import base64
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from importlib.resources import files
from itertools import groupby, pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

from calib.campaign.model import Campaign
from calib.documents import Result, csv_text, plain, templates_of, to_json
from calib.errors import CalibError
from calib.io import write_files
from calib.reporting import Block, Heading, Picture, Section
from calib.reporting.content import Attachment, Report
from calib.reporting.figures import known, marked, render_all
from calib.reporting.formatting import EQUATIONS
from calib.reporting.source import number_of
from calib.reporting.topics import content_of
from calib.types import Progress, silent, stepped

if TYPE_CHECKING:
    from jinja2 import Template

    from calib.fleet.run import Fleet, Survey
    from calib.gap.decision.diagnosis import Diagnosis

#: PDF/A-3, accessible level: tagged, with alternative texts
STANDARD: Final = "a-3a"
#: pictures of a diagnosis, which linked panels replace
GAP_PICTURES: Final = ("gap-map", "gap-by-covariate", "gap-before-after")
#: replaced one by one
MAX_MISSING_SIGNS: Final = 24


def to_pdf(report: Report, progress: Progress = silent) -> bytes:
    """Return the report as PDF/A-3a; raises CalibError where it cannot be set."""
    sources: dict[str, bytes] = {
        "main.typ": (files("calib.reporting") / "page.typ").read_bytes(),
        "data.json": to_json(report.to_dict()).encode("utf-8"),
    }
    for picture in stepped(report.pictures, progress, "figures of the PDF"):
        sources[f"{picture.name}.svg"] = picture.svg
    sources |= {attachment.name: attachment.data for attachment in report.attachments}
    if report.logo is not None:
        sources |= dict([report.logo])
    with TemporaryDirectory(prefix="calib-report-") as folder:
        for name, data in sources.items():
            (Path(folder) / name).write_bytes(data)
        return _compile_with_fallback(Path(folder), report)


def _compile_with_fallback(folder: Path, report: Report) -> bytes:
    text = (folder / "data.json").read_text(encoding="utf-8")
    with suppress(_MissingSign):
        return _compiled(folder, report, system_fonts=False)
    for _ in range(MAX_MISSING_SIGNS):
        try:
            return _compiled(folder, report, system_fonts=True)
        except _MissingSign as error:
            # a whole script is missing
            lost = set(str(error))
            kinds = {unicodedata.category(sign) for sign in lost}
            for sign in {sign for sign in text if unicodedata.category(sign) in kinds and not known(sign)} | lost:
                text = text.replace(sign, f"[U+{ord(sign):X}]")
            (folder / "data.json").write_text(text, encoding="utf-8")
    raise CalibError("the report's page cannot be set: too many signs that no font has; expected common scripts")


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
    """Return a report as a self-contained page, linked panels for the diagnosis' figures."""
    sections = report.sections
    if panels:
        kept = [[each for each in part.blocks if getattr(each, "name", "") not in GAP_PICTURES] for part in sections]
        sections = tuple(replace(part, blocks=tuple(blocks)) for part, blocks in zip(sections, kept, strict=True))
    page = {name: getattr(report, name) for name in ("title", "name", "simulated", "head")}
    page["kind"] = f"Calibration report {report.report_id}"
    page["footer"] = f"Issued {report.issued}; report {report.report_id}"
    return _page(page, sections, panels)


def diagnosis_page(diagnosis: "Diagnosis", campaign: Campaign) -> str:
    """Return a diagnosis as a self-contained HTML page; MissingExtraError without Bokeh."""
    from calib.reporting.interactive import interactive_panels
    from calib.reporting.topics.diagnosis import diagnosis_content, page_one_notice

    page = {
        "kind": "Diagnosis",
        "title": "Gap between measured and simulated motion",
        "name": diagnosis.campaign,
        "simulated": diagnosis.simulated,
        "head": (("Verdict", str(diagnosis.kind).replace("_", " ")), ("In words", page_one_notice(diagnosis).text)),
        "footer": f"Campaign {diagnosis.campaign}",
    }
    return _page(page, (Section("Findings", diagnosis_content(diagnosis)),), interactive_panels(diagnosis, campaign))


def _page(page: Mapping[str, Any], sections: Sequence[Section], panels: str) -> str:
    pictures = _pictures(block for section in sections for block in section.blocks)
    return _template().render(page=page, sections=plain(sections), panels=panels, pictures=pictures)


def blocks_html(blocks: Iterable[Block | Section]) -> str:
    """Return blocks as markup without a page around them; every text is escaped."""
    flat: list[Block] = []
    for block in blocks:
        flat += (Heading(block.title), *block.blocks) if isinstance(block, Section) else (block,)
    return _template().render(page=None, blocks=plain(flat), pictures=_pictures(flat)).strip()


def brief_html(result: Result) -> str:
    """Return what a notebook shows of a result."""
    return blocks_html(content_of(result, brief=True))


def _pictures(blocks: Iterable[Block]) -> dict[str, str]:
    return {one.name: base64.b64encode(one.svg).decode() for one in blocks if isinstance(one, Picture)}


@cache
def _template() -> "Template":
    environment = templates_of("calib.reporting", markup=True)
    environment.globals |= {"equations": EQUATIONS, "groups": _groups}
    return environment.get_template("page.html.j2")


def _groups(columns: Sequence[Mapping[str, str]]) -> list[tuple[str, int]]:
    keys = ((column["group"] or number, column["group"]) for number, column in enumerate(columns))
    return [(run[0][1], len(run)) for run in (list(group) for _, group in groupby(keys, key=lambda key: key[0]))]


def write_fleet(fleet: "Fleet | Survey", into: Path, *, name: str, issued: str, force: bool = False) -> list[Path]:
    """Write a task's result over a fleet and its pages, all or none.

    `name`, `issued`: of the fleet, and date of issue, see `Report`; `force`: in place of others.
    """
    from calib.fleet.run import Fleet
    from calib.reporting.figures.studies import fleet_figures
    from calib.reporting.topics.geometry import fleet_content

    document, blocks = fleet.to_dict(), fleet_content(fleet, page=True)
    view, text = document["fleet"], to_json(document)
    starts = [number for number, block in enumerate(blocks) if isinstance(block, Heading)]
    parts = (blocks[first:last] for first, last in pairwise([*starts, len(blocks)]))
    what = "Every vehicle and the fleet's view, as a program reads it"
    report = Report(
        report_id=number_of("FR", document),
        title="A fleet of vehicles",
        name=name,
        issued=issued,
        simulated=fleet.simulated,
        passed=not view["n_failed"],
        sections=tuple(Section(head.text, tuple(inner)) for head, *inner in parts if isinstance(head, Heading)),
        attachments=(Attachment("fleet.json", text.encode(), what),),
        facts=(("Vehicles", f"{view['n_vehicles']}, of which {view['n_failed']} failed"),),
    )
    stem = "fleet" if isinstance(fleet, Fleet) else fleet.what
    files = {f"{stem}.json": _bytes(text)}
    if isinstance(fleet, Fleet):
        files["vehicles.csv"] = _bytes(_table(document["vehicles"]))
        for figure, draw in fleet_figures(fleet).items():
            drawn = render_all(marked(draw(), simulated=fleet.simulated), ("png", "svg"))
            files |= {f"{figure}.{form}": data for form, data in drawn.items()}
    return write_files(
        into, files | {f"{stem}.pdf": to_pdf(report), f"{stem}.html": _bytes(to_html(report))}, force=force
    )


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "backslashreplace")


def _table(vehicles: Sequence[Mapping[str, Any]]) -> str:
    columns = list(dict.fromkeys(name for vehicle in vehicles for name in vehicle))
    heads = [part for name in columns for part in ([f"{name}_low", f"{name}_high"] if "_ci95_" in name else [name])]
    rows = []
    for vehicle in vehicles:
        values = ((name, vehicle.get(name)) for name in columns)
        cells = ((value or ("", "")) if "_ci95_" in name else (value,) for name, value in values)
        rows.append([cell for group in cells for cell in group])
    return csv_text(heads, rows)
