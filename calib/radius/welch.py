"""Intervals from two variance estimates of few degrees of freedom each: runs within sessions, and sessions.

An estimate whose variance is V_between + V_within, each known only by an independent multiple of chi-squared, has no
exact t. Satterthwaite's degrees of freedom are estimated from the same few sessions and cover too little (93 to 94 %
with five sessions). Here the critical value is a function of the observed share of V_between, found such that the
coverage is the stated one whatever the true share (Trickett and Welch, Biometrika 41 (1954) 361). Where one part
vanishes it is Student's t of the other.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from calib.arrays import FloatArray

SHARES: Final = 0.5 * (1 - np.cos(np.pi * np.arange(25) / 24))
ROUNDS: Final = 12
#: nodes of equal probability for a chi-squared of few and of many degrees of freedom
FEW_NODES: Final = 64
MANY_NODES: Final = 16
MANY: Final = 20.0


@lru_cache(maxsize=64)
def critical_curve(dof_between: float, dof_within: float, coverage: float) -> FloatArray:
    """Return the critical values at the observed shares `SHARES` of the between part.

    `dof_between`, `dof_within`: degrees of freedom of each part, above 0; `coverage`: wanted coverage. Shape (25,):
    from Student's t of `dof_within` to that of `dof_between`; read-only: wheels and bands share it.
    """
    from scipy.special import ndtr, stdtrit

    q_between, q_within = np.meshgrid(_nodes(dof_between), _nodes(dof_within), indexing="ij")
    share = SHARES[:, None, None]
    variance = share * q_between + (1 - share) * q_within
    observed = share * q_between / variance
    spread = np.sqrt(variance)
    ends = np.asarray(stdtrit([dof_within, dof_between], 0.5 + coverage / 2), dtype=np.float64)
    least = float(stdtrit(dof_within + dof_between, 0.5 + coverage / 2))
    curve = np.asarray(ends[0] + (ends[1] - ends[0]) * SHARES)
    for _ in range(ROUNDS):
        reach = np.interp(observed, SHARES, curve) * spread
        covered = np.mean(2 * ndtr(reach) - 1, axis=(1, 2))
        rate = np.mean(2 * spread * np.exp(-0.5 * reach**2) / np.sqrt(2 * np.pi), axis=(1, 2))
        # half steps: a neighbour's change moves the coverage too
        curve = np.clip(curve + 0.5 * (coverage - covered) / rate, least, ends.max())
        curve[0], curve[-1] = ends
        if ends[1] >= ends[0]:
            # past the dip that pooled degrees of freedom allow, more weight on fewer of them never narrows it
            low = int(np.argmin(curve))
            curve[low:] = np.maximum.accumulate(curve[low:])
    curve.flags.writeable = False
    return curve


def critical_value(share: npt.ArrayLike, dof_between: float, dof_within: float, coverage: float) -> FloatArray:
    """Return the critical value for observed shares of the between part.

    `share`: V_between over the sum; `dof_between`, `dof_within`: degrees of freedom of each part; 0 where there is no
    such part; `coverage`: wanted coverage. To be multiplied by the square root of the sum.
    """
    from scipy.special import stdtrit

    observed = np.asarray(share, dtype=np.float64)
    within = stdtrit(dof_within, 0.5 + coverage / 2) if dof_within > 0 else np.nan
    between = stdtrit(dof_between, 0.5 + coverage / 2) if dof_between > 0 else np.nan
    # the pure cases to the last digit, without a curve
    if dof_between <= 0 or not (observed > 0).any():
        return np.full(observed.shape, within)
    if dof_within <= 0 or not (observed < 1).any():
        return np.full(observed.shape, between)
    return np.asarray(np.interp(observed, SHARES, critical_curve(dof_between, dof_within, coverage)))


def equivalent_dof(critical: npt.ArrayLike, coverage: float) -> FloatArray:
    """Return the degrees of freedom whose Student's t is `critical`, by bisection on their reciprocal.

    `critical`: critical values; `coverage`: their coverage. At most 1e6.
    """
    from scipy.special import stdtrit

    wanted = np.asarray(critical, dtype=np.float64)
    low, high = np.full(wanted.shape, 1e-6), np.full(wanted.shape, 1.0)
    # 50 halvings: relative 1e-15
    for _ in range(50):
        middle = 0.5 * (low + high)
        above = stdtrit(1 / middle, 0.5 + coverage / 2) > wanted
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return np.asarray(2 / (low + high))


def _nodes(dof: float) -> FloatArray:
    """Return nodes of equal probability of chi-squared over its degrees of freedom, with mean 1."""
    from scipy.special import chdtri

    n = MANY_NODES if dof > MANY else FEW_NODES
    quantiles = np.asarray(chdtri(dof, (np.arange(n) + 0.5) / n)) / dof
    return np.asarray(quantiles / quantiles.mean())
