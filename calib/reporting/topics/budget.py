"""Uncertainty budget of a single effective radius and of the law."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from calib.radius.result import Fit
from calib.reporting.blocks import Picture, Section, Table, Text, picture, table
from calib.reporting.formatting import aligned, fixed, prose, two_digits

if TYPE_CHECKING:
    from calib.reporting.source import Source

_NAMES: Final = {"other run to run": "other, run to run"}


def radius_budget(fit: Fit) -> Table:
    """Return the contributions to the standard uncertainty of a single effective radius."""
    rows: list[tuple[str, ...]] = []
    for part in fit.radii.budget:
        name, dof = part.name.replace("_", " "), "∞" if part.dof is None else fixed(part.dof, 1)
        sizes = (two_digits(1e6 * std_m) for std_m in (part.std_left_m, part.std_right_m))
        rows.append((_NAMES.get(name, name), prose(part.what), part.kind, part.distribution, dof, *sizes))
    total = np.linalg.norm([(part.std_left_m, part.std_right_m) for part in fit.radii.budget], axis=0)
    combined = (two_digits(1e6 * float(std_m)) for std_m in total)
    rows.append(("combined", "one run in a session of its own", "", "", "", *combined))
    return table(
        "Uncertainty budget of a single effective radius, for a typical run: contributions to its standard uncertainty "
        "u (k = 1). Type A is evaluated from repeats, type B from other knowledge (GUM).",
        ("<Contribution", "*Quantity", "^Type", "<Distribution", "~ν", "u | left (µm)", "u | right (µm)"),
        aligned(rows, 5, 6),
    )


def budget_picture(fit: Fit) -> Picture:
    """Return the budget of a single radius as bars."""
    largest = max(fit.radii.budget, key=lambda part: part.std_left_m + part.std_right_m)
    return picture(
        "budget",
        "Contributions to the standard uncertainty of a single effective radius, and all of them combined.",
        f"Bars of the uncertainty budget; the largest contribution is {largest.name.replace('_', ' ')}",
        "radius.budget_bars",
        fit.radii.budget,
    )


def _has_systematic(fit: Fit) -> bool:
    return any(len(wheel.estimate.systematic) for wheel in fit.wheels.values())


def declared_text(fit: Fit) -> Text:
    """Say which systematic parts are declared, or that none is and what that means for U."""
    if _has_systematic(fit):
        return Text(
            "Parts that are the same in every run are declared by the campaign ([uncertainty] of campaign.toml); they "
            "enter every U and every band, and more runs do not make them smaller."
        )
    return Text(
        "The campaign declares no systematic parts ([uncertainty] of campaign.toml): scale and offset of the "
        "rangefinder, angle of its beam, scale of the weighing. Every U counts the instruments' errors as random from "
        "run to run; errors that are the same in every run are not contained in it."
    )


def law_budget(fit: Fit) -> Table:
    """Return what scatter of runs and sessions, and what is systematic, contribute to the coefficients."""
    systematic = _has_systematic(fit)
    rows = []
    for name, wheel in fit.wheels.items():
        parts = [wheel.estimate.cov_within, wheel.estimate.cov_between]
        parts += [wheel.estimate.cov_systematic] if systematic else []
        std = np.sqrt(np.maximum([np.diag(part) for part in (*parts, wheel.estimate.covariance)], 0.0))
        rows.append((name, "radius at F₀", "µm", *(two_digits(1e6 * float(value)) for value in std[:, 0])))
        if wheel.model == "line":
            rows.append(("", "slope", "nm/N", *(two_digits(1e9 * float(value)) for value in std[:, 1])))
    return table(
        "Budget of the law: contributions to the standard uncertainties u (k = 1) of its coefficients."
        + (" Systematic parts do not become smaller with more runs." if systematic else ""),
        (
            *("<Wheel", "<Coefficient", "<Unit", "u from the scatter | of runs", "u from the scatter | of sessions"),
            *(["Systematic"] if systematic else []),
            "Combined",
        ),
        aligned(rows, *range(3, 7 if systematic else 6)),
    )


def _scatter(fit: Fit) -> tuple[Text, ...]:
    """Say by how much runs scatter more than the instruments explain; nothing where they do not."""
    known = [float(np.sqrt(np.mean(std**2))) for std in (fit.radii.std_left_m, fit.radii.std_right_m)]
    scatter = [wheel.run_std_m for wheel in fit.wheels.values()]
    if not all(spread > 2 * two for spread, two in zip(scatter, known, strict=True)):
        return ()
    text = (
        f"Runs scatter {scatter[0] / known[0]:.1f} (left) and {scatter[1] / known[1]:.1f} (right) times as "
        "much as the instruments explain: ground, steering and tyre set the scatter, a better rangefinder would "
        "not help."
    )
    return (Text(text),)


def budget_section(source: Source) -> Section:
    """Return what the uncertainty is made of."""
    fit = source.fit
    blocks = (radius_budget(fit), budget_picture(fit), law_budget(fit), declared_text(fit), *_scatter(fit))
    return Section("Uncertainty budget", blocks)
