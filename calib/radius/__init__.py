"""From runs to a law: effective radii, path deviation, regression on load.

A radius is ``a + b x + session + run``, each scatter estimated from its own stratum, the residuals of a session a
first-order autoregression; see `docs/report.md`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr, stdtr, stdtrit

from calib.radius.law import LineEstimate
from calib.types import FloatArray, IntArray, StrArray, floats

#: session over run variance that the weights of sessions assume; the estimated variances make up for an error
WORKING_RATIO: Final = 1.0
#: a stratum with a smaller share of the information on the slope is not used
NEGLIGIBLE_SHARE: Final = 0.01
#: Breusch-Pagan p-value below which the covariance is the heteroscedasticity-consistent HC3, and the degrees of freedom
#: that it needs
HC3_BELOW: Final = 0.01
HC3_MIN_DOF: Final = 4
#: least 1 - leverage in HC3
HC3_MIN_SLACK: Final = 0.05
#: 1 - leverage of a run that the design fits exactly: rounding
FITTED_EXACTLY: Final = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """Sessions as integers."""

    #: in the order of first appearance, shape (n_sessions,)
    names: StrArray
    #: of each run, shape (n_runs,)
    index: IntArray
    #: runs, shape (n_sessions,)
    sizes: FloatArray

    def __len__(self) -> int:
        return len(self.names)

    def means(self, values: FloatArray) -> FloatArray:
        """Return the session means of `values`, shape (n_sessions,)."""
        return np.bincount(self.index, weights=values, minlength=len(self)) / self.sizes

    @property
    def weights(self) -> FloatArray:
        """Weights of the session means, shape (n_sessions,)."""
        return 1.0 / (WORKING_RATIO + 1.0 / self.sizes)

    @property
    def indicators(self) -> FloatArray:
        """Indicator columns of the sessions; a constant where there is one session or one run a session."""
        n = len(self.index)
        return np.eye(len(self))[self.index] if 2 <= len(self) < n else np.ones((n, 1))

    def within(self, values: FloatArray) -> FloatArray:
        """Return `values` minus their session's mean, shape (n_runs,)."""
        return values - self.means(values)[self.index]


def groups_of(session: ArrayLike) -> Groups:
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


def needs_hc3(residual: FloatArray, x: FloatArray, dof: float) -> bool:
    """Return whether the scatter of residuals clearly depends on `x`, with enough degrees of freedom for HC3."""
    return dof >= HC3_MIN_DOF and breusch_pagan(residual, x)[1] < HC3_BELOW


def line_of_strata(
    sizes: FloatArray,
    x_mean: FloatArray,
    y_mean: FloatArray,
    info: float,
    slope_within: float,
    square: float,
    residual_square: float,
) -> LineEstimate | None:
    """Return the line of two sessions or more; None where they cannot be told from runs or leave no degree of freedom.

    Parameters
    ----------
    sizes, x_mean, y_mean
        Runs, mean load (minus the reference load) and mean radius of each session, shape (n_sessions,).
    info, slope_within
        Squares of the loads within sessions, and slope of the regression there (0 of 0).
    square, residual_square
        Squares of the radii there, and about that regression.
    """
    n_sessions = len(sizes)
    weight = 1.0 / (WORKING_RATIO + 1.0 / sizes)
    centre = float(weight @ x_mean / weight.sum())
    centred = x_mean - centre
    info_between = float(weight @ centred**2)
    if info + info_between <= 0:
        return None
    share = info_between / (info + info_between)
    only_between = share >= 1 - NEGLIGIBLE_SHARE
    only_within = share < NEGLIGIBLE_SHARE or (n_sessions == 2 and not only_between)
    dof_within = float(sizes.sum()) - n_sessions - (0 if only_between else 1)
    dof_between = n_sessions - (1 if only_within else 2)
    if dof_within < 1 or dof_between < 1:
        return None

    weight_within = 1.0 if only_within else 0.0 if only_between else info / (info + info_between)
    run_variance = (square if only_between else residual_square) / dof_within
    mean_radius = float(weight @ y_mean / weight.sum())
    # slope between sessions; where it comes from within them, their means scatter about that
    between = slope_within if only_within else float(weight @ (centred * (y_mean - mean_radius))) / info_between
    slope = weight_within * slope_within + (1 - weight_within) * between if weight_within else between
    departures = y_mean - mean_radius - between * centred
    lever = np.array([[centre**2, -centre], [-centre, 1.0]])
    per_square = np.diag([1.0 / weight.sum(), 0.0])
    if not only_within:
        per_square = per_square + (1 - weight_within) ** 2 / info_between * lever
    design = "crossed" if only_within else "confounded" if only_between else "mixed"
    coefficients, dof = np.array([mean_radius - slope * centre, slope]), (dof_within, float(dof_between))
    cov_within = lever * (weight_within**2 * run_variance / info if weight_within else 0.0)
    return _with_sessions(design, coefficients, cov_within, per_square, departures, sizes, dof, run_variance)


def stratified_line(x: FloatArray, y: FloatArray, groups: Groups) -> LineEstimate | None:
    """Return `line_of_strata` of runs, its within part HC3 where their scatter clearly depends on the load.

    `x`, `y` (shape (n_runs,)): load minus reference load; radius; `groups`: sessions, two at least.
    """
    x_within, y_within = groups.within(x), groups.within(y)
    info = float(x_within @ x_within)
    slope = float(x_within @ y_within) / info if info > 0 else 0.0
    residual = y_within - slope * x_within
    squares = float(y_within @ y_within), float(residual @ residual)
    estimate = line_of_strata(groups.sizes, groups.means(x), groups.means(y), info, slope, *squares)
    if estimate is None or estimate.design == "confounded" or not needs_hc3(residual, x, estimate.dof_within):
        return estimate
    # statsmodels has no HC3 here: a run's leverage holds its share of the session's mean, too
    leverage = 1.0 / groups.sizes[groups.index] + x_within**2 / info
    variance = float(np.sum((x_within * residual / np.maximum(1 - leverage, HC3_MIN_SLACK)) ** 2)) / info**2
    return replace(estimate, cov_within=estimate.cov_within * (variance * info / estimate.run_variance), hc3=True)


def _with_sessions(
    design: str,
    coefficients: FloatArray,
    cov_within: FloatArray,
    per_square: FloatArray,
    departures: FloatArray,
    sizes: FloatArray,
    dof: tuple[float, float],
    run_variance: float,
) -> LineEstimate:
    # per_square: covariance between sessions over the mean square of their means about the law, which is raised where
    # few agree by chance: no interval is narrower than by the runs alone
    weight, explained = 1.0 / (WORKING_RATIO + 1.0 / sizes), run_variance * float(np.mean(1.0 / sizes))
    of_runs, of_sessions = stdtrit(dof, 0.975).tolist()
    least = explained * float(weight.mean()) * (of_runs / of_sessions) ** 2
    square = max(float(weight @ departures**2) / dof[1], least)
    variance = square / float(weight.mean())
    variances = (run_variance, max(variance - explained, 0.0))
    session_f = variance / explained if run_variance > 0 else None
    return LineEstimate(coefficients, *dof, *variances, cov_within, square * per_square, session_f, False, design)


def stratified_constant(y: FloatArray, groups: Groups) -> LineEstimate:
    """Return the constant radius, over session means where there are two sessions or more."""
    n, n_sessions = len(y), len(groups)
    if n_sessions < 2 or n_sessions == n:
        variance = float(np.var(y, ddof=1))
        part = np.diag([variance / n, 0.0])
        return LineEstimate.one_stratum("constant", np.array([y.mean(), 0.0]), part, float(n - 1), variance)
    mean, inner = groups.means(y), groups.within(y)
    weight, dof_within = groups.weights, n - n_sessions
    value, run_variance = float(weight @ mean / weight.sum()), float(inner @ inner) / dof_within
    constant, per_square = np.array([value, 0.0]), np.diag([1.0 / weight.sum(), 0.0])
    dof, none = (float(dof_within), n_sessions - 1.0), np.zeros((2, 2))
    return _with_sessions("constant", constant, none, per_square, mean - value, groups.sizes, dof, run_variance)


#: fewest degrees of freedom that an autocorrelation is tested with
RHO_MIN_DOF: Final = 6
#: p-value below which intervals allow for it: wider ones cost little
RHO_BELOW_P: Final = 0.05
#: largest autocorrelation; beyond, runs say nothing of the scatter of their mean
MAX_RHO: Final = 0.95
RHO_PRECISION: Final = 0.01


@dataclass(frozen=True, slots=True)
class Autocorrelation:
    """Autocorrelation of runs that follow each other."""

    #: of one run and the next: bias-corrected, plus one standard deviation; 0 where not significant
    rho: float
    #: lag-one autocorrelation of the residuals, and its p-value
    lag_one: float
    p_value: float
    #: factor that widens the slope's interval
    slope_ratio: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class _Series:
    residual: FloatArray
    #: orthonormal columns that the residuals are free of, shape (n_runs, k)
    basis: FloatArray
    #: 1 where a run begins a session, shape (n_runs,); runs of different ones are uncorrelated
    begins: FloatArray

    @property
    def dof(self) -> float:
        return float(len(self.residual) - self.basis.shape[1])

    def neighbours(self, columns: FloatArray) -> FloatArray:
        # half the sum of the run before and the run after, within a session
        half, product = 0.5 * (1.0 - self.begins[1:])[:, None], np.zeros_like(columns)
        product[1:] += half * columns[:-1]
        product[:-1] += half * columns[1:]
        return product

    def correlated(self, columns: FloatArray, rho: float) -> FloatArray:
        # the AR(1) correlation matrix, rho^|i - j| within a session, times the columns
        from scipy.signal import lfilter

        product = np.empty_like(columns)
        for first, behind in pairwise([*np.flatnonzero(self.begins), len(columns)]):
            block = columns[first:behind]
            forward = lfilter([1.0], [1.0, -rho], block, axis=0)
            product[first:behind] = forward + lfilter([1.0], [1.0, -rho], block[::-1], axis=0)[::-1] - block
        return product

    def expected_lag_one(self, rho: float) -> float:
        basis, pairs = self.basis, len(self.residual) - self.begins.sum()
        neighbours, correlated = self.neighbours(basis), self.correlated(basis, rho)
        cross = basis.T @ correlated
        product = rho * pairs - 2.0 * float(np.sum(neighbours * correlated))
        product += float(np.sum((basis.T @ neighbours) * cross))
        return float(product / (len(self.residual) - float(np.trace(cross))))

    def if_independent(self) -> tuple[float, float]:
        # mean and standard deviation of the lag-one autocorrelation of independent runs
        pairs, dof = len(self.residual) - self.begins.sum(), self.dof
        neighbours = self.neighbours(self.basis)
        inner = self.basis.T @ neighbours
        trace = -float(np.trace(inner))
        squares = 0.5 * pairs - 2.0 * float(np.sum(neighbours**2)) + float(np.sum(inner**2))
        variance = 2.0 * (dof * squares - trace**2) / (dof**2 * (dof + 2.0))
        return trace / dof, float(np.sqrt(max(variance, 1e-12)))


def autocorrelation(series: _Series) -> Autocorrelation:
    """Return the residuals' autocorrelation in the order driven."""
    square = float(series.residual @ series.residual)
    if series.dof < RHO_MIN_DOF or not square > 0.0:
        return Autocorrelation(0.0, 0.0, 1.0)
    lag_one = float(series.residual @ series.neighbours(series.residual[:, None])[:, 0]) / square
    mean, sd = series.if_independent()
    p_value = float(ndtr((mean - lag_one) / sd))
    if p_value >= RHO_BELOW_P:
        return Autocorrelation(0.0, lag_one, p_value)
    return Autocorrelation(rho_of(lag_one + sd, series.expected_lag_one), lag_one, p_value)


def rho_of(lag_one: float, expected: Callable[[float], float]) -> float:
    """Return the least autocorrelation, to `RHO_PRECISION`, whose `expected` lag-one value reaches `lag_one`."""
    low, high = 0.0, MAX_RHO
    while high - low > RHO_PRECISION:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if expected(middle) < lag_one else (low, middle)
    return high


def widened(
    estimate: LineEstimate, load_N: FloatArray | None, radius_m: FloatArray, groups: Groups
) -> tuple[LineEstimate, Autocorrelation]:
    """Return the estimate, of independent runs, with intervals for autocorrelated ones, and the autocorrelation.

    `load_N`: load minus reference load, in the order driven; None for a constant.
    """
    n = len(radius_m)
    by_session = estimate.dof_between > 0
    means = np.eye(len(groups))[groups.index] if by_session else np.ones((n, 1))
    columns = means if load_N is None or estimate.design == "confounded" else np.column_stack((means, load_N))
    basis = np.linalg.qr(columns)[0]
    begins = np.ones(n)
    begins[1:] = (np.diff(groups.index) != 0) if by_session else 0.0
    series = _Series(radius_m - basis @ (basis.T @ radius_m), basis, begins)
    order = autocorrelation(series)
    if order.rho == 0.0:
        return estimate, order
    correlated = series.correlated(basis, order.rho)
    cross = basis.T @ correlated
    # expected residual squares over a run's variance, and their degrees of freedom (Satterthwaite)
    expected = n - float(np.trace(cross))
    square = float(series.correlated(np.ones((n, 1)), order.rho**2).sum())
    dof = expected**2 / max(square - 2.0 * float(np.sum(correlated**2)) + float(np.sum(cross**2)), 1.0)
    # variance of each coefficient over that of independent runs
    solve = np.linalg.pinv(columns)
    spread = solve @ series.correlated(np.ascontiguousarray(solve.T), order.rho)
    ratio = np.diag(spread) / np.diag(solve @ solve.T) * series.dof / expected
    scale = np.sqrt(np.array([ratio[0], ratio[-1]]))
    if by_session:
        # within sessions only the slope is estimated; the mean comes from between them
        scale = np.full(2, scale[1])
    factor = np.maximum(scale, 1.0)
    wider = estimate.cov_within * np.outer(factor, factor)
    estimate = replace(estimate, cov_within=wider, dof_within=min(estimate.dof_within, max(dof, 1.0)))
    return estimate, replace(order, slope_ratio=float(factor[1]))


def outliers(basis: FloatArray, residual: FloatArray, most: int) -> list[tuple[int, float, float]]:
    """Return the `most` extreme runs, each omitted before the next: run, studentised residual, p-value.

    Generalised ESD test (Rosner, Technometrics 25 (1983) 165). `basis`: orthonormal columns of the design, (n_runs, k);
    `residual`: about it, (n_runs,).
    """
    residual, slack, extremes = residual.copy(), 1.0 - np.sum(basis**2, axis=1), []
    squares = float(residual @ residual)
    for dof in range(len(residual) - basis.shape[1] - 1, 1, -1)[:most]:
        free, left = slack > FITTED_EXACTLY, float(residual @ residual)
        # externally studentised
        others = np.maximum(left - residual[free] ** 2 / slack[free], 1e-12 * squares) / dof
        size = np.zeros_like(residual)
        size[free] = np.abs(residual[free]) / np.sqrt(others * slack[free])
        worst = int(np.argmax(size))
        extremes.append((worst, float(size[worst]), min(float(2 * free.sum() * stdtr(dof, -size[worst])), 1.0)))
        column = (np.arange(len(residual)) == worst) - basis @ basis[worst]
        column /= np.sqrt(np.maximum(slack[worst], FITTED_EXACTLY))
        residual, slack = residual - column * (column @ residual), slack - column**2
        basis = np.column_stack((basis, column))
    return extremes


def deletion_effect(
    line: FloatArray, basis: FloatArray, residual: FloatArray, out: list[int]
) -> tuple[FloatArray, float, int]:
    """Return how far runs `out` lie off the others, their squared change of the line over a run's variance, its dof.

    `line`: columns of the line itself, (n_runs, 1 or 2); see `outliers`.
    """
    n, alone = len(residual), np.equal.outer(np.arange(len(residual)), out).astype(np.float64)
    design = np.column_stack((basis, alone))
    off, _, rank, _ = np.linalg.lstsq(design, residual, rcond=1e-10)
    left, dof = residual - design @ off, max(n - int(rank), 1)
    others = np.linalg.lstsq(np.column_stack((line, alone)), residual, rcond=None)[0][: line.shape[1]]
    change = line @ (np.linalg.lstsq(line, residual, rcond=None)[0] - others)
    return floats(off[basis.shape[1] :]), float(change @ change) / max(float(left @ left) / dof, 1e-30), dof
