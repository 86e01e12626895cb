"""A report as plain sections: its head, its pages, its attachments, and the file that it is written to."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from calib import __version__
from calib.campaign.checks.design import assumed_settings
from calib.campaign.model import Campaign
from calib.documents import to_json
from calib.errors import BadInputError
from calib.gap.decision.diagnosis import Diagnosis
from calib.io import refuse_existing
from calib.reporting.blocks import Items, Notice, Picture, Section
from calib.reporting.formatting import prose
from calib.reporting.source import Logo, Source, logo_of, signatures_of, stated_of, verdict_document
from calib.reporting.topics import sections_of
from calib.reporting.topics.conditions import assumed_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: longest campaign name in the header of a page; the title has it whole
SHORT_NAME: Final = 44


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file carried inside the PDF."""

    name: str
    data: bytes
    mime: str
    description: str
    relationship: str = "data"


@dataclass(frozen=True, slots=True)
class Report:
    """A report, ready to be set."""

    #: identification, on every page
    report_id: str
    #: title and campaign
    title: str
    name: str
    #: date of issue, YYYY-MM-DD
    issued: str
    #: every page says so
    simulated: bool
    #: whether every check of the fit allows the law to be used
    passed: bool
    #: the laboratory, as stated; may be empty
    author: str
    #: facts under the title
    head: tuple[tuple[str, str], ...]
    sections: tuple[Section, ...]
    #: files inside the PDF
    attachments: tuple[Attachment, ...]
    #: role and name of those who sign
    signatures: tuple[tuple[str, str], ...] = ()
    logo: Logo | None = None

    @property
    def pictures(self) -> tuple[Picture, ...]:
        """The figures, in the order of the pages."""
        return tuple(block for section in self.sections for block in section.blocks if isinstance(block, Picture))

    def figures(self) -> dict[str, Figure]:
        """Return its figures, drawn, by name."""
        return {picture.name: picture.draw() for picture in self.pictures}

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain values, as the page reads it."""
        short = self.name if len(self.name) <= SHORT_NAME else self.name[: SHORT_NAME - 1] + "…"
        return {
            "format": "calib-report/1",
            "id": self.report_id,
            "kind": "Calibration report",
            "title": self.title,
            "name": self.name,
            "short_name": short,
            "subject": f"Calibration report on the campaign {self.name}" + (", simulated data" * self.simulated),
            "issued": self.issued,
            "date": [int(part) for part in self.issued.split("-")],
            "program": f"calib {__version__}",
            "simulated": self.simulated,
            "passed": self.passed,
            "author": self.author,
            "head": [list(fact) for fact in self.head],
            "signatures": [list(signature) for signature in self.signatures],
            "logo": None if self.logo is None else f"logo{self.logo.suffix}",
            "sections": [section.to_dict() for section in self.sections],
            "attachments": [
                {
                    "name": attachment.name,
                    "relationship": attachment.relationship,
                    "mime": attachment.mime,
                    "description": attachment.description,
                }
                for attachment in self.attachments
            ],
        }


def number_of(kind: str, content: str) -> str:
    """Return a report's identification: the kind of report and what its content gives, never chance."""
    return f"{kind}-{hashlib.sha256(content.encode()).hexdigest()[:12].upper()}"


def head_of(report_id: str, issued: str, stated: Mapping[str, str]) -> tuple[tuple[str, str], ...]:
    """Return the facts under a report's title."""
    facts = [("Report", report_id), ("Date of issue", issued)]
    titles = (
        ("Replaces report", "replaces"),
        ("Method", "method"),
        ("Laboratory", "laboratory"),
        ("Customer", "customer"),
        ("Vehicle", "item"),
        ("Dates of measurement", "measured"),
        ("Authorised by", "authorised"),
    )
    return (*facts, *((title, stated[key]) for title, key in titles if key in stated))


def compose(source: Source) -> Report:
    """Return the report on a fit.

    The sections of every page that has something to say.
    """
    return Report(
        report_id=source.report_id,
        title="Effective rolling radius of the rear wheels",
        name=source.fit.name,
        issued=source.issued,
        simulated=source.simulated,
        passed=source.fit.passed,
        author=source.stated.get("laboratory", ""),
        head=head_of(source.report_id, source.issued, source.stated),
        signatures=signatures_of(source.stated),
        logo=source.logo,
        sections=sections_of(source),
        attachments=(
            Attachment(
                name="coefficients.json",
                data=source.coefficients.to_bytes(),
                mime="application/json",
                description="Radius law of both wheels with covariance and valid load range, as the vehicle loads it",
            ),
        ),
    )


DEFAULT_FOLDER: Final = Path("reports")
LONGEST: Final = 80


def file_name(name: str) -> str:
    """Return the PDF's name for a campaign's name: letters, digits, ``-``, ``_`` and ``.`` only."""
    kept = re.sub(r"[^\w.-]+", "-", name, flags=re.UNICODE).strip("-.")[:LONGEST].strip("-.")
    return f"{kept or 'report'}.pdf"


def place_of(name: str, into: Path | None, *, force: bool = False) -> Path:
    """Return the file that a report is written to.

    `into`: a file ending in ``.pdf``, or a folder; None: ``reports/`` of the working directory. Raises BadInputError
    where the file exists and `force` is False, or `into` is a file that is no PDF.
    """
    if into is None:
        path = DEFAULT_FOLDER / file_name(name)
    elif into.suffix.lower() == ".pdf" and not into.is_dir():
        path = into
    elif into.is_file():
        raise BadInputError(f"into: found the file {into}; expected a folder or a name ending in .pdf; choose another")
    else:
        path = into / file_name(name)
    if path.is_dir():
        raise BadInputError(f"into: found the folder {path}; expected a place for a file; choose another")
    refuse_existing([path], force=force)
    return path


def diagnosis_report(campaign: Campaign, diagnosis: Diagnosis, *, issued: str, why: str) -> Report:
    """Return the report on what a diagnosis found, without a law.

    `campaign`: for example loops alone, from which no effective radius follows; `issued`: date of issue, YYYY-MM-DD;
    `why`: why there is no law, a sentence without its full stop. The verdict is attached as ``diagnosis.json``.
    """
    from calib.reporting.figures.gap import GapArrays
    from calib.reporting.topics.diagnosis import gap_section

    document = verdict_document(diagnosis)
    content = {"inputs": dict(campaign.hashes), "campaign": campaign.name, "version": __version__, "gap": document}
    number = number_of("CR", to_json(content))
    stated = stated_of(campaign)
    limits = Section(
        "What this report does not cover",
        (
            Items(
                (
                    "No radius, slope or uncertainty of a wheel is stated, and no coefficient file is attached.",
                    "The verdict holds for the vehicle, routes, loads and conditions of these runs.",
                )
            ),
            assumed_text(assumed_settings(campaign)),
        ),
    )
    reason = Section("Radius law", (Notice("note", "These runs give no radius law", prose(why.rstrip(".")) + "."),))
    return Report(
        report_id=number,
        title="Gap between measured and simulated motion",
        name=campaign.name,
        issued=issued,
        simulated=campaign.simulated,
        passed=True,
        author=stated.get("laboratory", ""),
        head=head_of(number, issued, stated),
        signatures=signatures_of(stated),
        logo=logo_of(campaign),
        sections=(reason, gap_section(diagnosis, GapArrays.of(diagnosis)), limits),
        attachments=(
            Attachment(
                name="diagnosis.json",
                data=to_json(document).encode("utf-8"),
                mime="application/json",
                description="The verdict of the diagnosis with everything that it rests on",
            ),
        ),
    )
