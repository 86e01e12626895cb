"""The coefficients with standard uncertainty, k and coverage."""

from __future__ import annotations

import numpy as np

from calib.radius.regression import WheelFit
from calib.report.blocks import Block, Equation, Section, Table, Text
from calib.report.numbers import aligned, fixed, measured, number_columns, span, text_columns, two_digits
from calib.report.source import Source
from calib.report.statements.law import MM, UM, coverage_factor


def section(source: Source) -> Section:
    """Return every coefficient with its uncertainty, and how to get the radius at a load from them."""
    fit = source.fit
    rows = [row for wheel in fit.wheels.values() for row in _rows(wheel)]
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


def _rows(wheel: WheelFit) -> list[tuple[str, ...]]:
    law = wheel.law
    lines = [
        _row(
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
            _row(
                "",
                "slope",
                "µm/N",
                UM * law.slope_m_per_N,
                UM * float(np.sqrt(law.covariance[1, 1])),
                wheel.dof_slope,
            )
        )
    return lines


def _row(wheel: str, name: str, unit: str, value: float, std: float, dof: float) -> tuple[str, ...]:
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
