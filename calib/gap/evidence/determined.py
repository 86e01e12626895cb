"""Which parameters of a named effect these runs determine, which only together, and which not at all."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Parameter


def undetermined(parameters: Sequence[Parameter], sizes: FloatArray, half_width: FloatArray) -> tuple[str, ...]:
    """Return the names of the parameters that the runs do not determine.

    Their interval holds nought and reaches beyond what is physically plausible on both sides: it says nothing.

    Parameters
    ----------
    parameters : sequence of Parameter
        Of one effect.
    sizes, half_width : array of float, shape (n_parameters,)
        Their values and half the width of their intervals.
    """
    return tuple(
        parameter.name
        for parameter, size, half in zip(parameters, sizes, half_width, strict=True)
        if half - abs(size) > parameter.largest
    )


def said_of_undetermined(
    parameters: Sequence[Parameter], sizes: FloatArray, covariance: FloatArray, coverage: float
) -> str:
    """Return in words what the runs do not determine, and what they determine together; empty where all are.

    Parameters
    ----------
    parameters : sequence of Parameter
        Of one effect.
    sizes : array of float, shape (n_parameters,)
        Their values.
    covariance : array of float, shape (n_parameters, n_parameters)
        Of the values.
    coverage : float
        Half an interval's width in standard uncertainties.
    """
    spread = np.sqrt(np.diag(covariance))
    open_ones = undetermined(parameters, sizes, coverage * spread)
    if not open_ones:
        return ""
    together = []
    for (a, p), (b, q) in combinations(enumerate(parameters), 2):
        if {p.name, q.name} <= set(open_ones) and p.unit == q.unit:
            mean = 0.5 * (sizes[a] + sizes[b])
            half = coverage * 0.5 * float(np.sqrt(max(covariance[np.ix_([a, b], [a, b])].sum(), 0.0)))
            if half < min(p.largest, q.largest):
                unit = "" if p.unit == "1" else f" {p.unit}"
                together.append(f"only the mean of {p.name} and {q.name}, {mean:.4g} +- {half:.2g}{unit}")
    alone = f"these runs do not determine {' and '.join(open_ones)}"
    return f"{alone}, {'; '.join(together)}" if together else alone
