r"""A Digital Calibration Certificate, DCC 3.0.0 of PTB, of both wheels' radius laws.

Numbers are in SI units, written as D-SI asks (``\metre\newton\tothe{-1}``; SI_Format 2.0.0). Of each wheel: the
effective radius at the loads driven with its expanded uncertainty (95 %), and the two coefficients of the law with
their covariance as an ellipsoidal region. The bytes depend on the inputs alone; no time of day is written.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element, SubElement, indent, register_namespace, tostring

import numpy as np

from calib import __version__
from calib.coefficients.build import load_points
from calib.coefficients.formats import Artifact
from calib.errors import RefusedError
from calib.radius.law import COVERAGE
from calib.radius.regression import WheelFit
from calib.radius.result import Fit
from calib.reporting.exports.certificate import Certificate, Contact, Equipment, certificate_of
from calib.reporting.source import Source, source_of
from calib.types import Progress

DCC: Final = "https://ptb.de/dcc"
SI: Final = "https://ptb.de/si"
SCHEMA: Final = "https://ptb.de/dcc/v3.0.0/dcc.xsd"
XSI: Final = "http://www.w3.org/2001/XMLSchema-instance"
METRE, NEWTON = r"\metre", r"\newton"
SLOPE_UNIT: Final = METRE + NEWTON + r"\tothe{-1}"
#: units of the covariance of radius (m) and slope (m/N)
COVARIANCE_UNITS: Final = (
    (METRE + r"\tothe{2}", METRE + r"\tothe{2}" + NEWTON + r"\tothe{-1}"),
    (METRE + r"\tothe{2}" + NEWTON + r"\tothe{-1}", METRE + r"\tothe{2}" + NEWTON + r"\tothe{-2}"),
)
#: loads at which the radius is stated where the runs do not repeat a few
LOAD_STEPS: Final = 5
#: significant digits: of a value, of an uncertainty, of a coverage factor
DIGITS, UNCERTAINTY_DIGITS, FACTOR_DIGITS = 12, 4, 5
#: column of the run table -> name, unit in D-SI and factor to it
CONDITIONS: Final = {
    "temperature_C": ("Temperature", r"\degreecelsius", 1.0),
    "speed_mps": ("Set speed", METRE + r"\second\tothe{-1}", 1.0),
    "distance_m": ("Length of the runs", METRE, 1.0),
    "payload_kg": ("Payload", r"\kilogram", 1.0),
    "load_left_N": ("Load of the left wheel", NEWTON, 1.0),
    "load_right_N": ("Load of the right wheel", NEWTON, 1.0),
    "minutes_under_load": ("Time under load before a run", r"\second", 60.0),
}
METHOD: Final = (
    "The vehicle is driven along a straight corridor past a laser rangefinder. The effective radius of a wheel is "
    "r_e = S / (2 pi n) with the distance S and the turns n of the wheel by its encoder, corrected for the excess of "
    "the path where that was measured. The radii of all runs are fitted by a line in the wheel load, sessions as a "
    "second stratum of the variance. Expanded uncertainties hold the scatter of runs, of sessions, and the standard "
    "uncertainties of the instruments."
)


def render(path: Path, accept: str, progress: Progress) -> tuple[Artifact, ...]:
    """Return the certificate of a campaign or a result folder, as one XML file; see `export_from`.

    Raises RefusedError where a check failed and no reason is given, or the campaign does not state what a certificate
    needs.
    """
    # the date of issue is not written: it only has to be a date until the end of the measurement is known
    source, campaign = source_of(path, issued="2000-01-01", accept=accept, progress=progress)
    fit = source.fit
    section = fit.provenance.get("certificate") if campaign is None else campaign.extra.get("certificate")
    stated = certificate_of(section, str(path / "campaign.toml" if campaign is not None else path))
    if not fit.passed and not accept:
        raise RefusedError(
            f"{path}: found a law that is {fit.verdict}: {_failed(fit)[0]}; expected one whose checks passed; measure "
            "as the check says, or give a reason with --accept-implausible, which the certificate then states"
        )
    root = document(replace(source, issued=stated.end.isoformat()), stated)
    indent(root)
    data = tostring(root, encoding="utf-8", xml_declaration=True, short_empty_elements=False)
    return (Artifact("certificate.xml", data + b"\n"),)


def _failed(fit: Fit) -> list[str]:
    return [check.sentence for wheel in fit.wheels.values() for check in wheel.checks if not check.passed]


def document(source: Source, stated: Certificate) -> Element:
    """Return the certificate's root element."""
    register_namespace("dcc", DCC)
    register_namespace("si", SI)
    register_namespace("xsi", XSI)
    root = Element(f"{{{DCC}}}digitalCalibrationCertificate", {"schemaVersion": "3.0.0"})
    root.set(f"{{{XSI}}}schemaLocation", f"{DCC} {SCHEMA}")
    _administrative(root, source, stated)
    results = _add(root, "measurementResults")
    for name, wheel in source.fit.wheels.items():
        _wheel(results, name, wheel, source, stated.equipment)
    return root


def _add(parent: Element, tag: str, text: str | None = None) -> Element:
    child = SubElement(parent, f"{{{DCC}}}{tag}")
    child.text = None if text is None else _printable(text)
    return child


def _add_stated(parent: Element, **texts: str | None) -> None:
    """Add an element for each text that is stated, in the order given."""
    for tag, text in texts.items():
        if text is not None:
            _add(parent, tag, text)


def _si(parent: Element, tag: str, text: str | None = None) -> Element:
    child = SubElement(parent, f"{{{SI}}}{tag}")
    child.text = text
    return child


def _text(parent: Element, tag: str, text: str) -> Element:
    """Add an element of the schema's text type; the certificate is written in English."""
    child = _add(parent, tag)
    _add(child, "content", text).set("lang", "en")
    return child


def _printable(text: str) -> str:
    """Return the text without what XML 1.0 cannot hold, controls and lone surrogates, shown as escapes."""
    return "".join(
        sign
        if sign in "\t\n" or (sign >= " " and not "\ud800" <= sign <= "\udfff" and sign not in "\ufffe\uffff")
        else f"\\x{ord(sign):x}"
        for sign in text
    )


def _administrative(root: Element, source: Source, stated: Certificate) -> None:
    part = _add(root, "administrativeData")
    software = _add(_add(part, "dccSoftware"), "software")
    _text(software, "name", "calib")
    _add(software, "release", str(source.fit.provenance.get("version", __version__)))
    core = _add(part, "coreData")
    _add(core, "countryCodeISO3166_1", stated.country)
    _add(core, "usedLangCodeISO639_1", "en")
    _add(core, "mandatoryLangCodeISO639_1", "en")
    _add(core, "uniqueIdentifier", stated.identifier)
    _identification(_add(core, "identifications"), "other", source.report_id, "Digest of inputs and version")
    _add_stated(
        core,
        receiptDate=None if stated.received is None else stated.received.isoformat(),
        beginPerformanceDate=stated.begin.isoformat(),
        endPerformanceDate=stated.end.isoformat(),
        performanceLocation=stated.performed_at,
    )
    item = _add(_add(part, "items"), "item")
    _text(item, "name", stated.item.name)
    _text(_add(item, "manufacturer"), "name", stated.item.manufacturer)
    _add(item, "model", stated.item.model)
    identifications = _add(item, "identifications")
    _identification(identifications, "manufacturer", stated.item.serial, "Serial number")
    if stated.item.owner_id is not None:
        _identification(identifications, "owner", stated.item.owner_id, "Identification by the owner")
    laboratory = _add(part, "calibrationLaboratory")
    _add_stated(laboratory, calibrationLaboratoryCode=stated.laboratory.code)
    _contact(_add(laboratory, "contact"), stated.laboratory)
    persons = _add(part, "respPersons")
    for at, person in enumerate(stated.persons):
        entry = _add(persons, "respPerson")
        _text(_add(entry, "person"), "name", person.name)
        _add_stated(entry, role=person.role, mainSigner="true" if at == 0 else "false")
    _contact(_add(part, "customer"), stated.customer)
    _statements(part, source, stated)


def _identification(parent: Element, issuer: str, value: str, name: str) -> None:
    entry = _add(parent, "identification")
    _add_stated(entry, issuer=issuer, value=value)
    _text(entry, "name", name)


def _contact(parent: Element, contact: Contact) -> None:
    _text(parent, "name", contact.name)
    _add_stated(parent, eMail=contact.email, phone=contact.phone)
    _add_stated(
        _add(parent, "location"),
        city=contact.city,
        countryCode=contact.country,
        postCode=contact.postcode,
        street=contact.street,
        streetNo=contact.street_no,
    )


def _statements(parent: Element, source: Source, stated: Certificate) -> None:
    """Add what limits the result: simulated data, failed checks that were accepted, assumed settings, traceability."""
    fit = source.fit
    texts = []
    if fit.simulated:
        texts.append("SIMULATED DATA: a program made the measurements of this certificate; they are no measurements.")
    failed = _failed(fit)
    if failed:
        texts.append(f"Accepted although a check failed: {fit.accepted}. Checks that failed: {' '.join(failed)}")
    if fit.setup is not None and fit.setup.assumed:
        listed = ", ".join(f"{key} {value}" for key, value in fit.setup.assumed.items())
        texts.append(f"Assumed, not stated by the campaign: {listed}. What depends on these is not measured.")
    untraced = [equipment.name for equipment in stated.equipment if equipment.certificate is None]
    if untraced:
        texts.append(
            f"No calibration certificate is stated of: {', '.join(untraced)}. Traceability to the SI is not shown for "
            "these."
        )
    if not texts:
        return
    statements = _add(parent, "statements")
    for text in texts:
        _text(_add(statements, "statement"), "declaration", text)


def _wheel(results: Element, name: str, wheel: WheelFit, source: Source, equipment: Iterable[Equipment]) -> None:
    """Add the results of one wheel."""
    marked = " (SIMULATED DATA)" if source.simulated else ""
    part = _add(results, "measurementResult")
    _text(part, "name", f"Effective radius of the {name} wheel against its load{marked}")
    method = _add(_add(part, "usedMethods"), "usedMethod")
    _text(method, "name", source.stated.get("method", "Corridor runs with a laser rangefinder and wheel encoders"))
    _text(method, "description", METHOD)
    _equipment(part, equipment)
    _conditions(part, source.fit)
    listed = _add(part, "results")
    _radii(listed, wheel, source.fit)
    _coefficients(listed, wheel)
    scatter = _result(listed, "Scatter of a single run", "Standard deviation of the radius of one run about the law")
    _real(_add(scatter, "quantity"), "run_std", wheel.law.residual_std_m, METRE)


def _equipment(part: Element, equipment: Iterable[Equipment]) -> None:
    listed = _add(part, "measuringEquipments")
    for stated in equipment:
        entry = _add(listed, "measuringEquipment")
        _text(entry, "name", stated.name)
        if stated.certificate is not None:
            _text(entry, "description", f"Calibration certificate {stated.certificate}")
        if stated.manufacturer is not None:
            _text(_add(entry, "manufacturer"), "name", stated.manufacturer)
        _add_stated(entry, model=stated.model)
        _identification(_add(entry, "identifications"), "manufacturer", stated.serial, "Serial number")


def _conditions(part: Element, fit: Fit) -> None:
    """Add smallest and largest value of every condition that the run table has."""
    ranges = {} if fit.setup is None else fit.setup.conditions
    known = {name: about for name, about in CONDITIONS.items() if np.isfinite(ranges.get(name, np.nan)).all()}
    listed = _add(part, "influenceConditions") if known else part
    for column, (title, unit, factor) in known.items():
        condition = _add(listed, "influenceCondition")
        _text(condition, "name", title)
        data = _add(condition, "data")
        for label, value in zip(("minimum", "maximum"), ranges[column], strict=True):
            _real(_add(data, "quantity"), label, factor * value, unit)


def _result(listed: Element, name: str, description: str) -> Element:
    """Add a result; return the element of its data."""
    result = _add(listed, "result")
    _text(result, "name", name)
    _text(result, "description", description)
    return _add(result, "data")


def _radii(listed: Element, wheel: WheelFit, fit: Fit) -> None:
    """Add the radius at the loads driven, each with its expanded uncertainty."""
    loads = _loads(wheel, fit)
    low, high = wheel.mean_band_m(loads)
    standard = wheel.law.mean_std_m(loads)
    data = _result(listed, "Effective radius at the loads driven", "Mean radius at each load, with 95 % coverage")
    lists = _si(_add(data, "quantity"), "list")
    forces = _si(lists, "realList")
    _si(forces, "label", "wheel_load")
    for load in loads:
        _real(forces, None, load, NEWTON)
    radii = _si(lists, "realList")
    _si(radii, "label", "effective_radius")
    for at, radius in enumerate(wheel.law.radius_m(loads)):
        _expanded(_real(radii, None, radius, METRE), 0.5 * (high[at] - low[at]), standard[at])


def _loads(wheel: WheelFit, fit: Fit) -> list[float]:
    """Return the loads that were driven, where the runs repeat a few; else five over their range."""
    side = 0 if wheel.wheel == "left" else 1
    points = load_points(fit.radii.load_left_N, fit.radii.load_right_N)
    loads = sorted({round(pair[side], 3) for pair in points.values()})
    # every run with a load of its own is weighing's scatter, not a set of load points
    if not loads or len(loads) > max(len(wheel.load_N) // 2, 1):
        return [float(load) for load in np.linspace(wheel.law.load_min_N, wheel.law.load_max_N, LOAD_STEPS)]
    return loads


def _coefficients(listed: Element, wheel: WheelFit) -> None:
    """Add the radius at the reference load and the slope, with intervals and joint covariance."""
    law = wheel.law
    data = _result(
        listed,
        "Coefficients of the radius law",
        f"r(F) = r_ref + s (F - F_ref) with F_ref = {law.reference_load_N:g} N, valid from {law.load_min_N:.1f} N to "
        f"{law.load_max_N:.1f} N",
    )
    _real(_add(data, "quantity"), "reference_load", law.reference_load_N, NEWTON)
    low, high = wheel.radius_ref_ci95_m
    radius = _real(_add(data, "quantity"), "radius_at_reference_load", law.radius_ref_m, METRE)
    _expanded(radius, 0.5 * (high - low), math.sqrt(law.covariance[0, 0]))
    interval = wheel.slope_ci95_m_per_N
    if interval is None:
        return
    slope = _real(_add(data, "quantity"), "slope", law.slope_m_per_N, SLOPE_UNIT)
    _expanded(slope, 0.5 * (interval[1] - interval[0]), math.sqrt(law.covariance[1, 1]))
    _region(_si(_si(_add(data, "quantity"), "list"), "realList"), wheel)


def _region(vector: Element, wheel: WheelFit) -> None:
    """Add both coefficients with the ellipse that holds them in 95 % (F distribution)."""
    from scipy.stats import f

    law = wheel.law
    _si(vector, "label", "radius_at_reference_load slope")
    for value, unit in ((law.radius_ref_m, METRE), (law.slope_m_per_N, SLOPE_UNIT)):
        _real(vector, None, value, unit)
    region = _si(vector, "ellipsoidalRegion")
    matrix = _si(region, "covarianceMatrix")
    for row in range(2):
        column = _si(matrix, "column")
        for at in range(2):
            covariance = _si(column, "covariance")
            _si(covariance, "value", _number(float(law.covariance[row, at]), DIGITS))
            _si(covariance, "unit", COVARIANCE_UNITS[row][at])
    _si(region, "coverageFactor", _factor(math.sqrt(2.0 * float(f.ppf(COVERAGE, 2, law.dof)))))
    _si(region, "coverageProbability", f"{COVERAGE:g}")
    _si(region, "distribution", "normal")


def _real(parent: Element, label: str | None, value: float, unit: str) -> Element:
    real = _si(parent, "real")
    if label is not None:
        _si(real, "label", label)
    _si(real, "value", _number(value, DIGITS))
    _si(real, "unit", unit)
    return real


def _expanded(real: Element, half_width: float, standard: float) -> None:
    """Add the expanded uncertainty; its coverage factor is half width over standard uncertainty."""
    part = _si(real, "expandedUnc")
    _si(part, "uncertainty", _number(half_width, UNCERTAINTY_DIGITS))
    _si(part, "coverageFactor", _factor(half_width / standard))
    _si(part, "coverageProbability", f"{COVERAGE:g}")
    _si(part, "distribution", "t")


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}g}"


def _factor(value: float) -> str:
    """Return a coverage factor as the schema asks: at least 1, no exponent."""
    return f"{max(value, 1.0):.{FACTOR_DIGITS}f}"
