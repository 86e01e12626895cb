"""Which calibration parameters are off beside some forms: the weight of each subset of them, and of all left free."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.calibration import DIRECTIONS, NAMES, TYPICAL
from calib.gap.evidence.climb import Settings
from calib.gap.evidence.marginal import CALIBRATION_SD, log_marginal
from calib.gap.evidence.models import SCALE_COST, effect_scale, log_evidence_parts
from calib.gap.evidence.system import LinearSystem
from calib.gap.evidence.weighting import Weighting, prior_precision

__all__ = ["PRIOR", "SUBSETS", "SubsetWeights", "sizes_beside", "weigh_subsets"]

#: prior odds of each being off
PRIOR: Final = 0.1
#: share of an effect's whitened size that a calibration shift may have and still belong to it
EXCUSE: Final = 0.5
#: prior standard deviation of a found effect's size, at least, in typical sizes
LOOSE: Final = 3.0
SUBSETS: Final = tuple(subset for count in range(4) for subset in combinations(range(3), count))


@dataclass(frozen=True, slots=True, eq=False)
class SubsetWeights:
    """Log weights beside some forms, of each of `SUBSETS`, shape (n_subsets,), and of a calibration left free."""

    each: FloatArray
    free: float

    @property
    def probabilities(self) -> FloatArray:
        """Of each subset, shape (n_subsets,)."""
        weight = np.exp(self.each - self.each.max())
        return np.asarray(weight / weight.sum())

    @property
    def over_free(self) -> float:
        """Log weight of all subsets together over that of a calibration left free.

        A set of causes that explains the gap with the calibration as it is says more than one that needs it off.
        """
        return float(np.logaddexp.reduce(self.each)) - self.free


def sizes_beside(
    system: LinearSystem, model: Sequence[int], weighting: Weighting
) -> tuple[list[FloatArray], FloatArray]:
    """Return the size of each form of a model in typical sizes, and the relative calibration (3,), all free."""
    columns = np.concatenate([system.calibration, *(system.of(k) for k in model)], axis=1)
    estimates, _ = weighting.solve(columns, prior_precision(columns.shape[1]))
    cuts = np.cumsum([4, *(len(system.forms[k].parameters) for k in model)])
    sizes = [estimates[first:last] for first, last in pairwise(cuts)]
    return sizes, np.linalg.solve(DIRECTIONS[:, :3].T, estimates[:3] * CALIBRATION_SD[:3])


def weigh_subsets(
    system: LinearSystem,
    model: Sequence[int],
    sizes: Sequence[FloatArray],
    values: FloatArray,
    settings: Settings,
    shifts: Mapping[str, tuple[str, ...]],
) -> SubsetWeights:
    """Weigh the subsets of the calibration's parameters beside some forms.

    An effect may be centred elsewhere than assumed, or deviate from its form; a shift of the calibration up to `EXCUSE`
    times the effect's own size counts as part of the effect.

    Parameters
    ----------
    system : LinearSystem
        The linear picture.
    model : sequence of int
        Forms, by their numbers in the system.
    sizes : sequence of array of float
        Size of each, in typical sizes.
    values : array of float, shape (3,)
        Relative size of each calibration parameter beside them, all free.
    settings : Settings
        What the search takes for granted.
    shifts : mapping of str to tuple of str
        For each effect, the calibration parameters that another zero point of it would look like.
    """
    directions = (system.calibration / CALIBRATION_SD) @ DIRECTIONS.T
    norm = np.maximum(np.sqrt((directions**2).sum(axis=0)), 1e-12)
    fixed = [system.calibration[:, 3:]]
    deviations = np.zeros((len(system.gap), len(model)))
    for place, (number, size) in enumerate(zip(model, sizes, strict=True)):
        form = system.forms[number]
        contribution = system.of(number) @ size
        fixed.append(system.of(number) * max(effect_scale(size, form), LOOSE))
        deviations[:, place] = settings.tolerance * contribution
        looks_like = [NAMES.index(name) for name in shifts.get(form.effect, ())]
        fixed.append((directions / norm)[:, looks_like] * (EXCUSE * np.sqrt((contribution**2).sum())))
    scaled = directions * TYPICAL * np.clip(np.abs(values) / TYPICAL, 0.1, 10.0)
    columns = np.concatenate([scaled, system.calibration[:, :3]], axis=1)
    sums = system.sums(columns, np.concatenate(fixed, axis=1), deviations, prior_rest=settings.prior_rest)

    def weight(picked: Sequence[int]) -> float:
        gram, right = sums.gram[:, picked][:, :, picked], sums.right[:, picked]
        log_det, gain = log_evidence_parts(gram, right, np.ones(len(picked)))
        value = settings.temper * (log_marginal(sums.square - gain, sums.log_det + log_det, sums.n_rows))
        return float(np.logaddexp.reduce(value + sums.log_prior))

    cost = np.log(PRIOR) - settings.temper * SCALE_COST
    each = [weight(list(subset)) + len(subset) * cost for subset in SUBSETS]
    return SubsetWeights(np.array(each), weight([3, 4, 5]))
