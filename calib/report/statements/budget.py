"""What the uncertainty of a radius and of the law is made of."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.radius.fitted import Fit
from calib.report.blocks import Column, Table, Text
from calib.report.numbers import aligned, fixed, left, prose, two_digits

__all__ = ["law_budget", "radius_budget", "scatter_text"]

_NAMES: Final = {
    "rangefinder": "rangefinder",
    "quantisation": "quantisation",
    "path": "path",
    "other_run_to_run": "other, run to run",
    "session_to_session": "session to session",
}


def radius_budget(fit: Fit) -> Table:
    """Return the contributions to the standard uncertainty of a single effective radius."""
    parts = fit.radii.budget
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
    sides = ([part.std_left_m for part in parts], [part.std_right_m for part in parts])
    total = [float(np.sqrt(sum(value**2 for value in side))) for side in sides]
    rows.append(("combined", "one run in a session of its own", "", "", "", *(two_digits(1e6 * u) for u in total)))
    return Table(
        "Uncertainty budget of a single effective radius, for a typical run: contributions to its standard uncertainty "
        "u (k = 1). Type A is evaluated from repeats, type B from other knowledge (GUM).",
        (
            left("Contribution"),
            left("Quantity", wide=True),
            Column("Type", align="center"),
            left("Distribution"),
            Column("ν", detail=True),
            Column("left", "µm", group="u"),
            Column("right", "µm", group="u"),
        ),
        aligned(rows, 5, 6),
    )


def law_budget(fit: Fit) -> Table:
    """Return what scatter of runs and of sessions contribute to the coefficients."""
    rows = []
    for name, wheel in fit.wheels.items():
        within, between = wheel.estimate.cov_within, wheel.estimate.cov_between
        kinds = [(0, "radius at F₀", "µm", 1e6)]
        if wheel.model == "line":
            kinds.append((1, "slope", "nm/N", 1e9))
        for number, (index, title, unit, scale) in enumerate(kinds):
            values = [float(one[index, index]) for one in (within, between, within + between)]
            cells = (two_digits(scale * float(np.sqrt(max(value, 0.0)))) for value in values)
            rows.append(("" if number else name, title, unit, *cells))
    return Table(
        "Budget of the law: what scatter of runs and of sessions contribute to the standard uncertainties u (k = 1) of "
        "its coefficients.",
        (
            left("Wheel"),
            left("Coefficient"),
            left("Unit"),
            Column("of runs", group="u from the scatter"),
            Column("of sessions", group="u from the scatter"),
            Column("Combined"),
        ),
        aligned(rows, 3, 4, 5),
    )


def scatter_text(fit: Fit) -> Text | None:
    """Say by how much runs scatter more than the instruments explain; None where they do not."""
    known = [float(np.sqrt(np.mean(std**2))) for std in (fit.radii.std_left_m, fit.radii.std_right_m)]
    scatter = [wheel.run_std_m for wheel in fit.wheels.values()]
    if not all(one > 2 * two for one, two in zip(scatter, known, strict=True)):
        return None
    return Text(
        f"Runs scatter {scatter[0] / known[0]:.1f} (left) and {scatter[1] / known[1]:.1f} (right) times as "
        "much as the instruments explain: floor, steering and tyre set the scatter, a better rangefinder would "
        "not help."
    )
