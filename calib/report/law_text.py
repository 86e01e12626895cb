"""A law as rows and words: the same columns wherever a report shows one."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.radius.regression import WheelFit, t_quantile
from calib.report.blocks import Column
from calib.report.numbers import MISSING, fixed, measured, span

__all__ = ["MM", "UM", "coverage_factor", "law_columns", "law_row"]

MM: Final = 1e3
UM: Final = 1e6


def coverage_factor(dof: float) -> float:
    """Return k, Student's t for 95 % coverage at `dof` degrees of freedom."""
    return float(t_quantile(dof))


def law_columns() -> tuple[Column, ...]:
    """Return the columns of `law_row`."""
    return (
        Column("Runs"),
        Column("Loads", "N", align="center"),
        Column("r(F₀)", "mm", group="Radius at F₀"),
        Column("U", "mm", group="Radius at F₀"),
        Column("k", group="Radius at F₀"),
        Column("s", "µm/N", group="Slope"),
        Column("U", "µm/N", group="Slope"),
        Column("k", group="Slope"),
    )


def law_row(fit: WheelFit) -> tuple[str, ...]:
    """Return number of runs, load range, radius and slope with expanded uncertainty and k."""
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
