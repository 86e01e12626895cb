"""A line through runs that come in sessions: what is learnt within sessions, and what only between them.

Runs of one session share whatever shifted that day (temperature, a remounted rangefinder, wear), so they are not
independent. A radius is ``a + b x + session + run``; both kinds of scatter are estimated from their own stratum and
never assumed away, so the intervals hold whether or not sessions scatter. Where the loads are crossed with the
sessions the slope's interval is the exact t of the within-session regression, where each session has one load it is
the exact t of the regression on session means, and between the two it follows `calib.radius.welch`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray, IntArray, StrArray
from calib.radius.welch import critical_value, equivalent_dof

__all__ = ["Estimate", "Groups", "groups_of", "plain_line", "stratified_constant", "stratified_line"]

#: session variance over run variance for which strata are weighted; it sets efficiency, never validity, because the
#: variances are estimated afterwards
WORKING_RATIO: Final = 1.0
#: a stratum that carries less than this share of the information on the slope is not used for it
NEGLIGIBLE_SHARE: Final = 0.01
#: below this p-value of the Breusch-Pagan statistic the heteroscedasticity-consistent covariance (HC3) is used
HC3_BELOW: Final = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """Sessions as integers.

    Parameters
    ----------
    names : array of str, shape (n_sessions,)
        In the order of first appearance.
    index : array of int, shape (n_runs,)
        Session of each run.
    sizes : array of float, shape (n_sessions,)
        Runs a session.
    """

    names: StrArray
    index: IntArray
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
    found, first, inverse, sizes = np.unique(labels, return_index=True, return_inverse=True, return_counts=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return Groups(names=found[order], index=rank[inverse].astype(np.int64), sizes=sizes[order].astype(np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Coefficients (radius at x = 0, slope) and their covariance by stratum.

    Parameters
    ----------
    design : str
        ``crossed`` (slope from within sessions), ``confounded`` (slope from session means only), ``mixed``, ``single``
        (one session, or sessions that cannot be told from runs) or ``constant`` (no slope).
    coefficients : array of float, shape (2,)
        Radius at the reference load and slope.
    cov_within, cov_between : array of float, shape (2, 2)
        Parts of the covariance that come from the scatter of runs and of sessions; their sum is the covariance.
    dof_within, dof_between : float
        Degrees of freedom of each part; 0 where it has none.
    run_variance, session_variance : float
        Estimated variances of runs within a session and of sessions (0 where negative).
    session_f : float or None
        Ratio of the two mean squares; F(dof_between, dof_within) where sessions do not scatter.
    robust : bool
        Whether the within part is heteroscedasticity-consistent (HC3).
    systematic : array of float, shape (n_sources, 2)
        What each source that is the same in every run does to the coefficients, times its standard uncertainty.
    systematic_dof : array of float, shape (n_sources,)
        Degrees of freedom behind each of these.
    """

    design: str
    coefficients: FloatArray
    cov_within: FloatArray
    dof_within: float
    cov_between: FloatArray
    dof_between: float
    run_variance: float
    session_variance: float
    session_f: float | None
    robust: bool
    systematic: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    systematic_dof: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def cov_systematic(self) -> FloatArray:
        """Part of the covariance that no number of runs makes smaller, shape (2, 2)."""
        return np.asarray(self.systematic.T @ self.systematic)

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the coefficients, shape (2, 2)."""
        return np.asarray(self.cov_within + self.cov_between + self.cov_systematic)

    def _systematic_half(self, contrast: npt.ArrayLike, coverage: float) -> FloatArray:
        """Return the half width that the systematic sources alone give ``contrast @ coefficients``, shape (...)."""
        from scipy.special import stdtrit

        each = np.asarray(contrast, dtype=np.float64) @ self.systematic.T
        # in place of infinitely many: Student's t is then normal to six digits
        factor = stdtrit(np.minimum(self.systematic_dof, 1e6), 0.5 + coverage / 2)
        return np.asarray(np.sqrt(np.sum((each * factor) ** 2, axis=-1)))

    def parts(self, contrast: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the within and between parts of the variance of ``contrast @ coefficients``.

        Parameters
        ----------
        contrast : array_like, shape (..., 2)
            For example (1, 0) for the radius and (0, 1) for the slope.

        Returns
        -------
        within, between : array of float, shape (...)
        """
        c = np.asarray(contrast, dtype=np.float64)
        within = np.einsum("...i,ij,...j->...", c, self.cov_within, c)
        between = np.einsum("...i,ij,...j->...", c, self.cov_between, c)
        return np.maximum(within, 0.0), np.maximum(between, 0.0)

    def half_width(
        self, contrast: npt.ArrayLike, coverage: float, *, more_within: float = 0.0, more_between: float = 0.0
    ) -> FloatArray:
        """Return the half width of the interval of ``contrast @ coefficients``, shape (...); see `parts`.

        Parameters
        ----------
        contrast : array_like, shape (..., 2)
            What is wanted of the coefficients.
        coverage : float
            Coverage of the interval.
        more_within, more_between : float
            Variances of a further run and session, for a prediction.
        """
        within, between = self.parts(contrast)
        within, between = within + more_within, between + more_between
        total = within + between
        share = np.where(total > 0, between / np.where(total > 0, total, 1.0), 0.0)
        random = critical_value(share, self.dof_between, self.dof_within, coverage) * np.sqrt(total)
        return (
            np.asarray(np.hypot(random, self._systematic_half(contrast, coverage))) if len(self.systematic) else random
        )

    def dof(self, contrast: npt.ArrayLike, coverage: float = 0.95) -> FloatArray:
        """Return the degrees of freedom whose Student's t gives `half_width`, shape (...)."""
        within, between = self.parts(contrast)
        total = within + between
        if len(self.systematic):
            c = np.asarray(contrast, dtype=np.float64)
            std = np.sqrt(total + np.einsum("...i,ij,...j->...", c, self.cov_systematic, c))
            return equivalent_dof(self.half_width(contrast, coverage) / np.where(std > 0, std, 1.0), coverage)
        share = np.where(total > 0, between / np.where(total > 0, total, 1.0), 0.0)
        critical = critical_value(share, self.dof_between, self.dof_within, coverage)
        dof = equivalent_dof(critical, coverage)
        # pure parts to the last digit
        dof = np.where(share <= 0, self.dof_within, dof)
        return np.where(share >= 1, self.dof_between, dof)


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


def plain_line(x: FloatArray, y: FloatArray, *, robust: bool = True) -> tuple[Estimate, Any]:
    """Return the ordinary least-squares line, every run counted as independent.

    Parameters
    ----------
    x, y : array of float, shape (n_runs,)
        Load minus reference load; radius.
    robust : bool
        Use HC3 where the scatter clearly depends on `x`.

    Returns
    -------
    Estimate
        With everything in the within part.
    statsmodels results
        The fit itself, for its leverages and residuals.
    """
    from statsmodels.regression.linear_model import OLS

    results = OLS(y, np.column_stack((np.ones_like(x), x))).fit(method="qr")
    covariance = np.asarray(results.cov_params(), dtype=np.float64)
    hc3 = bool(robust and results.df_resid >= 4 and breusch_pagan(results.resid, x)[1] < HC3_BELOW)
    if hc3:
        covariance = np.asarray(results.cov_HC3, dtype=np.float64)
    estimate = Estimate(
        design="single",
        coefficients=np.asarray(results.params, dtype=np.float64),
        cov_within=covariance,
        dof_within=float(results.df_resid),
        cov_between=np.zeros((2, 2)),
        dof_between=0.0,
        run_variance=float(results.scale),
        session_variance=0.0,
        session_f=None,
        robust=hc3,
    )
    return estimate, results


def stratified_line(x: FloatArray, y: FloatArray, groups: Groups) -> Estimate | None:
    """Return the session-aware line, or None where these runs cannot carry one.

    Parameters
    ----------
    x, y : array of float, shape (n_runs,)
        Load minus reference load; radius.
    groups : Groups
        Sessions, two at least.

    Returns
    -------
    Estimate or None
        None where sessions cannot be told from runs (one run a session) or the session means leave no degree of
        freedom.
    """
    from statsmodels.regression.linear_model import WLS

    n, n_sessions = len(x), len(groups)
    x_within, y_within = groups.within(x), groups.within(y)
    x_mean, y_mean = groups.means(x), groups.means(y)
    weight = 1.0 / (WORKING_RATIO + 1.0 / groups.sizes)
    centre = float(weight @ x_mean / weight.sum())
    info_within = float(x_within @ x_within)
    info_between = float(weight @ (x_mean - centre) ** 2)
    if info_within + info_between <= 0:
        return None
    share = info_between / (info_within + info_between)

    sloped = share < 1 - NEGLIGIBLE_SHARE
    dof_within = n - n_sessions - (1 if sloped else 0)
    if dof_within < 1:
        return None
    slope_within, slope_variance, robust = 0.0, 0.0, False
    if sloped:
        slope_within, run_variance, slope_variance, robust = _within_sessions(x, x_within, y_within, groups, dof_within)
    else:
        run_variance = float(y_within @ y_within) / dof_within

    only_within = share < NEGLIGIBLE_SHARE or (n_sessions == 2 and share < 1 - NEGLIGIBLE_SHARE)
    only_between = share > 1 - NEGLIGIBLE_SHARE
    part, dof_between = 1.0, n_sessions - 1
    if only_within:
        level = y_mean - slope_within * (x_mean - centre)
        deviation = level - weight @ level / weight.sum()
        mean_radius = float(weight @ level / weight.sum())
        slope = slope_within
    else:
        dof_between = n_sessions - 2
        if dof_between < 1:
            return None
        outer = WLS(y_mean, np.column_stack((np.ones(n_sessions), x_mean - centre)), weights=weight).fit(method="qr")
        part = 0.0 if only_between else info_within / (info_within + info_between)
        deviation = np.asarray(outer.resid)
        mean_radius = float(outer.params[0])
        slope = part * slope_within + (1 - part) * float(outer.params[1])
    between_square = float(weight @ deviation**2) / dof_between

    lever = np.array([[centre**2, -centre], [-centre, 1.0]])
    cov_between = np.diag([between_square / weight.sum(), 0.0])
    if not only_within:
        cov_between = cov_between + (1 - part) ** 2 * between_square / info_between * lever
    session_variance, session_f = _session_scatter(between_square / float(weight.mean()), run_variance, groups)
    return Estimate(
        design="crossed" if only_within else "confounded" if only_between else "mixed",
        coefficients=np.array([mean_radius - slope * centre, slope]),
        cov_within=part**2 * slope_variance * lever,
        dof_within=float(dof_within),
        cov_between=cov_between,
        dof_between=float(dof_between),
        run_variance=run_variance,
        session_variance=session_variance,
        session_f=session_f,
        robust=robust,
    )


def _within_sessions(
    x: FloatArray, x_within: FloatArray, y_within: FloatArray, groups: Groups, dof: int
) -> tuple[float, float, float, bool]:
    """Return slope, variance of runs, variance of the slope, and whether that is HC3's, from within sessions.

    HC3 stands here by hand, because each run's leverage holds its share of the session's mean, which a regression of
    values from which the means were taken knows nothing of.
    """
    from statsmodels.regression.linear_model import OLS

    info = float(x_within @ x_within)
    inner = OLS(y_within, x_within[:, None]).fit(method="qr")
    residual = np.asarray(inner.resid)
    run_variance = float(residual @ residual) / dof
    if dof < 4 or breusch_pagan(residual, x)[1] >= HC3_BELOW:
        return float(inner.params[0]), run_variance, run_variance / info, False
    leverage = 1.0 / groups.sizes[groups.index] + x_within**2 / info
    variance = float(np.sum((x_within * residual / np.maximum(1 - leverage, 0.05)) ** 2)) / info**2
    return float(inner.params[0]), run_variance, variance, True


def _session_scatter(mean_variance: float, run_variance: float, groups: Groups) -> tuple[float, float | None]:
    """Return the variance of sessions beyond that of their runs, and the ratio of the two mean squares."""
    explained = run_variance * float(np.mean(1.0 / groups.sizes))
    return max(mean_variance - explained, 0.0), mean_variance / explained if run_variance > 0 else None


def stratified_constant(y: FloatArray, groups: Groups) -> Estimate:
    """Return the constant radius, over session means where there are two sessions or more."""
    n, n_sessions = len(y), len(groups)
    if n_sessions < 2 or n_sessions == n:
        variance = float(np.var(y, ddof=1))
        part = np.diag([variance / n, 0.0])
        return Estimate(
            "constant", np.array([y.mean(), 0.0]), part, float(n - 1), np.zeros((2, 2)), 0.0, variance, 0.0, None, False
        )
    mean = groups.means(y)
    inner = groups.within(y)
    run_variance = float(inner @ inner) / (n - n_sessions)
    weight = 1.0 / (WORKING_RATIO + 1.0 / groups.sizes)
    value = float(weight @ mean / weight.sum())
    between_square = float(weight @ (mean - value) ** 2) / (n_sessions - 1)
    session_variance, session_f = _session_scatter(between_square / float(weight.mean()), run_variance, groups)
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
