"""Statistics over vehicles: mean and spread between them, vehicles that stand apart, labels that differ.

Random effects as in meta-analysis. Own code where statsmodels takes longer to import (1.2 s) than a view of 2,000
vehicles takes to make; the tests hold it against statsmodels and scipy.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from calib.types import BoolArray, FloatArray

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
#: Newton steps at most: each at least doubles a variance that is far too small
NEWTON_STEPS: Final = 200


@dataclass(frozen=True, slots=True)
class Population:
    """A quantity over the fleet.

    Parameters
    ----------
    mean : float
        Of the population of vehicles.
    mean_ci95 : tuple of float
        Its interval (Hartung, Knapp, Sidik and Jonkman).
    spread : float
        Standard deviation between vehicles, their own uncertainty taken out (Paule and Mandel).
    spread_ci95 : tuple of float
        Its interval (Q profile, Viechtbauer 2007).
    within : float
        Typical standard uncertainty of one vehicle.
    n : int
        Vehicles.
    """

    mean: float
    mean_ci95: tuple[float, float]
    spread: float
    spread_ci95: tuple[float, float]
    within: float
    n: int


def population(values: FloatArray, std: FloatArray) -> Population | None:
    """Return mean and spread of a quantity over vehicles.

    Parameters
    ----------
    values : array of float, shape (n_vehicles,)
        The quantity of each vehicle.
    std : array of float, shape (n_vehicles,)
        Its standard uncertainty.

    Returns
    -------
    Population or None
        None with fewer than three vehicles.
    """
    from scipy.special import chdtri, stdtrit

    n = len(values)
    if n < 3:
        return None
    variance = std**2
    between = _solve(values, variance, float(n - 1))
    weight = 1.0 / (between + variance)
    mean = float(weight @ values / weight.sum())
    spread_of_mean = float(np.sqrt(weight @ (values - mean) ** 2 / (n - 1) / weight.sum()))
    half = float(stdtrit(n - 1, 0.5 + COVERAGE / 2)) * spread_of_mean
    tail = 0.5 * (1.0 - COVERAGE)
    high, low = (_solve(values, variance, float(chdtri(n - 1, probability))) for probability in (1 - tail, tail))
    return Population(
        mean=mean,
        mean_ci95=(mean - half, mean + half),
        spread=float(np.sqrt(between)),
        spread_ci95=(float(np.sqrt(low)), float(np.sqrt(high))),
        within=float(np.sqrt(np.median(variance))),
        n=n,
    )


def _excess(values: FloatArray, variance: FloatArray, between: float) -> float:
    """Return Cochran's Q at a variance between vehicles."""
    weight = 1.0 / (between + variance)
    mean = weight @ values / weight.sum()
    return float(weight @ (values - mean) ** 2)


def _solve(values: FloatArray, variance: FloatArray, target: float) -> float:
    """Return the variance between vehicles at which Q is `target`; 0 where it is below it already."""
    floor = 1e-30 + 1e-12 * float(np.max(variance))
    variance = np.maximum(variance, floor)
    if _excess(values, variance, 0.0) <= target:
        return 0.0
    # Q falls as the variance grows and is convex in it (DerSimonian and Kacker 2007): Newton's steps from below stay
    # below, and end where they no longer move
    between = 0.0
    for _ in range(NEWTON_STEPS):
        weight = 1.0 / (between + variance)
        away = values - weight @ values / weight.sum()
        step = (float(weight @ away**2) - target) / float(weight**2 @ away**2)
        between += step
        if step <= 1e-12 * between:
            break
    return between


def outlying(values: FloatArray, std: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far each vehicle stands from the fleet, in standard deviations, and the chance of that.

    Median and median deviation find those that may stand apart, so that they do not hide themselves; mean and spread of
    the others, better known than a median deviation, then judge every vehicle by Student's t.

    Parameters
    ----------
    values, std : array of float, shape (n_vehicles,)
        A quantity and its standard uncertainty, which is part of a vehicle's standard deviation.

    Returns
    -------
    z, p_value : array of float, shape (n_vehicles,)
    """
    from scipy.special import stdtr

    away = values - np.median(values)
    variance = std**2
    # the spread at which the median of |z| is that of a normal
    low, high = 0.0, float(np.median(np.abs(away)) / MEDIAN_ABS) * 2.0 + 1e-300
    # to a billionth: it only tells those farther than FAR from the others
    for _ in range(30):
        middle = 0.5 * (low + high)
        if np.median(np.abs(away) / np.sqrt(middle**2 + variance + 1e-300)) > MEDIAN_ABS:
            low = middle
        else:
            high = middle
    usual = np.abs(away) / np.sqrt(high**2 + variance + 1e-300) < FAR
    fleet = population(values[usual], std[usual])
    if fleet is None:
        return np.zeros(len(values)), np.ones(len(values))
    z = (values - fleet.mean) / np.sqrt(fleet.spread**2 * (1.0 + 1.0 / fleet.n) + variance + 1e-300)
    return np.asarray(z), np.asarray(2.0 * stdtr(fleet.n - 1.0, -np.abs(z)))


def false_discovery(p_values: FloatArray, share: float = FALSE_SHARE) -> BoolArray:
    """Return which of many findings stand with a controlled share of false ones (Benjamini and Hochberg).

    Parameters
    ----------
    p_values : array of float, any shape
        Of each finding; NaN where there is none.
    share : float
        Expected share of false ones among those that stand.

    Returns
    -------
    array of bool, same shape
    """
    flat = np.asarray(p_values, dtype=np.float64).ravel()
    known = np.isfinite(flat)
    ordered = np.sort(flat[known])
    if not len(ordered):
        return np.zeros(np.shape(p_values), dtype=np.bool_)
    bound = share * np.arange(1, len(ordered) + 1) / len(ordered)
    below = np.flatnonzero(ordered <= bound)
    limit = ordered[below[-1]] if len(below) else -1.0
    return np.asarray((known & (flat <= limit)).reshape(np.shape(p_values)))


def any_false(p_values: FloatArray, chance: float = FALSE_CHANCE) -> BoolArray:
    """Return which of many findings stand with a controlled chance of any false one (Holm 1979).

    Parameters
    ----------
    p_values : array of float, shape (n,)
        Of each finding.
    chance : float
        Highest chance that any that stands is false.

    Returns
    -------
    array of bool, shape (n,)
    """
    p = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(p, kind="stable")
    below = p[order] <= chance / np.arange(len(p), 0, -1)
    stands = np.zeros(len(p), dtype=np.bool_)
    stands[order] = np.logical_and.accumulate(below)
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

    Parameters
    ----------
    values : array of float, shape (n_vehicles,)
        A quantity.
    inside : array of bool, shape (n_vehicles,)
        Which vehicles have the label.
    """
    clipped = _clipped(values, inside)
    size, half, p_value = _welch(clipped[inside], clipped[~inside])
    away = values[inside] - float(np.median(values[~inside]))
    showing = int((np.sign(size) * away > 0.5 * abs(size)).sum())
    return Difference(size, (size - half, size + half), p_value, showing)


def _welch(one: FloatArray, other: FloatArray) -> tuple[float, float, float]:
    """Return the difference of two means, half its 95 % interval, and Welch's p.

    By hand, because `scipy.stats` takes longer to import than the view of 2,000 vehicles takes to make.
    """
    from scipy.special import stdtr, stdtrit

    with np.errstate(divide="ignore", invalid="ignore"):
        variances = np.array([part.var(ddof=1) / len(part) for part in (one, other)])
        total = variances.sum()
        dof = total**2 / np.sum(variances**2 / (np.array([len(one), len(other)]) - 1))
        size = one.mean() - other.mean()
        p_value = 2.0 * stdtr(dof, -np.abs(size / np.sqrt(total)))
        half = stdtrit(dof, 0.975) * np.sqrt(total)
    return float(size), float(half), float(p_value)


def _clipped(values: FloatArray, inside: BoolArray) -> FloatArray:
    """Return values with those far from their side's median drawn in, so that no vehicle speaks for all."""
    clipped = values.copy()
    for part in (inside, ~inside):
        median = float(np.median(values[part]))
        width = 4.0 * max(float(np.median(np.abs(values[part] - median))), 1e-300)
        clipped[part] = np.clip(values[part], median - width, median + width)
    return clipped
