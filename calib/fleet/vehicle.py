"""A vehicle's record: both wheels' laws from its files' sums by session, with intervals and drift.

Intervals allow for autocorrelated runs as in `calib.radius`; the slope's variance grows by ``(1 + rho phi) /
(1 - rho phi)``, ``phi`` the lag-one autocorrelation of the loads (Bartlett 1935).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, Final

import numpy as np
from scipy.special import ndtr

from calib.radius import RHO_BELOW_P, RHO_MIN_DOF, line_of_strata, rho_of
from calib.radius.effective import SystematicSource, systematic_shift
from calib.radius.law import LineEstimate
from calib.radius.regression import SAME_LOAD
from calib.types import FloatArray, StrArray

WHEELS: Final = ("left", "right")


@dataclass(frozen=True, slots=True, eq=False)
class PartSums:
    """The runs of one file as sums."""

    name: str
    key: str
    reference_load_N: float
    radius_m: float
    sums: "Sequence[WheelSums]" = ()  #: of both wheels; `why` says why there are none
    why: str = ""
    doubtful: Sequence[str] = ()  #: checks of the law that failed
    sources: Sequence[SystematicSource] = ()
    lines: "Sequence[WheelLine]" = ()  #: of the fit of all runs of a vehicle

    @staticmethod
    def from_dict(value: Mapping[str, Any]) -> "PartSums":
        """Return what was kept."""
        sources = [SystematicSource(**{**one, "dof": one["dof"] or np.inf}) for one in value["sources"]]
        lines = [WheelLine(**{**one, "drift": one["drift"] and Drift(**one["drift"])}) for one in value["lines"]]
        sums = [*map(WheelSums.from_dict, value["sums"])]
        return PartSums(**{**value, "sums": sums, "sources": sources, "lines": lines})


@dataclass(frozen=True)
class Drift:
    """Change of a wheel's radius with time, from session means."""

    per_day_m: float
    std_m: float
    variance_m2: float
    dof: float
    last_day: float


@dataclass(frozen=True)
class WheelLine:
    """A wheel's law."""

    radius_ref_m: float
    slope_m_per_N: float
    radius_std_m: float
    slope_std_m_per_N: float
    radius_ci95_m: tuple[float, float]
    slope_ci95_m_per_N: tuple[float, float]
    autocorrelation: float
    drift: Drift | None

    @staticmethod
    def of(estimate: LineEstimate, rho: float, runs: "WheelSums") -> "WheelLine":
        """Return an estimate's figures, with the drift of its runs."""
        radius, slope = estimate.coefficients.tolist()
        std = np.sqrt(np.diag(estimate.covariance)).tolist()
        ends = (estimate.radius_ref_ci95_m, estimate.slope_ci95_m_per_N)
        return WheelLine(radius, slope, std[0], std[1], *ends, rho, _drift(runs, slope))


@dataclass(frozen=True)
class VehicleRecord:
    """What is known of a vehicle; `why` says why `left` and `right` are None."""

    vehicle: str
    n_runs: int
    left: WheelLine | None
    right: WheelLine | None
    why: str = ""
    doubtful: tuple[str, ...] = ()

    @property
    def status(self) -> str:
        """``fitted`` or ``failed``."""
        return "failed" if self.left is None or self.right is None else "fitted"

    def to_dict(self) -> dict[str, object]:
        """Return it as plain JSON values."""
        values: dict[str, object] = {"id": self.vehicle, "status": self.status, "n_runs": self.n_runs, "why": self.why}
        values["failed_checks"] = list(self.doubtful)
        for side, line in zip(WHEELS, (self.left, self.right), strict=True):
            if line is not None:
                values |= {
                    f"radius_{side}_m": line.radius_ref_m,
                    f"radius_{side}_ci95_m": list(line.radius_ci95_m),
                    f"slope_{side}_m_per_N": line.slope_m_per_N,
                    f"slope_{side}_ci95_m_per_N": list(line.slope_ci95_m_per_N),
                    f"autocorrelation_{side}": line.autocorrelation,
                    f"drift_{side}_m_per_day": line.drift and line.drift.per_day_m,
                }
        return values


def record_of(vehicle: str, parts: Sequence[PartSums]) -> VehicleRecord:
    """Return a vehicle's record from the sums of its files."""
    # sums shall not depend on the order of reading
    parts = sorted(parts, key=lambda part: part.name)
    wrong = next((part.why for part in parts if part.why), "" if parts else "it has no file of journeys")
    origins = {(part.reference_load_N, part.radius_m) for part in parts}
    if not wrong and len(origins) > 1:
        wrong = "its files have different reference loads or nominal radii; expected one campaign.toml for all"
    if wrong:
        return VehicleRecord(vehicle, 0, None, None, wrong)
    sums = [reduce(WheelSums.added, of_wheel) for of_wheel in zip(*(part.sums for part in parts), strict=True)]
    n_runs = int(sums[0].table[:, 0].sum())
    of_sums = (_line(side, one, parts[0]) for side, one in zip(WHEELS, sums, strict=True))
    left, right = parts[0].lines or of_sums
    if left is None or right is None:
        why = f"{n_runs} runs carry no line; expected three or more, at two loads or more"
        return VehicleRecord(vehicle, n_runs, None, None, why)
    doubtful = tuple(check for part in parts for check in part.doubtful)
    return VehicleRecord(vehicle, n_runs, left, right, doubtful=doubtful)


def _line(side: str, sums: "WheelSums", part: PartSums) -> WheelLine | None:
    loads = part.reference_load_N + sums.loads_N
    estimate = line_from_sums(sums)
    if estimate is None or np.ptp(loads) <= SAME_LOAD * np.abs(loads).max():
        return None
    estimate, rho = widened(estimate, sums)
    radius, slope = part.radius_m + float(estimate.coefficients[0]), float(estimate.coefficients[1])
    n, x, y, xx, xy = sums.table[:, :5].sum(axis=0)
    of_radius = _least_squares(n, x, y + n * part.radius_m, xx, xy + x * part.radius_m)
    lines = (of_radius, _least_squares(n, x, sums.whole[6], xx, sums.whole[7]))
    rows = [systematic_shift(one, side, part.reference_load_N, slope, *lines) for one in part.sources]
    systematic, dof = np.array(rows).reshape(-1, 2), np.array([one.dof for one in part.sources])
    line = replace(estimate, coefficients=np.array([radius, slope]), systematic=systematic, systematic_dof=dof)
    return WheelLine.of(line, rho, sums)


def _drift(sums: "WheelSums", slope: float) -> Drift | None:
    x, y, day = sums.means.T
    if len(day) < 4 or np.ptp(day) <= 0:
        return None
    weight = 1.0 / (1.0 + 1.0 / sums.table[:, 0])
    level = y - slope * x
    day_away = day - weight @ day / weight.sum()
    info = float(weight @ day_away**2)
    rate = float(weight @ (day_away * level)) / info
    residuals = level - weight @ level / weight.sum() - rate * day_away
    dof = len(day) - 2.0
    variance = float(weight @ residuals**2) / dof
    return Drift(rate, float(np.sqrt(variance / info)), variance, dof, float(day.max()))


@dataclass(frozen=True, slots=True, eq=False)
class WheelSums:
    """Sums over a wheel's runs, which add."""

    #: each once, in order, shape (n_sessions,)
    session: StrArray
    #: number of runs; sums of load F, radius r, F^2, F r, r^2, day, F and r from reference and nominal; sums of
    #: `_pairs` over successive runs in a session; shape (n_sessions, 13)
    table: FloatArray
    #: sums of `_pairs` over all runs of a file; of radius over distance and of its product with F; shape (8,)
    whole: FloatArray
    loads_N: FloatArray  #: least and largest, shape (2,)

    @staticmethod
    def from_runs(
        session: StrArray, load_N: FloatArray, radius_m: FloatArray, day: FloatArray, reach: FloatArray
    ) -> "WheelSums":
        """Return the sums of runs as driven; `reach`: radius over distance; see `WheelSums`."""
        labels, index = np.unique(session, return_inverse=True)
        table = np.zeros((len(labels), 13))
        terms = (np.ones_like(load_N), load_N, radius_m, load_N**2, load_N * radius_m, radius_m**2, day)
        table[:, :7] = np.stack([np.bincount(index, term, len(labels)) for term in terms], axis=1)
        together = np.argsort(index, kind="stable")
        at, pairs = index[together], _pairs(load_N[together], radius_m[together])
        same = at[1:] == at[:-1]
        np.add.at(table[:, 7:], at[1:][same], pairs[same])
        whole = [*_pairs(load_N, radius_m).sum(axis=0), reach.sum(), load_N @ reach]
        ends = np.array([load_N.min(initial=np.inf), load_N.max(initial=-np.inf)])
        return WheelSums(labels, table, np.array(whole), ends)

    @staticmethod
    def from_dict(value: Mapping[str, Any]) -> "WheelSums":
        """Return what was kept."""
        table, *others = (np.array(value[name], dtype=np.float64) for name in ("table", "whole", "loads_N"))
        return WheelSums(np.array(value["session"], dtype=np.str_), table.reshape(-1, 13), *others)

    def added(self, other: "WheelSums") -> "WheelSums":
        """Return the sums of both, sessions of one label joined."""
        labels, index = np.unique(np.concatenate([self.session, other.session]), return_inverse=True)
        table, ends = np.zeros((len(labels), 13)), np.concatenate([self.loads_N, other.loads_N])
        np.add.at(table, index, np.concatenate([self.table, other.table]))
        return WheelSums(labels, table, self.whole + other.whole, np.array([ends.min(), ends.max()]))

    @property
    def means(self) -> FloatArray:
        """Mean load, radius and day of each session, shape (n_sessions, 3)."""
        return self.table[:, [1, 2, 6]] / self.table[:, :1]


def _pairs(x: FloatArray, y: FloatArray) -> FloatArray:
    x0, x1, y0, y1 = x[:-1], x[1:], y[:-1], y[1:]
    return np.stack([np.ones_like(x0), x0 * x1, 0.5 * (x0 * y1 + y0 * x1), y0 * y1, x0 + x1, y0 + y1], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    sizes: FloatArray
    #: lag-one autocorrelation of the residuals, and of the loads where a slope is fitted
    lag_one: float
    of_loads: float | None

    def loads_ratio(self, rho: float) -> float:
        product = rho * max(self.of_loads or 0.0, 0.0)
        return (1.0 + product) / (1.0 - product)

    def expected(self, rho: float) -> tuple[float, float, float]:
        product = square = squared = 0.0
        for n, count in zip(*np.unique(self.sizes, return_counts=True), strict=True):
            powers = rho ** np.arange(n)
            # row sums of the correlation matrix
            rows = np.cumsum(powers) + np.cumsum(powers)[::-1] - 1.0
            total, alike = float(rows.sum()), float((n - np.arange(n)) @ (powers**2) * 2.0 - n)
            product += count * ((n - 1) * rho - 2.0 / n * (total - rows[0]) + (n - 1) * total / n**2)
            square += count * (n - total / n)
            squared += count * (alike - 2.0 / n * float(rows @ rows) + (total / n) ** 2)
        if self.of_loads is not None:
            ratio = self.loads_ratio(rho)
            product, square, squared = product - self.of_loads * ratio, square - ratio, squared - ratio**2
        return float(product), float(square), float(squared)

    @property
    def std(self) -> float:
        n = self.sizes
        squares = float(np.sum(0.5 * (n - 1.0) - 2.0 * (n - 1.5) / n + ((n - 1.0) / n) ** 2))
        squares -= (self.of_loads or 0.0) ** 2
        product, dof, _ = self.expected(0.0)
        return float(np.sqrt(max(2.0 * (dof * squares - product**2) / (dof**2 * (dof + 2.0)), 1e-12)))


def widened(estimate: LineEstimate, sums: WheelSums) -> tuple[LineEstimate, float]:
    """See `calib.radius.widened`."""
    blocks = _blocks_of(estimate, sums)
    if blocks is None:
        return estimate, 0.0
    product, dof, _ = blocks.expected(0.0)
    std = blocks.std
    if dof < RHO_MIN_DOF or float(ndtr((product / dof - blocks.lag_one) / std)) >= RHO_BELOW_P:
        return estimate, 0.0
    rho = rho_of(blocks.lag_one + std, lambda rho: np.divide(*blocks.expected(rho)[:2]))
    _, square, squared = blocks.expected(rho)
    of_slope = blocks.loads_ratio(rho) * dof / square
    scale = np.full(2, of_slope)
    if not estimate.dof_between > 0:
        n, x, _, xx = sums.table[:, :4].sum(axis=0).tolist()
        of_mean = float(2.0 * np.cumsum(rho ** np.arange(n)).sum() - n) / n * dof / square
        lever = (x / n) ** 2 / (xx - x**2 / n)
        scale[0] = (of_slope * lever + of_mean / n) / (lever + 1.0 / n)
    factor = np.sqrt(np.maximum(scale, 1.0))
    cov_within = estimate.cov_within * np.outer(factor, factor)
    dof_within = min(estimate.dof_within, max(square**2 / max(squared, 1.0), 1.0))
    return replace(estimate, cov_within=cov_within, dof_within=dof_within), rho


def _blocks_of(estimate: LineEstimate, sums: WheelSums) -> _Blocks | None:
    n, x, y, xx, xy, yy = sums.table[:, :6].T
    pairs, xx1, xy1, yy1, x_both, y_both = sums.table[:, 7:].T
    if not estimate.dof_between > 0:
        n, x, y, xx, xy, yy = sums.table[:, :6].sum(axis=0, keepdims=True).T
        pairs, xx1, xy1, yy1, x_both, y_both = sums.whole[:6, None]
    x_mean, y_mean = x / n, y / n
    info, cross, square = (
        (own - n * one * other).sum()
        for own, one, other in ((xx, x_mean, x_mean), (xy, x_mean, y_mean), (yy, y_mean, y_mean))
    )
    near_xx = float((xx1 - x_mean * x_both + pairs * x_mean**2).sum())
    near_xy = float((xy1 - 0.5 * (x_mean * y_both + y_mean * x_both) + pairs * x_mean * y_mean).sum())
    near_yy = float((yy1 - y_mean * y_both + pairs * y_mean**2).sum())
    with_slope = estimate.design != "confounded" and info > 0.0
    slope = cross / info if with_slope else 0.0
    residual = square - slope * cross
    if not residual > 0.0:
        return None
    lag_one = float((near_yy - 2.0 * slope * near_xy + slope**2 * near_xx) / residual)
    return _Blocks(n[n > 1.0], lag_one, float(near_xx / info) if with_slope else None)


#: sums of squares count as zero below this share
ROUNDING: Final = 1e-12


def line_from_sums(sums: WheelSums) -> LineEstimate | None:
    """Return `stratified_line` without HC3; a plain one where sessions tell nothing."""
    sizes, x, y, xx, xy, yy = sums.table[:, :6].T
    n, n_sessions = float(sizes.sum()), len(sizes)
    if n < 3:
        return None
    if not 2 <= n_sessions < n:
        return _plain(sums)
    x_mean, y_mean, _ = sums.means.T
    info, cross, square = (float(part.sum()) for part in (xx - x * x_mean, xy - x * y_mean, yy - y * y_mean))
    if not info + float(np.ptp(x_mean)) ** 2 > ROUNDING * max(float(xx.sum()), 1.0):
        return None
    slope = cross / info if info > 0 else 0.0
    squares = square, max(square - slope * cross, 0.0)
    return line_of_strata(sizes, x_mean, y_mean, info, slope, *squares) or _plain(sums)


def _plain(sums: WheelSums) -> LineEstimate | None:
    n, x, y, xx, xy, yy = sums.table[:, :6].sum(axis=0)
    info = xx - x * x / n
    if n < 3 or not info > ROUNDING * max(xx, 1.0):
        return None
    coefficients, mean = _least_squares(n, x, y, xx, xy), x / n
    variance = max(yy - y * y / n - coefficients[1] * (xy - x * y / n), 0.0) / (n - 2)
    covariance = variance * (np.array([[mean**2, -mean], [-mean, 1.0]]) / info + np.diag([1.0 / n, 0.0]))
    return LineEstimate.one_stratum("single", coefficients, covariance, float(n - 2), float(variance))


def _least_squares(n: float, x: float, y: float, xx: float, xy: float) -> FloatArray:
    slope = (xy - x * y / n) / (xx - x * x / n)
    return np.array([(y - slope * x) / n, slope])
