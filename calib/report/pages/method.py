"""The method: what was done with the runs, and by which equations."""

from __future__ import annotations

from calib.report.blocks import Equation, Section, Text, items
from calib.report.numbers import prose
from calib.report.source import Source

_DESIGNS = {
    "crossed": "The slope comes from differences between loads within the sessions.",
    "confounded": "Each session has a load of its own, so the slope comes from the session means alone.",
    "mixed": "The slope combines differences within the sessions with those between their means.",
    "single": "The runs count as one session.",
    "constant": "The runs have one load, so a constant radius is given and no slope.",
}


def section(source: Source) -> Section:
    """Return effective radius, regression, and how their uncertainty comes about."""
    fit = source.fit
    designs = dict.fromkeys(_DESIGNS.get(wheel.design, "") for wheel in fit.wheels.values())
    blocks: list[Text | Equation] = [
        Text(
            "The vehicle drives along a straight corridor. A laser rangefinder measures the distance Sₒ of each run, "
            "the encoders of the free rear wheels count their revolutions n. The effective radius of a wheel in a run "
            "is"
        ),
        Equation("effective_radius"),
        Text(
            "where the path correction e accounts for weaving and turning about the straight line. For each wheel a "
            "line is fitted by least squares to the radii of all runs,"
        ),
        Equation("law"),
        Text(
            "with F the wheel load and F₀ the reference load. Runs of one session share temperature, mounting and wear "
            "and are not independent: scatter between sessions and between runs are estimated separately, and both "
            "enter the "
            "uncertainty. " + " ".join(text for text in designs if text)
        ),
        Text(
            "Uncertainties follow the Guide to the expression of uncertainty in measurement (GUM). Expanded "
            "uncertainties use Student's t at the effective degrees of freedom for a coverage of 95 %."
        ),
        Text(f"Deviations from the method: {source.stated.get('deviations', 'none stated')}."),
    ]
    return Section("Method", (*blocks, *items(map(prose, fit.notes))))
