"""The diagnosis of the sim-to-real gap."""

from __future__ import annotations

from calib.report.blocks import Section
from calib.report.gap_findings import GapFindings
from calib.report.source import Source
from calib.report.statements.diagnosis import diagnosis_content


def section(source: Source) -> Section | None:
    """Return the findings of the diagnosis, or None where none was asked for."""
    return None if source.gap is None else gap_section(source.gap)


def gap_section(gap: GapFindings) -> Section:
    """Return what a report says of the findings of a diagnosis."""
    return Section("Diagnosis of the gap", diagnosis_content(gap))
