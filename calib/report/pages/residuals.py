"""Residual checks, each as a sentence."""

from __future__ import annotations

from functools import partial

from calib.radius.checks import Check
from calib.report.blocks import Block, Column, Picture, Section, Table, Text
from calib.report.figures import radius as figures
from calib.report.numbers import left, probability, prose
from calib.report.source import Source

__all__ = ["section"]

_LEVELS = {"ok": "passed", "note": "remark", "failed": "failed"}


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
        Text(
            "p is the probability of a statistic at least as extreme where nothing is wrong; the decision rule below "
            "says from which p on a check speaks.",
            small=True,
        ),
        *(
            Table(
                f"Checks of the {name} wheel.",
                (left("Check"), left("Verdict"), left("Statistic"), Column("p"), left("Meaning", wide=True)),
                tuple(_row(check) for check in wheel.checks),
                dense=True,
            )
            for name, wheel in fit.wheels.items()
        ),
    ]
    return Section("Residual checks", tuple(blocks))


def _row(check: Check) -> tuple[str, ...]:
    statistic = ""
    if check.statistic is not None and check.statistic_name:
        value = f"{check.statistic:.3g}".replace("-", "−")
        statistic = prose(f"{check.statistic_name} = {value}")
    return (
        check.name.replace("_", " "),
        _LEVELS.get(check.level, check.level),
        statistic,
        probability(check.p_value),
        prose(check.sentence),
    )
