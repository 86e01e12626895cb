"""Checks of a wheel's fit against what the instruments say: lengths of the runs, their uncertainty, the temperature."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from calib.radius.checks import NOTE_BELOW, UM, p_of_t, tested
from calib.radius.law import COVERAGE
from calib.radius.regression import FAILED, NOTE, OK, Check, WheelFit, t_quantile
from calib.radius.sessions import groups_of
from calib.types import FloatArray, StrArray

#: a smaller span of temperatures shows nothing of a radius
MIN_SPAN_K: Final = 1.0
#: degrees of freedom, less sessions and both lines, that the scatter about the temperature or the length needs
MIN_SLOPE_DOF: Final = 5
#: lengths of runs that differ by less than so many times what a distance is uncertain by show no error of their
#: common zero: what is random in a distance is then seen in its length, too
LENGTHS_APART: Final = 30.0
#: share of a radius by which the path of a run may move it (the tolerance of 'calib deviation'): more scatter of one
#: sign, as a weave has it, is an error of the law that no interval holds
PATH_TOLERANCE: Final = 5e-4
#: checks whose failure says already why runs scatter
EXPLAINED_BY: Final = ("lack_of_fit", "curvature", "influence", "run_length")


def with_instrument_checks(fit: WheelFit, distance_m: FloatArray, std_m: FloatArray, session: StrArray) -> WheelFit:
    """Return `fit` with the checks of its residuals against the lengths of the runs and the stated uncertainty.

    `distance_m`, `std_m` (shape (n_runs,)): by the rangefinder, and what rangefinder, counters and path leave of a
    radius uncertain; `session` (shape (n_runs,)): of the same runs.
    """
    groups, n = groups_of(session), len(distance_m)
    base = np.eye(len(groups))[groups.index] if 2 <= len(groups) < n else np.ones((n, 1))
    if fit.model == "line" and fit.design != "confounded":
        base = np.column_stack((base, (fit.load_N - fit.load_N.mean()) / np.ptp(fit.load_N)))
    u, size, _ = np.linalg.svd(base, full_matrices=False)
    fitted, std = u[:, size > 1e-10 * size[0]], np.nan_to_num(std_m)
    found = _run_length(fit, distance_m, std, fitted)
    checks = (*fit.checks, *(() if found is None else (found,)))
    if not any(check.level == FAILED and check.name in EXPLAINED_BY for check in checks):
        checks = (*checks, *_scatter(fit, std, len(std) - fitted.shape[1]))
    return replace(fit, checks=checks)


def _run_length(fit: WheelFit, distance_m: FloatArray, std_m: FloatArray, fitted: FloatArray) -> Check | None:
    """Hold radii against one over the length: a constant error of the distances moves those of short runs most.

    `fitted` (shape (n_runs, k)): orthonormal columns of sessions and load, which is all that is taken off first.
    """
    radius = float(fit.radius_m.mean())
    reach = radius / distance_m
    own, residual = (values - fitted @ (fitted.T @ values) for values in (reach, fit.residual_m))
    norm, dof = float(own @ own), len(own) - fitted.shape[1] - 1
    least = LENGTHS_APART * float(np.mean(reach)) * float(np.sqrt(np.mean(std_m**2))) / radius
    if dof < MIN_SLOPE_DOF or float(np.std(reach)) <= least:
        return None
    if np.sqrt(norm / len(own)) <= least:
        sentence = (
            "The lengths of the runs follow loads or sessions: a constant error of the distances looks like these; "
            "drive each load over the same lengths."
        )
        return Check("run_length", NOTE, sentence)
    offset = float(own @ residual) / norm
    # HC3, since the scatter of short runs may be larger; no less than what the instruments alone give
    slack = np.maximum(1.0 - np.sum(fitted**2, axis=1) - own**2 / norm, 1.0 / len(own))
    spread = np.maximum(np.sum((own * (residual - offset * own) / slack) ** 2), np.sum((own * std_m) ** 2))
    sd = float(np.sqrt(spread)) / norm
    # the slope rests on the runs that carry it: two short runs among many long ones tell little of their own scatter
    carrying = min(float(dof), norm**2 / float(np.sum(own**4)))
    statistic = offset / sd if sd > 0.0 else 0.0
    moved, half = offset * float(np.mean(reach)), sd * float(t_quantile(carrying))
    low, high = (1e3 * (offset + sign * half) for sign in (-1.0, 1.0))
    p_value = p_of_t(statistic, carrying)
    sentences = (
        "Short and long runs give the same radius.",
        f"The distances seem to be off by a constant {1e3 * offset:+.3g} mm ({low:+.3g} to {high:+.3g}): short and "
        f"long runs give other radii, and the law is off by {UM * moved:+.3g} um. Check the rangefinder's zero on "
        "vehicle and wall, and slip at start and stop; take the constant off distance_m, or drive long runs alone.",
    )
    fails = abs(moved) > float(fit.estimate.half_width((1.0, 0.0), COVERAGE))
    return tested("run_length", statistic, f"t({carrying:.3g})", p_value, sentences, fails=fails)


def _scatter(fit: WheelFit, std_m: FloatArray, dof: int) -> Iterator[Check]:
    """Hold the scatter of runs, with so many degrees of freedom, against what the instruments say."""
    from scipy.special import chdtrc

    stated, scatter = float(np.sqrt(np.mean(std_m**2))), fit.run_std_m
    if dof < MIN_SLOPE_DOF or stated <= 0.0:
        return
    ratio, beyond = scatter / stated, float(np.sqrt(max(scatter**2 - stated**2, 0.0)))
    p_value, statistic = float(chdtrc(dof, dof * ratio**2)), "scatter over stated"
    if p_value >= NOTE_BELOW or beyond <= max(PATH_TOLERANCE * float(fit.radius_m.mean()), stated):
        yield Check("scatter", OK, "Runs scatter no more than a straight path lets them.", ratio, statistic)
        return
    times = f"{ratio:.{0 if ratio >= 10.0 else 1}f} times"
    sentence = (
        f"Runs scatter by {UM * scatter:.3g} um, {times} what rangefinder and counters explain. The cause is not known "
        "(a weave that was not measured, slip, the zero of the rangefinder), and one that acts one way moves the law "
        "by about as much, which no interval holds: add logs, or amplitude_m and wavelength_m."
    )
    yield Check("scatter", NOTE, sentence, ratio, statistic, p_value)


def with_temperature_check(fit: WheelFit, temperature_C: FloatArray, session: StrArray) -> WheelFit:
    """Return `fit` with the check of its residuals against the temperature, where these runs allow one.

    `temperature_C` (NaN where not read), `session` (shape (n_runs,)): of the same runs. Within sessions: shifts of
    whole sessions belong to the check of sessions. Both are taken minus their regression on the load, so that a
    temperature that correlates with it is not blamed.
    """
    known = np.isfinite(temperature_C)
    if not known.any() or np.ptp(temperature_C[known]) < MIN_SPAN_K:
        return fit
    groups, span = groups_of(session[known]), np.ptp(temperature_C[known])
    columns = (fit.residual_m[known], temperature_C[known], fit.load_N[known])
    residual, warmth, load = (groups.within(column) for column in columns)
    if load @ load > 0:
        residual, warmth = (each - load * float(load @ each) / float(load @ load) for each in (residual, warmth))
    dof, squares = len(residual) - len(groups) - 2, float(warmth @ warmth)
    if dof < MIN_SLOPE_DOF or np.sqrt(squares / len(warmth)) < 0.1 * MIN_SPAN_K:
        return fit
    slope = float(warmth @ residual) / squares
    scatter = float(np.sum((residual - slope * warmth) ** 2)) / dof
    if scatter <= 0:
        return fit
    statistic = slope * np.sqrt(squares / scatter)
    sentences = (
        "The radius does not follow the temperature.",
        f"The radius follows the temperature by {UM * slope:+.2g} um/K over {span:.0f} K driven: a law of the load "
        "alone is off by that on a warmer or colder day; calib diagnose says whether it is the temperature or "
        "something that correlates with it, and corrects it.",
    )
    check = tested("temperature", statistic, f"t({dof})", p_of_t(statistic, dof), sentences, fails=True)
    return replace(fit, checks=(*fit.checks, check))
