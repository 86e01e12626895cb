"""One fit for all tests of the report: a sample campaign, computed once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.reporting.content import Report, compose
from calib.reporting.pages import to_pdf
from calib.reporting.source import Source, source_of

DATE = "2025-03-31"


@pytest.fixture(scope="session")
def campaign(project_root: Path) -> Campaign:
    return read_campaign(project_root / "sample_runs" / "corridor_crossed")


@pytest.fixture(scope="session")
def source(campaign: Campaign) -> Source:
    return source_of(campaign, issued=DATE)


@pytest.fixture(scope="session")
def report(source: Source) -> Report:
    return compose(source)


@pytest.fixture(scope="session")
def pdf(report: Report) -> bytes:
    return to_pdf(report)


@pytest.fixture(scope="session")
def measured(source: Source) -> Source:
    """The same numbers as if a vehicle had been measured."""
    made = source.coefficients.changed(simulated=False)
    return replace(source, fit=replace(source.fit, simulated=False), coefficients=made)
