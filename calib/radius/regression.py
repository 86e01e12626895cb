"""Regression of one wheel's radius on its load: coefficients, intervals, bands (Figs 10 and 11)."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtr, stdtrit

from calib.documents import plain, plain_fields
from calib.errors import RefusedError
from calib.radius import Autocorrelation, Groups, groups_of, needs_hc3, stratified_constant, stratified_line, widened
from calib.radius.law import UPPER, LineEstimate, RadiusLaw, WheelLaw
from calib.types import BoolArray, FloatArray, IntArray, StrArray, floats

if TYPE_CHECKING:
    from statsmodels.regression.linear_model import RegressionResults

Plain = TypeVar("Plain")

#: loads nearer than this share of the largest count as one load
SAME_LOAD: Final = 0.02
RUN_ARRAYS: Final = ("load_N", "radius_m", "residual_m", "leverage", "cook")
_DOCUMENT: Final = (
    "reference_load_N", "intercept_m", "radius_ref_ci95_m", "slope_ci95_m_per_N", "r_squared", "residual_std_m",
    "dof_radius_ref", "model", "design", "run_std_m", "session_std_m", "checks",
)  # fmt: skip
#: fewest degrees of freedom of the scatter about a further slope
MIN_SLOPE_DOF: Final = 5
#: p-values below which a check gives a note, and fails: with nine checks a wheel 5 % would give a false note in every
#: third campaign
NOTE_BELOW: Final = 0.01
FAIL_BELOW: Final = 1e-4
UM: Final = 1e6
#: levels of a check: usable; with caution; not as it is
OK: Final = "ok"
NOTE: Final = "note"
FAILED: Final = "failed"


@dataclass(frozen=True, slots=True)
class Check:
    """One check of a fit: a statistic, and its meaning and remedy in a sentence."""

    name: str
    #: ``ok``, ``note`` or ``failed``
    level: str
    sentence: str
    #: None where the check has none, or could not be made
    statistic: float | None = None
    statistic_name: str = ""
    #: of the statistic where nothing is wrong
    p_value: float | None = None

    @property
    def passed(self) -> bool:
        """Whether the result can be used as it is (``ok`` and ``note``)."""
        return self.level != FAILED

    def to_dict(self) -> dict[str, Any]:
        """Return the check as plain values; an infinite statistic is null."""
        return plain_fields(self, passed=self.passed)


def p_check(
    name: str, statistic: float, statistic_name: str, p_value: float, sentences: tuple[str, str], *, fails: bool = False
) -> Check:
    """Return the check of a significance test; see `Check`.

    `sentences`: without and with a finding; `fails`: whether a p-value below `FAIL_BELOW` forbids the law.
    """
    level = FAILED if fails and p_value < FAIL_BELOW else NOTE if p_value < NOTE_BELOW else OK
    return Check(name, level, sentences[p_value < NOTE_BELOW], float(statistic), statistic_name, p_value)


def t_check(
    name: str, slope: float, sd: float, dof: float, sentences: tuple[str, str], *, fails: bool = False
) -> Check:
    """Return the check of a slope by Student's t; see `p_check`."""
    statistic = slope / sd if sd > 0.0 else 0.0
    return p_check(name, statistic, f"t({dof:.3g})", float(2 * stdtr(dof, -abs(statistic))), sentences, fails=fails)


@dataclass(frozen=True, eq=False)
class WheelFit:
    """One wheel's fit: the session-aware estimate, its runs and its checks."""

    #: ``left`` or ``right``
    wheel: str
    #: see `calib.radius.law.LineEstimate`
    design: str
    reference_load_N: float
    estimate: LineEstimate
    #: the same by ordinary least squares, every run counted as independent; None for a constant
    naive: LineEstimate | None
    r_squared: float
    #: over the runs' degrees of freedom
    residual_std_m: float
    #: loads, radii, and radius minus law, shape (n_runs,)
    load_N: FloatArray
    radius_m: FloatArray
    residual_m: FloatArray
    #: leverage and Cook's distance of each run in the ordinary least-squares line, shape (n_runs,)
    leverage: FloatArray
    cook: FloatArray
    #: see `calib.radius.checks`
    checks: tuple[Check, ...] = ()
    #: of consecutive runs; None in a fit read from a file, whose estimate allows for it already
    autocorrelation: Autocorrelation | None = None

    @property
    def model(self) -> str:
        """``line``, or ``constant`` where the loads do not carry a slope."""
        return "constant" if self.design == "constant" else "line"

    @cached_property
    def law(self) -> WheelLaw:
        """The law for odometry and export; its ``dof`` is the smaller of those of radius and slope."""
        radius, slope = self.estimate.coefficients.tolist()
        return WheelLaw(
            reference_load_N=self.reference_load_N,
            radius_ref_m=radius,
            slope_m_per_N=slope,
            covariance=self.estimate.covariance,
            dof=float(self._dof.min()) if self.model == "line" else self.dof_radius_ref,
            residual_std_m=float(np.sqrt(self.estimate.run_variance + self.estimate.session_variance)),
            load_min_N=float(self.load_N.min()),
            load_max_N=float(self.load_N.max()),
            n_runs=len(self.load_N),
            strata=self.estimate,
        )

    @cached_property
    def _dof(self) -> FloatArray:
        return self.estimate.dof(np.eye(2))

    @property
    def dof_radius_ref(self) -> float:
        """Degrees of freedom of the radius at the reference load."""
        return float(self._dof[0])

    @property
    def dof_slope(self) -> float:
        """Degrees of freedom of the slope; 0 for a constant."""
        return float(self._dof[1]) if self.model == "line" else 0.0

    @property
    def intercept_m(self) -> float:
        """Radius at zero load, extrapolated."""
        return self.law.radius_ref_m - self.law.slope_m_per_N * self.reference_load_N

    @property
    def run_std_m(self) -> float:
        """Standard deviation of runs within a session."""
        return float(np.sqrt(self.estimate.run_variance))

    @property
    def session_std_m(self) -> float:
        """Standard deviation of sessions."""
        return float(np.sqrt(self.estimate.session_variance))

    @property
    def radius_ref_ci95_m(self) -> tuple[float, float]:
        """See `LineEstimate`."""
        return self.estimate.radius_ref_ci95_m

    @property
    def slope_ci95_m_per_N(self) -> tuple[float, float] | None:
        """95 % interval of the slope; None for a constant."""
        return self.estimate.slope_ci95_m_per_N if self.model == "line" else None

    def band_m(self, load_N: ArrayLike, *, single_run: bool) -> tuple[FloatArray, FloatArray]:
        """Return the ends of the 95 % band at wheel loads, in m (Fig. 11): of the mean, or of a further run."""
        centre, half = self.law.radius_m(load_N), self.law.half_width_m(load_N, single_run=single_run)
        return centre - half, centre + half

    def design_basis(self, session: StrArray, known: BoolArray | slice = slice(None)) -> FloatArray:
        """Return an orthonormal basis of the design, (n_known, k): sessions, and the load where it has a slope."""
        base, load = groups_of(session[known]).indicators, self.load_N[known]
        if self.design not in {"constant", "confounded"}:
            base = np.column_stack((base, load / load.max()))
        u, size, _ = np.linalg.svd(base, full_matrices=False)
        return u[:, size > 1e-10 * size[0]]

    def to_dict(self) -> dict[str, Any]:
        """Return the fit as plain values; the contract's keys first."""
        law, line, naive = self.law, self.model == "line", self.naive
        document = {name: getattr(law, name) for name in ("n_runs", "radius_ref_m", "dof", "covariance")}
        document |= {name: getattr(self, name) for name in (*_DOCUMENT, *RUN_ARRAYS)}
        document |= {
            "slope_m_per_N": law.slope_m_per_N if line else None,
            "dof_slope": self.dof_slope if line else None,
            "load_range_N": (law.load_min_N, law.load_max_N),
            "single_run_std_m": law.residual_std_m,
            "strata": self.estimate,
            "naive": naive
            and {
                "radius_ref_m": naive.coefficients[0],
                "slope_m_per_N": naive.coefficients[1],
                "radius_ref_ci95_m": naive.radius_ref_ci95_m,
                "slope_ci95_m_per_N": naive.slope_ci95_m_per_N,
                "dof": naive.dof_within,
                "covariance": naive.covariance,
            },
        }
        return {key: plain(value) for key, value in document.items()}

    @staticmethod
    def from_dict(wheel: str, value: Mapping[str, Any]) -> "WheelFit":
        """Return the fit that `to_dict` wrote."""
        strata, naive, line = value["strata"], value["naive"], value["model"] == "line"
        scalars = ("reference_load_N", "r_squared", "residual_std_m")
        written: dict[str, Any] = {name: float(value[name]) for name in scalars}
        written |= {name: np.array(value[name], dtype=np.float64) for name in RUN_ARRAYS}
        estimate = LineEstimate(
            coefficients=np.array([float(value["radius_ref_m"]), float(value["slope_m_per_N"]) if line else 0.0]),
            cov_within=_covariance(strata["covariance_within"]),
            cov_between=_covariance(strata["covariance_between"]),
            session_f=strata["session_f"],
            hc3=bool(strata["hc3"]),
            design=str(strata["design"]),
            systematic=np.array(strata.get("systematic", []), dtype=np.float64).reshape(-1, 2),
            systematic_dof=np.array([np.inf if dof is None else dof for dof in strata.get("systematic_dof", [])]),
            **{name: float(strata[name]) for name in ("dof_within", "dof_between", "run_variance", "session_variance")},
        )
        if not np.allclose(_covariance(value["covariance"]), estimate.covariance, rtol=1e-6, atol=0.0):
            raise ValueError(f"a covariance of the {wheel} wheel's law that is not the sum of its strata")
        if naive is not None:
            line_of_runs = np.array([float(naive["radius_ref_m"]), float(naive["slope_m_per_N"])])
            covariance, variance = _covariance(naive["covariance"]), written["residual_std_m"] ** 2
            naive = LineEstimate.one_stratum("single", line_of_runs, covariance, float(naive["dof"]), variance)
        checks = tuple(from_plain(Check, check) for check in value["checks"])
        return WheelFit(wheel, design=str(value["design"]), estimate=estimate, naive=naive, checks=checks, **written)


def _covariance(rows: Any) -> FloatArray:
    matrix = np.array(rows, dtype=np.float64)
    if matrix.shape != (2, 2) or not (np.isfinite(matrix).all() and (np.diag(matrix) >= 0.0).all()):
        raise ValueError(f"{str(rows)[:60]} where the covariance of radius and slope, 2 by 2, is expected")
    return matrix


def from_plain(kind: type[Plain], value: Any) -> Plain:
    """Return the dataclass of a JSON object, its types checked, numbers not taken from text.

    Raises ValueError where a key is missing or of the wrong kind.
    """
    from pydantic import TypeAdapter

    return TypeAdapter(kind).validate_json(json.dumps(value), strict=True)


def t_quantile(dof: ArrayLike) -> FloatArray:
    """Return Student's t such that ``+-t`` covers 95 % with `dof` degrees of freedom."""
    return np.asarray(stdtrit(floats(dof), UPPER))


def distinct_loads(load_N: FloatArray) -> int:
    """Return how many distinct loads there are; see `load_groups`."""
    return int(load_groups(load_N).max()) + 1


def load_groups(load_N: FloatArray) -> IntArray:
    """Return the load group of each run, shape (n_runs,); loads within 2 % of the largest count as one."""
    width, group = SAME_LOAD * float(np.max(np.abs(load_N))), np.zeros(len(load_N), dtype=np.int64)
    number, start = 0, float(load_N.min())
    for index in np.argsort(load_N, kind="stable"):
        if load_N[index] - start > width:
            number, start = number + 1, float(load_N[index])
        group[index] = number
    return group


def fit_wheel(
    wheel: str, load_N: ArrayLike, radius_m: ArrayLike, session: ArrayLike, *, reference_load_N: float
) -> WheelFit:
    """Fit one wheel's law: a line, or a constant on one load; see `with_checks`.

    Arrays of shape (n_runs,); `reference_load_N`: load on which the coefficients are centred. Raises RefusedError with
    fewer than three runs.
    """
    load, radius = floats(load_N), floats(radius_m)
    if len(load) < 3:
        fault = f"{wheel} wheel: found {len(load)} usable runs; expected three or more"
        raise RefusedError(f"{fault}; drive more corridor runs, or see 'calib check' for why runs were omitted")
    groups = groups_of(session)
    grouped = 2 <= len(groups) < len(load)
    if distinct_loads(load) == 1:
        reference_load_N, x = float(load.mean()), np.zeros_like(load)
        ols = least_squares(None, radius)
        naive, estimate = None, stratified_constant(radius, groups)
    else:
        x = load - reference_load_N
        ols = least_squares(x, radius)
        naive = independent_line(ols)
        estimate = (stratified_line(x, radius, groups) if grouped else None) or independent_line(ols, x)
    estimate, autocorrelation = widened(estimate, x if naive else None, radius, groups)
    # confounded also where there are too few sessions to estimate their scatter
    design = "confounded" if grouped and estimate.design == "single" else estimate.design
    influence = ols.get_influence()
    with np.errstate(divide="ignore", invalid="ignore"):
        cook = np.nan_to_num(influence.cooks_distance[0], nan=0.0, posinf=0.0)
    return WheelFit(
        wheel=wheel,
        design=design,
        reference_load_N=reference_load_N,
        estimate=estimate,
        naive=naive,
        r_squared=float(ols.rsquared) if naive and ols.centered_tss > 0 else 0.0,
        residual_std_m=float(np.sqrt(ols.mse_resid)),
        load_N=load,
        radius_m=radius,
        residual_m=radius - estimate.coefficients[0] - estimate.coefficients[1] * x,
        leverage=np.asarray(influence.hat_matrix_diag),
        cook=np.asarray(cook),
        autocorrelation=autocorrelation,
    )


def least_squares(x: FloatArray | None, y: FloatArray) -> "RegressionResults":
    """Return the ordinary least-squares fit of ``y = a + b x``, shape (n_runs,) both; None for x: of a constant."""
    from statsmodels.regression.linear_model import OLS

    return OLS(y, np.column_stack([np.ones_like(y)] if x is None else [np.ones_like(y), x])).fit(method="qr")


def independent_line(ols: "RegressionResults", x: FloatArray | None = None) -> LineEstimate:
    """Return a least-squares line of independent runs.

    `x` (shape (n_runs,)): load minus reference load, for HC3 where the scatter depends on it; None: never.
    """
    hc3 = x is not None and needs_hc3(ols.resid, x, ols.df_resid)
    covariance, dof = ols.cov_HC3 if hc3 else ols.cov_params(), float(ols.df_resid)
    return LineEstimate.one_stratum("single", ols.params, covariance, dof, float(ols.mse_resid), hc3=bool(hc3))


def paired_law(left: WheelFit, right: WheelFit, groups: Groups) -> RadiusLaw:
    """Return the law of both wheels with the covariance between them, from paired residuals.

    Mean and difference of both radii then have the variance that a fit of their own gives them.
    """
    wheels, estimates = (left, right), (left.estimate, right.estimate)
    residuals, of_sessions = [wheel.residual_m for wheel in wheels], 0.0
    if all(estimate.dof_between > 0.0 for estimate in estimates):
        of_sessions = _cosine(*(np.sqrt(groups.weights) * groups.means(residual) for residual in residuals))
        residuals = [groups.within(residual) for residual in residuals]
    of_runs = _cosine(*residuals)
    of_loads = _cosine(*(wheel.load_N - wheel.load_N.mean() for wheel in wheels))
    block = of_runs * _if_fully_correlated(estimates[0].cov_within, estimates[1].cov_within, of_loads)
    block += of_sessions * _if_fully_correlated(estimates[0].cov_between, estimates[1].cov_between, of_loads)
    block += estimates[0].systematic.T @ estimates[1].systematic
    joint = RadiusLaw(left.law, right.law).covariance()
    joint[:2, 2:4], joint[2:4, :2] = block, block.T
    variances = ([getattr(one, f"{of}_variance") for one in estimates] for of in ("run", "session"))
    scatter = np.dot((of_runs, of_sessions), [np.sqrt(np.prod(pair)) for pair in variances])
    return RadiusLaw(left.law, right.law, joint, float(scatter))


def _cosine(one: FloatArray, other: FloatArray) -> float:
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.clip(one @ other / size, -1.0, 1.0)) if size > 0.0 else 0.0


def _if_fully_correlated(left: FloatArray, right: FloatArray, of_loads: float) -> FloatArray:
    # covariance between both wheels' coefficients, (2, 2), if runs erred alike; of_loads: correlation of their loads
    slopes, means = [], []
    for covariance in (left, right):
        slope = covariance[:, 1] / np.sqrt(covariance[1, 1]) if covariance[1, 1] > 0.0 else np.zeros(2)
        slopes.append(slope)
        means.append(max(covariance[0, 0] - slope[0] ** 2, 0.0))
    between = of_loads * np.outer(*slopes)
    between[0, 0] += np.sqrt(means[0] * means[1])
    return between
