"""Report on runs that give no radius law: their geometry, the diagnosis of their gap, or both."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib import __version__
from calib.campaign.checks.design import assumed_settings
from calib.documents import to_json
from calib.kinematics.adequacy import GeometryVerdict
from calib.radius.result import ingest_notes
from calib.reporting.blocks import Block, Facts, Items, Notice, Picture, Section, Text, items, picture
from calib.reporting.content import Attachment, Report
from calib.reporting.formatting import prose
from calib.reporting.source import logo_of, number_of, stated_of, verdict_document
from calib.reporting.topics.conditions import assumed_text, missing_of, preparation_of
from calib.reporting.topics.geometry import geometry_remarks, parameter_table, route_tables, verdict_sentences

if TYPE_CHECKING:
    from calib.campaign.model import Campaign
    from calib.gap.decision.diagnosis import Diagnosis
    from calib.kinematics.result import Geometry, RunTrace

#: verdict -> level of its notice
LEVELS: Final = {GeometryVerdict.CALIBRATED: "good", GeometryVerdict.DOUBTFUL: "note", GeometryVerdict.WRONG: "bad"}


def report_without_law(
    campaign: Campaign,
    *,
    issued: str,
    why: str,
    geometry: Geometry | None = None,
    coefficients: bytes | None = None,
    diagnosis: Diagnosis | None = None,
) -> Report:
    """Return the report on runs that give no radius law.

    Parameters
    ----------
    campaign : Campaign
        What was driven.
    issued : str
        Date of issue, YYYY-MM-DD.
    why : str
        Why the runs give no radius law, a sentence without its full stop.
    geometry : Geometry, optional
        Its estimate, with the traces of the runs in ``paths``; None where the runs allow none.
    coefficients : bytes, optional
        Coefficient file, attached; None where the geometry is not passed on.
    diagnosis : Diagnosis, optional
        Has a section of its own and is attached.
    """
    kind, title = "CR", "Gap between measured and simulated motion"
    content: dict[str, Any] = {"inputs": dict(campaign.hashes), "campaign": campaign.name, "version": __version__}
    if geometry is not None:
        kind, title = "GR", "Geometry of a vehicle: radii, track and sensor"
        content["geometry"] = geometry.to_dict()
    content["gap"] = None if diagnosis is None else verdict_document(diagnosis)
    stated = stated_of(campaign)
    reason = Notice("note", "These runs give no radius law", _capital(prose(why.rstrip("."))) + ".")
    # a diagnosis alone begins with it
    first = [] if diagnosis is None or geometry is not None else [_page_one(diagnosis)]
    sections = (
        *([] if not first else [Section("Result", (*first, reason))]),
        *([] if geometry is None else _sections(geometry, diagnosis)),
        *([] if diagnosis is None else [_diagnosed(diagnosis)]),
        *([] if first else [Section("Radius law", (reason,))]),
        preparation_of(ingest_notes(campaign)),
        _limits(campaign, geometry, coefficients),
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
        attachments=_attachments(geometry, coefficients, diagnosis),
        stated=stated,
        logo=logo_of(campaign),
    )


def _page_one(diagnosis: Diagnosis) -> Notice:
    from calib.reporting.topics.diagnosis import page_one_notice

    return page_one_notice(diagnosis)


def _diagnosed(diagnosis: Diagnosis) -> Section:
    from calib.reporting.figures.gap import GapArrays
    from calib.reporting.topics.diagnosis import gap_section

    return gap_section(diagnosis, GapArrays.of(diagnosis))


def _sections(geometry: Geometry, diagnosis: Diagnosis | None) -> list[Section]:
    """Return the result, its residuals, and how the parameters correlate."""
    verdict = geometry.verdict
    first, *further = verdict_sentences(geometry)
    result: list[Block] = [
        Notice(LEVELS[verdict], f"Geometry {verdict.value}", prose(_capital(first.partition(": ")[2]))),
        *items(map(prose, further)),
        *([] if diagnosis is None else [_page_one(diagnosis)]),
        Facts(_facts(geometry)),
        parameter_table(geometry),
        *items(map(prose, geometry_remarks(geometry))),
    ]
    left: list[Block] = [
        Text("Residuals are measured less predicted: along and across the path, and in heading.", small=True),
        *_path_pictures(geometry.paths),
        *_residual_pictures(geometry.paths),
        *route_tables(geometry),
    ]
    sections = [Section("Result", tuple(result)), Section("Residuals", tuple(left))]
    if len(geometry.estimates) > 1:
        sections.append(Section("Correlation of the parameters", _correlation(geometry)))
    return sections


def _capital(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


def _facts(geometry: Geometry) -> tuple[tuple[str, str], ...]:
    """Return what the estimate was made from."""
    of, n = geometry.clusters
    stretches = "end poses of whole runs" if geometry.using == "end_poses" else f"{geometry.n_segments} windows"
    open_parameters = ", ".join(geometry.undetermined) or "none"
    return (
        ("Drive", geometry.drive),
        ("Runs", f"{geometry.n_runs}, by {stretches}"),
        ("Intervals", f"95 %, from {n} {of}s"),
        ("Not determined", open_parameters),
        ("Outliers", ", ".join(geometry.outliers) or "none"),
    )


def _path_pictures(traces: tuple[RunTrace, ...]) -> list[Picture]:
    measured = [trace for trace in traces if np.isfinite(trace.reference_m).any()]
    if not measured:
        return []
    largest = max(float(np.nanmax(np.hypot(*trace.residual_after[:, :2].T), initial=0.0)) for trace in measured)
    return [
        picture(
            "geometry-paths",
            "Paths of the reference's sensor: by the calibrated odometry, coloured by its distance from the reference; "
            "by the nominal odometry in grey; by the reference, dotted.",
            f"Paths of {len(measured)} runs; the calibrated ones at most {1e3 * largest:.3g} mm from the reference",
            "geometry.draw_paths",
            measured,
        )
    ]


def _residual_pictures(traces: tuple[RunTrace, ...]) -> list[Picture]:
    along = [trace for trace in traces if len(trace.seen) > 1]
    ends = [trace for trace in traces if len(trace.seen) < 2]
    in_time = picture(
        "geometry-residuals-in-time",
        "Residuals along the path of the first runs; in grey by the nominal odometry.",
        f"Residuals along, lateral and in heading against time, of {len(along)} runs",
        "geometry.residuals_in_time",
        along,
    )
    by_run = picture(
        "geometry-residuals-by-run",
        "Residuals at the end of each run, in the order driven.",
        f"Residuals of {len(traces)} end poses before and after",
        "geometry.residuals_by_run",
        ends,
    )
    return [*([in_time] if along else []), *([by_run] if ends else [])]


def _correlation(geometry: Geometry) -> tuple[Block, ...]:
    names = [estimate.name for estimate in geometry.estimates]
    remark = "Parameters that correlate beyond 0.9, in bold, are known better together than each by itself."
    shown = picture(
        "geometry-correlation",
        "Correlation of the parameters.",
        f"Correlation of {', '.join(names)}",
        "geometry.correlations",
        *(names, geometry.covariance),
    )
    return (Text(remark, small=True), shown)


def _limits(campaign: Campaign, geometry: Geometry | None, coefficients: bytes | None) -> Section:
    """Return what the report does not cover."""
    if geometry is None:
        sentences = [
            "No radius, slope or uncertainty of a wheel is stated, and no coefficient file is attached.",
            "The verdict holds for the vehicle, routes, loads and conditions of these runs.",
        ]
    else:
        sentences = [
            "No law of the load is stated: the radii hold for the loads of these runs.",
            "The estimates hold for the vehicle, floor, speeds and reference of these runs.",
        ]
        if coefficients is None:
            sentences.append("No coefficient file is attached, since the geometry is not passed on.")
    blocks = (Items(tuple(sentences)), assumed_text(assumed_settings(campaign)))
    return Section("What this report does not cover", blocks)


def _attachments(
    geometry: Geometry | None, coefficients: bytes | None, diagnosis: Diagnosis | None
) -> tuple[Attachment, ...]:
    files = []
    if geometry is not None:
        estimates = to_json(geometry.to_dict()).encode()
        files.append(Attachment("geometry.json", estimates, "Estimates, covariance and verdict"))
    if coefficients is not None:
        lengths = "Radii, lengths and their covariance, as the vehicle loads it"
        files.append(Attachment("coefficients.json", coefficients, lengths))
    if diagnosis is not None:
        verdict = to_json(verdict_document(diagnosis)).encode()
        files.append(Attachment("diagnosis.json", verdict, "Verdict of the diagnosis with everything that it rests on"))
    return tuple(files)
