"""Whether a result is adequate: held against the residuals it leaves, on runs that it has not seen, and the noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

#: a residual of so many times the noise is a lack of fit: chance makes a mean square of 9 in no campaign of ten runs
LACK_OF_FIT: Final = 3.0
#: a residual below this share of the way travelled (of the rotation, for headings) is as small as calibrated wheel
#: odometry gets (UMBmark's and our real recordings: 0.1 to 0.5 %), even where replicates scatter less
SMALL_SHARE: Final = 0.005
#: a result that leaves more than this share of the error on held-out runs explains nothing of it
USELESS_SHARE: Final = 0.9
#: a residual above this share of the way travelled, or of the rotation, is no calibration
WRONG_SHARE: Final = 0.05


class Level(IntEnum):
    """How far a result may be believed."""

    ADEQUATE = 0
    DOUBTFUL = 1
    WRONG = 2


@dataclass(frozen=True, slots=True)
class Residuals:
    """Root mean squares of one quantity, all in its unit, and what it is relative to (way or rotation), likewise."""

    before: float
    after: float
    held_out: float
    noise: float
    travelled: float
    #: what the stated noise of the reference and the usual drift make of it
    usual_noise: float = math.inf


def judge(
    residuals: Residuals, what: str = "position", unit: str = "mm", scale: float = 1e3
) -> tuple[Level, tuple[str, ...]]:
    """Return how far a result may be believed, and why it may not.

    `what`, `unit`, `scale`: for the sentences; a residual times `scale` is in `unit`.
    """
    before, after, held_out, noise = (
        f"{scale * value:.3g} {unit}"
        for value in (residuals.before, residuals.after, residuals.held_out, residuals.noise)
    )
    of = "way travelled" if what == "position" else "rotation"
    scattered = residuals.noise / max(residuals.travelled, 1e-12)
    if scattered > WRONG_SHARE and residuals.noise > LACK_OF_FIT * residuals.usual_noise:
        reason = f"{what}: replicates scatter by {noise}, {100 * scattered:.2g} % of the {of}"
        return Level.WRONG, (f"{reason}: more than wheels that roll; look for slip and a bad reference",)
    unusual = LACK_OF_FIT * residuals.usual_noise
    if min(residuals.noise, residuals.before) > unusual and residuals.held_out > USELESS_SHARE * residuals.before:
        reason = (
            f"{what}: nothing of {before} is explained, and stretches that look alike to the wheels scatter by {noise}"
        )
        return Level.DOUBTFUL, (f"{reason}: the wheels, or a steering sensor, do not tell how the vehicle moved",)
    small = max(LACK_OF_FIT * residuals.noise, SMALL_SHARE * residuals.travelled)
    if max(residuals.after, residuals.held_out) <= small:
        return Level.ADEQUATE, ()
    if residuals.before > small and residuals.held_out > USELESS_SHARE * residuals.before:
        reason = f"{what}: on held-out runs it leaves {held_out} of {before}: these parameters do not explain the error"
        return Level.WRONG, (reason,)
    share = max(residuals.after, residuals.held_out) / max(residuals.travelled, 1e-12)
    where = f"{after} on the runs used, {held_out} on held-out runs, noise {noise}"
    if share > WRONG_SHARE:
        return Level.WRONG, (f"{what}: the residual is {100 * share:.2g} % of the {of} ({where})",)
    return Level.DOUBTFUL, (f"{what}: the residual is {held_out_ratio(residuals):.2g} times the noise ({where})",)


def held_out_ratio(residuals: Residuals) -> float:
    """Return the larger of the residuals after the fit over the noise."""
    return max(residuals.after, residuals.held_out) / max(residuals.noise, 1e-12)
