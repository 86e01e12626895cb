"""How well the size of each named effect is known."""

from __future__ import annotations

from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.evidence.fit import Fitted
from calib.gap.evidence.marginal import Nuisance
from calib.gap.evidence.whitened import WhitenedSystem

__all__ = ["size_spreads"]

#: prior standard deviation of a size in typical sizes: it keeps what these runs cannot tell finite, as in the fit
PRIOR_SD: Final = 30.0


def size_spreads(bench: WhitenedSystem, fitted: Fitted, tolerance: float) -> list[FloatArray]:
    """Return the standard uncertainty of each form's parameters, the noise and the form's own tolerance in it.

    An effect that deviates from its assumed form by so much a condition is known on the whole no better than its
    conditions average that out.

    Parameters
    ----------
    bench : WhitenedSystem
        The whitened system about the fit.
    fitted : Fitted
        The hypothesis.
    tolerance : float
        Share by which an effect may deviate from its form, a condition.

    Returns
    -------
    list of array of float, each shape (n_parameters,)
        In the parameters' units.
    """
    columns = [bench.columns(form) for form in fitted.forms]
    typical = [form.typical for form in fitted.forms]
    loose = [bench.calibration]
    for signature, theta, unit in zip(columns, fitted.theta, typical, strict=True):
        loose.append(tolerance * bench.by_condition(signature @ (theta / unit)))
    nuisance = Nuisance.of(np.concatenate(loose, axis=1))
    whole = np.concatenate(columns, axis=1) if columns else np.zeros((len(bench.gap), 0))
    gram = nuisance.scalar(whole, whole)
    sd = np.sqrt(np.diag(np.linalg.inv(gram + np.eye(len(gram)) / PRIOR_SD**2)))
    cuts = np.cumsum([0, *(len(t) for t in typical)])
    return [sd[a:b] * unit for a, b, unit in zip(cuts[:-1], cuts[1:], typical, strict=True)]
