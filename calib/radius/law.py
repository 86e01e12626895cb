"""The radius law of a wheel, effective radius against load: coefficients, covariance by stratum, and intervals.

Critical values by Trickett and Welch, Biometrika 41 (1954) 361; see `docs/report.md`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri, ndtr, stdtr, stdtridf, stdtrit

from calib.documents import plain_fields
from calib.types import BoolArray, FloatArray, floats

JOINT: Final = ("radius_left_m", "slope_left_m_per_N", "radius_right_m", "slope_right_m_per_N", "track_m")
#: of all intervals, and the quantile at their upper end
COVERAGE: Final = 0.95
UPPER: Final = 0.5 + COVERAGE / 2
#: shares of the between part for which critical values are solved
SHARES: Final = 0.5 * (1 - np.cos(np.pi * np.arange(25) / 24))
#: half steps of the solution; the coverage is then right to 0.15 %
WELCH_ITERATIONS: Final = 12
#: with fewer (two sessions) each part has its own t: equal nodes miss the tail (coverage 92.6 %)
FEWEST_BETWEEN_DOF: Final = 2.0
#: nodes of equal probability of a chi-squared of few and of many degrees of freedom
NODES_FEW_DOF: Final = 64
NODES_MANY_DOF: Final = 16
MANY_DOF: Final = 20.0
#: stands for infinitely many: Student's t is then normal to six digits
LARGEST_DOF: Final = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class WheelLaw:
    """Linear law of one wheel, r_e(F) = radius_ref + slope (F - reference_load).

    Of bonded solid rubber the slope can have either sign.
    """

    reference_load_N: float
    radius_ref_m: float
    #: change of the radius with load; 0 in a reduced model
    slope_m_per_N: float
    #: covariance of (radius_ref_m, slope_m_per_N), shape (2, 2)
    covariance: FloatArray
    #: degrees of freedom of `covariance`; see `strata`
    dof: float
    #: standard deviation of a single run, in a session of its own, about the law; 0: not estimated
    residual_std_m: float
    #: measured range (a coefficient file's valid range); beyond, the law extrapolates
    load_min_N: float
    load_max_N: float
    n_runs: int
    #: runs' and sessions' parts of covariance and scatter, which give each load its degrees of freedom; None: `dof`
    strata: "LineEstimate | None" = None

    def radius_m(self, load_N: ArrayLike) -> FloatArray:
        """Return the effective radius at `load_N` (any shape), same shape, in m."""
        return np.asarray(self.radius_ref_m + self.slope_m_per_N * (floats(load_N) - self.reference_load_N))

    def mean_std_m(self, load_N: ArrayLike) -> FloatArray:
        """Return the standard uncertainty of the mean radius at `load_N` (any shape), same shape, in m."""
        return self.std_of(self.contrast(load_N))

    def std_of(self, contrast: ArrayLike) -> FloatArray:
        """Return the standard uncertainty of ``contrast @ (radius_ref, slope)`` (shape (..., 2)), shape (...)."""
        c = floats(contrast)
        return np.asarray(np.sqrt(np.maximum(np.einsum("...i,ij,...j->...", c, self.covariance, c), 0.0)))

    def half_width_m(self, load_N: ArrayLike, *, single_run: bool = False) -> FloatArray:
        """Return the half width of the 95 % band at `load_N` (any shape), same shape, in m.

        Of the mean, or of a `single_run` in a session of its own. NaN without degrees of freedom, or scatter of runs.
        """
        contrast = self.contrast(load_N)
        if single_run and not self.residual_std_m:
            return np.full(contrast.shape[:-1], np.nan)
        if self.strata is not None:
            return self.strata.half_width(contrast, single_run=single_run)
        std = np.hypot(self.mean_std_m(load_N), self.residual_std_m if single_run else 0.0)
        return np.asarray(std * (stdtrit(self.dof, UPPER) if self.dof > 0 else np.nan))

    def dof_of(self, contrast: ArrayLike, *, single_run: bool = False) -> FloatArray:
        """Return the degrees of freedom of the 95 % band of ``contrast @ (radius_ref, slope)``, shape (..., 2)."""
        c = floats(contrast)
        if self.strata is None:
            return np.full(c.shape[:-1], self.dof)
        return self.strata.dof(c, single_run=single_run)

    def contrast(self, load_N: ArrayLike) -> FloatArray:
        """Return (1, load above the reference), (..., 2), at `load_N` (any shape)."""
        offset = floats(load_N) - self.reference_load_N
        return np.stack((np.ones_like(offset), offset), axis=-1)


def half_width(scales: FloatArray, dof: Sequence[float]) -> float:
    """Return the 97.5 % quantile of one Student variate or a sum of two, each times its scale."""
    from scipy.optimize import brentq

    if len(scales) == 1:
        return float(scales[0] * stdtrit(dof[0], UPPER))
    large, small = (0, 1) if scales[0] >= scales[1] else (1, 0)
    if scales[large] <= 0.0:
        return 0.0
    share = float(scales[small] / scales[large])
    # double-exponential nodes of probability (Takahasi and Mori 1974), half of them by symmetry: right to 1e-7
    at = np.arange(-600, 1) / 200
    probability = 1.0 / (1.0 + np.exp(-np.pi * np.sinh(at)))
    weight = np.cosh(at) * probability * (1.0 - probability)
    points = share * stdtrit(dof[small], probability)
    points, weight = np.append(points, -points[:-1]), np.append(weight, weight[:-1])
    weight /= weight.sum()

    def beyond(q: float) -> float:
        return float(weight @ stdtr(dof[large], q - points)) - 0.975

    widest = float(stdtrit(dof[large], 0.975) + share * stdtrit(dof[small], 0.975))
    return float(scales[large] * brentq(beyond, 0.0, 2.0 * widest, xtol=1e-9))


def shared_dof(variance: FloatArray, dof: FloatArray) -> FloatArray:
    """Return the variance-weighted harmonic mean, (...), of the degrees of freedom of parts, (..., k) both."""
    weight = variance + 1e-300
    return np.asarray(weight.sum(axis=-1) / (weight / dof).sum(axis=-1))


def round_loads(low: float, high: float) -> FloatArray:
    """Return round loads above zero inside the range, else its ends."""
    for step in (100.0, 200.0, 500.0, 1000.0, 50.0, 20.0, 10.0, 5.0, 1.0):
        first, last = max(np.ceil(low / step), 1.0), np.floor(high / step)
        if 3 <= last - first + 1 <= 9:
            return floats(step * np.arange(first, last + 1))
    return np.unique(np.array([low, 0.5 * (low + high), high]))


@dataclass(frozen=True, slots=True, eq=False)
class RadiusLaw:
    """The laws of both rear wheels."""

    left: WheelLaw
    right: WheelLaw
    #: covariance of `JOINT`, fitted together, shape (5, 5), the track's 0 where not; None: the wheels are independent
    joint: FloatArray | None = None
    #: of a single run's scatter about both laws
    run_covariance_m2: float = 0.0

    @property
    def scatters(self) -> bool:
        """Whether the scatter of single runs was estimated."""
        return self.left.residual_std_m > 0.0

    def covariance(self, track_std_m: float = 0.0, *, single_run: bool = False) -> FloatArray:
        """Return the covariance of `JOINT`, shape (5, 5).

        Without `joint` wheels and track count as independent. `single_run` adds the scatter of single runs.
        """
        joint = np.zeros((len(JOINT), len(JOINT)))
        joint[:2, :2], joint[2:4, 2:4], joint[4, 4] = self.left.covariance, self.right.covariance, track_std_m**2
        if self.joint is not None:
            joint = self.joint.copy()
            joint[4, 4] = joint[4, 4] or track_std_m**2
        if single_run:
            joint[[0, 2], [0, 2]] += np.square([self.left.residual_std_m, self.right.residual_std_m])
            joint[[0, 2], [2, 0]] += self.run_covariance_m2
        return joint

    def covariance_at(
        self, loads_N: tuple[float, float], track_std_m: float = 0.0, *, single_run: bool = False
    ) -> FloatArray:
        """Return the covariance of radii at loads (left, right) and of the track, shape (3, 3); see `covariance`."""
        at = np.zeros((3, len(JOINT)))
        at[0, :2], at[1, 2:4], at[2, 4] = self.left.contrast(loads_N[0]), self.right.contrast(loads_N[1]), 1.0
        return at @ self.covariance(track_std_m, single_run=single_run) @ at.T


@dataclass(frozen=True, slots=True, eq=False)
class LineEstimate:
    """Radius at the reference load and slope, with their covariance by stratum."""

    #: shape (2,)
    coefficients: FloatArray = field(metadata={"json": False})
    #: of the scatter of runs within sessions and of sessions; 0: none
    dof_within: float
    dof_between: float
    #: of runs within a session, and of sessions (0 where negative)
    run_variance: float
    session_variance: float
    #: parts of the covariance from the scatter of runs and of sessions, shape (2, 2)
    cov_within: FloatArray = field(metadata={"json": "covariance_within"})
    cov_between: FloatArray = field(metadata={"json": "covariance_between"})
    #: ratio of the two mean squares; F(dof_between, dof_within) where sessions do not scatter
    session_f: float | None
    #: the within part is heteroscedasticity-consistent (MacKinnon and White 1985)
    hc3: bool
    #: ``crossed`` (slope from within sessions), ``confounded`` (from session means only), ``mixed``, ``single`` (one
    #: session, or not to be told from runs) or ``constant`` (no slope)
    design: str
    #: change of the coefficients by a standard uncertainty of each systematic source, shape (n_sources, 2), and its
    #: degrees of freedom
    systematic: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    systematic_dof: FloatArray = field(default_factory=lambda: np.zeros(0))

    @staticmethod
    def one_stratum(
        design: str, coefficients: FloatArray, covariance: FloatArray, dof: float, variance: float, *, hc3: bool = False
    ) -> "LineEstimate":
        """Return an estimate of independent runs; see `LineEstimate`; `variance`: of a single run."""
        return LineEstimate(coefficients, dof, 0.0, variance, 0.0, covariance, np.zeros((2, 2)), None, hc3, design)

    @property
    def cov_systematic(self) -> FloatArray:
        """Part of the covariance that no number of runs makes smaller, shape (2, 2)."""
        return self.systematic.T @ self.systematic

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the coefficients, shape (2, 2)."""
        return self.cov_within + self.cov_between + self.cov_systematic

    def half_width(self, contrast: ArrayLike, *, single_run: bool = False) -> FloatArray:
        """Return the half width of the interval of ``contrast @ coefficients``, shape (...).

        `contrast` (shape (..., 2)): (1, 0) is the radius, (0, 1) the slope; `single_run`: of a further run in a session
        of its own.
        """
        total, share = self._variance(contrast, single_run)
        random = critical_value(share, self.dof_between, self.dof_within) * np.sqrt(total)
        if self.sessions_agree:
            # never narrower than of independent runs
            independent = self._variance(contrast, single_run, self.session_f or 1.0)[0]
            random = np.maximum(random, stdtrit(self.dof_within, UPPER) * np.sqrt(independent))
        if not len(self.systematic):
            return random
        each = floats(contrast) @ self.systematic.T
        factor = stdtrit(np.minimum(self.systematic_dof, LARGEST_DOF), UPPER)
        return np.asarray(np.hypot(random, np.sqrt(np.sum((each * factor) ** 2, axis=-1))))

    @property
    def radius_ref_ci95_m(self) -> tuple[float, float]:
        """95 % interval of the radius at the reference load."""
        return self._interval(0)

    @property
    def slope_ci95_m_per_N(self) -> tuple[float, float]:
        """95 % interval of the slope."""
        return self._interval(1)

    def _interval(self, index: int) -> tuple[float, float]:
        value, half = self.coefficients[index], self.half_width(np.eye(2)[index])
        return float(value - half), float(value + half)

    def dof(self, contrast: ArrayLike, *, single_run: bool = False) -> FloatArray:
        """Return the degrees of freedom whose Student's t gives `half_width`, shape (...)."""
        total, share = self._variance(contrast, single_run)
        if len(self.systematic) or self.sessions_agree:
            std = np.sqrt(total + np.sum((floats(contrast) @ self.systematic.T) ** 2, axis=-1))
            return equivalent_dof(self.half_width(contrast, single_run=single_run) / np.where(std > 0, std, 1.0))
        dof = equivalent_dof(critical_value(share, self.dof_between, self.dof_within))
        return np.where(share <= 0, self.dof_within, np.where(share >= 1, self.dof_between, dof))

    @property
    def sessions_agree(self) -> bool:
        """Whether sessions agree better than the scatter of their runs lets expect."""
        return self.session_f is not None and 0.0 < self.session_f < 1.0

    def _variance(self, contrast: ArrayLike, single_run: bool, ratio: float = 1.0) -> tuple[FloatArray, FloatArray]:
        # variance of runs and sessions, and the sessions' share of it; ratio: divisor of the sessions' covariance
        c = floats(contrast)
        scatter = c[..., 0] ** 2 * single_run
        parts = ((self.cov_within, self.run_variance), (self.cov_between / ratio, self.session_variance))
        within, between = (
            np.maximum(np.einsum("...i,ij,...j->...", c, part, c), 0.0) + scatter * variance for part, variance in parts
        )
        total = np.asarray(within + between)
        return total, np.where(total > 0, between / np.where(total > 0, total, 1.0), 0.0)

    def to_dict(self) -> dict[str, Any]:
        """Return all but the coefficients as plain values."""
        document = plain_fields(self)
        unused = () if len(self.systematic) else ("systematic", "systematic_dof")
        return {key: value for key, value in document.items() if key not in unused}


@lru_cache(maxsize=64)
def critical_curve(dof_between: float, dof_within: float) -> FloatArray:
    """Return the critical values at the observed `SHARES` of the between part, (25,); read-only: wheels share it.

    They go from Student's t of `dof_within` to that of `dof_between`, both above 0.
    """
    if dof_between < FEWEST_BETWEEN_DOF:
        within, between = stdtrit([dof_within, dof_between], UPPER)
        return np.asarray(np.sqrt(SHARES * between**2 + (1.0 - SHARES) * within**2))
    q_between, q_within = np.meshgrid(_nodes(dof_between), _nodes(dof_within), indexing="ij")
    share = SHARES[:, None, None]
    variance = share * q_between + (1 - share) * q_within
    observed = share * q_between / variance
    spread = np.sqrt(variance)
    ends = floats(stdtrit([dof_within, dof_between], UPPER))
    pooled_t = float(stdtrit(dof_within + dof_between, UPPER))
    curve = np.asarray(ends[0] + (ends[1] - ends[0]) * SHARES)
    for _ in range(WELCH_ITERATIONS):
        reach = np.interp(observed, SHARES, curve) * spread
        covered = np.mean(2 * ndtr(reach) - 1, axis=(1, 2))
        rate = np.mean(2 * spread * np.exp(-0.5 * reach**2) / np.sqrt(2 * np.pi), axis=(1, 2))
        # half steps: a neighbour's change moves the coverage too
        curve = np.clip(curve + 0.5 * (COVERAGE - covered) / rate, pooled_t, ends.max())
        curve[0], curve[-1] = ends
        if ends[1] >= ends[0]:
            # beyond its minimum a critical value never falls: sessions have fewer degrees of freedom
            low = int(np.argmin(curve))
            curve[low:] = np.maximum.accumulate(curve[low:])
    curve.flags.writeable = False
    return curve


def critical_value(share: ArrayLike, dof_between: float, dof_within: float) -> FloatArray:
    """Return the critical value for observed shares, V_between over the sum V; it multiplies sqrt(V).

    Degrees of freedom are 0 where there is no such part.
    """
    observed = floats(share)
    within = stdtrit(dof_within, UPPER) if dof_within > 0 else np.nan
    between = stdtrit(dof_between, UPPER) if dof_between > 0 else np.nan
    if dof_between <= 0 or not (observed > 0).any():
        return np.full(observed.shape, within)
    if dof_within <= 0 or not (observed < 1).any():
        return np.full(observed.shape, between)
    return np.asarray(np.interp(observed, SHARES, critical_curve(dof_between, dof_within)))


def equivalent_dof(critical: ArrayLike) -> FloatArray:
    """Return the degrees of freedom, 1 to 1e6, whose Student's t is `critical`."""
    return np.asarray(np.clip(np.nan_to_num(stdtridf(UPPER, floats(critical)), nan=LARGEST_DOF), 1.0, LARGEST_DOF))


def _nodes(dof: float) -> FloatArray:
    n = NODES_MANY_DOF if dof > MANY_DOF else NODES_FEW_DOF
    quantiles = np.asarray(chdtri(dof, (np.arange(n) + 0.5) / n)) / dof
    return np.asarray(quantiles / quantiles.mean())


def within_law(law: RadiusLaw, load_left_N: FloatArray, load_right_N: FloatArray) -> BoolArray:
    """Return whether both loads lie within a newton of the law's range, shape (n,)."""
    loads = ((law.left, load_left_N), (law.right, load_right_N))
    inside = [(load >= law.load_min_N - 1.0) & (load <= law.load_max_N + 1.0) for law, load in loads]
    return np.asarray(np.all(inside, axis=0))
