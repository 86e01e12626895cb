"""A fit as plain values and back: the keys of ``calib fit --json`` and of ``fit.json`` in a result folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.settings import Encoder, OdometryModel, Rangefinder, Reference
from calib.errors import BadInputError
from calib.radius.checks import Check
from calib.radius.effective import Component, EffectiveRadii
from calib.radius.law import WheelLaw
from calib.radius.regression import NaiveLine, WheelFit
from calib.radius.sessions import Estimate
from calib.radius.usable import LeftOut
from calib.vehicle import Vehicle

if TYPE_CHECKING:
    from calib.radius.fit import Fit, Setup

__all__ = ["fit_from_dict", "fit_to_dict", "wheel_from_dict", "wheel_to_dict"]

_TEXTS = ("run_id", "session", "direction", "path_source")
_SECTIONS: dict[str, type] = {
    "vehicle": Vehicle,
    "encoder": Encoder,
    "model": OdometryModel,
    "rangefinder": Rangefinder,
    "reference": Reference,
}
_ESTIMATE = ("dof_within", "dof_between", "run_variance", "session_variance")


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _numbers(values: FloatArray) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


def _array(values: Any) -> FloatArray:
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def wheel_to_dict(fit: WheelFit) -> dict[str, Any]:
    """Return one wheel's fit as plain values; the contract's keys first."""
    law, line = fit.law, fit.model == "line"
    estimate = fit.estimate
    naive = fit.naive
    return {
        "n_runs": law.n_runs,
        "reference_load_N": law.reference_load_N,
        "radius_ref_m": law.radius_ref_m,
        "intercept_m": fit.intercept_m,
        "slope_m_per_N": law.slope_m_per_N if line else None,
        "radius_ref_ci95_m": list(fit.radius_ref_ci95_m),
        "slope_ci95_m_per_N": list(fit.slope_ci95_m_per_N) if fit.slope_ci95_m_per_N else None,
        "r_squared": fit.r_squared,
        "residual_std_m": fit.residual_std_m,
        "dof": law.dof,
        "covariance": law.covariance.tolist(),
        "dof_radius_ref": fit.dof_radius_ref,
        "dof_slope": fit.dof_slope if line else None,
        "model": fit.model,
        "design": fit.design,
        "load_range_N": [law.load_min_N, law.load_max_N],
        "single_run_std_m": law.residual_std_m,
        "run_std_m": fit.run_std_m,
        "session_std_m": fit.session_std_m,
        "strata": {
            **{name: float(getattr(estimate, name)) for name in _ESTIMATE},
            "covariance_within": estimate.cov_within.tolist(),
            "covariance_between": estimate.cov_between.tolist(),
            "session_f": estimate.session_f,
            "hc3": estimate.robust,
            "design": estimate.design,
        },
        "naive": None
        if naive is None
        else {
            "radius_ref_m": naive.radius_ref_m,
            "slope_m_per_N": naive.slope_m_per_N,
            "radius_ref_ci95_m": list(naive.radius_ref_ci95_m),
            "slope_ci95_m_per_N": list(naive.slope_ci95_m_per_N),
            "dof": naive.dof,
            "covariance": naive.covariance.tolist(),
        },
        "load_N": _numbers(fit.load_N),
        "radius_m": _numbers(fit.radius_m),
        "residual_m": _numbers(fit.residual_m),
        "leverage": _numbers(fit.leverage),
        "cook": _numbers(fit.cook),
        "checks": [check.to_dict() for check in fit.checks],
    }


def wheel_from_dict(wheel: str, value: Mapping[str, Any]) -> WheelFit:
    """Return the wheel's fit that `wheel_to_dict` wrote."""
    strata, naive, line = value["strata"], value["naive"], value["model"] == "line"
    slope = float(value["slope_m_per_N"]) if line else 0.0
    estimate = Estimate(
        design=str(strata["design"]),
        coefficients=np.array([float(value["radius_ref_m"]), slope]),
        cov_within=np.array(strata["covariance_within"], dtype=np.float64),
        cov_between=np.array(strata["covariance_between"], dtype=np.float64),
        session_f=strata["session_f"],
        robust=bool(strata["hc3"]),
        **{name: float(strata[name]) for name in _ESTIMATE},
    )
    law = WheelLaw(
        reference_load_N=float(value["reference_load_N"]),
        radius_ref_m=float(value["radius_ref_m"]),
        slope_m_per_N=slope,
        covariance=np.array(value["covariance"], dtype=np.float64),
        dof=float(value["dof"]),
        residual_std_m=float(value["single_run_std_m"]),
        load_min_N=float(value["load_range_N"][0]),
        load_max_N=float(value["load_range_N"][1]),
        n_runs=int(value["n_runs"]),
    )
    return WheelFit(
        wheel=wheel,
        law=law,
        model=str(value["model"]),
        design=str(value["design"]),
        estimate=estimate,
        naive=None
        if naive is None
        else NaiveLine(
            radius_ref_m=float(naive["radius_ref_m"]),
            slope_m_per_N=float(naive["slope_m_per_N"]),
            covariance=np.array(naive["covariance"], dtype=np.float64),
            dof=float(naive["dof"]),
            radius_ref_ci95_m=_pair(naive["radius_ref_ci95_m"]),
            slope_ci95_m_per_N=_pair(naive["slope_ci95_m_per_N"]),
        ),
        intercept_m=float(value["intercept_m"]),
        r_squared=float(value["r_squared"]),
        residual_std_m=float(value["residual_std_m"]),
        run_std_m=float(value["run_std_m"]),
        session_std_m=float(value["session_std_m"]),
        dof_radius_ref=float(value["dof_radius_ref"]),
        dof_slope=float(value["dof_slope"]) if line else 0.0,
        radius_ref_ci95_m=_pair(value["radius_ref_ci95_m"]),
        slope_ci95_m_per_N=_pair(value["slope_ci95_m_per_N"]) if line else None,
        load_N=_array(value["load_N"]),
        radius_m=_array(value["radius_m"]),
        residual_m=_array(value["residual_m"]),
        leverage=_array(value["leverage"]),
        cook=_array(value["cook"]),
        checks=tuple(Check.from_dict(check) for check in value["checks"]),
    )


def fit_to_dict(fit: Fit) -> dict[str, Any]:
    """Return a fit as plain values: what ``calib fit --json`` prints."""
    radii = fit.radii
    columns = {
        one.name: getattr(radii, one.name) for one in fields(radii) if isinstance(getattr(radii, one.name), np.ndarray)
    }
    plain = {
        name: [str(value) for value in column] if name in _TEXTS else _numbers(column)
        for name, column in columns.items()
    }
    residuals = {"residual_left_m": _numbers(fit.left.residual_m), "residual_right_m": _numbers(fit.right.residual_m)}
    rows = [
        dict(zip((*plain, *residuals), row, strict=True))
        for row in zip(*plain.values(), *residuals.values(), strict=True)
    ]
    from calib.radius.fit import FORMAT

    return {
        "format": FORMAT,
        "campaign": fit.name,
        "simulated": fit.simulated,
        "wheels": {name: wheel_to_dict(wheel) for name, wheel in fit.wheels.items()},
        "runs": rows,
        "static": {name: wheel_to_dict(wheel) for name, wheel in fit.static.items()},
        "budget": [asdict(component) for component in radii.budget],
        "left_out": [asdict(run) for run in radii.left_out],
        "notes": list(fit.notes),
        "setup": None if fit.setup is None else _setup_to_dict(fit.setup),
        "provenance": dict(fit.provenance),
        "passed": fit.passed,
    }


def _setup_to_dict(setup: Setup) -> dict[str, Any]:
    sections = {name: asdict(getattr(setup, name)) for name in _SECTIONS}
    return {**sections, "conditions": {name: list(span) for name, span in setup.conditions.items()}}


def _setup_from_dict(value: Mapping[str, Any]) -> Setup:
    from calib.radius.fit import Setup

    sections: dict[str, Any] = {name: kind(**value[name]) for name, kind in _SECTIONS.items()}
    return Setup(**sections, conditions={name: _pair(span) for name, span in value["conditions"].items()})


def fit_from_dict(value: Mapping[str, Any]) -> Fit:
    """Return the fit that `fit_to_dict` wrote.

    Raises
    ------
    BadInputError
        Where a key is missing or of the wrong kind.
    """
    from calib.radius.fit import FORMAT, Fit

    if value.get("format") != FORMAT:
        raise BadInputError(f"found format {value.get('format')!r}; expected {FORMAT!r}; make it anew with 'calib fit'")
    try:
        rows = value["runs"]
        columns: dict[str, Any] = {}
        for one in fields(EffectiveRadii):
            if one.name in {"budget", "left_out", "notes"}:
                continue
            cells = [row[one.name] for row in rows]
            columns[one.name] = np.array(cells, dtype=np.str_) if one.name in _TEXTS else _array(cells)
        return Fit(
            name=str(value["campaign"]),
            simulated=bool(value["simulated"]),
            left=wheel_from_dict("left", value["wheels"]["left"]),
            right=wheel_from_dict("right", value["wheels"]["right"]),
            radii=EffectiveRadii(
                **columns,
                budget=tuple(Component(**component) for component in value["budget"]),
                left_out=tuple(LeftOut(**run) for run in value["left_out"]),
                notes=tuple(value["notes"]),
            ),
            static={name: wheel_from_dict(name, wheel) for name, wheel in value["static"].items()},
            notes=tuple(value["notes"]),
            provenance=dict(value["provenance"]),
            setup=None if value.get("setup") is None else _setup_from_dict(value["setup"]),
        )
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise BadInputError(
            f"the fit is damaged ({type(error).__name__}: {error}); expected what 'calib fit' wrote; make it anew"
        ) from error


def _pair(value: Any) -> tuple[float, float]:
    low, high = value
    return float(low), float(high)
