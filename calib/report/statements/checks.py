"""The checks of a fit: a table, and what follows from them for the user."""

from __future__ import annotations

from typing import Final

from calib.radius.checks import Check
from calib.radius.fitted import Fit
from calib.report.blocks import Column, Notice, Table
from calib.report.numbers import left, probability, prose, text_columns

_LEVELS: Final = {"ok": "passed", "note": "remark", "failed": "FAILED"}
#: remarks told in one sentence each beside the result
_MOST: Final = 3


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
        "Checks of the fit; p is the probability of a statistic at least as extreme where nothing is wrong.",
        (
            *text_columns("Check", "Wheel", "Verdict"),
            Column("Statistic", align="left", wide=True, detail=True),
            Column("p", detail=True),
            left("Meaning", wide=True),
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
            "Implausible, and passed on by the user all the same",
            f"Reason given: {prose(fit.accepted)}. Findings: {' '.join(prose(text) for text in fit.implausible)}",
        )
    if failed:
        return Notice(
            "bad",
            "The law should not be used as it is",
            f"FAILED: {'; '.join(failed)}. The checks say what that means and what to do.",
        )
    remarks = [check for wheel in fit.wheels.values() for check in wheel.checks if check.level == "note"]
    if remarks:
        sentences = tuple(dict.fromkeys(prose(check.sentence) for check in remarks))
        return Notice("note", "The law can be used; its user has to know this", " ".join(sentences[:_MOST]))
    return Notice("good", "The law can be used", "Every check of the fit passed without remark.")
