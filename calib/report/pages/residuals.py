"""Residual checks, each as a sentence."""

from __future__ import annotations

from functools import partial

from calib.report.blocks import Block, Picture, Section
from calib.report.figures import radius as figures
from calib.report.source import Source
from calib.report.statements.checks import checks_table

__all__ = ["section"]


def section(source: Source) -> Section:
    """Return the checks of both wheels: verdict, statistic, and what it means for the user."""
    fit = source.fit
    blocks: list[Block] = [
        Picture(
            "residuals",
            "Residuals of both wheels against load, in the order driven, and against a normal distribution; colours "
            "are sessions as above.",
            "Residuals of both wheels: "
            + "; ".join(
                f"{name} wheel within {1e6 * float(abs(wheel.residual_m).max()):.0f} µm"
                for name, wheel in fit.wheels.items()
            ),
            partial(figures.residuals, fit.left, fit.right, fit.radii.session),
        ),
        checks_table(fit),
    ]
    return Section("Residual checks", tuple(blocks))
