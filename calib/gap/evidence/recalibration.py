"""Which of the three calibration parameters is really off, given the other effects that were found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.calibration import DIRECTIONS, NAMES, TYPICAL
from calib.gap.evidence.fit import Fitted
from calib.gap.evidence.marginal import CALIBRATION_SD, log_marginal
from calib.gap.evidence.models import SCALE_COST, effect_scale, log_evidence_parts
from calib.gap.evidence.noise import Noise
from calib.gap.evidence.search import Search, Settings
from calib.gap.evidence.system import LinearSystem
from calib.gap.evidence.weighting import prior_precision
from calib.gap.predict.path import Path

__all__ = ["PRIOR", "Recalibration", "judge_recalibration"]

#: prior odds of each being off
PRIOR: Final = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Recalibration:
    """Which calibration parameters are off.

    Parameters
    ----------
    subsets : tuple of tuple of str
        All subsets of `NAMES`, best first.
    probabilities : array of float, shape (n_subsets,)
        Their posterior probabilities.
    values, sd : array of float, shape (3,)
        Relative size of each, all three free, and its standard uncertainty.
    signal : array of float, shape (3,)
        Whitened norm of each at its fitted size.
    instead : mapping of str to tuple of str
        For each, effects of other likely sets beside which it is hardly off.
    """

    subsets: tuple[tuple[str, ...], ...]
    probabilities: FloatArray
    values: FloatArray
    sd: FloatArray
    signal: FloatArray
    instead: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def probability(self, name: str) -> float:
        """Return the probability that one of the three is off."""
        return float(sum(p for s, p in zip(self.subsets, self.probabilities, strict=True) if name in s))


#: share of an effect's whitened size that a calibration shift may have and still belong to it
EXCUSE: Final = 0.5
#: prior standard deviation of a found effect's size, at least, in typical sizes
LOOSE: Final = 3.0
#: a rival set is as likely as the best where it has more than this share of its probability
LIKELY: Final = 0.1
#: a calibration parameter less probable than this beside a rival set is needless there
NEEDLESS: Final = 0.2
SUBSETS: Final = tuple(subset for count in range(4) for subset in combinations(range(3), count))


def judge_recalibration(
    fitted: Fitted,
    nominal: Path,
    noise: Noise,
    settings: Settings,
    shifts: Mapping[str, tuple[str, ...]] | None = None,
    search: Search | None = None,
) -> Recalibration:
    """Weigh the subsets of the calibration's parameters against each other.

    A found effect may be centred elsewhere than assumed, or deviate from its form; a shift of the calibration up to
    `EXCUSE` times the effect's own size counts as part of the effect. Where other sets of effects are likely too, the
    calibration is judged beside each of them.

    Parameters
    ----------
    fitted : Fitted
        Fit of the effects found, the recalibration free.
    nominal : Path
        The model alone.
    noise : Noise
        Covariance of each unit.
    settings : Settings
        What the search takes for granted.
    shifts : mapping of str to tuple of str, optional
        For each effect, the calibration parameters that another zero point of it would look like.
    search : Search, optional
        Has the other sets of effects.

    Returns
    -------
    Recalibration
    """
    system = LinearSystem(fitted, nominal, noise, fitted.forms)
    own = [theta / form.typical for form, theta in zip(fitted.forms, fitted.theta, strict=True)]
    matrix = DIRECTIONS[:, :3].T
    values = np.linalg.solve(matrix, fitted.calibration[:3])
    inverse = np.linalg.inv(matrix)
    sd = np.sqrt(np.diag(inverse @ fitted.covariance[:3, :3] @ inverse.T))
    shifts = shifts or {}
    weighed = [(1.0, _subsets_beside(system, range(len(own)), own, values, settings, shifts))]
    for model, weight in search.rivals if search is not None else ():
        assert search is not None
        whole = search.system
        columns = np.concatenate([whole.calibration, *(whole.of(k) for k in model)], axis=1)
        estimates, _ = search.weighting.solve(columns, prior_precision(columns.shape[1]))
        cuts = np.cumsum([4, *(len(whole.forms[k].parameters) for k in model)])
        sizes = [estimates[first:last] for first, last in pairwise(cuts)]
        theirs = np.linalg.solve(matrix, estimates[:3] * CALIBRATION_SD[:3])
        weighed.append((weight, _subsets_beside(whole, model, sizes, theirs, settings, shifts)))
    instead = {name: _instead(k, fitted, search, weighed) for k, name in enumerate(NAMES)}
    total = sum(weight for weight, _ in weighed)
    probability = np.asarray(sum(weight * beside for weight, beside in weighed)) / total
    order = np.argsort(-probability, kind="stable")
    norm = np.sqrt((((system.calibration / CALIBRATION_SD) @ DIRECTIONS.T) ** 2).sum(axis=0))
    return Recalibration(
        subsets=tuple(tuple(NAMES[k] for k in SUBSETS[int(number)]) for number in order),
        probabilities=probability[order],
        values=values,
        sd=sd,
        signal=np.maximum(norm, 1e-12) * np.abs(values),
        instead=instead,
    )


def _instead(
    parameter: int, fitted: Fitted, search: Search | None, weighed: Sequence[tuple[float, FloatArray]]
) -> tuple[str, ...]:
    """Return single effects of likely rivals that make a calibration parameter needless."""
    if search is None:
        return ()
    holds = np.array([parameter in subset for subset in SUBSETS])
    own = {form.effect for form in fitted.forms}
    effects: list[str] = []
    for (model, weight), (_, probability) in zip(search.rivals, weighed[1:], strict=True):
        extra = {search.system.forms[k].effect for k in model} - own
        if weight > LIKELY and len(extra) == 1 and probability[holds].sum() < NEEDLESS:
            effects += extra
    return tuple(dict.fromkeys(effects))


def _subsets_beside(
    system: LinearSystem,
    model: Sequence[int],
    sizes: Sequence[FloatArray],
    values: FloatArray,
    settings: Settings,
    shifts: Mapping[str, tuple[str, ...]],
) -> FloatArray:
    """Return the probability of each of `SUBSETS` beside some forms at their sizes, shape (n_subsets,)."""
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
    sums = system.sums(scaled, np.concatenate(fixed, axis=1), deviations, prior_rest=settings.prior_rest)
    weights = np.zeros(len(SUBSETS))
    for place, subset in enumerate(SUBSETS):
        picked = list(subset)
        gram, right = sums.gram[:, picked][:, :, picked], sums.right[:, picked]
        log_det, gain = log_evidence_parts(gram, right, np.ones(len(picked)))
        value = settings.temper * (log_marginal(sums.square - gain, sums.log_det + log_det, sums.n_rows))
        value = value + sums.log_prior + len(picked) * (np.log(PRIOR) - settings.temper * SCALE_COST)
        top = value.max()
        weights[place] = top + np.log(np.exp(value - top).sum())
    weight = np.exp(weights - weights.max())
    return np.asarray(weight / weight.sum())
