"""Scatter about the law beyond the instruments', and errors of the run table that would explain it."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.special import chdtrc

from calib.campaign.checks import listed
from calib.radius import groups_of
from calib.radius.checks import FAIL_BELOW, MAX_CELLS, NOTE_BELOW, UM
from calib.radius.effective import EffectiveRadii
from calib.radius.regression import FAILED, NOTE, OK, SAME_LOAD, Check, WheelFit
from calib.radius.result import PLAUSIBLE
from calib.types import FloatArray, IntArray, StrArray

#: fewest degrees of freedom of the scatter about a further slope
MIN_SLOPE_DOF: Final = 5
#: relative error of a radius by a path that 'calib deviation' tolerates
PATH_TOLERANCE: Final = 5e-4
#: a law that leaves more than this share of the held-out runs' scatter explains less than 3/4 of its variance
MAX_SHARE_LEFT: Final = 0.5
EXCHANGED: Final = "the loads, or else the counts, of left and right exchanged in all runs"
#: rounds of choosing each run's reading and fitting the laws; a few converge
ROUNDS: Final = 20


def scatter_check(fit: WheelFit, std_m: FloatArray, session: StrArray) -> Iterator[Check]:
    """Yield the check of the scatter against the instruments' standard uncertainties `std_m` (n_runs,)."""
    dof = len(std_m) - fit.design_basis(session).shape[1]
    stated, scatter = float(np.sqrt(np.mean(np.nan_to_num(std_m) ** 2))), fit.run_std_m
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
    # a scatter that a tolerated path may add is no finding, however significant
    yield Check("scatter", level, sentence, ratio, "scatter over stated", p_value if finding else None)


def with_reading_checks(radii: EffectiveRadii, wheels: list[WheelFit]) -> list[WheelFit]:
    """Return the wheels' fits, failed where runs scatter beyond instruments and paths and the loads do not explain it.

    They do not where the law leaves most of the scatter of held-out runs, or another reading of the table far less.
    """
    scatters = [[*scatter_check(wheel, getattr(radii, f"std_{wheel.wheel}_m"), radii.session)] for wheel in wheels]
    if not any(check.level == NOTE for part in scatters for check in part) or "constant" in {
        one.model for one in wheels
    }:
        return wheels
    other, judged = _better_reading(radii), []
    for wheel, scatter in zip(wheels, scatters, strict=True):
        left_m, before_m = _held_out_scatter_m(wheel, radii)
        if any(check.level == NOTE for check in scatter) and (other or left_m > MAX_SHARE_LEFT * before_m):
            worst = ", ".join(radii.run_id[np.argsort(-np.abs(wheel.residual_m))][:3])
            remedy = f"hold loads, counts and distances against the notes of the day, first of {worst}"
            sentence = (
                f"the loads do not explain the {wheel.wheel} wheel's radii: the law leaves {UM * left_m:.3g} of "
                f"{UM * before_m:.3g} um of runs held out, {scatter[0].statistic:.0f} times what instruments explain"
            )
            checks = (Check(PLAUSIBLE, FAILED, f"{sentence}; {other or remedy}"), *wheel.checks)
            wheel = replace(wheel, checks=tuple(check for check in checks if check.name != "scatter"))
        judged.append(wheel)
    return judged


def _held_out_scatter_m(wheel: WheelFit, radii: EffectiveRadii) -> tuple[float, float]:
    # of each run about the others' fit, with the law and without it: beside one mean or one a session, whichever the
    # law helps more
    pairs = []
    for means in (np.ones((len(radii), 1)), groups_of(radii.session).indicators):
        sizes = []
        for columns in (np.column_stack((means, wheel.load_N)), means):
            basis = np.linalg.qr(columns)[0]
            slack = np.maximum(1.0 - np.sum(basis**2, axis=1), 1.0 / len(radii))
            sizes.append(float(np.std((wheel.radius_m - basis @ (basis.T @ wheel.radius_m)) / slack)))
        pairs.append((sizes[0], sizes[1]))
    return min(pairs, key=lambda pair: pair[0] / max(pair[1], 1e-300))


def _better_reading(radii: EffectiveRadii) -> str:
    # p-value of a reading: ratio of the squares to the power of half their dof, times the number of readings
    loads = np.column_stack((radii.load_left_N, radii.load_right_N)) / float(np.max(radii.load_left_N))
    radius = np.column_stack((radii.radius_left_m, radii.radius_right_m))
    days, n = groups_of(radii.session).indicators, len(loads)
    dof = n - days.shape[1] - 1
    pairs: FloatArray = np.unique(np.round(np.vstack((loads, loads[:, ::-1])), 2), axis=0).astype(np.float64)
    readings: dict[str, tuple[FloatArray, FloatArray]] = {
        "the loads of left and right exchanged": (loads[:, ::-1][None], radius),
        "the counts of left and right exchanged": (loads[None], radius[:, ::-1]),
        "the loads of the row before": (np.roll(loads, 1, axis=0)[None], radius),
        "the loads of the row after": (np.roll(loads, -1, axis=0)[None], radius),
        "loads of other runs": (np.repeat(pairs[:, None], n, axis=1), radius),
    }
    unlike = np.abs(loads[:, 0] - loads[:, 1]) > SAME_LOAD
    stated = _squares(loads[None], radius[None], days, np.zeros(n))[0]
    found = []
    for name, (other, moved) in readings.items() if dof > 0 and len(pairs) <= MAX_CELLS else ():
        other = np.where(np.abs(other - loads) < SAME_LOAD, loads, other)
        options, measured = np.concatenate((loads[None], other)), np.stack((radius, *[moved] * len(other)))
        starts = [np.zeros(n), np.ones(n), *days.T[:MAX_CELLS]]
        of_kind = []
        for start in starts if len(other) == 1 else _starts(loads, radius, pairs):
            square, chosen = _squares(options, measured, days, start)
            log_p = 0.5 * dof * np.log(max(square, 1e-300) / stated) + n * np.log(len(options))
            fewer = log_p + np.log(n) * np.count_nonzero(chosen)
            words = f"with {name} in {listed(radii.run_id[chosen > 0])}"
            # the same pairs of load and radius, for the other wheel
            whole = name.endswith(" of left and right exchanged") and (chosen[unlike] > 0).all()
            of_kind.append((fewer, log_p, square, f"with {EXCHANGED}" if whole else words))
        found += [min(of_kind)[1:]] if min(of_kind)[1] < np.log(FAIL_BELOW) else []
    if not found:
        return ""
    best, square, _ = min(found)
    likely = ", or ".join({words: 0 for log_p, _, words in sorted(found) if log_p + np.log(FAIL_BELOW) < best})
    scatter = UM * np.sqrt(square / (2 * dof))
    return f"read {likely}, they scatter by {scatter:.3g} um: correct the table by the notes of the day"


def _starts(loads: FloatArray, radius: FloatArray, pairs: FloatArray) -> list[FloatArray]:
    order = np.argsort(loads.sum(axis=1))
    nearest = 1.0 + np.argmin(np.abs(pairs[:, None] - loads[order]).sum(axis=2), axis=0)
    rank = np.argsort(np.argsort(radius.sum(axis=1)))
    return [nearest[rank], nearest[::-1][rank]]


def _squares(loads: FloatArray, radius: FloatArray, days: FloatArray, start: FloatArray) -> tuple[float, IntArray]:
    # residual squares of both laws and the best option of each run (n,), searched from `start`; loads and radii of the
    # options (n_options, n, 2), indicators of the days (n, n_sessions)
    runs, chosen = np.arange(loads.shape[1]), start.astype(np.int64)
    for _ in range(ROUNDS):
        squares = np.zeros(loads.shape[:2])
        for x, y in zip(np.moveaxis(loads, 2, 0), np.moveaxis(radius, 2, 0), strict=True):
            columns = np.column_stack((days, x[chosen, runs]))
            *shifts, slope = np.linalg.lstsq(columns, y[chosen, runs], rcond=None)[0]
            squares += (y - days @ shifts - slope * x) ** 2
        before, chosen = chosen, np.argmin(squares, axis=0)
        if (chosen == before).all():
            break
    return float(squares[before, runs].sum()), before
