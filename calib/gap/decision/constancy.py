"""Whether a cause has one size: an imitation is larger on some routes, speeds, loads, directions or sessions."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.gap.decision.diagnosis import Evidence
from calib.gap.decision.trials import groupings
from calib.gap.effects.calibration import DIRECTIONS, NAMES
from calib.gap.inference.fit import CALIBRATION_SD
from calib.gap.inference.least_squares import HeldOutFit
from calib.types import FloatArray, StrArray

#: probability that a true cause fails any of a campaign's tests of constancy, the usual level of a test
FALSE_REJECTION: Final = 0.05
#: whitened square of what a cause does on a group, at least: two standard deviations, else its size there is unknown
LEAST_SQUARE: Final = 4.0
#: spread of a size over groups that leaves it the same: two sizes a tenth apart leave a hundredth of the squares
SAME_SIZE_SD: Final = 0.05
#: prior precision of a size's difference between groups: a hundred times the size, which leaves it to the data
DIFFERENCE_PRECISION: Final = 1e-4


@dataclass(frozen=True, slots=True)
class SizeDifference:
    """A cause whose size differs between groups of runs beyond noise and what its form may deviate by."""

    effect: str  #: id of the effect
    by: str  #: what the runs are grouped by: ``kind``, ``speed``, ``load``, ``balance``, ``direction``, ``session``
    value: str  #: the group that differs most significantly
    reference: str  #: the group that determines the size best
    ratio: float  #: size on the one over the size on the other
    ratio_sd: float  #: standard uncertainty of the ratio
    p_value: float  #: of equal sizes on all groups

    @property
    def sentence(self) -> str:
        """What differs, with figures and what to do."""
        return (
            f"the size of {self.effect} differs by {self.by}: on {self.value} it is {self.ratio:.2g} +- "
            f"{2.0 * self.ratio_sd:.1g} times that on {self.reference} (p = {self.p_value:.1g}): another effect "
            "may act instead; 'calib plan' names the runs that tell"
        )


def size_differences(evidence: Evidence, effects: Collection[str]) -> dict[str, SizeDifference]:
    """Return, by effect, the effects whose sizes differ between groups of runs.

    A cause's contribution is given a further factor on each group, beside the recalibration and all fitted effects (a
    test of parameter constancy: Chow, Econometrica 28, 1960). The covariance holds the lack of fit and what each
    condition may deviate from the form by. The statistic follows F; levels are divided by the number of tests.
    """
    fit = HeldOutFit(evidence.fitted, evidence.nominal, evidence.noise, evidence.search.weighting)
    # what has a size of its own in each session has no common one
    names = {name for name in effects if not evidence.effects[name].per_session}
    groups = groupings(evidence.observations, by_balance=True)
    tested = [
        difference
        for effect, contribution in _contributions(evidence, fit, names).items()
        for by, labels in groups.items()
        if (difference := _difference(fit, effect, contribution, by, labels)) is not None
    ]
    differing: dict[str, SizeDifference] = {}
    for difference in sorted(tested, key=lambda each: each.p_value):
        if len(tested) * difference.p_value < FALSE_REJECTION:
            differing.setdefault(difference.effect, difference)
    return differing


def _contributions(evidence: Evidence, fit: HeldOutFit, names: Collection[str]) -> dict[str, FloatArray]:
    """Return what each named effect does at its fitted size, whitened, in the order of the fit's rows."""
    contributions, first = {}, 4
    for form, theta in zip(evidence.fitted.forms, evidence.fitted.theta, strict=True):
        contributions[form.effect] = fit.columns[:, first : first + len(theta)] @ (theta / form.typical)
        first += len(theta)
    per_unit = fit.weighting.system.calibration / CALIBRATION_SD
    for number, name in enumerate(NAMES):
        if name in evidence.calibration:
            contributions[name] = per_unit @ DIRECTIONS[number] * evidence.recalibration.values[number]
    return {name: contribution for name, contribution in contributions.items() if name in names}


def _difference(
    fit: HeldOutFit, effect: str, contribution: FloatArray, by: str, labels: StrArray
) -> SizeDifference | None:
    """Return how the size of a contribution (n_rows,) differs between groups of runs; None where one alone shows it."""
    from scipy.special import fdtrc

    on_rows = labels[fit.weighting.system.blocks.unit]
    squares = {str(value): float((contribution[on_rows == value] ** 2).sum()) for value in np.unique(labels)}
    reference, *others = sorted((v for v in squares if squares[v] > LEAST_SQUARE), key=lambda v: -squares[v]) or [""]
    if not others:
        return None
    further = np.column_stack([np.where(on_rows == value, contribution, 0.0) for value in others])
    precision = np.concatenate([fit.precision, np.full(len(others), DIFFERENCE_PRECISION)])
    estimates, covariance = fit.weighting.solve(np.concatenate([fit.columns, further], axis=1), precision)
    change, covariance = estimates[-len(others) :], covariance[-len(others) :, -len(others) :]
    sd = np.sqrt(np.diag(covariance))
    covariance = covariance + SAME_SIZE_SD**2 * (np.eye(len(others)) + 1.0)
    largest = int(np.argmax(np.abs(change) / sd))
    statistic = float(change @ np.linalg.solve(covariance, change)) / len(others)
    p_value = float(fdtrc(len(others), max(fit.noise.dof, 3.0), statistic))
    ratio = 1.0 + float(change[largest])
    return SizeDifference(effect, by, others[largest], reference, ratio, float(sd[largest]), p_value)
