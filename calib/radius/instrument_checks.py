"""Checks of residuals against run lengths, instruments, and temperature."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.special import chdtrc

from calib.radius.checks import NOTE_BELOW, UM, p_of_t, tested
from calib.radius.regression import FAILED, NOTE, OK, Check, WheelFit, t_quantile
from calib.radius.sessions import groups_of
from calib.types import BoolArray, FloatArray, StrArray

#: of temperatures, to show in a radius
MIN_SPAN_K: Final = 1.0
#: less sessions and both lines, for the scatter about a further slope
MIN_SLOPE_DOF: Final = 5
#: lengths nearer than so many times a distance's uncertainty hold that error themselves
LENGTHS_APART: Final = 30.0
#: of a radius: the tolerance of 'calib deviation'
PATH_TOLERANCE: Final = 5e-4
#: checks that explain the scatter
EXPLAINED_BY: Final = ("lack_of_fit", "curvature", "influence", "run_length")


def with_instrument_checks(fit: WheelFit, distance_m: FloatArray, std_m: FloatArray, session: StrArray) -> WheelFit:
    """Return `fit` with two more checks; `std_m`: of each radius by the instruments; shape (n_runs,) all."""
    fitted, std = _fitted(fit, session, np.ones(len(std_m), dtype=np.bool_)), np.nan_to_num(std_m)
    checks = [*fit.checks, *_run_length(fit, fit.radius_m.mean() / distance_m, std, fitted)]
    if not any(check.level == FAILED and check.name in EXPLAINED_BY for check in checks):
        checks += _scatter(fit, std, session)
    return replace(fit, checks=tuple(checks))


def _fitted(fit: WheelFit, session: StrArray, known: BoolArray) -> FloatArray:
    """Return orthonormal columns (n_known, k) of sessions and load."""
    groups, load = groups_of(session[known]), fit.load_N[known]
    base = np.eye(len(groups))[groups.index] if 2 <= len(groups) < len(load) else np.ones((len(load), 1))
    if fit.model == "line" and fit.design != "confounded":
        base = np.column_stack((base, load / load.max()))
    u, size, _ = np.linalg.svd(base, full_matrices=False)
    return np.asarray(u[:, size > 1e-10 * size[0]])


def _run_length(fit: WheelFit, reach: FloatArray, std_m: FloatArray, fitted: FloatArray) -> Iterator[Check]:
    """Look for a constant error of the distances; `reach` (n_runs,): by how much a metre moves a radius."""
    own, residual = (values - fitted @ (fitted.T @ values) for values in (reach, fit.residual_m))
    norm, dof, mean = float(own @ own), len(own) - fitted.shape[1] - 1, float(reach.mean())
    least = LENGTHS_APART * mean * float(np.sqrt(np.mean(std_m**2)) / fit.radius_m.mean())
    if dof < MIN_SLOPE_DOF or np.std(reach) <= least:
        return
    if np.sqrt(norm / len(own)) <= least:
        hidden = "The lengths of the runs follow loads or sessions, which hides a constant error of the distances; "
        yield Check("run_length", NOTE, f"{hidden}drive each load over the same lengths.")
        return
    offset = float(own @ residual) / norm
    # HC3, since short runs may scatter more; no less than the instruments
    slack = np.maximum(1.0 - np.sum(fitted**2, axis=1) - own**2 / norm, 1.0 / len(own))
    spreads = [np.linalg.norm(own * error) for error in ((residual - offset * own) / slack, std_m)]
    sd = float(max(spreads)) / norm
    # few short runs among many tell little of their own scatter
    carrying = min(float(dof), norm**2 / float(np.sum(own**4)))
    statistic, half = offset / sd if sd > 0.0 else 0.0, sd * float(t_quantile(carrying))
    sentences = (
        "Short and long runs give the same radius.",
        f"The distances seem to be off by a constant {1e3 * offset:+.3g} mm ({1e3 * (offset - half):+.3g} to "
        f"{1e3 * (offset + half):+.3g}), and the law by {UM * offset * mean:+.3g} um: short runs give other radii. "
        "Check the rangefinder's zero, and slip at start and stop; correct distance_m, or drive long runs alone.",
    )
    fails = abs(offset * mean) > float(fit.estimate.half_width((1.0, 0.0)))
    yield tested("run_length", statistic, f"t({carrying:.3g})", p_of_t(statistic, carrying), sentences, fails=fails)


def beyond_instruments(fit: WheelFit, std_m: FloatArray, session: StrArray) -> float:
    """Return the radii's standard uncertainty where runs clearly scatter beyond it and a path's tolerance, else 0."""
    check = next(_scatter(fit, np.nan_to_num(std_m), session), None)
    return fit.run_std_m / float(check.statistic or 1.0) if check and check.level == NOTE else 0.0


def _scatter(fit: WheelFit, std_m: FloatArray, session: StrArray) -> Iterator[Check]:
    dof = len(std_m) - _fitted(fit, session, np.ones(len(std_m), dtype=np.bool_)).shape[1]
    stated, scatter = float(np.sqrt(np.mean(std_m**2))), fit.run_std_m
    if dof < MIN_SLOPE_DOF or stated <= 0.0:
        return
    ratio, least = scatter / stated, max(PATH_TOLERANCE * float(fit.radius_m.mean()), stated)
    p_value, level = float(chdtrc(dof, dof * ratio**2)), OK
    finding = p_value < NOTE_BELOW and scatter**2 > stated**2 + least**2
    sentence = "Runs scatter no more than a straight path lets them."
    if finding:
        level, times = NOTE, f"{ratio:.{0 if ratio >= 10.0 else 1}f} times"
        sentence = (
            f"Runs scatter by {UM * scatter:.3g} um, {times} what rangefinder and counters explain: the cause (a "
            "weave, slip) is not known, and may move the law by as much, which no interval holds; add logs, or "
            "amplitude_m and wavelength_m."
        )
    # what a path may add is no finding, however sure
    yield Check("scatter", level, sentence, ratio, "scatter over stated", p_value if finding else None)


def with_path_check(fit: WheelFit, radius_per_bow: float, apart_m: float) -> WheelFit:
    """Return `fit` with the check whether unmeasured paths are straight on the whole.

    `radius_per_bow`: what a bow of all runs moves the radius by; `apart_m`: see `steered_itself_m`.
    """
    moved, level = f"{UM * 0.01 * radius_per_bow:.2g} um", NOTE
    sentence = (
        "No run's heading at the end was measured: the paths are taken for straight. A bow of 1 cm, the same in all "
        f"runs, moves the radius by {moved}, and the other wheel's the other way, which no interval holds; measure "
        "ref_theta_rad, or declare path.apart_m under [uncertainty]."
    )
    if apart_m >= 0.0:
        level = FAILED
        sentence = (
            f"The wheels of all runs rolled alike to within {1e3 * apart_m:.2g} mm: the vehicle seems to have steered "
            "by its own counts. Then only the mean of both radii is known, what they differ by went into the arc of "
            "the path; measure ref_theta_rad at the end, or guide the vehicle by a line."
        )
    return replace(fit, checks=(*fit.checks, Check("path", level, sentence)))


def with_temperature_check(fit: WheelFit, temperature_C: FloatArray, session: StrArray) -> WheelFit:
    """Return `fit` with the check against temperature, where these runs allow one.

    `temperature_C` (NaN where not read), `session`: shape (n_runs,). Sessions, and what correlates with the load, are
    taken off both first.
    """
    known = np.isfinite(temperature_C)
    if not known.any() or np.ptp(temperature_C[known]) < MIN_SPAN_K:
        return fit
    fitted, span = _fitted(fit, session, known), np.ptp(temperature_C[known])
    columns = (column[known] for column in (fit.residual_m, temperature_C))
    residual, warmth = (column - fitted @ (fitted.T @ column) for column in columns)
    dof, squares = len(residual) - fitted.shape[1] - 1, float(warmth @ warmth)
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
