"""Radius law: table of both wheels, regression with both bands, coefficients with their uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.radius.regression import WheelFit, t_quantile
from calib.radius.result import Fit
from calib.reporting.blocks import Block, Column, Equation, Picture, Section, Table, Text, drawn
from calib.reporting.formatting import (
    MISSING,
    aligned,
    fixed,
    measured,
    number_columns,
    places,
    span,
    text_column,
    text_columns,
    two_digits,
)

if TYPE_CHECKING:
    from calib.reporting.source import Source

MM: Final = 1e3
UM: Final = 1e6


def coverage_factor(dof: float) -> float:
    """Return k, Student's t for 95 % coverage at `dof` degrees of freedom."""
    return float(t_quantile(dof))


def law_table(fit: Fit) -> Table:
    """Return both wheels' laws with expanded uncertainties."""
    reference = [wheel.law.reference_load_N for wheel in fit.wheels.values()]
    zero = f"F₀ = {reference[0]:.4g} N"
    if reference[0] != reference[1]:
        zero += f" (left), {reference[1]:.4g} N (right)"
    return _table(
        f"Radius law of each wheel, r(F) = r(F₀) + s (F − F₀) with {zero}; U = k u is the half width of the 95 % "
        "interval, k from Student's t.",
        fit.wheels,
    )


def static_table(fit: Fit) -> Table:
    """Return the same regression on the standing wheels."""
    return _table("Static radius against load, the same regression on the standing wheel; U as above.", fit.static)


def _table(caption: str, wheels: Mapping[str, WheelFit]) -> Table:
    columns = (
        text_column("Wheel"),
        Column("Runs"),
        Column("Loads", "N", align="center"),
        *number_columns("r(F₀)", "U", unit="mm", group="Radius at F₀"),
        Column("k", group="Radius at F₀"),
        *number_columns("s", "U", unit="µm/N", group="Slope"),
        Column("k", group="Slope"),
    )
    return Table(caption, columns, tuple((name, *_row(wheel)) for name, wheel in wheels.items()))


def _row(fit: WheelFit) -> tuple[str, ...]:
    law = fit.law
    k_radius = coverage_factor(fit.dof_radius_ref)
    radius = measured(MM * law.radius_ref_m, MM * k_radius * float(np.sqrt(law.covariance[0, 0])))
    if fit.model == "line":
        k_slope = coverage_factor(fit.dof_slope)
        slope = measured(UM * law.slope_m_per_N, UM * k_slope * float(np.sqrt(law.covariance[1, 1])))
        slope_cells = (*slope, fixed(k_slope, 2))
    else:
        slope_cells = (MISSING, MISSING, MISSING)
    loads = span(law.load_min_N, law.load_max_N, "", ".0f").replace(" to ", "–")
    return (str(law.n_runs), loads, *radius, fixed(k_radius, 2), *slope_cells)


def single_run_text(fit: Fit) -> Text:
    """Return the prediction interval of one further run in the middle of the load range."""
    parts = []
    for name, wheel in fit.wheels.items():
        middle = 0.5 * (wheel.law.load_min_N + wheel.law.load_max_N)
        low, high = wheel.prediction_band_m(middle)
        parts.append(f"±{two_digits(0.5 * UM * float(high - low))} µm ({name})")
    return Text(
        "The radius that one further run shows lies, with 95 % probability, within "
        + " and ".join(parts)
        + " of the law in the middle of the load range."
    )


def quality_text(wheel: WheelFit) -> str:
    """Return the scatter about the law, and how much of the spread of the radii it explains."""
    text = f"{wheel.wheel.capitalize()} wheel: residual standard deviation {two_digits(UM * wheel.residual_std_m)} µm"
    if wheel.model == "line":
        # more digits only where the line explains nearly everything
        text += f", R² = {wheel.r_squared:.5f}" if wheel.r_squared > 0.99 else f", R² = {wheel.r_squared:.3f}"
    if wheel.session_std_m > 0:
        text += (
            f", scatter of runs {two_digits(UM * wheel.run_std_m)} µm and of sessions "
            f"{two_digits(UM * wheel.session_std_m)} µm"
        )
    return text + "."


def naive_text(fit: Fit) -> Text | None:
    """Return the slopes' intervals as if runs were independent, to compare; None where there is no slope."""
    parts = []
    for name, wheel in fit.wheels.items():
        if wheel.naive is not None and wheel.model == "line":
            low, high = (UM * end for end in wheel.naive.slope_ci95_m_per_N)
            _, half = measured(0.5 * (low + high), 0.5 * (high - low))
            parts.append(f"±{half} µm/N ({name})")
    if not parts:
        return None
    return Text(
        f"If every run were independent of the others, U of the slopes would be {' and '.join(parts)}; the table "
        "accounts for the correlation of runs within a session.",
        small=True,
    )


def regression_section(source: Source) -> Section:
    """Return figure and table of both wheels' laws with the band of the mean and the prediction band."""
    fit = source.fit
    blocks: list[Block] = [
        Text(
            "The band of the mean holds the law itself: it answers how well the mean radius at a load is known. The "
            "prediction band holds the radius of one further run, driven in a session of its own: it answers how far "
            "off the next journey can be. Both have a coverage of 95 % at each load."
        ),
        regressions_picture(fit),
        Table(
            "The law at loads of the valid range, with the half widths of both bands.",
            (
                Column("Load", "N"),
                *(
                    Column(title, unit, group=f"{wheel} wheel")
                    for wheel in ("Left", "Right")
                    for title, unit in (("radius", "mm"), ("mean", "± µm"), ("single run", "± µm"))
                ),
            ),
            aligned(_band_rows(fit.left, fit.right), 2, 3, 5, 6),
        ),
        Text(" ".join(quality_text(wheel) for wheel in fit.wheels.values())),
    ]
    return Section("Regression on load", tuple(blocks))


def _band_rows(left: WheelFit, right: WheelFit) -> tuple[tuple[str, ...], ...]:
    low = max(left.law.load_min_N, right.law.load_min_N)
    high = min(left.law.load_max_N, right.law.load_max_N)
    if not high > low:
        low, high = min(left.law.load_min_N, right.law.load_min_N), max(left.law.load_max_N, right.law.load_max_N)
    loads = _round_loads(low, high)
    cells = []
    for wheel in (left, right):
        mean = 0.5e3 * np.subtract(*reversed(wheel.mean_band_m(loads)))
        single = 0.5e3 * np.subtract(*reversed(wheel.prediction_band_m(loads)))
        radius = 1e3 * wheel.law.radius_m(loads)
        # one number of decimals for all radii: that of the narrowest band
        decimals = places(float(mean.min()))
        widths = ([two_digits(1e3 * float(value)) for value in column] for column in (mean, single))
        cells.append([[fixed(float(value), decimals) for value in radius], *widths])
    return tuple(
        (fixed(float(load), 0), *(column[k] for wheel_cells in cells for column in wheel_cells))
        for k, load in enumerate(loads)
    )


def _round_loads(low: float, high: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return round loads inside the range; its ends where nothing round lies in it."""
    for step in (100.0, 200.0, 500.0, 1000.0, 50.0, 20.0, 10.0, 5.0, 1.0):
        first, last = np.ceil(low / step), np.floor(high / step)
        if 3 <= last - first + 1 <= 9:
            return np.asarray(step * np.arange(first, last + 1), dtype=np.float64)
    return np.unique(np.array([low, 0.5 * (low + high), high]))


def coefficients_section(source: Source) -> Section:
    """Return every coefficient with its uncertainty, and how to get the radius at a load from them."""
    fit = source.fit
    rows = [row for wheel in fit.wheels.values() for row in _coefficient_rows(wheel)]
    blocks: list[Block] = [
        Table(
            "Coefficients: value, standard uncertainty u, degrees of freedom ν, coverage factor k (Student's t), "
            "expanded uncertainty U = k u for a coverage of 95 %.",
            (*text_columns("Wheel", "Quantity", "Unit"), *number_columns("Value", "u", "ν", "k", "U")),
            aligned(rows, 3, 4, 7),
        ),
        *_propagation(source),
        Text(" ".join(_correlation(wheel) for wheel in fit.wheels.values())),
    ]
    if source.coefficients.outside == "refuse":
        outside = "the vehicle refuses loads outside the valid range"
    else:
        outside = "the vehicle clamps loads outside the valid range to its ends"
    blocks.append(
        Text(
            f"The attached coefficients.json ({source.coefficients.checksum[:19]}…) carries law, covariance and valid "
            f"range for the vehicle; by it {outside}."
        )
    )
    return Section("Coefficients", tuple(blocks))


def _propagation(source: Source) -> tuple[Block, ...]:
    if all(wheel.model != "line" for wheel in source.fit.wheels.values()):
        return ()
    text = "The standard uncertainty of the radius at a load F follows from both and their covariance,"
    return Text(text), Equation("law_uncertainty")


def _coefficient_rows(wheel: WheelFit) -> list[tuple[str, ...]]:
    law = wheel.law
    lines = [
        _coefficient_row(
            wheel.wheel,
            f"radius at {law.reference_load_N:.4g} N",
            "mm",
            MM * law.radius_ref_m,
            MM * float(np.sqrt(law.covariance[0, 0])),
            wheel.dof_radius_ref,
        )
    ]
    if wheel.model == "line":
        lines.append(
            _coefficient_row(
                "",
                "slope",
                "µm/N",
                UM * law.slope_m_per_N,
                UM * float(np.sqrt(law.covariance[1, 1])),
                wheel.dof_slope,
            )
        )
    return lines


def _coefficient_row(wheel: str, name: str, unit: str, value: float, std: float, dof: float) -> tuple[str, ...]:
    k = coverage_factor(dof)
    # two digits of u fix the last place of the value, too
    text, u = measured(value, std)
    return wheel, name, unit, text, u, fixed(dof, 1), fixed(k, 2), two_digits(k * std)


def _correlation(wheel: WheelFit) -> str:
    law, covariance = wheel.law, wheel.law.covariance
    valid = span(law.load_min_N, law.load_max_N, "N", ".1f")
    if wheel.model != "line":
        return f"{wheel.wheel.capitalize()} wheel: constant, measured at {valid}."
    norm = float(np.sqrt(covariance[0, 0] * covariance[1, 1]))
    correlation = fixed(float(covariance[0, 1]) / norm if norm > 0 else 0.0, 2)
    return f"{wheel.wheel.capitalize()} wheel: correlation of radius and slope {correlation}, valid from {valid}."


def regressions_picture(fit: Fit) -> Picture:
    """Return both wheels' laws with the band of the mean and the prediction band."""
    return Picture(
        "regressions",
        "Effective radius against wheel load with the law and both bands; below, the same as deviation from the law.",
        "Regression of the radius on the load: " + "; ".join(_law_in_words(wheel) for wheel in fit.wheels.values()),
        partial(drawn, "radius.regressions", fit.left, fit.right, fit.radii.session),
    )


def _law_in_words(wheel: WheelFit) -> str:
    law = wheel.law
    if wheel.model != "line":
        return f"{wheel.wheel} wheel: constant radius {1e3 * law.radius_ref_m:.4f} mm"
    change = "grows" if law.slope_m_per_N > 0 else "shrinks"
    return f"{wheel.wheel} wheel: the radius {change} by {abs(1e6 * law.slope_m_per_N):.3g} µm for each newton"
