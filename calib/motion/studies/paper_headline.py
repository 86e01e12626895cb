"""The paper's headline: what the load correction is worth at the end of its route, computed from its own equations.

The paper prints 1.1 m and 0.06 m. Both are rounded, so that their quotient, 18, is good to one digit only; the same
study computed without rounding gives about 17 at any track.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

from calib.motion.routes import Route, find_route
from calib.motion.studies.sweeps import STUDIES, Case, run_sweep

#: end error along the route without and with the load correction, as the paper prints them (Sect. 7.3)
PAPER_BEFORE_M: Final = 1.1
PAPER_AFTER_M: Final = 0.06

#: the vehicle's track as the paper states it
PAPER_TRACK_M: Final = 0.7


@dataclass(frozen=True, slots=True)
class Improvement:
    """End errors without and with a correction, and their ratio; None where the corrected error is nought."""

    before_m: float
    after_m: float
    ratio: float | None


@dataclass(frozen=True, slots=True)
class Headline:
    """End error without and with the correction, each the largest case of its sweep, and their ratio."""

    which: str  #: wheel that is off
    #: without_m, corrected_m: largest global e_x by absolute value
    without_m: float
    corrected_m: float
    ratio: float  #: how many times smaller the corrected one is


def headlines(route: Route, track_m: float) -> tuple[Headline, ...]:
    """Set the study of corrected radii against that of uncorrected ones, on the same route, wheel by wheel."""
    before, after = STUDIES["asymmetric"], STUDIES["corrected"]
    lines = []
    for which in before.which:
        first, second = (
            run_sweep(route, [Case.off(which, ratio) for ratio in study.ratios], track_m=track_m).largest_m()
            for study in (before, after)
        )
        lines.append(Headline(which, first, second, first / second))
    return tuple(lines)


@cache
def paper_headline() -> Improvement:
    """Return the paper's end errors as printed, and their ratio before rounding."""
    largest = max(headlines(find_route("paper_route"), PAPER_TRACK_M), key=lambda line: line.without_m)
    return Improvement(PAPER_BEFORE_M, PAPER_AFTER_M, largest.ratio)
