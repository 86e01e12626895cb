"""Input of a report: a fit, its coefficient file, and the ``[report]`` section of campaign.toml."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import date, time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from calib import __version__
from calib.campaign.model import Campaign, Note
from calib.documents import to_json
from calib.errors import BadFileError, CalibError, RefusedError, refuse_other_than_date
from calib.io import inside
from calib.reporting import catalogue
from calib.types import Progress, silent

if TYPE_CHECKING:
    from calib.coefficients.file import CoefficientFile
    from calib.gap.decision.diagnosis import Diagnosis, VerdictKind
    from calib.radius.result import Fit, Setup
    from calib.reporting.figures.gap import GapArrays

#: a PDF carries no earlier date of creation
FIRST_YEAR: Final = 1970
SURE_FROM: Final = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """Input of all pages."""

    fit: "Fit"
    #: the law as the vehicle gets it; attached to the PDF
    coefficients: "CoefficientFile"
    #: YYYY-MM-DD
    issued: str
    #: of the ``[report]`` section, by keys of `STATED`
    stated: Mapping[str, str] = field(default_factory=dict)
    #: of the diagnosis, if asked for
    verdict: "Diagnosis | None" = None
    #: of its figures, if not its own
    gap: "GapArrays | None" = None
    logo: tuple[str, bytes] | None = None
    #: verdict and sentence of a diagnosis.json that lies beside the fit
    known_verdict: "tuple[VerdictKind, str] | None" = None

    @property
    def setup(self) -> "Setup":
        """Vehicle, instruments and conditions; a fit without them is refused."""
        assert self.fit.setup is not None
        return self.fit.setup

    @property
    def inputs(self) -> dict[str, str]:
        """SHA-256 of every input file, by path relative to the campaign."""
        return {str(key): str(value) for key, value in self.fit.provenance.get("inputs", {}).items()}

    @property
    def report_id(self) -> str:
        """Identification: derived from inputs, version and what was asked, never from chance."""
        content = {
            "inputs": self.inputs or {"fit": hashlib.sha256(to_json(self.fit.to_dict()).encode()).hexdigest()},
            "campaign": self.fit.name,
            "version": __version__,
            "coefficients": self.coefficients.changed(created=None).checksum,
            "gap": None if self.verdict is None else self.verdict.to_dict(),
        }
        return number_of("CR", content)

    def facts(self, **titles: str) -> list[tuple[str, str]]:
        """Return what the campaign states under keys of `STATED`, each with its title."""
        return [(title, self.stated[key]) for key, title in titles.items() if key in self.stated]


def number_of(kind: str, content: Mapping[str, Any]) -> str:
    """Return a report's identification by kind and content, never chance."""
    return f"{kind}-{hashlib.sha256(to_json(content).encode()).hexdigest()[:12].upper()}"


def issue_date(text: str | None) -> str:
    """Return the date of issue: `text`, refused if no date; None: today."""
    if text is None:
        return date.today().isoformat()
    refuse_other_than_date(text, FIRST_YEAR)
    return text


def opened(path: Path, *, progress: Progress = silent) -> "Fit | Campaign":
    """Return the fit of a result folder or ``fit.json``, else the folder's campaign."""
    from calib.campaign.read import read_campaign
    from calib.radius.result import is_result, read_result

    if not path.exists():
        raise BadFileError(path, "nothing", "a campaign folder or a result folder of calib fit", "give the path of one")
    return read_result(path) if is_result(path) else read_campaign(path, progress=progress)


def source_of(subject: "Fit | Campaign", *, issued: str, accept: str = "", where: Path | None = None) -> Source:
    """Return the source of a report on a fit, or a campaign fitted now, without diagnosis.

    `issued`: date of issue, YYYY-MM-DD; `accept`: why a law beyond its vehicle's bounds is passed on; empty: refused;
    `where`: where the fit was read from, if it was.
    """
    from calib.coefficients.build import from_fit
    from calib.radius.fit import fit_campaign
    from calib.radius.result import provenance

    if isinstance(subject, Campaign):
        fit, where, inputs = fit_campaign(subject), subject.root, subject.hashes
        fit = replace(fit, provenance=provenance(subject, {}))
        stated, logo = stated_of(subject), logo_of(subject)
    else:
        fit, inputs, logo = subject, None, None
        if fit.setup is None:
            raise RefusedError(
                f"{where or 'fit'}: found a fit without its setup; expected vehicle, instruments and conditions; make "
                "it anew with 'calib fit CAMPAIGN --into FOLDER'"
            )
        stated = texts_of(fit.provenance.get("report"), where or "fit")
    fit = replace(fit, accepted=accept)
    file = from_fit(fit, created=issued, inputs=inputs)
    known = None if where is None else _verdict_beside(where, fit.name)
    return Source(fit, file, issued, stated, logo=logo, known_verdict=known)


def _verdict_beside(path: Path, name: str) -> "tuple[VerdictKind, str] | None":
    file = (path if path.is_dir() else path.parent) / "diagnosis.json"
    if not file.is_file():
        return None
    from calib.gap.decision.diagnosis import VerdictKind

    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        if document["campaign"] != name:
            return None
        doubt = doubtful_causes((str(one["effect"]), float(one["probability"])) for one in document.get("causes", ()))
        return VerdictKind(document["verdict"]), f"{document['sentence']} {doubt}".strip()
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadFileError(file, f"{type(error).__name__}", "what calib diagnose --into wrote", "remove it") from error


def doubtful_causes(causes: Iterable[tuple[str, float]]) -> str:
    """Return causes' probabilities, (effect, probability), where one is below 0.9; else nothing."""
    named = list(causes)
    if all(value >= SURE_FROM for _, value in named):
        return ""
    return f"Probability: {', '.join(f'{name} {100 * value:.0f} %' for name, value in named)}."


#: key of the ``[report]`` section -> what a reader is told without it
STATED: Final[Mapping[str, str]] = catalogue()["stated"]
#: keys whose absence a reader need not be told
OPTIONAL: Final = frozenset({"remarks", "deviations", "prepared", "method", "replaces", "logo"})
_PICTURES: Final = (".svg", ".png", ".jpg", ".jpeg")
#: a larger logo is a photograph by mistake
_LARGEST: Final = 2_000_000


def stated_of(campaign: Campaign) -> dict[str, str]:
    """Return what the ``[report]`` section of a campaign states, by the keys of `STATED`."""
    where = "campaign.toml" if campaign.root is None else campaign.root / "campaign.toml"
    return texts_of(campaign.extra.get("report"), where)


def refused_settings(campaign: Campaign) -> list[Note]:
    """Return the settings that fit, diagnosis or report refuse, as faults."""
    from calib.gap.effects.quantities import declared_effects
    from calib.radius.effective import declared_sources

    faults = []
    for section, read in (
        ("report", lambda: (stated_of(campaign), logo_of(campaign))),
        ("uncertainty", lambda: declared_sources(campaign)),
        ("effects", lambda: declared_effects(campaign.extra["effects"], campaign.runs.numbers, ())),
    ):
        if section in campaign.extra:
            try:
                read()
            except CalibError as error:
                where, _, text = str(error).partition(": ")
                faults.append(Note("wrong", f"campaign.toml{where.partition('campaign.toml')[2]}", text, "settings"))
    return faults


def texts_of(section: Any, where: Path | str) -> dict[str, str]:
    """Return the texts of a ``[report]`` section, lists joined; BadFileError names what is no text."""
    if section is None:
        return {}
    remedy = f"write text under these keys: {', '.join(STATED)}"
    if not isinstance(section, Mapping):
        raise BadFileError(where, column="report", found=type(section).__name__, expected="a section", remedy=remedy)
    stated = {}
    for key, value in section.items():
        texts = value if isinstance(value, (list, tuple)) else [value]
        if key not in STATED or not all(isinstance(text, str | int | float | date | time) for text in texts):
            actual = "an unknown key" if key not in STATED else f"a {type(value).__name__}"
            raise BadFileError(where, column=f"report.{key}", found=actual, expected="text", remedy=remedy)
        joined = "; ".join(str(text).strip() for text in texts if str(text).strip())
        if joined:
            stated[str(key)] = joined
    return stated


def logo_of(campaign: Campaign) -> tuple[str, bytes] | None:
    """Return a campaign's logo, as name in the page and bytes; None where it states none."""
    name = stated_of(campaign).get("logo")
    if name is None or campaign.root is None:
        return None
    where = campaign.root / "campaign.toml"
    path = inside(campaign.root, name, named_in=where, column="report.logo")
    remedy = "give an SVG, PNG or JPEG of at most 2 MB inside the campaign's folder"
    if path.suffix.lower() not in _PICTURES or not path.is_file() or path.stat().st_size > _LARGEST:
        raise BadFileError(where, column="report.logo", found=repr(name), expected="a small picture", remedy=remedy)
    return f"logo{path.suffix.lower()}", path.read_bytes()
