"""Whether radii follow the temperature, which a law of the load does not know."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from calib.arrays import FloatArray, StrArray
from calib.radius.checks import Check
from calib.radius.regression import WheelFit
from calib.radius.residual_checks import NOTE_BELOW, UM, level, p_t
from calib.radius.sessions import groups_of

#: a span of less says nothing of a radius
LEAST_SPAN_K: Final = 1.0
#: runs, sessions and the line taken off, that a scatter needs at least
FEWEST_DOF: Final = 5


def against_temperature(fit: WheelFit, temperature_C: FloatArray, session: StrArray) -> WheelFit:
    """Return `fit` with the check of its residuals against the temperature, where these runs allow one.

    `temperature_C` (NaN where not read), `session` (shape (n_runs,)): of the same runs. Within sessions: what a session
    shifts as a whole is the check of sessions. The load is taken off both, so that a temperature that went with it is
    not blamed.
    """
    on = np.isfinite(temperature_C)
    if not on.any() or np.ptp(temperature_C[on]) < LEAST_SPAN_K:
        return fit
    groups, temperature_C = groups_of(session[on]), temperature_C[on]
    left, warmth, load = (groups.within(each) for each in (fit.residual_m[on], temperature_C, fit.load_N[on]))
    if load @ load > 0:
        left, warmth = (each - load * float(load @ each) / float(load @ load) for each in (left, warmth))
    dof = len(left) - len(groups) - 2
    if dof < FEWEST_DOF or np.sqrt(float(warmth @ warmth) / len(warmth)) < 0.1 * LEAST_SPAN_K:
        return fit
    slope = float(warmth @ left) / float(warmth @ warmth)
    scatter = float(np.sum((left - slope * warmth) ** 2)) / dof
    if scatter <= 0:
        return fit
    statistic = slope * np.sqrt(float(warmth @ warmth) / scatter)
    p_value = p_t(statistic, dof)
    sentence = (
        "The radius does not follow the temperature."
        if p_value >= NOTE_BELOW
        else f"The radius follows the temperature by {UM * slope:+.2g} um/K over {np.ptp(temperature_C):.0f} K driven: "
        "a law of the load alone is off by that on a warmer or colder day; calib diagnose says whether it is the "
        "temperature or what went with it, and corrects it."
    )
    check = Check("temperature", level(p_value), sentence, float(statistic), f"t({dof})", p_value)
    return replace(fit, checks=(*fit.checks, check))
