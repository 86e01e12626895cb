"""Regression of runs that come in sessions: what is known within sessions, and what only between them.

Runs of one session share what shifted that day (temperature, a remounted rangefinder, wear), so they are not
independent. A radius is ``a + b x + session + run``; both kinds of scatter are estimated from their own stratum and
never assumed away, so the intervals hold whether or not sessions scatter. Where the loads are crossed with the
sessions the slope's interval is the exact t of the within-session regression, where each session has one load it is
the exact t of the regression on session means, and between the two it follows the critical values of
`calib.radius.law`.

The estimator needs of the runs of a session only their number and the sums of loads, radii, their squares and products
(`SessionSums`): a fleet adds runs to them and reads none again. Only HC3 needs the runs themselves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from calib.radius.law import LineEstimate
from calib.types import FloatArray, IntArray, StrArray

#: session variance over run variance for which strata are weighted; it affects efficiency, never validity: the
#: variances are estimated afterwards
WORKING_RATIO: Final = 1.0
#: a stratum that carries less than this share of the information on the slope is not used for it
NEGLIGIBLE_SHARE: Final = 0.01
#: below this p-value of the Breusch-Pagan statistic the heteroscedasticity-consistent covariance (HC3) is used,
#: with so many degrees of freedom at least
HC3_BELOW: Final = 0.01
HC3_MIN_DOF: Final = 4
#: leverage is kept so far below one in HC3
HC3_MIN_SLACK: Final = 0.05
#: sums of squares counted from a reference load count as zero below this share: rounding
ROUNDING: Final = 1e-12


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
    """Return the studentised Breusch-Pagan statistic (Koenker 1981) of residuals against `x`, and its p-value."""
    from statsmodels.stats.diagnostic import het_breuschpagan

    if not (np.ptp(residual**2) > 0 and np.ptp(x) > 0):
        return 0.0, 1.0
    statistic, p_value, _, _ = het_breuschpagan(residual, np.column_stack((np.ones_like(x), x)))
    return float(statistic), float(p_value)


@dataclass(frozen=True, slots=True, eq=False)
class Strata:
    """Sufficient statistics of runs in sessions: session means, and the regression within sessions."""

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
    residual_square: float


def line_of_strata(strata: Strata) -> LineEstimate | None:
    """Return the session-aware line, or None where these runs cannot carry one.

    `strata`: of two sessions at least. None where sessions cannot be told from runs (one run a session) or the session
    means leave no degree of freedom.
    """
    sizes, x_mean, y_mean = strata.sizes, strata.x_mean, strata.y_mean
    n_sessions = len(sizes)
    weight = 1.0 / (WORKING_RATIO + 1.0 / sizes)
    centre = float(weight @ x_mean / weight.sum())
    centred = x_mean - centre
    info_between = float(weight @ centred**2)
    if strata.info + info_between <= 0:
        return None
    share = info_between / (strata.info + info_between)
    only_between = share >= 1 - NEGLIGIBLE_SHARE
    only_within = share < NEGLIGIBLE_SHARE or (n_sessions == 2 and not only_between)
    dof_within = float(sizes.sum()) - n_sessions - (0 if only_between else 1)
    dof_between = n_sessions - (1 if only_within else 2)
    if dof_within < 1 or dof_between < 1:
        return None

    weight_within = 1.0 if only_within else 0.0 if only_between else strata.info / (strata.info + info_between)
    run_variance = (strata.square if only_between else strata.residual_square) / dof_within
    mean_radius = float(weight @ y_mean / weight.sum())
    # slope between sessions; within sessions alone the means only scatter about the slope from there
    between = strata.slope if only_within else float(weight @ (centred * (y_mean - mean_radius))) / info_between
    slope = weight_within * strata.slope + (1 - weight_within) * between if weight_within else between
    between_square = float(weight @ (y_mean - mean_radius - between * centred) ** 2) / dof_between
    between_square = max(between_square, _least_between(run_variance, sizes, weight, dof_within, dof_between))

    lever = np.array([[centre**2, -centre], [-centre, 1.0]])
    cov_between = np.diag([between_square / weight.sum(), 0.0])
    if not only_within:
        cov_between = cov_between + (1 - weight_within) ** 2 * between_square / info_between * lever
    session_variance, session_f = _session_scatter(between_square / float(weight.mean()), run_variance, sizes)
    return LineEstimate(
        design="crossed" if only_within else "confounded" if only_between else "mixed",
        coefficients=np.array([mean_radius - slope * centre, slope]),
        cov_within=lever * (weight_within**2 * run_variance / strata.info if weight_within else 0.0),
        dof_within=dof_within,
        cov_between=cov_between,
        dof_between=float(dof_between),
        run_variance=run_variance,
        session_variance=session_variance,
        session_f=session_f,
        hc3=False,
    )


def stratified_line(x: FloatArray, y: FloatArray, groups: Groups) -> LineEstimate | None:
    """Return `line_of_strata` of runs, its within part HC3 where their scatter clearly depends on the load.

    `x`, `y` (shape (n_runs,)): load minus reference load; radius; `groups`: sessions, two at least.
    """
    x_within, y_within = groups.within(x), groups.within(y)
    info = float(x_within @ x_within)
    slope = float(x_within @ y_within) / info if info > 0 else 0.0
    residual = y_within - slope * x_within
    squares = float(y_within @ y_within), float(residual @ residual)
    estimate = line_of_strata(Strata(groups.sizes, groups.means(x), groups.means(y), info, slope, *squares))
    if estimate is None or estimate.design == "confounded" or estimate.dof_within < HC3_MIN_DOF:
        return estimate
    if breusch_pagan(residual, x)[1] >= HC3_BELOW:
        return estimate
    # statsmodels has no HC3 here: the leverage of a run holds its share of the session's mean, which a regression of
    # values minus these means does not count
    leverage = 1.0 / groups.sizes[groups.index] + x_within**2 / info
    variance = float(np.sum((x_within * residual / np.maximum(1 - leverage, HC3_MIN_SLACK)) ** 2)) / info**2
    return replace(estimate, cov_within=estimate.cov_within * (variance * info / estimate.run_variance), hc3=True)


def _least_between(
    run_variance: float, sizes: FloatArray, weight: FloatArray, dof_within: float, dof_between: float
) -> float:
    """Return the mean square of two sessions below which they agree better than their runs allow, by chance.

    An interval from there is as wide as that of the runs alone. With more sessions it is rare, and Student's t holds.
    """
    from scipy.special import stdtrit

    if dof_between > 1.0:
        return 0.0
    of_runs, of_sessions = (float(stdtrit(dof, 0.975)) for dof in (dof_within, dof_between))
    return run_variance * float(np.mean(1.0 / sizes)) * float(weight.mean()) * (of_runs / of_sessions) ** 2


def _session_scatter(mean_variance: float, run_variance: float, sizes: FloatArray) -> tuple[float, float | None]:
    """Return the variance of sessions beyond that of their runs, and the ratio of the two mean squares."""
    explained = run_variance * float(np.mean(1.0 / sizes))
    return max(mean_variance - explained, 0.0), mean_variance / explained if run_variance > 0 else None


def stratified_constant(y: FloatArray, groups: Groups) -> LineEstimate:
    """Return the constant radius, over session means where there are two sessions or more."""
    n, n_sessions = len(y), len(groups)
    if n_sessions < 2 or n_sessions == n:
        variance = float(np.var(y, ddof=1))
        part = np.diag([variance / n, 0.0])
        return LineEstimate.one_stratum("constant", np.array([y.mean(), 0.0]), part, float(n - 1), variance)
    mean = groups.means(y)
    inner = groups.within(y)
    run_variance = float(inner @ inner) / (n - n_sessions)
    weight = 1.0 / (WORKING_RATIO + 1.0 / groups.sizes)
    value = float(weight @ mean / weight.sum())
    between_square = float(weight @ (mean - value) ** 2) / (n_sessions - 1)
    least = _least_between(run_variance, groups.sizes, weight, float(n - n_sessions), n_sessions - 1.0)
    between_square = max(between_square, least)
    session_variance, session_f = _session_scatter(between_square / float(weight.mean()), run_variance, groups.sizes)
    return LineEstimate(
        design="constant",
        coefficients=np.array([value, 0.0]),
        cov_within=np.zeros((2, 2)),
        dof_within=float(n - n_sessions),
        cov_between=np.diag([between_square / weight.sum(), 0.0]),
        dof_between=float(n_sessions - 1),
        run_variance=run_variance,
        session_variance=session_variance,
        session_f=session_f,
        hc3=False,
    )


@dataclass(frozen=True, slots=True, eq=False)
class SessionSums:
    """Sums over the runs of each session, for one wheel."""

    #: labels, each once, in order, shape (n_sessions,)
    session: StrArray
    #: number of runs; sums of load, radius, load squared, load times radius, radius squared, day, and day squared.
    #: Loads are counted from a reference load (N), radii from a nominal radius (m), days from any common day, shape
    #: (n_sessions, 8)
    table: FloatArray
    #: span of the loads, counted from the same reference load; inf and -inf where there are no runs
    load_min_N: float
    load_max_N: float

    @staticmethod
    def from_runs(session: StrArray, load_N: FloatArray, radius_m: FloatArray, day: FloatArray) -> SessionSums:
        """Return the sums of runs, each argument of shape (n_runs,)."""
        labels, index = np.unique(session, return_inverse=True)
        ones = np.ones_like(load_N)
        terms = (ones, load_N, radius_m, load_N**2, load_N * radius_m, radius_m**2, day, day**2)
        table = np.stack([np.bincount(index, term, len(labels)) for term in terms], axis=1).astype(np.float64)
        return SessionSums(labels, table, float(load_N.min(initial=np.inf)), float(load_N.max(initial=-np.inf)))

    def added(self, other: SessionSums) -> SessionSums:
        """Return the sums of both, sessions of the same label as one."""
        labels, index = np.unique(np.concatenate([self.session, other.session]), return_inverse=True)
        table = np.zeros((len(labels), self.table.shape[1]))
        np.add.at(table, index, np.concatenate([self.table, other.table]))
        low = min(self.load_min_N, other.load_min_N)
        return SessionSums(labels, table, low, max(self.load_max_N, other.load_max_N))

    @property
    def n_runs(self) -> float:
        """Number of runs."""
        return float(self.table[:, 0].sum())

    @property
    def means(self) -> FloatArray:
        """Mean load, radius and day of each session, shape (n_sessions, 3)."""
        return np.asarray(self.table[:, [1, 2, 6]] / self.table[:, :1])

    @property
    def within(self) -> FloatArray:
        """Sums of squares within sessions: of load, of load times radius, of radius, shape (3,)."""
        n, x, y, xx, xy, yy = self.table[:, :6].T
        return np.array([(xx - x * x / n).sum(), (xy - x * y / n).sum(), (yy - y * y / n).sum()])


def line_from_sums(sums: SessionSums) -> LineEstimate | None:
    """Return the session-aware line, or None where these runs cannot carry one.

    As `stratified_line` gives it, without HC3; the plain line where there is one session, or one
    run a session. None with fewer than three runs or a single load.
    """
    n, n_sessions = sums.n_runs, len(sums.session)
    if n < 3:
        return None
    if not 2 <= n_sessions < n:
        return _plain(sums)
    x_mean, y_mean, _ = sums.means.T
    info, cross, square = sums.within
    if not info + float(np.ptp(x_mean)) ** 2 > ROUNDING * max(float(sums.table[:, 3].sum()), 1.0):
        return None
    slope = cross / info if info > 0 else 0.0
    strata = Strata(sums.table[:, 0], x_mean, y_mean, info, slope, square, max(square - slope * cross, 0.0))
    return line_of_strata(strata) or _plain(sums)


def _plain(sums: SessionSums) -> LineEstimate | None:
    """Return the least-squares line, every run counted as independent; None with a single load."""
    n, x, y, xx, xy, yy = sums.table[:, :6].sum(axis=0)
    info = xx - x * x / n
    if n < 3 or not info > ROUNDING * max(xx, 1.0):
        return None
    slope = (xy - x * y / n) / info
    variance = max(yy - y * y / n - slope * (xy - x * y / n), 0.0) / (n - 2)
    mean = x / n
    covariance = variance * (np.array([[mean**2, -mean], [-mean, 1.0]]) / info + np.diag([1.0 / n, 0.0]))
    coefficients = np.array([y / n - slope * mean, slope])
    return LineEstimate.one_stratum("single", coefficients, covariance, float(n - 2), float(variance))
