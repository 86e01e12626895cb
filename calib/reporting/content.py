"""A report as plain sections, and the file that it is written to."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from calib import __version__
from calib.campaign.checks import assumed_settings
from calib.campaign.model import Campaign
from calib.documents import plain_fields, to_json
from calib.errors import BadInputError, RefusedError
from calib.io import refuse_existing
from calib.radius.result import Fit, ingest_notes
from calib.reporting import Items, Notice, Picture, Section, catalogue, named, paragraph
from calib.reporting.formatting import capital, prose
from calib.reporting.source import Source, logo_of, number_of, source_of, stated_of
from calib.reporting.topics.fit import assumed_text
from calib.reporting.topics.report import missing_of, preparation_of
from calib.types import Progress, silent

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from calib.gap.decision.diagnosis import Diagnosis
    from calib.kinematics.result import Geometry

#: in a page's header; the title has it whole
SHORT_NAME: Final = 44
SIGNED: Final = {"prepared": "Prepared by", "authorised": "Authorised by"}


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file carried inside the PDF."""

    name: str
    data: bytes = field(metadata={"json": False})
    description: str
    mime: str = "application/json"
    relationship: str = "data"


@dataclass(frozen=True, slots=True)
class Report:
    """A report, ready to be set."""

    #: on every page
    report_id: str = field(metadata={"json": "id"})
    title: str
    name: str
    #: YYYY-MM-DD
    issued: str
    #: every page says so
    simulated: bool
    passed: bool
    sections: tuple[Section, ...]
    attachments: tuple[Attachment, ...]
    #: of the ``[report]`` section; None where nobody signs
    stated: Mapping[str, str] | None = field(default=None, metadata={"json": False})
    #: name and bytes of the laboratory's picture
    logo: tuple[str, bytes] | None = None
    facts: tuple[tuple[str, str], ...] = field(default=(), metadata={"json": False})
    #: made from, as far as estimated for it
    diagnosis: "Diagnosis | None" = field(default=None, metadata={"json": False})
    geometry: "Geometry | None" = field(default=None, metadata={"json": False})

    @property
    def head(self) -> tuple[tuple[str, str], ...]:
        """Facts under the title."""
        stated = self.stated or {}
        named = ((title, stated[key]) for key, title in catalogue()["head"].items() if key in stated)
        return (("Report", self.report_id), ("Date of issue", self.issued), *named, *self.facts)

    @property
    def signatures(self) -> tuple[tuple[str, str], ...]:
        """The lines to be signed, (role, name or empty)."""
        return () if self.stated is None else tuple((role, self.stated.get(key, "")) for key, role in SIGNED.items())

    @property
    def pictures(self) -> tuple[Picture, ...]:
        """The figures, in the order of the pages."""
        return tuple(block for section in self.sections for block in section.blocks if isinstance(block, Picture))

    def figures(self) -> "dict[str, Figure]":
        """Return its figures, drawn, by name."""
        return {picture.name: picture.draw() for picture in self.pictures}

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain values, as the page reads it."""
        return {"format": "calib-report/1", "kind": "Calibration report"} | plain_fields(
            self,
            short_name=self.name if len(self.name) <= SHORT_NAME else f"{self.name[: SHORT_NAME - 1]}…",
            subject=f"Calibration report on the campaign {self.name}" + (", simulated data" * self.simulated),
            date=[int(part) for part in self.issued.split("-")],
            program=f"calib {__version__}",
            author=(self.stated or {}).get("laboratory", ""),
            head=self.head,
            signatures=self.signatures,
            logo=self.logo and self.logo[0],
        )


def report_of(
    subject: Fit | Campaign,
    *,
    issued: str,
    accept: str = "",
    seed: int | None = None,
    where: Path | None = None,
    progress: Progress = silent,
) -> Report:
    """Return the report on a fit or a campaign; without a law, on its geometry.

    `issued`, `accept`, `where`: see `source_of`; `seed`: of the diagnosis that is added; None: none is. Raises
    BadInputError where a fit is to be diagnosed; RefusedError where the runs allow neither.
    """
    if not isinstance(subject, Campaign):
        if seed is not None:
            raise BadInputError(
                f"{where or 'report'}: found the result of a fit; expected a campaign folder, which a diagnosis "
                "needs; give the campaign"
            )
        return compose(source_of(subject, issued=issued, accept=accept, where=where))
    try:
        source = source_of(subject, issued=issued, accept=accept)
    except RefusedError as error:
        return _without_law(subject, error, issued, accept, seed, progress)
    if seed is None:
        return compose(source)
    from calib.gap.diagnose import diagnose_in_full

    return compose(replace(source, verdict=diagnose_in_full(subject, seed=seed, progress=progress)))


def _without_law(
    campaign: Campaign, refusal: RefusedError, issued: str, accept: str, seed: int | None, progress: Progress
) -> Report:
    from calib.coefficients.build import from_geometry
    from calib.gap.diagnose import diagnose_in_full
    from calib.kinematics.assemble import traces_of
    from calib.kinematics.estimate import estimate_geometry

    diagnosis = None if seed is None else diagnose_in_full(campaign, seed=seed, progress=progress)
    geometry, file = None, None
    try:
        geometry = estimate_geometry(campaign, progress=progress)
    except RefusedError:
        if diagnosis is None:
            raise refusal from None
    else:
        geometry = replace(geometry, paths=traces_of(campaign, geometry))
        if geometry.passed or accept:
            file = from_geometry(geometry, campaign, created=issued, accept=accept).to_bytes()
    why = str(refusal).removeprefix(f"{campaign.root}: ")
    return report_without_law(
        campaign, issued=issued, why=why, geometry=geometry, coefficients=file, diagnosis=diagnosis
    )


#: ``module.function`` of `calib.reporting.topics`, in the order of the report; each is ``(source) -> Section | None``
PAGES: Final = (
    "fit.result_section", "report.item_section", "report.method_section", "report.conditions_section",
    "report.preparation_section", "report.runs_section", "report.regression_section", "report.deviation_section",
    "fit.residuals_section", "report.coefficients_section", "report.budget_section", "fit.diagnosis_section",
    "fit.decision_section", "report.limits_section", "report.files_section", "report.missing_section",
)  # fmt: skip


def compose(source: Source) -> Report:
    """Return the report on a fit."""
    sections = (named("topics", page)(source) for page in PAGES)
    law = "Radius law of both wheels with covariance and valid load range, as the vehicle loads it"
    return Report(
        report_id=source.report_id,
        title="Effective rolling radius of the rear wheels",
        name=source.fit.name,
        issued=source.issued,
        simulated=source.fit.simulated,
        passed=source.fit.passed,
        sections=tuple(section for section in sections if section is not None),
        attachments=(Attachment("coefficients.json", source.coefficients.to_bytes(), law),),
        stated=source.stated,
        logo=source.logo,
        diagnosis=source.verdict,
    )


def report_without_law(
    campaign: Campaign,
    *,
    issued: str,
    why: str,
    geometry: "Geometry | None" = None,
    coefficients: bytes | None = None,
    diagnosis: "Diagnosis | None" = None,
) -> Report:
    """Return the report on runs without a radius law: geometry, diagnosis, or both.

    `why`: a sentence without full stop; `geometry`: with traces in ``paths``; `coefficients`: None where the geometry
    is not passed on; `issued`: see `source_of`.
    """
    from calib.reporting.topics.diagnosis import gap_section, page_one_notice
    from calib.reporting.topics.geometry import geometry_sections

    kind, title = "CR", "Gap between measured and simulated motion"
    content: dict[str, object] = {"inputs": dict(campaign.hashes), "campaign": campaign.name, "version": __version__}
    files = {"coefficients.json": (coefficients, "Radii, lengths and their covariance, as the vehicle loads it")}
    if geometry is not None:
        kind, title = "GR", "Geometry of a vehicle: radii, track and sensor"
        content["geometry"] = geometry.to_dict()
        estimates = None if coefficients is None else to_json(content["geometry"]).encode()
        files = {"geometry.json": (estimates, "Estimates, covariance and verdict"), **files}
    content["gap"] = None if diagnosis is None else diagnosis.to_dict()
    if diagnosis is not None:
        verdict = to_json(content["gap"]).encode()
        files["diagnosis.json"] = (verdict, "Verdict of the diagnosis with everything that it rests on")
    stated = stated_of(campaign)
    lawful = geometry is not None and any(one.name.startswith("slope_") for one in geometry.estimates)
    known = (
        "The radius law is that of the geometry; 'calib fit' finds none" if lawful else "These runs give no radius law"
    )
    reason = Notice("note", known, capital(prose(why.rstrip("."))) + ".")
    notices = [] if diagnosis is None else [page_one_notice(diagnosis)]
    result = [Section("Result", (*notices, reason))]
    if geometry is not None:
        result = geometry_sections(geometry, notices, withheld=coefficients is None)
    sections = (
        *result,
        *([] if diagnosis is None else [gap_section(diagnosis)]),
        *([] if geometry is None else [Section("Radius law", (reason,))]),
        preparation_of(ingest_notes(campaign)),
        _limits(campaign, geometry, coefficients, lawful=lawful),
        missing_of(stated),
    )
    return Report(
        report_id=number_of(kind, content),
        title=title,
        name=campaign.name,
        issued=issued,
        simulated=campaign.simulated,
        passed=geometry is None or geometry.passed,
        sections=tuple(section for section in sections if section is not None),
        attachments=tuple(Attachment(name, data, what) for name, (data, what) in files.items() if data is not None),
        stated=stated,
        logo=logo_of(campaign),
        diagnosis=diagnosis,
        geometry=geometry,
    )


def _limits(campaign: Campaign, geometry: "Geometry | None", coefficients: bytes | None, *, lawful: bool) -> Section:
    limits = ["no_law", "no_law_holds"]
    if geometry is not None:
        kept = ["geometry_kept"] if coefficients is None else []
        limits = [*([] if lawful else ["geometry_law"]), "geometry_holds", *kept]
    blocks = (Items(tuple(map(paragraph, limits))), assumed_text(assumed_settings(campaign)))
    return Section("What this report does not cover", blocks)


DEFAULT_FOLDER: Final = Path("reports")
LONGEST: Final = 80


def file_name(name: str) -> str:
    """Return a campaign's PDF name: letters, digits, ``-``, ``_`` and ``.`` only."""
    kept = re.sub(r"[^\w.-]+", "-", name, flags=re.UNICODE).strip("-.")[:LONGEST].strip("-.")
    return f"{kept or 'report'}.pdf"


def place_of(name: str, into: Path | None, *, force: bool = False) -> Path:
    """Return a report's file: ``.pdf``, or in a folder (None: ``reports/``).

    Raises BadInputError where the file exists and `force` is False, or `into` is a file that is no PDF.
    """
    place = into or DEFAULT_FOLDER
    single = place.suffix.lower() == ".pdf" and not place.is_dir()
    if into and into.is_file() and not single:
        raise BadInputError(f"into: found the file {into}; expected a folder or a name ending in .pdf; choose another")
    path = place if single else place / file_name(name)
    if path.is_dir():
        raise BadInputError(f"into: found the folder {path}; expected a place for a file; choose another")
    refuse_existing([path], force=force)
    return path
