"""The pictures of a fit: the runs, the laws with their bands, path deviation, residuals, and the budget."""

from __future__ import annotations

from functools import partial
from typing import Final

import numpy as np

from calib.radius.fitted import Fit
from calib.radius.regression import WheelFit
from calib.report.blocks import Picture
from calib.report.figures import radius as figures
from calib.report.statements.budget import budget_picture

#: names of all of them, in the order of the report's pages
FIT_PICTURES: Final = ("runs-by-series", "regressions", "path-deviation", "residuals", "budget")


def fit_pictures(fit: Fit) -> tuple[Picture, ...]:
    """Return the pictures that a report on a fit shows."""
    draw = (runs_picture, regressions_picture, deviation_picture, residuals_picture)
    return (*(picture(fit) for picture in draw), *((budget_picture(fit),) if fit.radii.budget else ()))


def runs_picture(fit: Fit) -> Picture:
    """Return the radius of every run in the order driven."""
    parts = []
    for name, wheel in fit.wheels.items():
        low, high = 1e3 * float(wheel.radius_m.min()), 1e3 * float(wheel.radius_m.max())
        parts.append(f"{name} wheel {low:.3f} to {high:.3f} mm")
    return Picture(
        "runs-by-series",
        "Effective radius of each run in the order driven; colours are sessions. Bars, where larger than the mark, are "
        "two standard uncertainties of the instruments.",
        f"Radius by run for both wheels, {len(fit.radii)} runs: " + "; ".join(parts),
        partial(figures.runs_by_series, fit.radii),
    )


def regressions_picture(fit: Fit) -> Picture:
    """Return both wheels' laws with the band of the mean and the prediction band."""
    return Picture(
        "regressions",
        "Effective radius against wheel load with the law and both bands; below, the same as deviation from the law.",
        "Regression of the radius on the load: " + "; ".join(_law_in_words(wheel) for wheel in fit.wheels.values()),
        partial(figures.regressions, fit.left, fit.right, fit.radii.session),
    )


def deviation_picture(fit: Fit) -> Picture:
    """Return what weaving and turning added to the paths."""
    radii = fit.radii
    known = np.isfinite(radii.amplitude_m) & np.isfinite(radii.wavelength_m)
    worst = 1e6 * float(max(np.abs(radii.path_left).max(), np.abs(radii.path_right).max()))
    return Picture(
        "path-deviation",
        "Left: excess of a weaving path over the straight distance, by amplitude and wavelength over whole periods, "
        "and the runs of this campaign. Right: correction of each run's radius for weave and turn.",
        f"Excess of the path by amplitude for five wavelengths with {int(known.sum())} runs; corrections of all runs "
        f"up to {worst:.0f} ppm",
        partial(figures.path_deviation, radii),
    )


def residuals_picture(fit: Fit) -> Picture:
    """Return the residuals of both wheels."""
    return Picture(
        "residuals",
        "Residuals of both wheels against load, in the order driven, and against a normal distribution; colours are "
        "sessions as above.",
        "Residuals of both wheels: "
        + "; ".join(
            f"{name} wheel within {1e6 * float(abs(wheel.residual_m).max()):.0f} µm"
            for name, wheel in fit.wheels.items()
        ),
        partial(figures.residuals, fit.left, fit.right, fit.radii.session),
    )


def _law_in_words(wheel: WheelFit) -> str:
    law = wheel.law
    if wheel.model != "line":
        return f"{wheel.wheel} wheel: constant radius {1e3 * law.radius_ref_m:.4f} mm"
    way = "grows" if law.slope_m_per_N > 0 else "shrinks"
    return f"{wheel.wheel} wheel: the radius {way} by {abs(1e6 * law.slope_m_per_N):.3g} µm for each newton"
