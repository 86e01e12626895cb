"""The uncertainty budget of a single effective radius and of the law."""

from __future__ import annotations

import numpy as np

from calib.report.blocks import Block, Column, Section, Table, Text
from calib.report.numbers import aligned, fixed, left, prose, two_digits
from calib.report.source import Source

__all__ = ["section"]

_NAMES = {
    "rangefinder": "rangefinder",
    "quantisation": "quantisation",
    "path": "path",
    "other_run_to_run": "other, run to run",
    "session_to_session": "session to session",
}


def section(source: Source) -> Section:
    """Return what the uncertainty is made of."""
    fit, parts = source.fit, source.fit.radii.budget
    rows: list[tuple[str, ...]] = [
        (
            _NAMES.get(part.name, part.name.replace("_", " ")),
            prose(part.what),
            part.kind,
            part.distribution,
            "∞" if part.dof is None else fixed(part.dof, 1),
            two_digits(1e6 * part.std_left_m),
            two_digits(1e6 * part.std_right_m),
        )
        for part in parts
    ]
    total = [float(np.sqrt(sum(value**2 for value in side))) for side in _sides(source)]
    rows.append(("combined", "one run in a session of its own", "", "", "", *(two_digits(1e6 * one) for one in total)))
    blocks: list[Block] = [
        Table(
            "Budget of a single effective radius, for a typical run: contributions to its standard uncertainty. Type A "
            "is evaluated from repeats, type B from other knowledge (GUM).",
            (
                left("Contribution"),
                left("Quantity", wide=True),
                Column("Type", align="center"),
                left("Distribution"),
                Column("ν"),
                Column("left", "µm", group="u"),
                Column("right", "µm", group="u"),
            ),
            aligned(rows, 5, 6),
        ),
        Table(
            "Budget of the law: what scatter of runs and of sessions contribute to the standard uncertainties of its "
            "coefficients.",
            (
                left("Wheel"),
                left("Coefficient"),
                left("Unit"),
                Column("of runs", group="u from the scatter"),
                Column("of sessions", group="u from the scatter"),
                Column("Combined"),
            ),
            aligned(_law_rows(source), 3, 4, 5),
        ),
    ]
    known = [float(np.sqrt(np.mean(std**2))) for std in (fit.radii.std_left_m, fit.radii.std_right_m)]
    scatter = [wheel.run_std_m for wheel in fit.wheels.values()]
    if all(one > 2 * two for one, two in zip(scatter, known, strict=True)):
        blocks.append(
            Text(
                f"Runs scatter {scatter[0] / known[0]:.1f} (left) and {scatter[1] / known[1]:.1f} (right) times as "
                "much as the instruments explain: floor, steering and tyre set the scatter, a better rangefinder would "
                "not help."
            )
        )
    return Section("Uncertainty budget", tuple(blocks))


def _sides(source: Source) -> tuple[list[float], list[float]]:
    parts = source.fit.radii.budget
    return [part.std_left_m for part in parts], [part.std_right_m for part in parts]


def _law_rows(source: Source) -> list[tuple[str, ...]]:
    rows = []
    for name, wheel in source.fit.wheels.items():
        within, between = wheel.estimate.cov_within, wheel.estimate.cov_between
        kinds = [(0, "radius at F₀", "µm", 1e6)]
        if wheel.model == "line":
            kinds.append((1, "slope", "nm/N", 1e9))
        for number, (index, title, unit, scale) in enumerate(kinds):
            values = [float(one[index, index]) for one in (within, between, within + between)]
            cells = (two_digits(scale * float(np.sqrt(max(value, 0.0)))) for value in values)
            rows.append(("" if number else name, title, unit, *cells))
    return rows
