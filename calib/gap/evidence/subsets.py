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

#: prior odds of one being off by itself, whichever it is
ANY: Final = 0.3
#: share of an effect's whitened size that a calibration shift may have and still belong to it
EXCUSE: Final = 0.5
#: prior standard deviation of a found effect's size, at least, in typical sizes
LOOSE: Final = 3.0
#: all subsets of the relative calibration, by their numbers: both radii (0), their ratio (1), the track (2)
SUBSETS: Final = tuple(subset for count in range(4) for subset in combinations(range(3), count))
#: the radius of one wheel, left (3) or right (4), is as likely off by itself: the radii are then off both in scale and
#: in ratio; alone, or beside the track (2)
_ONE_WHEEL: Final = ((3,), (4,), (2, 3), (2, 4))


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


def log_prior_of(count: int, settings: Settings) -> float:
    """Return the log prior odds of one subset of so many parameters, over none being off.

    Of a vehicle that was never calibrated more than one is off: as with effects, every number is less likely than one
    fewer by the same odds, and of so many all subsets are as likely.
    """
    if not count:
        return 0.0
    alike = sum(len(subset) == count for subset in SUBSETS + _ONE_WHEEL)
    return float(np.log(ANY) + (count - 1) * np.log(settings.further) - np.log(alike))


def without_idle(subset: tuple[int, ...], probabilities: FloatArray, settings: Settings) -> tuple[int, ...]:
    """Return a subset without what the runs say nothing of: parameters that are no likelier for what was measured.

    Of what does not show, the prior alone is left, and by that three may well be off together.

    Parameters
    ----------
    subset : tuple of int
        One of `SUBSETS`.
    probabilities : array of float, shape (n_subsets,)
        Of each of `SUBSETS`.
    settings : Settings
        What the search takes for granted.
    """
    prior = {own: np.exp(log_prior_of(len(own), settings)) for own in SUBSETS}
    for way in _ONE_WHEEL:
        prior[_both_radii(way)] += np.exp(log_prior_of(len(way), settings))
    spoken = {own: float(p) / prior[own] for own, p in zip(SUBSETS, probabilities, strict=True)}
    while len(subset) > 1:
        best = max((tuple(k for k in subset if k != own) for own in subset), key=lambda fewer: spoken[fewer])
        if spoken[best] < spoken[subset]:
            break
        subset = best
    return subset


def _both_radii(way: tuple[int, ...]) -> tuple[int, ...]:
    """Return the subset that one wheel's radius, alone or beside the track, belongs to."""
    return (0, 1, *way[:-1])


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
    ways = np.concatenate([DIRECTIONS, np.eye(4)[:2]])
    typical = np.concatenate([TYPICAL, TYPICAL[:1], TYPICAL[:1]])
    times = np.concatenate([values, (values @ DIRECTIONS)[:2]]) / typical
    columns = np.concatenate(
        [(system.calibration / CALIBRATION_SD) @ ways.T * typical, system.calibration[:, :3]], axis=1
    )
    sums = system.sums(columns, np.concatenate(fixed, axis=1), deviations, prior_rest=settings.prior_rest)

    def weight(picked: Sequence[int], scale: float) -> float:
        gram, right = sums.gram[:, picked][:, :, picked], sums.right[:, picked]
        log_det, gain = log_evidence_parts(gram, right, np.full(len(picked), scale**2))
        value = log_marginal(sums.square - gain, sums.log_det + log_det, sums.n_rows)
        return float(np.logaddexp.reduce(value + sums.log_prior))

    def of_subset(subset: tuple[int, ...]) -> float:
        picked = list(subset)
        if not picked:
            return weight(picked, 1.0)
        # as with the parameters of a form: one scale for all that is off, chosen by its size and paid for once
        scale = float(np.clip(np.sqrt(np.mean(times[picked] ** 2)), 0.1, 10.0))
        return weight(picked, scale) + log_prior_of(len(picked), settings) - SCALE_COST

    weights = {subset: of_subset(subset) for subset in SUBSETS + _ONE_WHEEL}
    for subset in _ONE_WHEEL:
        both = _both_radii(subset)
        weights[both] = float(np.logaddexp(weights[both], weights[subset]))
    return SubsetWeights(np.array([weights[subset] for subset in SUBSETS]), weight([5, 6, 7], 1.0))
