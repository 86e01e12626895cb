"""What a report is made from: a fit, its coefficient file, and what the campaign states of laboratory and customer."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Final

from calib import __version__
from calib.campaign.model import Campaign
from calib.coefficients.build import from_fit
from calib.coefficients.file import CoefficientFile
from calib.errors import BadFileError, BadInputError, RefusedError
from calib.files import to_json
from calib.gap.verdict.result import VerdictKind
from calib.progress import Progress, silent
from calib.radius.fit import fit_campaign
from calib.radius.fitted import Fit
from calib.radius.result import is_result, provenance, read_result
from calib.report.stated import Logo, logo_of, stated_of, texts_of

if TYPE_CHECKING:
    from calib.report.gap_findings import GapFindings

#: a PDF cannot carry an earlier date of creation
FIRST_YEAR: Final = 1970


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """Everything that the pages speak of."""

    #: the fit with its setup and provenance
    fit: Fit
    #: the same law as the vehicle gets it; attached to the PDF
    coefficients: CoefficientFile
    #: date of issue, YYYY-MM-DD
    issued: str
    #: what the campaign's ``[report]`` section states, by the keys of `STATED`
    stated: Mapping[str, str] = field(default_factory=dict)
    #: findings of the diagnosis, where one was asked for
    gap: GapFindings | None = None
    logo: Logo | None = None
    #: verdict and sentence of a diagnosis.json that lies beside the fit
    known_verdict: tuple[VerdictKind, str] | None = None

    @property
    def simulated(self) -> bool:
        """True where a program made the data."""
        return self.fit.simulated

    @property
    def inputs(self) -> dict[str, str]:
        """SHA-256 of every input file, by path relative to the campaign."""
        hashes = self.fit.provenance.get("inputs", {})
        return {str(key): str(value) for key, value in hashes.items()} if isinstance(hashes, Mapping) else {}

    @property
    def report_id(self) -> str:
        """Identification: derived from the inputs, the program's version and what was asked, never from chance."""
        inputs = self.inputs or {"fit": hashlib.sha256(to_json(self.fit.to_dict()).encode()).hexdigest()}
        content = {
            "inputs": inputs,
            "campaign": self.fit.name,
            "version": __version__,
            "coefficients": self.coefficients.changed(created=None).checksum,
            "gap": None if self.gap is None else self.gap.to_dict(),
        }
        return "CR-" + hashlib.sha256(to_json(content).encode()).hexdigest()[:12].upper()

    def said(self, key: str) -> str:
        """Return what the campaign states under a key of `STATED`, or that it states nothing."""
        return self.stated.get(key, "not stated")


def issue_date(text: str | None) -> str:
    """Return the date of issue: `text`, checked, or today's where it is None.

    Raises BadInputError where `text` is no date as YYYY-MM-DD.
    """
    if text is None:
        return date.today().isoformat()
    try:
        fine = len(text) == len("YYYY-MM-DD") and date.fromisoformat(text).year >= FIRST_YEAR
    except ValueError:
        fine = False
    if not fine:
        raise BadInputError(f"date: found {text!r}; expected a date as YYYY-MM-DD; for example 2025-03-31")
    return text


def source_of(
    path: Path | str, *, issued: str, accept: str = "", progress: Progress = silent
) -> tuple[Source, Campaign | None]:
    """Return what a report on a campaign folder or a result folder is made from.

    `path`: a campaign's folder, which is fitted now, or a result folder or ``fit.json``, which is only read; `issued`:
    date of issue, YYYY-MM-DD; `accept`: why a law beyond the bounds of its vehicle is passed on all the same; empty: it
    is refused. Returns `source`: without diagnosis; `campaign`: the campaign, where it was read. Raises BadInputError
    where the path is neither, or cannot be used; RefusedError where the runs allow no law.
    """
    path = Path(path)
    if not path.exists():
        raise BadFileError(path, "nothing", "a campaign folder or a result folder of calib fit", "give the path of one")
    if is_result(path):
        source = source_of_fit(replace(read_result(path), accepted=accept), issued=issued, where=path)
        return replace(source, known_verdict=_verdict_beside(path, source.fit.name)), None
    from calib.campaign.read import read_campaign

    campaign = read_campaign(path, progress=progress)
    source = from_campaign(campaign, issued=issued, accept=accept)
    return replace(source, known_verdict=_verdict_beside(path, campaign.name)), campaign


def _verdict_beside(path: Path, name: str) -> tuple[VerdictKind, str] | None:
    """Return verdict and sentence of the diagnosis of the same campaign that lies in the folder, if there is one."""
    file = (path if path.is_dir() else path.parent) / "diagnosis.json"
    if not file.is_file():
        return None
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        if document["campaign"] != name:
            return None
        return VerdictKind(document["verdict"]), str(document["sentence"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadFileError(file, f"{type(error).__name__}", "what calib diagnose --into wrote", "remove it") from error


def source_of_fit(fit: Fit, *, issued: str, where: Path | str = "fit") -> Source:
    """Return what a report on a fit is made from; see `source_of`."""
    if fit.setup is None:
        raise RefusedError(
            f"{where}: found a fit without its setup; expected vehicle, instruments and conditions; make it anew "
            "with 'calib fit CAMPAIGN --into FOLDER'"
        )
    stated = texts_of(fit.provenance.get("report"), where)
    return Source(fit, from_fit(fit, created=issued), issued, stated)


def from_campaign(campaign: Campaign, *, issued: str, accept: str = "") -> Source:
    """Return what a report on `campaign`, fitted now, is made from; see `source_of`."""
    fit = fit_campaign(campaign)
    fit = replace(fit, provenance=provenance(campaign, version=__version__, arguments={}), accepted=accept)
    file = from_fit(fit, created=issued, inputs=campaign.hashes)
    return Source(fit, file, issued, stated_of(campaign), logo=logo_of(campaign))
