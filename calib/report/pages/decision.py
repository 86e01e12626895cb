"""The decision rule: when a law counts as usable."""

from __future__ import annotations

from calib.radius.residual_checks import FAIL_BELOW, NOTE_BELOW
from calib.report.blocks import Items, Section, Text
from calib.report.source import Source


def section(source: Source) -> Section:
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
