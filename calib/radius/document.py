"""A wheel's fit and the runs behind it as plain values and back: the keys of ``calib fit --json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, Final, cast

import numpy as np

from calib.arrays import FloatArray
from calib.radius.checks import Check
from calib.radius.effective import Component, EffectiveRadii
from calib.radius.estimate import Estimate
from calib.radius.law import WheelLaw
from calib.radius.regression import NaiveLine, WheelFit
from calib.radius.usable import LeftOut

_TEXTS: Final = ("run_id", "session", "direction", "path_source")
_RUN_COLUMNS: Final = tuple(
    column.name for column in fields(EffectiveRadii) if column.name not in {"budget", "left_out", "notes"}
)
_NUMBERS: Final = ("intercept_m", "r_squared", "residual_std_m", "run_std_m", "session_std_m", "dof_radius_ref")
_ARRAYS: Final = ("load_N", "radius_m", "residual_m", "leverage", "cook")
_ESTIMATE: Final = ("dof_within", "dof_between", "run_variance", "session_variance")


def _numbers(values: FloatArray) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


def _array(values: Any) -> FloatArray:
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def _covariance(rows: Any) -> FloatArray:
    """Return the covariance of a radius and its slope, shape (2, 2)."""
    matrix = np.array(rows, dtype=np.float64)
    if matrix.shape != (2, 2) or not (np.isfinite(matrix).all() and (np.diag(matrix) >= 0.0).all()):
        raise ValueError(f"{str(rows)[:60]} where the covariance of radius and slope, 2 by 2, is expected")
    return matrix


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
            **_systematic(estimate),
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
        **{name: _numbers(getattr(fit, name)) for name in _ARRAYS},
        "checks": [check.to_dict() for check in fit.checks],
    }


def _check(value: Mapping[str, Any]) -> Check:
    """Return the check that `Check.to_dict` wrote; whether it passed follows from its level."""
    return cast("Check", plain_fields(Check, {key: part for key, part in value.items() if key != "passed"}))


def _systematic(estimate: Estimate) -> dict[str, Any]:
    """Return the parts that are the same in every run; nothing where none is declared."""
    if not len(estimate.systematic):
        return {}
    dof = [float(value) if np.isfinite(value) else None for value in estimate.systematic_dof]
    return {"systematic": estimate.systematic.tolist(), "systematic_dof": dof}


def wheel_from_dict(wheel: str, value: Mapping[str, Any]) -> WheelFit:
    """Return the wheel's fit that `wheel_to_dict` wrote."""
    strata, naive, line = value["strata"], value["naive"], value["model"] == "line"
    slope = float(value["slope_m_per_N"]) if line else 0.0
    estimate = Estimate(
        design=str(strata["design"]),
        coefficients=np.array([float(value["radius_ref_m"]), slope]),
        cov_within=_covariance(strata["covariance_within"]),
        cov_between=_covariance(strata["covariance_between"]),
        session_f=strata["session_f"],
        robust=bool(strata["hc3"]),
        systematic=np.array(strata.get("systematic", []), dtype=np.float64).reshape(-1, 2),
        systematic_dof=np.array([np.inf if dof is None else dof for dof in strata.get("systematic_dof", [])]),
        **{name: float(strata[name]) for name in _ESTIMATE},
    )
    law = WheelLaw(
        reference_load_N=float(value["reference_load_N"]),
        radius_ref_m=float(value["radius_ref_m"]),
        slope_m_per_N=slope,
        covariance=_covariance(value["covariance"]),
        dof=float(value["dof"]),
        residual_std_m=float(value["single_run_std_m"]),
        load_min_N=float(value["load_range_N"][0]),
        load_max_N=float(value["load_range_N"][1]),
        n_runs=int(value["n_runs"]),
    )
    plain: dict[str, Any] = {name: float(value[name]) for name in _NUMBERS}
    plain |= {name: _array(value[name]) for name in _ARRAYS}
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
            covariance=_covariance(naive["covariance"]),
            dof=float(naive["dof"]),
            radius_ref_ci95_m=pair(naive["radius_ref_ci95_m"]),
            slope_ci95_m_per_N=pair(naive["slope_ci95_m_per_N"]),
        ),
        dof_slope=float(value["dof_slope"]) if line else 0.0,
        radius_ref_ci95_m=pair(value["radius_ref_ci95_m"]),
        slope_ci95_m_per_N=pair(value["slope_ci95_m_per_N"]) if line else None,
        **plain,
        checks=tuple(_check(check) for check in value["checks"]),
    )


def rows_of(radii: EffectiveRadii, wheels: Mapping[str, WheelFit]) -> list[dict[str, Any]]:
    """Return the runs used, one mapping each: every array of `radii`, and the residual of each wheel."""
    arrays = {name: getattr(radii, name) for name in _RUN_COLUMNS}
    columns: dict[str, list[Any]] = {
        name: [str(value) for value in column] if name in _TEXTS else _numbers(column)
        for name, column in arrays.items()
    }
    columns |= {f"residual_{name}_m": _numbers(wheel.residual_m) for name, wheel in wheels.items()}
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def radii_from_rows(
    rows: Sequence[Mapping[str, Any]],
    *,
    budget: tuple[Component, ...],
    left_out: tuple[LeftOut, ...],
    notes: tuple[str, ...],
) -> EffectiveRadii:
    """Return the effective radii that `rows_of` wrote."""
    columns: dict[str, Any] = {}
    for name in _RUN_COLUMNS:
        cells = [row[name] for row in rows]
        columns[name] = np.array(cells, dtype=np.str_) if name in _TEXTS else _array(cells)
    return EffectiveRadii(**columns, budget=budget, left_out=left_out, notes=notes)


def pair(value: Any) -> tuple[float, float]:
    """Return two plain values as floats."""
    low, high = value
    return float(low), float(high)


def plain_fields(kind: type, value: Mapping[str, Any]) -> Any:
    """Return a dataclass of plain fields from a JSON object, numbers where its annotations say so.

    Raises TypeError where a key is missing or unknown, or a value is of the wrong kind.
    """
    wanted = {column.name: str(column.type) for column in fields(kind)}
    for name, entry in value.items():
        annotation = wanted.get(name, "")
        if entry is None and "None" in annotation:
            continue
        number = isinstance(entry, int | float) and not isinstance(entry, bool)
        if (annotation.startswith(("float", "int")) and not number) or (
            annotation.startswith("str") and not isinstance(entry, str)
        ):
            raise TypeError(f"{name}: {entry!r:.40} where {annotation} is expected")
    return kind(**value)
