r"""A Digital Calibration Certificate, DCC 3.0.0 of PTB, of both wheels' radius laws.

Numbers are in D-SI units (``\metre\newton\tothe{-1}``; SI_Format 2.0.0).
"""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Final, Literal
from xml.etree.ElementTree import Element, fromstring, indent, register_namespace, tostring

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from calib import __version__
from calib.campaign.model import Campaign
from calib.coefficients.build import load_points
from calib.coefficients.formats import Artifact
from calib.documents import templates_of
from calib.errors import BadInputError, RefusedError
from calib.radius.law import COVERAGE
from calib.radius.regression import WheelFit
from calib.radius.result import Fit
from calib.reporting import paragraph
from calib.reporting.source import Source, opened, source_of
from calib.types import Progress

Text = Annotated[str, Field(min_length=1, max_length=1000)]
#: ISO 3166-1, two letters
Country = Annotated[str, Field(pattern="^[A-Z]{2}$")]
#: or its text as YYYY-MM-DD
Day = Annotated[date, BeforeValidator(lambda day: date.fromisoformat(day) if isinstance(day, str) else day)]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class Contact(_Section):
    """A laboratory or a customer."""

    name: Text
    email: Text
    city: Text
    country: Country
    street: Text | None = None
    street_no: Text | None = None
    postcode: Text | None = None
    phone: Text | None = None
    #: if accredited
    code: Text | None = None


class Item(_Section):
    """The vehicle that was calibrated."""

    name: Text
    manufacturer: Text
    model: Text
    serial: Text
    owner_id: Text | None = None


class Person(_Section):
    """A person responsible for the certificate."""

    name: Text
    role: Text


class Equipment(_Section):
    """An instrument; without `certificate` its traceability is not stated."""

    name: Text
    serial: Text
    manufacturer: Text | None = None
    model: Text | None = None
    certificate: Text | None = None


class Certificate(_Section):
    """All that a certificate states and no measurement gives."""

    identifier: Text
    country: Country
    begin: Day
    end: Day
    performed_at: Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"]
    laboratory: Contact
    customer: Contact
    item: Item
    persons: Annotated[list[Person], Field(min_length=1)]
    equipment: Annotated[list[Equipment], Field(min_length=1)]
    received: Day | None = None

    @model_validator(mode="after")
    def _ordered(self) -> "Certificate":
        if self.end < self.begin:
            raise ValueError("end is before begin")
        return self


def certificate_of(section: Any, where: str) -> Certificate:
    """Return the ``[certificate]`` section of ``campaign.toml`` or a result folder, checked.

    Raises RefusedError that names all that is not stated; BadInputError where a value is wrong.
    """
    stated = isinstance(section, Mapping)
    try:
        return Certificate.model_validate(dict(section) if stated else {"laboratory": {}, "customer": {}, "item": {}})
    except ValidationError as error:
        faults = error.errors(include_url=False)
        places = [(".".join(map(str, fault["loc"])), fault) for fault in faults]
        missing = ", ".join(place for place, fault in places if fault["type"] == "missing")
        if not stated:
            raise RefusedError(
                f"{where}: found no section [certificate]; expected {missing}; state them, nothing of a certificate is "
                "invented (docs/exports.md has the section to fill in)"
            ) from error
        if missing:
            raise RefusedError(
                f"{where}, [certificate]: found no {missing}; expected what a certificate states; state them, nothing "
                "of a certificate is invented"
            ) from error
        place, fault = places[0]
        actual = repr(fault.get("input"))[:80]
        expected = fault["msg"].removeprefix("Value error, ")
        raise BadInputError(f"{where}, certificate.{place}: found {actual}; expected {expected}; correct it") from error


NAMESPACES: Final = {
    "dcc": "https://ptb.de/dcc",
    "si": "https://ptb.de/si",
    "xsi": "http://www.w3.org/2001/XMLSchema-instance",
}
#: where runs do not repeat a few
LOAD_STEPS: Final = 5
#: column of the run table -> name, unit in D-SI and factor to it
CONDITIONS: Final = {
    "temperature_C": ("Temperature", r"\degreecelsius", 1.0),
    "speed_mps": ("Set speed", r"\metre\second\tothe{-1}", 1.0),
    "distance_m": ("Length of the runs", r"\metre", 1.0),
    "payload_kg": ("Payload", r"\kilogram", 1.0),
    "load_left_N": ("Load of the left wheel", r"\newton", 1.0),
    "load_right_N": ("Load of the right wheel", r"\newton", 1.0),
    "minutes_under_load": ("Time under load before a run", r"\second", 60.0),
}


def render(path: Path, accept: str, progress: Progress) -> tuple[Artifact, ...]:
    """Return the certificate of a campaign or a result folder, as one XML file; see `export_from`."""
    subject = opened(path, progress=progress)
    source = source_of(subject, issued="2000-01-01", accept=accept, where=path)
    fit, driven = source.fit, isinstance(subject, Campaign)
    section = subject.extra.get("certificate") if isinstance(subject, Campaign) else fit.provenance.get("certificate")
    stated = certificate_of(section, str(path / "campaign.toml" if driven else path))
    if not fit.passed and not accept:
        (_, first), *_ = fit.failed_checks
        raise RefusedError(
            f"{path}: found a law that is {fit.verdict}: {first.sentence}; expected one whose checks passed; measure "
            "as the check says, or give a reason with --accept-implausible, which the certificate then states"
        )
    root = document(replace(source, issued=stated.end.isoformat()), stated)
    indent(root)
    data = tostring(root, encoding="utf-8", xml_declaration=True, short_empty_elements=False)
    return (Artifact("certificate.xml", data + b"\n"),)


def document(source: Source, stated: Certificate) -> Element:
    """Return the certificate's root element."""
    for prefix, address in NAMESPACES.items():
        register_namespace(prefix, address)
    from scipy.stats import f

    fit, ranges = source.fit, source.setup.conditions
    values = {
        "source": source,
        "given": stated,
        "version": str(fit.provenance.get("version", __version__)),
        "limits": _limits(source, stated),
        "conditions": [
            (title, factor * ranges[name][0], factor * ranges[name][1], unit)
            for name, (title, unit, factor) in CONDITIONS.items()
            if np.isfinite(ranges.get(name, np.nan)).all()
        ],
        "radii": {name: _radii(wheel, fit) for name, wheel in fit.wheels.items()},
        "factors": {name: math.sqrt(2.0 * float(f.ppf(COVERAGE, 2, w.law.dof))) for name, w in fit.wheels.items()},
    }
    template = templates_of(__package__, markup=True).get_template("dcc.xml.j2")
    return fromstring(_NO_XML.sub(lambda sign: f"\\x{ord(sign[0]):x}", template.render(values)))


#: what XML 1.0 cannot hold
_NO_XML: Final = re.compile("[\x00-\x08\x0b-\x1f\ud800-\udfff\ufffe\uffff]")


def _limits(source: Source, stated: Certificate) -> list[str]:
    fit = source.fit
    texts = []
    if fit.simulated:
        texts.append(paragraph("certificate_simulated"))
    if failed := " ".join(check.sentence for _, check in fit.failed_checks):
        texts.append(paragraph("certificate_failed", accepted=fit.accepted, failed=failed))
    if assumed := ", ".join(f"{key} {value}" for key, value in source.setup.assumed.items()):
        texts.append(paragraph("certificate_assumed", listed=assumed))
    if untraced := ", ".join(equipment.name for equipment in stated.equipment if equipment.certificate is None):
        texts.append(paragraph("certificate_untraced", listed=untraced))
    return texts


def _radii(wheel: WheelFit, fit: Fit) -> list[tuple[float, ...]]:
    loads, law = np.array(_loads(wheel, fit)), wheel.law
    columns = np.column_stack((loads, law.radius_m(loads), law.half_width_m(loads), law.mean_std_m(loads)))
    return list(map(tuple, columns.tolist()))


def _loads(wheel: WheelFit, fit: Fit) -> list[float]:
    side = 0 if wheel.wheel == "left" else 1
    points = load_points(fit.radii.load_left_N, fit.radii.load_right_N)
    loads = sorted({round(pair[side], 3) for pair in points.values()})
    if not loads or len(loads) > max(len(wheel.load_N) // 2, 1):
        return list(np.linspace(wheel.law.load_min_N, wheel.law.load_max_N, LOAD_STEPS))
    return loads
