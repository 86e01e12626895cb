"""Whether loads, as the table has them, explain the radii, and which other reading of the table would."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from calib.campaign.checks.design import listed
from calib.radius.checks import FAIL_BELOW, MAX_CELLS, UM
from calib.radius.effective import EffectiveRadii
from calib.radius.instrument_checks import EXPLAINED_BY, beyond_instruments
from calib.radius.regression import FAILED, Check, WheelFit
from calib.radius.result import PLAUSIBLE
from calib.radius.sessions import groups_of
from calib.types import FloatArray, IntArray

#: of what runs differ by: a law that leaves more of runs not seen explains less than three quarters of their mean
#: square, and is none, as a geometry
WORTH_SHARE: Final = 0.5
#: of reading and fitting in turn, which settle in a few
ROUNDS: Final = 20


def held_against_residuals(radii: EffectiveRadii, wheels: list[WheelFit]) -> list[WheelFit]:
    """Return the wheels' fits, failed where runs scatter beyond instruments and paths and the loads do not say why.

    That is where the law leaves most of what the runs differ by, or another reading of the table leaves far less.
    """
    stds = (radii.std_left_m, radii.std_right_m)
    found = [beyond_instruments(wheel, std, radii.session) for wheel, std in zip(wheels, stds, strict=True)]
    if not any(found) or "constant" in {wheel.model for wheel in wheels}:
        return wheels
    other, judged = _other_reading(radii), []
    for wheel, scatters in zip(wheels, found, strict=True):
        explained = any(check.level == FAILED and check.name in EXPLAINED_BY for check in wheel.checks)
        left_m, before_m = _left(wheel, radii)
        if scatters and (other or (left_m > WORTH_SHARE * before_m and not explained)):
            worst = ", ".join(radii.run_id[np.argsort(-np.abs(wheel.residual_m))][:3])
            remedy = f"hold loads, counts and distances against the notes of the day, first of {worst}"
            sentence = (
                f"the loads do not explain the {wheel.wheel} wheel's radii: of runs held out the law leaves "
                f"{UM * left_m:.3g} of {UM * before_m:.3g} um, and the instruments explain {UM * scatters:.2g} um"
            )
            checks = (Check(PLAUSIBLE, FAILED, f"{sentence}; {other or remedy}"), *wheel.checks)
            wheel = replace(wheel, checks=tuple(check for check in checks if check.name != "scatter"))
        judged.append(wheel)
    return judged


def _left(wheel: WheelFit, radii: EffectiveRadii) -> tuple[float, float]:
    """Return what the law leaves of held-out runs, and what they differ by; within sessions, or all, the better."""
    groups, pairs = groups_of(radii.session), []
    for means in (np.ones((len(radii), 1)), np.eye(len(groups))[groups.index]):
        sizes = []
        for columns in (np.column_stack((means, wheel.load_N)), means):
            basis = np.linalg.qr(columns)[0]
            slack = np.maximum(1.0 - np.sum(basis**2, axis=1), 1.0 / len(radii))
            sizes.append(float(np.std((wheel.radius_m - basis @ (basis.T @ wheel.radius_m)) / slack)))
        pairs.append((sizes[0], sizes[1]))
    return min(pairs, key=lambda pair: pair[0] / max(pair[1], 1e-300))


def _other_reading(radii: EffectiveRadii) -> str:
    """Return the readings of the table that explain both wheels' radii best; empty where chance may be as good.

    Each run is read as stated or otherwise, by the laws of all. Scatter comes that near to another reading with a
    probability of the ratio of the squares to the power of half their degrees of freedom, times the number of readings
    tried. A path moves both wheels: one wheel's degrees of freedom count.
    """
    loads = np.column_stack((radii.load_left_N, radii.load_right_N)) / float(np.max(radii.load_left_N))
    radius = np.column_stack((radii.radius_left_m, radii.radius_right_m))
    n, groups = len(loads), groups_of(radii.session)
    sessions = np.eye(len(groups))[groups.index]
    dof = n - len(groups) - 1
    pairs = np.unique(np.round(np.vstack((loads, loads[:, ::-1])), 2), axis=0)
    readings = {
        "with the loads of left and right exchanged in": (loads[:, ::-1][None], radius),
        "with the counts of left and right exchanged in": (loads[None], radius[:, ::-1]),
        "with the loads of the row before in": (np.roll(loads, 1, axis=0)[None], radius),
        "with the loads of the row after in": (np.roll(loads, -1, axis=0)[None], radius),
        "with loads of other runs in": (np.repeat(pairs[:, None], n, axis=1), radius),
    }
    stated = _squares(loads[None], radius[None], sessions, np.zeros(n, dtype=np.int64))[0]
    found = []
    for name, (other, moved) in readings.items() if dof > 0 and len(pairs) <= MAX_CELLS else ():
        options, measured = np.concatenate((loads[None], other)), np.stack((radius, *[moved] * len(other)))
        # all of them, or those of a session
        starts = [np.ones_like(groups.index), *(groups.index == at for at in range(-1, min(len(groups), MAX_CELLS)))]
        for start in starts if len(other) == 1 else _starts(loads, radius, pairs):
            square, chosen = _squares(options, measured, sessions, start.astype(np.int64))
            log_p = 0.5 * dof * np.log(max(square, 1e-300) / stated) + n * np.log(len(options))
            if log_p < np.log(FAIL_BELOW):
                found.append((log_p, square, f"{name} {listed(radii.run_id[chosen > 0])}"))
    if not found:
        return ""
    best, square, _ = min(found)
    # what is not clearly worse may be it, too
    alike = dict.fromkeys(words for log_p, _, words in sorted(found) if log_p + np.log(FAIL_BELOW) < best)
    scatter = UM * np.sqrt(square / (2 * dof))
    return f"read {', or '.join(alike)}, they scatter by {scatter:.3g} um: correct the table by the notes of the day"


def _starts(loads: FloatArray, radius: FloatArray, pairs: FloatArray) -> list[IntArray]:
    """Return each run's option of `pairs`, counted from 1, if radii rise or fall with the loads."""
    order = np.argsort(loads.sum(axis=1))
    nearest = 1 + np.argmin(np.abs(pairs[:, None] - loads[order]).sum(axis=2), axis=0)
    rank = np.argsort(np.argsort(radius.sum(axis=1)))
    return [nearest[rank], nearest[::-1][rank]]


def _squares(
    loads: FloatArray, radius: FloatArray, sessions: FloatArray, chosen: IntArray
) -> tuple[float, IntArray]:
    """Return the squares left by both laws and the option of each run, shape (n,), from those `chosen` at first.

    `loads`, `radius`: of each option, shape (n_options, n, 2); `sessions`: indicators, shape (n, n_sessions).
    """
    runs = np.arange(loads.shape[1])
    for _ in range(ROUNDS):
        squares = np.zeros(loads.shape[:2])
        for x, y in zip(np.moveaxis(loads, 2, 0), np.moveaxis(radius, 2, 0), strict=True):
            columns = np.column_stack((sessions, x[chosen, runs]))
            *shifts, slope = np.linalg.lstsq(columns, y[chosen, runs], rcond=None)[0]
            squares += (y - sessions @ shifts - slope * x) ** 2
        before, chosen = chosen, np.argmin(squares, axis=0)
        if (chosen == before).all():
            break
    return float(squares[before, runs].sum()), before
