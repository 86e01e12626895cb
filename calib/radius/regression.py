"""Regression of one wheel's radius on its load: coefficients, intervals, bands (Figs 10 and 11)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray, IntArray
from calib.errors import RefusedError
from calib.radius.checks import Check
from calib.radius.estimate import Estimate
from calib.radius.law import WheelLaw
from calib.radius.sessions import (
    Groups,
    groups_of,
    plain_line,
    stratified_constant,
    stratified_line,
)

#: loads nearer than this share of the largest count as one load
SAME_LOAD: Final = 0.02
COVERAGE: Final = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class NaiveLine:
    """The line and its intervals where every run counts as independent; beside the honest one, never instead of it."""

    #: ordinary least-squares coefficients
    radius_ref_m: float
    slope_m_per_N: float
    #: their covariance, shape (2, 2)
    covariance: FloatArray
    #: number of runs minus the number of coefficients
    dof: float
    #: 95 % intervals
    radius_ref_ci95_m: tuple[float, float]
    slope_ci95_m_per_N: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class WheelFit:
    """Everything known of one wheel's law."""

    #: ``left`` or ``right``
    wheel: str
    #: the law that is handed on; its covariance is the session-aware one, its ``dof`` the smaller of those of radius
    #: and slope, its ``residual_std_m`` the standard deviation of a single run in a session of its own
    law: WheelLaw
    #: ``line``, or ``constant`` where the loads do not carry a slope
    model: str
    #: ``crossed``, ``mixed``, ``confounded``, ``single`` or ``constant``; see `calib.radius.estimate.Estimate`
    design: str
    #: coefficients and covariance by stratum, for bands at any load
    estimate: Estimate
    #: the same with every run counted as independent; None for a constant
    naive: NaiveLine | None
    #: radius at zero load, where the line is prolonged to it
    intercept_m: float
    #: share of the variance of the radii that the line explains
    r_squared: float
    #: root mean square residual over the runs' degrees of freedom (as in ordinary least squares)
    residual_std_m: float
    #: standard deviations of runs within a session and of sessions
    run_std_m: float
    session_std_m: float
    #: degrees of freedom behind each interval
    dof_radius_ref: float
    dof_slope: float
    #: 95 % interval of the radius at the reference load
    radius_ref_ci95_m: tuple[float, float]
    #: 95 % interval of the slope; None for a constant
    slope_ci95_m_per_N: tuple[float, float] | None
    #: what was fitted, and radius minus law, shape (n_runs,)
    load_N: FloatArray
    radius_m: FloatArray
    residual_m: FloatArray
    #: leverage and Cook's distance of each run in the ordinary least-squares line, shape (n_runs,)
    leverage: FloatArray
    cook: FloatArray
    #: what an expert would check
    checks: tuple[Check, ...] = ()

    def mean_band_m(self, load_N: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the 95 % band of the regression mean (Fig. 11).

        `load_N`: wheel loads. Returns `low`, `high`: in m.
        """
        centre, half = self._band(load_N, single=False)
        return centre - half, centre + half

    def prediction_band_m(self, load_N: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the band that holds the radius of one further run in a session of its own; see `mean_band_m`."""
        centre, half = self._band(load_N, single=True)
        return centre - half, centre + half

    def _band(self, load_N: npt.ArrayLike, *, single: bool) -> tuple[FloatArray, FloatArray]:
        load = np.asarray(load_N, dtype=np.float64)
        contrast = np.stack((np.ones_like(load), load - self.law.reference_load_N), axis=-1)
        half = self.estimate.half_width(
            contrast,
            COVERAGE,
            more_within=self.run_std_m**2 if single else 0.0,
            more_between=self.session_std_m**2 if single else 0.0,
        )
        return self.law.radius_m(load), np.asarray(half)


def t_quantile(dof: npt.ArrayLike) -> FloatArray:
    """Return Student's t such that ``+-t`` covers 95 % with `dof` degrees of freedom."""
    from scipy.special import stdtrit

    return np.asarray(stdtrit(np.asarray(dof, dtype=np.float64), 0.5 + COVERAGE / 2))


def t_interval(value: float, std: float, dof: float) -> tuple[float, float]:
    """Return the 95 % interval ``value +- t std``."""
    half = float(t_quantile(dof)) * float(std)
    return float(value) - half, float(value) + half


def distinct_loads(load_N: FloatArray) -> int:
    """Return how many distinct loads there are; see `load_groups`."""
    return int(load_groups(load_N).max()) + 1


def load_groups(load_N: FloatArray) -> IntArray:
    """Return the load group of each run, shape (n_runs,); loads within 2 % of the largest count as one."""
    order = np.argsort(load_N, kind="stable")
    width = SAME_LOAD * float(np.max(np.abs(load_N)))
    group, number, start = np.zeros(len(load_N), dtype=np.int64), 0, float(load_N[order[0]])
    for index in order:
        if load_N[index] - start > width:
            number, start = number + 1, float(load_N[index])
        group[index] = number
    return group


def fit_wheel(
    wheel: str, load_N: npt.ArrayLike, radius_m: npt.ArrayLike, session: npt.ArrayLike, *, reference_load_N: float
) -> WheelFit:
    """Fit the law of one wheel.

    Parameters
    ----------
    wheel : str
        Name for messages and results.
    load_N, radius_m : array_like of float, shape (n_runs,)
        Load and effective radius of each run.
    session : array_like of str, shape (n_runs,)
        Session of each run.
    reference_load_N : float
        Load on which the coefficients are centred.

    Returns
    -------
    WheelFit
        A line, or a constant where the runs have one load only. Its checks are empty; see
        `calib.radius.residual_checks`.

    Raises
    ------
    RefusedError
        With fewer than three runs.
    """
    load, radius = np.asarray(load_N, dtype=np.float64), np.asarray(radius_m, dtype=np.float64)
    if len(load) < 3:
        raise RefusedError(
            f"{wheel} wheel: found {len(load)} usable runs; expected three or more; drive more corridor runs, "
            "or see 'calib check' for why runs were left out"
        )
    groups = groups_of(session)
    if distinct_loads(load) == 1:
        return _constant(wheel, load, radius, groups)
    x = load - reference_load_N
    plain, line = plain_line(x, radius)
    estimate = stratified_line(x, radius, groups) if 2 <= len(groups) < len(load) else None
    estimate = estimate or plain
    design = "confounded" if estimate is plain and 2 <= len(groups) < len(load) else estimate.design
    influence = _influence(x, radius, line.residual, line.variance)
    naive = NaiveLine(
        radius_ref_m=float(line.coefficients[0]),
        slope_m_per_N=float(line.coefficients[1]),
        covariance=line.covariance,
        dof=line.dof,
        radius_ref_ci95_m=t_interval(line.coefficients[0], np.sqrt(line.covariance[0, 0]), line.dof),
        slope_ci95_m_per_N=t_interval(line.coefficients[1], np.sqrt(line.covariance[1, 1]), line.dof),
    )
    return _wheel_fit(wheel, load, radius, estimate, design, naive, reference_load_N, influence)


@dataclass(frozen=True, slots=True, eq=False)
class _Influence:
    """How well the ordinary least-squares fit does, and how much each run carries of it."""

    r_squared: float
    variance_m2: float
    leverage: FloatArray
    cook: FloatArray


def _constant(wheel: str, load: FloatArray, radius: FloatArray, groups: Groups) -> WheelFit:
    estimate = stratified_constant(radius, groups)
    n = len(radius)
    scatter = radius - radius.mean()
    variance = float(scatter @ scatter) / (n - 1)
    leverage = np.full(n, 1.0 / n)
    cook = scatter**2 / variance * leverage / (1 - leverage) ** 2 if variance > 0 else np.zeros(n)
    influence = _Influence(0.0, variance, leverage, cook)
    return _wheel_fit(wheel, load, radius, estimate, "constant", None, float(load.mean()), influence)


def _wheel_fit(
    wheel: str,
    load: FloatArray,
    radius: FloatArray,
    estimate: Estimate,
    design: str,
    naive: NaiveLine | None,
    reference_load_N: float,
    influence: _Influence,
) -> WheelFit:
    value, slope = estimate.coefficients.tolist()
    covariance = estimate.covariance
    dof_radius, dof_slope = estimate.dof(np.eye(2)).tolist()
    line = design != "constant"
    law = WheelLaw(
        reference_load_N=reference_load_N,
        radius_ref_m=value,
        slope_m_per_N=slope,
        covariance=covariance,
        dof=min(dof_radius, dof_slope) if line else dof_radius,
        residual_std_m=float(np.sqrt(estimate.run_variance + estimate.session_variance)),
        load_min_N=float(load.min()),
        load_max_N=float(load.max()),
        n_runs=len(load),
    )
    return WheelFit(
        wheel=wheel,
        law=law,
        model="line" if line else "constant",
        design=design,
        estimate=estimate,
        naive=naive,
        intercept_m=value - slope * reference_load_N,
        r_squared=influence.r_squared,
        residual_std_m=float(np.sqrt(influence.variance_m2)),
        run_std_m=float(np.sqrt(estimate.run_variance)),
        session_std_m=float(np.sqrt(estimate.session_variance)),
        dof_radius_ref=dof_radius,
        dof_slope=dof_slope if line else 0.0,
        radius_ref_ci95_m=t_interval(value, float(np.sqrt(covariance[0, 0])), dof_radius),
        slope_ci95_m_per_N=t_interval(slope, float(np.sqrt(covariance[1, 1])), dof_slope) if line else None,
        load_N=load,
        radius_m=radius,
        residual_m=radius - law.radius_m(load),
        leverage=influence.leverage,
        cook=influence.cook,
    )


def _r_squared(radius: FloatArray, residual: FloatArray) -> float:
    centred = radius - radius.mean()
    total = float(centred @ centred)
    return 1.0 - float(residual @ residual) / total if total > 0 else 0.0


def _influence(x: FloatArray, radius: FloatArray, residual: FloatArray, scale: float) -> _Influence:
    centred = x - x.mean()
    leverage = 1.0 / len(x) + centred**2 / float(centred @ centred)
    slack = np.maximum(1.0 - leverage, 1e-12)
    cook = residual**2 * leverage / (2 * scale * slack**2) if scale > 0 else np.zeros_like(x)
    return _Influence(_r_squared(radius, residual), scale, leverage, cook)
