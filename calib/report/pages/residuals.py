"""Residual checks, each as a sentence."""

from __future__ import annotations

from calib.report.blocks import Section
from calib.report.source import Source
from calib.report.statements.checks import checks_table
from calib.report.statements.fit_pictures import residuals_picture


def section(source: Source) -> Section:
    """Return the checks of both wheels: verdict, statistic, and what it means for the user."""
    fit = source.fit
    return Section("Residual checks", (residuals_picture(fit), checks_table(fit)))
