"""Looking again and again: how often the loop of planning, driving and diagnosing raises a false alarm in all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.types import FloatArray

__all__ = ["ever_alarmed", "levels"]


def levels(n_looks: int, alpha: float = 0.05) -> FloatArray:
    """Return the level of each look, shape (n_looks,): half of what is left each time.

    They add up to less than `alpha` however many looks there are, so that the chance of any false alarm stays below it
    (the union bound), however the looks depend on one another and on what was planned after them.
    """
    return np.asarray(alpha * 0.5 ** np.arange(1, n_looks + 1), dtype=np.float64)


def ever_alarmed(
    each: Sequence[float] | FloatArray, n_channels: int, rng: np.random.Generator, draws: int = 20_000
) -> float:
    """Return how often a campaign without any gap raises an alarm at one look or another, by simulation.

    Each look adds as many runs as there were in the first and tests all runs so far for a gap in `n_channels` channels,
    by the squared norm of their mean.

    Parameters
    ----------
    each : sequence of float
        Level of each look.
    n_channels : int
        Directions in which a gap is looked for.
    rng : numpy.random.Generator
        Draws the noise.
    draws : int
        Campaigns.
    """
    from scipy.stats import chi2

    n_looks = len(each)
    total = np.cumsum(rng.standard_normal((draws, n_looks, n_channels)), axis=1)
    squares = (total**2).sum(axis=2) / np.arange(1, n_looks + 1)
    limits = chi2.isf(np.asarray(each, dtype=np.float64), n_channels)
    return float((squares > limits).any(axis=1).mean())
