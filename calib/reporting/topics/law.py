"""Radius law: tables, regression, coefficients, uncertainty budget."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from calib.campaign.checks.design import SIDES
from calib.radius.law import round_loads
from calib.radius.regression import WheelFit, t_quantile
from calib.radius.result import Fit
from calib.reporting.blocks import Block, Equation, Picture, Section, Table, Text, caption, paragraph, picture, table
from calib.reporting.formatting import MISSING, aligned, fixed, measured, places, prose, span, two_digits
from calib.reporting.source import Source

MM: Final = 1e3
UM: Final = 1e6


def law_table(fit: Fit) -> Table:
    """Return both wheels' laws with expanded uncertainties."""
    left, right = fit.left.law.reference_load_N, fit.right.law.reference_load_N
    zero = f"F₀ = {left:.4g} N" + ("" if left == right else f" (left), {right:.4g} N (right)")
    return _table(caption("table-law", zero=zero), fit.wheels)


def static_table(fit: Fit) -> Table:
    """Return the same regression on the standing wheels."""
    return _table("Static radius against load, the same regression on the standing wheel; U as above.", fit.static)


def _table(title: str, wheels: Mapping[str, WheelFit]) -> Table:
    radius = tuple(f"Radius at F₀ | {head}" for head in ("r(F₀) (mm)", "U (mm)", "k"))
    slope = tuple(f"Slope | {head}" for head in ("s (µm/N)", "U (µm/N)", "k"))
    rows = [(name, *_row(wheel)) for name, wheel in wheels.items()]
    return table(title, ("<Wheel", "Runs", "^Loads (N)", *radius, *slope), rows)


def _coefficients(fit: WheelFit) -> list[tuple[str, str, float, float, float]]:
    law, (radius_std, slope_std) = fit.law, np.sqrt(np.diag(fit.law.covariance)).tolist()
    title = f"radius at {law.reference_load_N:.4g} N"
    rows = [(title, "mm", MM * law.radius_ref_m, MM * radius_std, fit.dof_radius_ref)]
    if fit.model == "line":
        rows.append(("slope", "µm/N", UM * law.slope_m_per_N, UM * slope_std, fit.dof_slope))
    return rows


def _row(fit: WheelFit) -> tuple[str, ...]:
    cells: list[str] = []
    for _, _, value, std, dof in _coefficients(fit):
        k = float(t_quantile(dof))
        cells += [*measured(value, k * std), fixed(k, 2)]
    cells += [MISSING] * (6 - len(cells))
    loads = span(fit.law.load_min_N, fit.law.load_max_N, "", ".0f").replace(" to ", "–")
    return (str(fit.law.n_runs), loads, *cells)


def single_run_text(fit: Fit) -> Text:
    """Return a further run's prediction interval in mid load range."""
    parts = []
    line = any(wheel.model == "line" for wheel in fit.wheels.values())
    for name, wheel in fit.wheels.items():
        half = wheel.law.half_width_m(0.5 * (wheel.law.load_min_N + wheel.law.load_max_N), single_run=True)
        parts.append(f"±{two_digits(UM * float(half))} µm ({name})")
    return Text(
        f"The radius that one further run shows lies, with 95 % probability, within {' and '.join(parts)} of the law "
        + ("in the middle of the load range." if line else "at this load.")
    )


def quality_text(wheel: WheelFit) -> str:
    """Return the scatter about the law, and what it explains."""
    text = f"{wheel.wheel.capitalize()} wheel: residual standard deviation {two_digits(UM * wheel.residual_std_m)} µm"
    if wheel.model == "line":
        # more digits where the line explains nearly all
        text += f", R² = {wheel.r_squared:.5f}" if wheel.r_squared > 0.99 else f", R² = {wheel.r_squared:.3f}"
    if wheel.session_std_m > 0:
        of_runs, of_sessions = two_digits(UM * wheel.run_std_m), two_digits(UM * wheel.session_std_m)
        text += f", scatter of runs {of_runs} µm and of sessions {of_sessions} µm"
    return text + "."


def naive_text(fit: Fit) -> tuple[Text, ...]:
    """Return the slopes' intervals as if runs were independent."""
    parts = []
    for name, wheel in fit.wheels.items():
        if wheel.naive is not None and wheel.model == "line" and wheel.design != "single":
            low, high = (UM * end for end in wheel.naive.slope_ci95_m_per_N)
            _, half = measured(0.5 * (low + high), 0.5 * (high - low))
            parts.append(f"±{half} µm/N ({name})")
    return (Text(paragraph("independent", slopes=" and ".join(parts)), small=True),) if parts else ()


def regression_section(source: Source) -> Section:
    """Return figure and table of both laws with their bands."""
    fit = source.fit
    bands = ("radius (mm)", "mean (± µm)", "single run (± µm)")
    heads = ("Load (N)", *(f"{wheel} wheel | {head}" for wheel in ("Left", "Right") for head in bands))
    title = "The law at the least and largest load and at round ones between, with the half widths of both bands."
    shown = table(title, heads, aligned(_band_rows(fit.left, fit.right), 2, 3, 5, 6))
    quality = Text(" ".join(map(quality_text, fit.wheels.values())))
    return Section("Regression on load", (Text(paragraph("bands")), regressions_picture(fit), shown, quality))


def _band_rows(left: WheelFit, right: WheelFit) -> tuple[tuple[str, ...], ...]:
    lows, highs = zip(*((wheel.law.load_min_N, wheel.law.load_max_N) for wheel in (left, right)), strict=True)
    low, high = (max(lows), min(highs)) if max(lows) < min(highs) else (min(lows), max(highs))
    loads = np.unique(np.rint([low, *round_loads(low, high), high]))
    columns = [[fixed(float(load), 0) for load in loads]]
    for wheel in (left, right):
        mean, single = (UM * wheel.law.half_width_m(loads, single_run=one) for one in (False, True))
        # one number of decimals for all radii: the narrowest band's
        decimals = places(1e-3 * float(mean.min()))
        columns.append([fixed(MM * float(radius), decimals) for radius in wheel.law.radius_m(loads)])
        columns += [[two_digits(float(width)) for width in widths] for widths in (mean, single)]
    return tuple(zip(*columns, strict=True))


def coefficients_section(source: Source) -> Section:
    """Return the coefficients with uncertainties, and how to get a radius at a load."""
    fit = source.fit
    rows = []
    for wheel in fit.wheels.values():
        for number, (title, unit, value, std, dof) in enumerate(_coefficients(wheel)):
            k = float(t_quantile(dof))
            # two digits of u fix the value's last place, too
            numbers = (*measured(value, std), fixed(dof, 1), fixed(k, 2), two_digits(k * std))
            rows.append(("" if number else wheel.wheel, title, unit, *numbers))
    heads = ("<Wheel", "<Quantity", "<Unit", "Value", "u", "ν", "k", "U")
    blocks: list[Block] = [table(caption("table-coefficients"), heads, aligned(rows, 3, 4, 7))]
    if any(wheel.model == "line" for wheel in fit.wheels.values()):
        text = "The standard uncertainty of the radius at a load F follows from both and their covariance,"
        blocks += [Text(text), Equation("law_uncertainty")]
    ends = "clamps loads outside the valid range to its ends"
    outside = "refuses loads outside the valid range" if source.coefficients.outside == "refuse" else ends
    wheels = {side: getattr(source.coefficients.law, side) for side in SIDES}
    valid = [f"{span(one.load_min_N, one.load_max_N, 'N', '.1f')} ({side})" for side, one in wheels.items()]
    known = {"checksum": source.coefficients.checksum[:19], "valid": " and ".join(valid), "outside": outside}
    correlations = Text(" ".join(map(_correlation, fit.wheels.values())))
    return Section("Coefficients", (*blocks, correlations, Text(paragraph("attached", **known))))


def _correlation(wheel: WheelFit) -> str:
    law, covariance = wheel.law, wheel.law.covariance
    valid = span(law.load_min_N, law.load_max_N, "N", ".1f")
    if wheel.model != "line":
        return f"{wheel.wheel.capitalize()} wheel: constant, measured at {valid}."
    norm = float(np.sqrt(covariance[0, 0] * covariance[1, 1]))
    correlation = fixed(float(covariance[0, 1]) / norm if norm > 0 else 0.0, 2)
    return f"{wheel.wheel.capitalize()} wheel: correlation of radius and slope {correlation}, measured at {valid}."


def regressions_picture(fit: Fit) -> Picture:
    """Return both laws with their bands."""
    alt = f"Regression of the radius on the load: {'; '.join(map(_law_in_words, fit.wheels.values()))}"
    return picture("regressions", alt, "calibration.regressions", fit.left, fit.right, fit.radii.session)


def _law_in_words(wheel: WheelFit) -> str:
    law = wheel.law
    if wheel.model != "line":
        return f"{wheel.wheel} wheel: constant radius {1e3 * law.radius_ref_m:.4f} mm"
    change = "grows" if law.slope_m_per_N > 0 else "shrinks"
    return f"{wheel.wheel} wheel: the radius {change} by {abs(1e6 * law.slope_m_per_N):.3g} µm for each newton"


_NAMES: Final = {"other run to run": "other, run to run"}


def radius_budget(fit: Fit) -> Table:
    """Return the budget of a single effective radius."""
    rows: list[tuple[str, ...]] = []
    for part in fit.radii.budget:
        name, dof = part.name.replace("_", " "), "∞" if part.dof is None else fixed(part.dof, 1)
        sizes = (two_digits(1e6 * std_m) for std_m in (part.std_left_m, part.std_right_m))
        rows.append((_NAMES.get(name, name), prose(part.what), part.kind, part.distribution, dof, *sizes))
    total = np.linalg.norm([(part.std_left_m, part.std_right_m) for part in fit.radii.budget], axis=0)
    combined = (two_digits(1e6 * float(std_m)) for std_m in total)
    rows.append(("combined", "one run in a session of its own", "", "", "", *combined))
    heads = ("<Contribution", "*Quantity", "^Type", "<Distribution", "~ν", "u | left (µm)", "u | right (µm)")
    return table(caption("table-radius-budget"), heads, aligned(rows, 5, 6))


def budget_picture(fit: Fit) -> Picture:
    """Return the budget of a single radius as bars."""
    largest = max(fit.radii.budget, key=lambda part: part.std_left_m + part.std_right_m)
    alt = f"Bars of the uncertainty budget; the largest contribution is {largest.name.replace('_', ' ')}"
    return picture("budget", alt, "calibration.budget_bars", fit.radii.budget)


def law_budget(fit: Fit) -> Table:
    """Return what scatter and systematic sources contribute to the coefficients."""
    systematic = any(len(wheel.estimate.systematic) for wheel in fit.wheels.values())
    rows = []
    for name, wheel in fit.wheels.items():
        parts = [wheel.estimate.cov_within, wheel.estimate.cov_between]
        parts += [wheel.estimate.cov_systematic] if systematic else []
        std = np.sqrt(np.maximum([np.diag(part) for part in (*parts, wheel.estimate.covariance)], 0.0))
        rows.append((name, "radius at F₀", "µm", *(two_digits(1e6 * float(value)) for value in std[:, 0])))
        if wheel.model == "line":
            rows.append(("", "slope", "nm/N", *(two_digits(1e9 * float(value)) for value in std[:, 1])))
    heads = ["<Wheel", "<Coefficient", "<Unit", "u from the scatter | of runs", "u from the scatter | of sessions"]
    heads += ["Systematic", "Combined"] if systematic else ["Combined"]
    remark = " Systematic parts do not become smaller with more runs." if systematic else ""
    return table(caption("table-law-budget", systematic=remark), heads, aligned(rows, *range(3, len(heads))))


def _scatter(fit: Fit) -> tuple[Text, ...]:
    known = [float(np.sqrt(np.mean(std**2))) for std in (fit.radii.std_left_m, fit.radii.std_right_m)]
    scatter = [wheel.run_std_m for wheel in fit.wheels.values()]
    if not all(spread > 2 * two for spread, two in zip(scatter, known, strict=True)):
        return ()
    return (Text(paragraph("scatter", left=scatter[0] / known[0], right=scatter[1] / known[1])),)


def budget_section(source: Source) -> Section:
    """Return what the uncertainty is made of."""
    fit = source.fit
    declared = Text(paragraph("declared" if any(": " in part.name for part in fit.radii.budget) else "undeclared"))
    blocks = (radius_budget(fit), budget_picture(fit), law_budget(fit), declared, *_scatter(fit))
    return Section("Uncertainty budget", blocks)
