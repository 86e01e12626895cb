"""A law as table and sentences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from calib.radius.fitted import Fit
from calib.radius.regression import WheelFit, t_quantile
from calib.report.blocks import Column, Table, Text
from calib.report.numbers import MISSING, fixed, left, measured, number_columns, span, two_digits

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
        left("Wheel"),
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
    """Say how far one further run may lie off: the law's own interval does not answer that."""
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
        "allows for what the runs of a session have in common.",
        small=True,
    )
