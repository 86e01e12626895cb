"""A line through runs that come in sessions: what is learnt within sessions, and what only between them.

Runs of one session share whatever shifted that day (temperature, a remounted rangefinder, wear), so they are not
independent. A radius is ``a + b x + session + run``; both kinds of scatter are estimated from their own stratum and
never assumed away, so the intervals hold whether or not sessions scatter. Where the loads are crossed with the
sessions the slope's interval is the exact t of the within-session regression, where each session has one load it is
the exact t of the regression on session means, and between the two it follows `calib.radius.welch`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray, IntArray, StrArray
from calib.radius.estimate import Estimate, of_one_stratum
from calib.radius.least_squares import PlainLine, fit_line

#: session variance over run variance for which strata are weighted; it sets efficiency, never validity, because the
#: variances are estimated afterwards
WORKING_RATIO: Final = 1.0
#: a stratum that carries less than this share of the information on the slope is not used for it
NEGLIGIBLE_SHARE: Final = 0.01
#: below this p-value of the Breusch-Pagan statistic the heteroscedasticity-consistent covariance (HC3) is used
HC3_BELOW: Final = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """Sessions as integers."""

    #: in the order of first appearance, shape (n_sessions,)
    names: StrArray
    #: session of each run, shape (n_runs,)
    index: IntArray
    #: runs a session, shape (n_sessions,)
    sizes: FloatArray

    def __len__(self) -> int:
        return len(self.names)

    def means(self, values: FloatArray) -> FloatArray:
        """Return the session means of `values`, shape (n_sessions,)."""
        return np.bincount(self.index, weights=values, minlength=len(self)) / self.sizes

    def within(self, values: FloatArray) -> FloatArray:
        """Return `values` minus their session's mean, shape (n_runs,)."""
        return np.asarray(values - self.means(values)[self.index])


def groups_of(session: npt.ArrayLike) -> Groups:
    """Return the sessions of runs; an empty label is a session of its own name."""
    labels = np.asarray(session, dtype=np.str_)
    names, first, inverse, sizes = np.unique(labels, return_index=True, return_inverse=True, return_counts=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return Groups(names=names[order], index=rank[inverse].astype(np.int64), sizes=sizes[order].astype(np.float64))


def breusch_pagan(residual: FloatArray, x: FloatArray) -> tuple[float, float]:
    """Return the studentised Breusch-Pagan statistic (Koenker 1981) of residuals against `x`, and its p-value.

    The closed form for one regressor: the same digits as `statsmodels.stats.diagnostic.het_breuschpagan` twenty times
    as fast, which counts in studies of coverage, and defined where there is no scatter at all.
    """
    from scipy.special import chdtrc

    squared = residual**2 - np.mean(residual**2)
    centred = x - x.mean()
    denominator = float(squared @ squared) * float(centred @ centred)
    if denominator <= 0:
        return 0.0, 1.0
    statistic = len(x) * float(squared @ centred) ** 2 / denominator
    return statistic, float(chdtrc(1.0, statistic))


def plain_line(x: FloatArray, y: FloatArray, *, robust: bool = True) -> tuple[Estimate, PlainLine]:
    """Return the ordinary least-squares line, every run counted as independent.

    `x`, `y` (shape (n_runs,)): load minus reference load; radius; `robust`: use HC3 where the scatter clearly depends
    on `x`. With everything in the within part; the fit itself, for its residuals.
    """
    line = fit_line(x, y)
    hc3 = bool(robust and line.dof >= 4 and breusch_pagan(line.residual, x)[1] < HC3_BELOW)
    covariance = line.robust_covariance if hc3 else line.covariance
    return of_one_stratum("single", line.coefficients, covariance, line.dof, line.variance, robust=hc3), line


@dataclass(frozen=True, slots=True, eq=False)
class Strata:
    """What the line needs of runs in sessions: their means, and the regression within sessions."""

    #: number of runs, mean load (minus the reference load) and mean radius of each session, shape (n_sessions,)
    sizes: FloatArray
    x_mean: FloatArray
    y_mean: FloatArray
    #: sum of squares of the loads within sessions
    info: float
    #: of the regression within sessions; 0 where `info` is
    slope: float
    #: sum of squares of the radii within sessions, and about that regression
    square: float
    rest: float


def line_of_strata(strata: Strata) -> Estimate | None:
    """Return the session-aware line, or None where these runs cannot carry one.

    `strata`: of two sessions at least. None where sessions cannot be told from runs (one run a session) or the session
    means leave no degree of freedom.
    """
    sizes, x_mean, y_mean = strata.sizes, strata.x_mean, strata.y_mean
    n_sessions = len(sizes)
    weight = 1.0 / (WORKING_RATIO + 1.0 / sizes)
    centre = float(weight @ x_mean / weight.sum())
    away = x_mean - centre
    info_between = float(weight @ away**2)
    if strata.info + info_between <= 0:
        return None
    share = info_between / (strata.info + info_between)
    only_between = share >= 1 - NEGLIGIBLE_SHARE
    only_within = share < NEGLIGIBLE_SHARE or (n_sessions == 2 and not only_between)
    dof_within = float(sizes.sum()) - n_sessions - (0 if only_between else 1)
    dof_between = n_sessions - (1 if only_within else 2)
    if dof_within < 1 or dof_between < 1:
        return None

    part = 1.0 if only_within else 0.0 if only_between else strata.info / (strata.info + info_between)
    run_variance = (strata.square if only_between else strata.rest) / dof_within
    mean_radius = float(weight @ y_mean / weight.sum())
    # what the line between sessions is; within sessions alone the means only scatter about the slope from there
    between = strata.slope if only_within else float(weight @ (away * (y_mean - mean_radius))) / info_between
    slope = part * strata.slope + (1 - part) * between if part else between
    between_square = float(weight @ (y_mean - mean_radius - between * away) ** 2) / dof_between

    lever = np.array([[centre**2, -centre], [-centre, 1.0]])
    cov_between = np.diag([between_square / weight.sum(), 0.0])
    if not only_within:
        cov_between = cov_between + (1 - part) ** 2 * between_square / info_between * lever
    session_variance, session_f = _session_scatter(between_square / float(weight.mean()), run_variance, sizes)
    return Estimate(
        design="crossed" if only_within else "confounded" if only_between else "mixed",
        coefficients=np.array([mean_radius - slope * centre, slope]),
        cov_within=lever * (part**2 * run_variance / strata.info if part else 0.0),
        dof_within=dof_within,
        cov_between=cov_between,
        dof_between=float(dof_between),
        run_variance=run_variance,
        session_variance=session_variance,
        session_f=session_f,
        robust=False,
    )


def stratified_line(x: FloatArray, y: FloatArray, groups: Groups) -> Estimate | None:
    """Return `line_of_strata` of runs, its within part HC3 where their scatter clearly depends on the load.

    `x`, `y` (shape (n_runs,)): load minus reference load; radius; `groups`: sessions, two at least.
    """
    x_within, y_within = groups.within(x), groups.within(y)
    info = float(x_within @ x_within)
    slope = float(x_within @ y_within) / info if info > 0 else 0.0
    residual = y_within - slope * x_within
    strata = Strata(
        groups.sizes,
        groups.means(x),
        groups.means(y),
        info,
        slope,
        float(y_within @ y_within),
        float(residual @ residual),
    )
    estimate = line_of_strata(strata)
    if estimate is None or estimate.design == "confounded" or estimate.dof_within < 4:
        return estimate
    if breusch_pagan(residual, x)[1] >= HC3_BELOW:
        return estimate
    # by hand, because each run's leverage holds its share of the session's mean, which a regression of values from
    # which the means were taken knows nothing of
    leverage = 1.0 / groups.sizes[groups.index] + x_within**2 / info
    variance = float(np.sum((x_within * residual / np.maximum(1 - leverage, 0.05)) ** 2)) / info**2
    return replace(estimate, cov_within=estimate.cov_within * (variance * info / estimate.run_variance), robust=True)


def _session_scatter(mean_variance: float, run_variance: float, sizes: FloatArray) -> tuple[float, float | None]:
    """Return the variance of sessions beyond that of their runs, and the ratio of the two mean squares."""
    explained = run_variance * float(np.mean(1.0 / sizes))
    return max(mean_variance - explained, 0.0), mean_variance / explained if run_variance > 0 else None


def stratified_constant(y: FloatArray, groups: Groups) -> Estimate:
    """Return the constant radius, over session means where there are two sessions or more."""
    n, n_sessions = len(y), len(groups)
    if n_sessions < 2 or n_sessions == n:
        variance = float(np.var(y, ddof=1))
        part = np.diag([variance / n, 0.0])
        return of_one_stratum("constant", np.array([y.mean(), 0.0]), part, float(n - 1), variance)
    mean = groups.means(y)
    inner = groups.within(y)
    run_variance = float(inner @ inner) / (n - n_sessions)
    weight = 1.0 / (WORKING_RATIO + 1.0 / groups.sizes)
    value = float(weight @ mean / weight.sum())
    between_square = float(weight @ (mean - value) ** 2) / (n_sessions - 1)
    session_variance, session_f = _session_scatter(between_square / float(weight.mean()), run_variance, groups.sizes)
    return Estimate(
        design="constant",
        coefficients=np.array([value, 0.0]),
        cov_within=np.zeros((2, 2)),
        dof_within=float(n - n_sessions),
        cov_between=np.diag([between_square / weight.sum(), 0.0]),
        dof_between=float(n_sessions - 1),
        run_variance=run_variance,
        session_variance=session_variance,
        session_f=session_f,
        robust=False,
    )
