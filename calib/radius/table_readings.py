"""What the law leaves beyond the instruments, and other readings of the table by which it would leave far less."""

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

#: less sessions and both lines, for the scatter about a further slope
MIN_SLOPE_DOF: Final = 5
#: of a radius: the tolerance of 'calib deviation'
PATH_TOLERANCE: Final = 5e-4
#: of what runs differ by; a law that leaves more takes away less than three quarters of its square
WORTH_SHARE: Final = 0.5
EXCHANGED: Final = "the loads, or else the counts, of left and right exchanged in all runs"
#: of reading and fitting in turn, which settle in a few
ROUNDS: Final = 20


def scatter_check(fit: WheelFit, std_m: FloatArray, session: StrArray) -> Iterator[Check]:
    """Yield the check of the scatter against what instruments, `std_m` (n_runs,), explain."""
    dof = len(std_m) - fit.fitted(session).shape[1]
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
    # what a path may add is no finding, however sure
    yield Check("scatter", level, sentence, ratio, "scatter over stated", p_value if finding else None)


def held_against_residuals(radii: EffectiveRadii, wheels: list[WheelFit]) -> list[WheelFit]:
    """Return the wheels' fits, failed where runs scatter beyond instruments and paths without the loads' doing.

    The law leaves most of what runs held out differ by, or another reading of the table leaves far less.
    """
    found = [[*scatter_check(one, getattr(radii, f"std_{one.wheel}_m"), radii.session)] for one in wheels]
    if all(check.level == OK for part in found for check in part) or "constant" in {wheel.model for wheel in wheels}:
        return wheels
    other, judged = _other_reading(radii), []
    for wheel, scatter in zip(wheels, found, strict=True):
        left_m, before_m = _left(wheel, radii)
        if any(check.level == NOTE for check in scatter) and (other or left_m > WORTH_SHARE * before_m):
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


def _left(wheel: WheelFit, radii: EffectiveRadii) -> tuple[float, float]:
    pairs = []
    for means in (np.ones((len(radii), 1)), groups_of(radii.session).indicators):
        sizes = []
        for columns in (np.column_stack((means, wheel.load_N)), means):
            basis = np.linalg.qr(columns)[0]
            slack = np.maximum(1.0 - np.sum(basis**2, axis=1), 1.0 / len(radii))
            sizes.append(float(np.std((wheel.radius_m - basis @ (basis.T @ wheel.radius_m)) / slack)))
        pairs.append((sizes[0], sizes[1]))
    return min(pairs, key=lambda pair: pair[0] / max(pair[1], 1e-300))


def _other_reading(radii: EffectiveRadii) -> str:
    # chance: the ratio of the squares to the power of half their degrees of freedom, times the readings
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
    alike = ", or ".join({words: 0 for log_p, _, words in sorted(found) if log_p + np.log(FAIL_BELOW) < best})
    scatter = UM * np.sqrt(square / (2 * dof))
    return f"read {alike}, they scatter by {scatter:.3g} um: correct the table by the notes of the day"


def _starts(loads: FloatArray, radius: FloatArray, pairs: FloatArray) -> list[FloatArray]:
    order = np.argsort(loads.sum(axis=1))
    nearest = 1.0 + np.argmin(np.abs(pairs[:, None] - loads[order]).sum(axis=2), axis=0)
    rank = np.argsort(np.argsort(radius.sum(axis=1)))
    return [nearest[rank], nearest[::-1][rank]]


def _squares(loads: FloatArray, radius: FloatArray, days: FloatArray, start: FloatArray) -> tuple[float, IntArray]:
    # squares left by both laws and the option of each run (n,), from those at `start`; loads and radii of each option
    # (n_options, n, 2), indicators of the days (n, n_sessions)
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
