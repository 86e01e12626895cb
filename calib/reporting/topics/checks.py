"""Checks of the fit's residuals, the decision rule, and whether the law can be used."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

from calib.radius.design_checks import FAIL_BELOW, NOTE_BELOW
from calib.radius.regression import Check
from calib.radius.result import Fit
from calib.reporting.blocks import Column, Items, Notice, Picture, Section, Table, Text, drawn
from calib.reporting.formatting import probability, prose, text_column, text_columns

if TYPE_CHECKING:
    from calib.reporting.source import Source

_LEVELS: Final = {"ok": "passed", "note": "remark", "failed": "FAILED"}
#: remarks beside the result, a sentence each
MAX_REMARKS: Final = 3


def checks_table(fit: Fit) -> Table:
    """Return the checks of both wheels: verdict, statistic, and what it means for the user."""
    wheels_by_check: dict[tuple[str, str, str], list[tuple[str, Check]]] = {}
    for name, wheel in fit.wheels.items():
        for check in wheel.checks:
            wheels_by_check.setdefault((check.name, check.level, check.sentence), []).append((name, check))
    order = {check.name: number for number, check in enumerate(fit.left.checks + fit.right.checks)}
    rows = [
        (
            check_name.replace("_", " "),
            "both" if len(pairs) == 2 else pairs[0][0],
            _LEVELS.get(level, level),
            _statistics([check for _, check in pairs]),
            " / ".join(dict.fromkeys(probability(check.p_value) for _, check in pairs)),
            prose(sentence),
        )
        for (check_name, level, sentence), pairs in sorted(wheels_by_check.items(), key=lambda item: order[item[0][0]])
    ]
    return Table(
        "Checks of the fit; p is the probability of a statistic at least as extreme where all assumptions hold.",
        (
            *text_columns("Check", "Wheel", "Verdict"),
            Column("Statistic", align="left", wide=True, detail=True),
            Column("p", detail=True),
            text_column("Meaning", wide=True),
        ),
        tuple(rows),
        dense=True,
    )


def _statistics(checks: list[Check]) -> str:
    """Return the statistics of a check on one wheel or both, by one name."""
    values: dict[str, list[str]] = {}
    for check in checks:
        if check.statistic is not None and check.statistic_name:
            values.setdefault(check.statistic_name, []).append(f"{check.statistic:.3g}".replace("-", "−"))
    return prose("; ".join(f"{name} = {' / '.join(dict.fromkeys(each))}" for name, each in values.items()))


def usable_notice(fit: Fit) -> Notice:
    """Return whether the law can be used, and what its user has to know."""
    failed = [
        f"{name} wheel, {check.name.replace('_', ' ')}"
        for name, wheel in fit.wheels.items()
        for check in wheel.checks
        if not check.passed
    ]
    if fit.implausible and fit.accepted:
        return Notice(
            "bad",
            "Implausible, and accepted by the user",
            f"Reason given: {prose(fit.accepted)}. Findings: {' '.join(prose(text) for text in fit.implausible)}",
        )
    if failed:
        return Notice(
            "bad",
            "The law should not be used as it is" if fit.implausible else "The law is doubtful",
            f"FAILED: {'; '.join(failed)}. The checks say what that means and what to do.",
        )
    remarks = [check for wheel in fit.wheels.values() for check in wheel.checks if check.level == "note"]
    if remarks:
        sentences = tuple(dict.fromkeys(prose(check.sentence) for check in remarks))
        return Notice("note", "The law can be used; its user has to know this", " ".join(sentences[:MAX_REMARKS]))
    return Notice("good", "The law can be used", "Every check of the fit passed without remark.")


def residuals_section(source: Source) -> Section:
    """Return the checks of both wheels: verdict, statistic, and what it means for the user."""
    fit = source.fit
    return Section("Residual checks", (residuals_picture(fit), checks_table(fit)))


def decision_section(source: Source) -> Section:
    """Return by which rule the checks were judged, and what was not judged."""
    tests = sum(check.p_value is not None for wheel in source.fit.wheels.values() for check in wheel.checks)
    false_alarm = 100 * (1 - (1 - NOTE_BELOW) ** tests)
    return Section(
        "Decision rule",
        (
            Items(
                (
                    f"A check with a probability p below {NOTE_BELOW:g} is given as a remark: the result stands, but "
                    "its user has to know.",
                    f"A check on which the validity of the law rests has failed where p is below {FAIL_BELOW:g}; the "
                    "law should then not be used as it is. One failed check on one wheel is enough.",
                    f"With the {tests} tests made here, all assumptions being true, the probability of any remark is "
                    f"about {false_alarm:.0f} %, and that of any failure at most {100 * tests * FAIL_BELOW:.2g} %.",
                    "Intervals are two-sided with a coverage of 95 %; uncertainties are rounded to two significant "
                    "digits, values to the same place.",
                )
            ),
            Text(
                "No tolerance on radius or slope was agreed, so no statement of conformity with a specification is "
                "made. Where one is made from these results, the expanded uncertainty has to be taken into account."
            ),
        ),
    )


def residuals_picture(fit: Fit) -> Picture:
    """Return the residuals of both wheels."""
    return Picture(
        "residuals",
        "Residuals of both wheels against load, in the order driven, and against a normal distribution; colours are "
        "sessions as above.",
        "Residuals of both wheels: "
        + "; ".join(
            f"{name} wheel within {1e6 * float(abs(wheel.residual_m).max()):.0f} µm"
            for name, wheel in fit.wheels.items()
        ),
        partial(drawn, "radius.residuals", fit.left, fit.right, fit.radii.session),
    )
