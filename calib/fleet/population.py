"""Statistics over vehicles: mean and spread between them (random effects), outliers, labels that differ."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final
from warnings import catch_warnings

import numpy as np

from calib.types import BoolArray, FloatArray, floats

COVERAGE: Final = 0.95
#: of those named, this share may be named wrongly (Benjamini and Hochberg); a vehicle named costs a visit, and at a
#: hundredth a list of twenty holds a wrong one in one fleet of five
FALSE_SHARE: Final = 0.01
#: chance that any of a short list is named wrongly (Holm): one wrong name among five is no small share
FALSE_CHANCE: Final = 0.01
#: median of |z| of a standard normal
MEDIAN_ABS: Final = 0.6744897501960817
#: robust standard deviations from which on a vehicle has no say in the fleet's mean and spread; a median deviation of
#: some tens of vehicles may be a third too small, and 5 of those is still what one normal vehicle in a thousand reaches
FAR: Final = 5.0
#: median deviations to which values are drawn in before labels are compared, so that no vehicle speaks for all
DRAWN_IN: Final = 4.0
#: a variance that keeps quotients finite where all vehicles and their uncertainties are equal
SMALLEST_VARIANCE: Final = 1e-300


@dataclass(frozen=True, slots=True)
class Population:
    """A quantity over the fleet."""

    mean: float
    mean_ci95: tuple[float, float]
    spread: float
    spread_ci95: tuple[float, float]
    within: float
    n: int


def population(values: FloatArray, std: FloatArray) -> Population | None:
    """Return mean and spread of a quantity over vehicles; None with fewer than three.

    `values`, `std`: of each vehicle, shape (n_vehicles,), and its standard uncertainty.
    """
    from scipy.special import chdtri, stdtrit

    n = len(values)
    if n < 3:
        return None
    variance = std**2
    tail = 0.5 * (1.0 - COVERAGE)
    targets = (float(n - 1), float(chdtri(n - 1, 1 - tail)), float(chdtri(n - 1, tail)))
    between, high, low = (_between(values, variance, target) for target in targets)
    weight = 1.0 / (between + variance)
    mean = float(weight @ values / weight.sum())
    spread_of_mean = float(np.sqrt(weight @ (values - mean) ** 2 / (n - 1) / weight.sum()))
    half = float(stdtrit(n - 1, 1 - tail)) * spread_of_mean
    return Population(
        mean=mean,
        mean_ci95=(mean - half, mean + half),
        spread=float(np.sqrt(between)),
        spread_ci95=(float(np.sqrt(low)), float(np.sqrt(high))),
        within=float(np.sqrt(np.median(variance))),
        n=n,
    )


def _between(values: FloatArray, variance: FloatArray, target: float) -> float:
    """Return the variance between vehicles at which Cochran's Q is `target`; 0 where Q is below it already."""
    variance = np.maximum(variance, 1e-30 + 1e-12 * float(np.max(variance)))

    def excess(between: float) -> float:
        weight = 1.0 / (between + variance)
        return float(weight @ (values - weight @ values / weight.sum()) ** 2) - target

    # with weights of at most 1 / between, Q is at most the sum of squares over it
    return _root(excess, float(np.sum((values - values.mean()) ** 2)) / target)


def _root(falling: Callable[[float], float], high: float) -> float:
    """Return where a falling function is zero, from 0 to `high`; 0 where it is negative there already."""
    from scipy.optimize import brentq

    if falling(0.0) <= 0.0:
        return 0.0
    return float(brentq(falling, 0.0, 2.0 * high, xtol=1e-13 * high + 1e-300, rtol=1e-14))


def outlying(values: FloatArray, std: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far each vehicle stands from the fleet, in standard deviations, and the p-value of that.

    Median and median deviation find those that may stand apart, so that they do not hide themselves; mean and spread of
    the others, better known than a median deviation, then judge every vehicle by Student's t.

    `values`, `std`: a quantity, shape (n_vehicles,), and its standard uncertainty, a part of a vehicle's deviation.
    """
    from scipy.special import stdtr

    away = np.abs(values - np.median(values))
    variance = std**2 + SMALLEST_VARIANCE

    def excess(spread: float) -> float:
        return float(np.median(away / np.sqrt(spread**2 + variance))) - MEDIAN_ABS

    spread = _root(excess, float(np.median(away)) / MEDIAN_ABS)
    usual = away / np.sqrt(spread**2 + variance) < FAR
    fleet = population(values[usual], std[usual])
    if fleet is None:
        return np.zeros(len(values)), np.ones(len(values))
    z = (values - fleet.mean) / np.sqrt(fleet.spread**2 * (1.0 + 1.0 / fleet.n) + variance)
    return np.asarray(z), np.asarray(2.0 * stdtr(fleet.n - 1.0, -np.abs(z)))


def false_discovery(p_values: FloatArray, share: float = FALSE_SHARE) -> BoolArray:
    """Return which findings stand at a false discovery rate of `share` (Benjamini and Hochberg); NaN is no finding."""
    return _standing(p_values, share, "fdr_bh")


def any_false(p_values: FloatArray, chance: float = FALSE_CHANCE) -> BoolArray:
    """Return which findings stand at a family-wise error rate of `chance` (Holm 1979); NaN is no finding."""
    return _standing(p_values, chance, "holm")


def _standing(p_values: FloatArray, alpha: float, method: str) -> BoolArray:
    from statsmodels.stats.multitest import multipletests

    p = floats(p_values)
    stands, known = np.zeros(p.shape, dtype=np.bool_), np.isfinite(p)
    if known.any():
        stands[known] = multipletests(p[known], alpha, method)[0]
    return stands


@dataclass(frozen=True, slots=True)
class Difference:
    """What the vehicles of a label have more than the others: size, its interval, Welch's p, how many show it."""

    size: float
    ci95: tuple[float, float] = field(metadata={"json": "size_ci95"})
    p_value: float
    n_showing: int


def difference_of(values: FloatArray, inside: BoolArray) -> Difference:
    """Compare the vehicles of a label with the others (Welch's test on values drawn in towards their median).

    `values`: a quantity, shape (n_vehicles,); `inside`: which vehicles have the label, same shape.
    """
    from scipy.stats import ttest_ind

    one, other = (_drawn_in(values[side]) for side in (inside, ~inside))
    with catch_warnings(action="ignore"):  # equal vehicles have no variance: the p-value is NaN then, no finding
        test = ttest_ind(one, other, equal_var=False)
        low, high = map(float, test.confidence_interval(COVERAGE))
    size = float(one.mean() - other.mean())
    away = values[inside] - float(np.median(values[~inside]))
    return Difference(size, (low, high), float(test.pvalue), int((np.sign(size) * away > 0.5 * abs(size)).sum()))


def _drawn_in(values: FloatArray) -> FloatArray:
    median = float(np.median(values))
    width = DRAWN_IN * max(float(np.median(np.abs(values - median))), SMALLEST_VARIANCE)
    return np.clip(values, median - width, median + width)
